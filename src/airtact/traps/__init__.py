"""Acoustic traps for small beads: signatures, Gor'kov potential, force, stiffness and verdict."""

from airtact.lazy import attached

__getattr__, __dir__, __all__ = attached(__name__, __file__)
