"""The pose of a hand from echoes of the array's own coded transmissions, and calibration."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
