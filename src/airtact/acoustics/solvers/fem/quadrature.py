"""Quadrature points on the surfaces of the bodies, and inside filled bodies."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Complex128, Float64, Int64
from scipy.sparse import csr_array

from airtact.acoustics.solvers.arrays import Coefficients
from airtact.acoustics.solvers.fem.meshing.netgen import CurvedMesh, FiniteSpace, ngsolve_library
from airtact.printing import in_short

LARGEST_RULE = 5
"""NGSolve 6.2.2608 mixes up the points of larger rules in tetrahedra."""


@dataclass(frozen=True, eq=False)
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

    __repr__ = in_short

    def pressure(self, solution: Coefficients) -> Complex128[np.ndarray, "nodes excitations"]:
        """Pressure of a solution at the points."""
        return (self.weighted.T @ solution) / self.areas[:, None]


def quadrature(mesh: CurvedMesh, space: FiniteSpace, kind: str, order: int) -> QuadraturePoints:
    """Quadrature points, exact to twice an order, of the boundaries ``surface0`` ... or the materials ``body0`` ..."""
    ngsolve = ngsolve_library()
    on_surface = kind == "surface"
    names = mesh.GetBoundaries() if on_surface else mesh.GetMaterials()
    owners = {name: int(name.removeprefix(kind)) for name in names if name.startswith(kind)}
    if not owners:
        none, nothing = np.zeros((0, 3)), np.zeros(0)
        return QuadraturePoints(
            none, none, nothing, np.zeros(0, dtype=np.int64), csr_array((space.ndof, 0))
        )
    region = mesh.Boundaries(f"{kind}.*") if on_surface else mesh.Materials(f"{kind}.*")
    rules_space = (
        ngsolve.comp.IntegrationRuleSpaceSurface
        if on_surface
        else ngsolve.comp.IntegrationRuleSpace
    )
    values = rules_space(mesh, order=order)
    rules = values.GetIntegrationRules()
    integral = ngsolve.BilinearForm(trialspace=values, testspace=space)
    measure = ngsolve.ds if on_surface else ngsolve.dx
    integral += (
        values.TrialFunction() * space.TestFunction() * measure(definedon=region, intrules=rules)
    )
    integral.Assemble()
    entries, columns, first = (np.array(part) for part in integral.mat.CSR())
    matrix = csr_array(
        (np.real(entries), columns, first), shape=(integral.mat.height, integral.mat.width)
    )
    mapped: Any = mesh.MapToAllElements(rules, region)
    each = len(mapped) // len(np.unique(mapped["nr"]))
    chosen = matrix.tocsc()[
        :, mapped["nr"].astype(np.int64) * each + np.tile(np.arange(each), len(mapped) // each)
    ]
    points = np.asarray(ngsolve.CF((ngsolve.x, ngsolve.y, ngsolve.z))(mapped)).reshape(-1, 3)
    normals = np.zeros_like(points)
    if on_surface:
        normals = -np.asarray(ngsolve.specialcf.normal(3)(mapped)).reshape(-1, 3)
    ones = np.zeros(space.ndof)
    ones[: mesh.nv] = 1.0
    kinds = mesh.BoundaryCF if on_surface else mesh.MaterialCF
    body = np.asarray(kinds(owners, default=-1)(mapped)).ravel()
    return QuadraturePoints(
        points, normals, chosen.T @ ones, body.round().astype(np.int64), csr_array(chosen)
    )
