"""Scenes: media, bodies, sources and targets. The solvers are in ``solvers``."""

from airtact.lazy import attached

__getattr__, __dir__, __all__ = attached(__name__, __file__)
