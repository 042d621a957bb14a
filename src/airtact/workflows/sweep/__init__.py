"""A scene file at many points of its keys."""
