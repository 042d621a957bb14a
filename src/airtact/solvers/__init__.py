"""How sound travels: a scene and monopoles in, a radiated field out."""

from airtact.solvers.bem.factorised_bodies import FactorisedBodies
from airtact.solvers.bem.field import BoundaryField
from airtact.solvers.bem.solver import BoundaryElement
from airtact.solvers.fem.field import FiniteField
from airtact.solvers.fem.solver import FactorisedScene, FiniteElement
from airtact.solvers.free_field import FreeField, OpenAirField
from airtact.solvers.problem import RadiatedField, Solver, SolveReport, SurfaceField
from airtact.solvers.sampled_field import SampledField, load_samples
from airtact.solvers.spherical.multipole_field import multipole_expansion
from airtact.solvers.spherical.sphere_series import SphereField, SphereSeries

__all__ = [
    "BoundaryElement",
    "BoundaryField",
    "FactorisedBodies",
    "FactorisedScene",
    "FiniteElement",
    "FiniteField",
    "FreeField",
    "OpenAirField",
    "RadiatedField",
    "SampledField",
    "SolveReport",
    "Solver",
    "SphereField",
    "SphereSeries",
    "SurfaceField",
    "load_samples",
    "multipole_expansion",
]
