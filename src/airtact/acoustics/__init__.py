"""What is in the air: media, bodies, sources and targets. No acoustics is solved here."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
