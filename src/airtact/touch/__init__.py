"""Virtual objects in the air, and their contacts with the skin of a hand."""

from airtact.lazy import attached

__getattr__, __dir__, __all__ = attached(__name__, __file__)
