"""Calibration of the array, and location of a hand from echoes of its coded transmissions."""

from airtact.lazy import attached

__getattr__, __dir__, __all__ = attached(__name__, __file__)
