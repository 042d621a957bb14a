"""Figures and HTML pages of results, and the plotting functions of ``airtact.plot``."""

from airtact.lazy import attached

__getattr__, __dir__, __all__ = attached(__name__, __file__)
