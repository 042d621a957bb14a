"""A hand computed from its joints: its shape, its skin and its motion."""

from airtact.lazy import attached

__getattr__, __dir__, __all__ = attached(__name__, __file__)
