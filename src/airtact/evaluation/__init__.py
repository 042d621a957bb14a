"""Fields and figures of merit of a drive, from a solver that was not used to compute the drive."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
