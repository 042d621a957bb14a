"""Fields and figures of merit of a drive, from a solver that did not compute the drive."""

from airtact.lazy import attached

__getattr__, __dir__, __all__ = attached(__name__, __file__)
