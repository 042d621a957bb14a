"""Closed surfaces of bodies: their shapes, panels, union and checks."""
