"""The boundary element method (BEM) for sound-hard and impedance bodies."""
