"""Transfer matrices, and the drives and sequences computed from them."""

from airtact.lazy import attached

__getattr__, __dir__, __all__ = attached(__name__, __file__)
