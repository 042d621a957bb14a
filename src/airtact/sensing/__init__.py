"""Location of a hand from echoes of the array's own coded transmissions, and calibration."""

from airtact.lazy import attached

__getattr__, __dir__, __all__ = attached(__name__, __file__)
