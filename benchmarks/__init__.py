"""What the README measures."""
