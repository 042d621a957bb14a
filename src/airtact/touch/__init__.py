"""Virtual objects in the air, and the contacts of a hand's skin with them."""

from airtact.lazy import attached

__getattr__, __dir__, __all__ = attached(__name__, __file__)
