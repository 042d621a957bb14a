"""Functions that read files within size limits, write files atomically, and parse text tables."""
