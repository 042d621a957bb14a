"""What the echoes of a hand in the array's own sound show: coded transmissions, and where the hand is."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
