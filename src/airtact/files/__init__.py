"""Files of panels and fields for other programs, and drives read back."""
