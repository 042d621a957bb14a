"""Drives that account for the hand, and the processes that solve for its scattering."""
