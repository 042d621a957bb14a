"""The scene file: a TOML text that describes what is in the air, the array and what a person feels."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
