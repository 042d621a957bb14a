"""Solvers that compute the field that monopoles radiate in a scene."""
