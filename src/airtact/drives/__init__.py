"""What to emit: a transfer matrix and a target in, a drive or a sequence out."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
