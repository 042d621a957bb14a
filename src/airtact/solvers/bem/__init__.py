"""The boundary element method (BEM) for sound-hard bodies."""
