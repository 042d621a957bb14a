"""Closed surfaces of bodies: their shapes, panels, unions and checks."""

from airtact.lazy import attached

__getattr__, __dir__, __all__ = attached(__name__, __file__)
