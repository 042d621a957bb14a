"""A hand fitted to a cloud of points."""
