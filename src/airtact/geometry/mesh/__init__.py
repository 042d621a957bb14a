"""Functions on plain arrays of vertices and triangles, without physics or ``Surface``."""
