"""What is in the air: media, bodies, sources and targets. No acoustics is solved here."""
