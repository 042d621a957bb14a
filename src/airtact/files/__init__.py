"""Reading of files within size limits, atomic writing, and tables of text."""
