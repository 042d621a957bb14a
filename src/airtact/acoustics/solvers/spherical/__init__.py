"""Solutions in spherical waves: the series of one sphere, and multipole expansions."""
