"""Quadrature points of the skins, and inside filled bodies."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Complex128, Float64, Int64
from scipy.sparse import csr_array

from airtact.printing import in_short
from airtact.solvers.fem.meshing.netgen import CurvedMesh, FiniteSpace, ngsolve_library

LARGEST_RULE = 5
"""NGSolve 6.2.2608 mixes up the points of larger rules in tetrahedra."""


@dataclass(frozen=True, eq=False)
class Spots:
    """Quadrature points of the skins, or inside filled bodies.

    Attributes
    ----------
    points : (Q, 3) [λ].
    normals : (Q, 3) out of the body; 0 inside.
    areas : (Q,) area [λ²] or volume [λ³] that each stands for.
    body : (Q,) obstacle of each.
    weighted : (unknowns, Q) integrates values given there against the test functions.
    """

    points: Float64[np.ndarray, "spots 3"]
    normals: Float64[np.ndarray, "spots 3"]
    areas: Float64[np.ndarray, "spots"]
    body: Int64[np.ndarray, "spots"]
    weighted: csr_array

    __repr__ = in_short

    def pressure(self, solution: Complex128[np.ndarray, "unknowns sounds"]) -> Complex128[np.ndarray, "spots sounds"]:
        """Pressure of a solution at the spots."""
        return (self.weighted.T @ solution) / self.areas[:, None]


def quadrature(mesh: CurvedMesh, space: FiniteSpace, kind: str, order: int) -> Spots:
    """Quadrature points, exact to twice an order, of the boundaries ``skin0`` ... or the materials ``body0`` ..."""
    ngsolve = ngsolve_library()
    grid: Any = mesh
    unknowns: Any = space
    on_skin = kind == "skin"
    names = grid.GetBoundaries() if on_skin else grid.GetMaterials()
    owner = np.array([int(name[4:]) if name.startswith(kind) else -1 for name in names])
    if (owner < 0).all():
        none, nothing = np.zeros((0, 3)), np.zeros(0)
        return Spots(none, none, nothing, np.zeros(0, dtype=np.int64), csr_array((unknowns.ndof, 0)))
    region = grid.Boundaries(f"{kind}.*") if on_skin else grid.Materials(f"{kind}.*")
    rules_space = ngsolve.comp.IntegrationRuleSpaceSurface if on_skin else ngsolve.comp.IntegrationRuleSpace
    values = rules_space(grid, order=order)
    rules = values.GetIntegrationRules()
    integral = ngsolve.BilinearForm(trialspace=values, testspace=unknowns)
    measure = ngsolve.ds if on_skin else ngsolve.dx
    integral += values.TrialFunction() * unknowns.TestFunction() * measure(definedon=region, intrules=rules)
    integral.Assemble()
    entries, columns, first = (np.array(part) for part in integral.mat.CSR())
    matrix = csr_array((np.real(entries), columns, first), shape=(integral.mat.height, integral.mat.width))
    places = grid.MapToAllElements(rules, region)
    each = len(places) // len(np.unique(places["nr"]))
    chosen = matrix.tocsc()[:, places["nr"].astype(np.int64) * each + np.tile(np.arange(each), len(places) // each)]
    points = np.asarray(ngsolve.CF((ngsolve.x, ngsolve.y, ngsolve.z))(places)).reshape(-1, 3)
    normals = -np.asarray(ngsolve.specialcf.normal(3)(places)).reshape(-1, 3) if on_skin else np.zeros_like(points)
    ones = np.zeros(unknowns.ndof)
    ones[: grid.nv] = 1.0
    kinds = grid.BoundaryCF if on_skin else grid.MaterialCF
    body = np.asarray(kinds({f"{kind}{number}": number for number in owner[owner >= 0]}, default=-1)(places)).ravel()
    return Spots(points, normals, chosen.T @ ones, body.round().astype(np.int64), csr_array(chosen))
