"""Functions on plain arrays of vertices and triangles."""
