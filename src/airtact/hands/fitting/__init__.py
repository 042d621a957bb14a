"""Fit a hand model to a point cloud."""
