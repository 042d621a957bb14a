"""Reading of files within size limits, atomic writing, and text tables."""
