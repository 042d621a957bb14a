"""Plain arrays of vertices and triangles: no physics, no Surface."""
