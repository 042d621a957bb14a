"""Scenes: media, bodies, sources and targets. The solvers are in ``solvers``."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
