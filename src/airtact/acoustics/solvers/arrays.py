"""Array types of the solvers. Axes with the same name in a signature have the same length."""

import numpy as np
from jaxtyping import Bool, Complex128, Float64, Int64, Real

Points = Real[np.ndarray, "points 3"]
Vectors = Float64[np.ndarray, "points 3"]  # positions or directions
Mask = Bool[np.ndarray, "points"]
Indices = Int64[np.ndarray, "points"]
Lengths = Float64[np.ndarray, "points"]
# Barycentric coordinates of each point in its tetrahedron.
Barycentric = Float64[np.ndarray, "points 4"]
Pressures = Complex128[np.ndarray, "points excitations"]
Gradients = Complex128[np.ndarray, "points 3 excitations"]  # also velocities

SourcePoints = Real[np.ndarray, "sources 3"]
Strengths = Complex128[np.ndarray, "sources excitations"]
Coefficients = Complex128[np.ndarray, "unknowns excitations"]
# A number for each pair of point and source.
Pairs = Float64[np.ndarray, "points sources"]
ComplexPairs = Complex128[np.ndarray, "points sources"]

NodePoints = Float64[np.ndarray, "nodes 3"]  # also normals
NodeValues = Complex128[np.ndarray, "nodes excitations"]
# Second collocation points, each shared by three neighbouring nodes of a panel.
GroupPoints = Float64[np.ndarray, "groups 3"]
PanelPoints = Float64[np.ndarray, "panels 3"]
PanelLengths = Float64[np.ndarray, "panels"]
Admittances = Complex128[np.ndarray, "panels"]
# ikρc/Z times the area of each node; empty if all bodies are sound-hard.
SingleLayer = Complex128[np.ndarray, "_"]
# Bounds of each point's panels in the list of panels, and that list.
NearLists = tuple[Int64[np.ndarray, "_"], Int64[np.ndarray, "_"]]
