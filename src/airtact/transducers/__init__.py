"""Transducers, and their arrangement in boards and arrays."""

from airtact.lazy import attached

__getattr__, __dir__, __all__ = attached(__name__, __file__)
