"""Tetrahedra between the bodies and the perfectly matched layer."""
