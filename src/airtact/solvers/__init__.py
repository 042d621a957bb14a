"""How sound travels: a scene and monopoles in, a radiated field out."""

from airtact.solvers.bem.solver import BoundaryElement
from airtact.solvers.fem.solver import FiniteElement
from airtact.solvers.free_field import FreeField
from airtact.solvers.problem import RadiatedField, Solver, SolveReport, SurfaceField
from airtact.solvers.sampled_field import SampledField, load_samples
from airtact.solvers.spherical.multipole_field import multipole_expansion
from airtact.solvers.spherical.sphere_series import SphereSeries

__all__ = [
    "BoundaryElement",
    "FiniteElement",
    "FreeField",
    "RadiatedField",
    "SampledField",
    "SolveReport",
    "Solver",
    "SphereSeries",
    "SurfaceField",
    "load_samples",
    "multipole_expansion",
]
