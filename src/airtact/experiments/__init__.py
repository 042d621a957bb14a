"""Published experiments, done again from the paper's own numbers: their figures, and what comes out."""

PAPERS = ("inoue2014",)
"""The papers by name, each a module of this room with a function ``reproduce``."""
