"""The arrays of the solvers by what they hold; an axis of the same name has the same length within a signature."""

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
