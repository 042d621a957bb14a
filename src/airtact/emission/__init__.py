"""Emission of drives: messages to boards, links to boards, and safe shutdown."""

from airtact.lazy import attached

__getattr__, __dir__, __all__ = attached(__name__, __file__)
