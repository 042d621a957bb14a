"""Array types of meshes. Axes with the same name in a signature have the same length."""

import numpy as np
from jaxtyping import Bool, Float64, Int64, Real

Points = Real[np.ndarray, "points 3"]
PointVectors = Float64[np.ndarray, "points 3"]
PointLengths = Float64[np.ndarray, "points"]
Vector3 = Float64[np.ndarray, "3"]

Vertices = Float64[np.ndarray, "vertices 3"]
VertexSizes = Float64[np.ndarray, "vertices"]

# Indices of the three vertices of each triangle.
Triangles = Int64[np.ndarray, "triangles 3"]

# Triangles of a result, whose number differs from that of the arguments.
NewTriangles = Int64[np.ndarray, "_ 3"]

# Positions of the corners of each triangle [m].
Corners = Real[np.ndarray, "triangles 3 3"]

# Index of the same edge in the neighbour, for each edge 01, 12, 20; see ``edge_twins``.
Twins = Int64[np.ndarray, "triangles 3"]

# Whether each of the edges 01, 12, 20 is in a set.
EdgeMask = Bool[np.ndarray, "triangles 3"]

# A vector for each edge or corner of each triangle.
EdgeVectors = Float64[np.ndarray, "triangles 3 3"]
TriangleVectors = Float64[np.ndarray, "triangles 3"]
TriangleMask = Bool[np.ndarray, "triangles"]
TriangleLabels = Int64[np.ndarray, "triangles"]

# The two ends of each sharp edge.
Ridges = Int64[np.ndarray, "ridges 2"]

# Curved panels: corners 0, 1, 2 and points of the surface at the middles of edges 01, 12, 20 [m].
QuadraticTriangles = Float64[np.ndarray, "panels 6 3"]
Pieces = Float64[np.ndarray, "_ 6 3"]

# One triangle for each pair that is compared [m].
PairedCorners = Real[np.ndarray, "n 3 3"]
PairedSegments = Real[np.ndarray, "n 2 3"]
PairMask = Bool[np.ndarray, "n"]

# Indices of the two triangles of each pair.
IndexPairs = Int64[np.ndarray, "_ 2"]
Indices = Int64[np.ndarray, "n"]

# Vertices [m] and triangles of a mesh of flat triangles.
FlatMesh = tuple[Float64[np.ndarray, "_ 3"], NewTriangles]
