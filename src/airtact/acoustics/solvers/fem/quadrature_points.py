"""Quadrature points on the surfaces of the bodies and inside filled ones."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex128, Float64, Int64
from scipy.sparse import csr_array

from airtact.acoustics.solvers.arrays import (
    Coefficients,
)
from airtact.acoustics.solvers.fem.libraries import CurvedMesh, FiniteSpace, ngsolve_library

# Highest order of quadrature in tetrahedra: NGSolve 6.2.2608 mixes up the points of higher ones
MAX_RULE_ORDER = 5


@dataclass(frozen=True, eq=False, repr=False)
class QuadraturePoints:
    """Quadrature points on the surfaces of the bodies, or inside filled bodies.

    Attributes
    ----------
    points, normals : [λ]; the normals out of the body, 0 inside.
    areas : (Q,) area [λ²] or volume [λ³] that each represents.
    body : (Q,) obstacle of each.
    weighted : (unknowns, Q) integrates values at the points against the test functions.
    """

    points: Float64[np.ndarray, "nodes 3"]
    normals: Float64[np.ndarray, "nodes 3"]
    areas: Float64[np.ndarray, "nodes"]
    body: Int64[np.ndarray, "nodes"]
    weighted: csr_array

    def pressure(self, solution: Coefficients) -> Complex128[np.ndarray, "nodes excitations"]:
        """Pressure of a solution at the points."""
        return (self.weighted.T @ solution) / self.areas[:, None]


def quadrature(mesh: CurvedMesh, space: FiniteSpace, kind: str, order: int) -> QuadraturePoints:
    """Quadrature points of the boundaries ``surface0`` ... or the materials ``body0`` ..."""
    ngsolve = ngsolve_library()
    on_surface = kind == "surface"
    names = mesh.GetBoundaries() if on_surface else mesh.GetMaterials()
    owners = {name: int(name.removeprefix(kind)) for name in names if name.startswith(kind)}
    if not owners:
        no_points = np.zeros((0, 3))
        no_bodies = np.zeros(0, dtype=np.int64)
        return QuadraturePoints(
            no_points, no_points, np.zeros(0), no_bodies, csr_array((space.ndof, 0))
        )
    if on_surface:
        region = mesh.Boundaries(f"{kind}.*")
        values = ngsolve.comp.IntegrationRuleSpaceSurface(mesh, order=order)
        measure = ngsolve.ds
        owner_of = mesh.BoundaryCF(owners, default=-1)
    else:
        region = mesh.Materials(f"{kind}.*")
        values = ngsolve.comp.IntegrationRuleSpace(mesh, order=order)
        measure = ngsolve.dx
        owner_of = mesh.MaterialCF(owners, default=-1)
    rules = values.GetIntegrationRules()
    integral = ngsolve.BilinearForm(trialspace=values, testspace=space)
    integrand = values.TrialFunction() * space.TestFunction()
    integral += integrand * measure(definedon=region, intrules=rules)
    integral.Assemble()
    entries, columns, row_starts = (np.array(part) for part in integral.mat.CSR())
    matrix = csr_array(
        (np.real(entries), columns, row_starts), shape=(integral.mat.height, integral.mat.width)
    )
    # The matrix has columns for the points of all elements; those of the region are wanted.
    mapped = mesh.MapToAllElements(rules, region)
    per_element = len(mapped) // len(np.unique(mapped["nr"]))
    within = np.tile(np.arange(per_element), len(mapped) // per_element)
    chosen = matrix.tocsc()[:, mapped["nr"].astype(np.int64) * per_element + within]
    points = np.asarray(ngsolve.CF((ngsolve.x, ngsolve.y, ngsolve.z))(mapped)).reshape(-1, 3)
    normals = np.zeros_like(points)
    if on_surface:
        normals = -np.asarray(ngsolve.specialcf.normal(3)(mapped)).reshape(-1, 3)
    # Integrating 1 against each point gives the area or volume that it represents.
    ones = np.zeros(space.ndof)
    ones[: mesh.nv] = 1.0  # the shape functions of the vertices add up to 1 everywhere
    body = np.asarray(owner_of(mapped)).ravel().round().astype(np.int64)
    return QuadraturePoints(points, normals, chosen.T @ ones, body, csr_array(chosen))
