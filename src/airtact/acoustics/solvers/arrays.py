"""Array types of the solvers. Axes of one name have one length within a signature."""

import numpy as np
from jaxtyping import Bool, Complex128, Float64, Int64, Real

Points = Real[np.ndarray, "points 3"]
Vectors = Float64[np.ndarray, "points 3"]
"""A position or a direction for each point."""

Mask = Bool[np.ndarray, "points"]
Indices = Int64[np.ndarray, "points"]
Lengths = Float64[np.ndarray, "points"]
Barycentric = Float64[np.ndarray, "points 4"]
"""Weights of the corners of the tetrahedron that holds each point."""

Pressures = Complex128[np.ndarray, "points excitations"]
Gradients = Complex128[np.ndarray, "points 3 excitations"]
"""Also velocities."""

SourcePoints = Real[np.ndarray, "sources 3"]
Strengths = Complex128[np.ndarray, "sources excitations"]
Coefficients = Complex128[np.ndarray, "unknowns excitations"]
Pairs = Float64[np.ndarray, "points sources"]
ComplexPairs = Complex128[np.ndarray, "points sources"]
"""A number for each point and source, as for unit monopoles."""

NodePoints = Float64[np.ndarray, "nodes 3"]
"""Also normals."""

GroupPoints = Float64[np.ndarray, "groups 3"]
"""Second collocation points, each shared by three neighbouring nodes of a panel."""

NodeValues = Complex128[np.ndarray, "nodes excitations"]
PanelPoints = Float64[np.ndarray, "panels 3"]
PanelLengths = Float64[np.ndarray, "panels"]
Admittances = Complex128[np.ndarray, "panels"]
SingleLayer = Complex128[np.ndarray, "_"]
"""ikρc/Z times area [m] of each node; empty if all are sound-hard."""

NearLists = tuple[Int64[np.ndarray, "_"], Int64[np.ndarray, "_"]]
"""Bounds of each point's panels, and the panels."""
