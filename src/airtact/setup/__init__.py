"""Scene files, setups and rendering: the steps from a TOML file to a verified drive."""

from airtact.lazy import attached

__getattr__, __dir__, __all__ = attached(__name__, __file__)
