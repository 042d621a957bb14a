"""Solvers: from a scene and monopoles to the radiated field."""
