"""Quadrature points of the skins, and inside filled bodies."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Complex128, Float64, Int64
from scipy.sparse import csr_array

from airtact.scene.printing import in_short
from airtact.solvers.finite_netgen import ngsolve_library

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


def quadrature(mesh: Any, space: Any, kind: str, order: int) -> Spots:
    """Quadrature points, exact to twice an order, of the boundaries ``skin0`` ... or the materials ``body0`` ..."""
    ngsolve = ngsolve_library()
    on_skin = kind == "skin"
    names = mesh.GetBoundaries() if on_skin else mesh.GetMaterials()
    owner = np.array([int(name[4:]) if name.startswith(kind) else -1 for name in names])
    if (owner < 0).all():
        none, nothing = np.zeros((0, 3)), np.zeros(0)
        return Spots(none, none, nothing, np.zeros(0, dtype=np.int64), csr_array((space.ndof, 0)))
    region = mesh.Boundaries(f"{kind}.*") if on_skin else mesh.Materials(f"{kind}.*")
    rules_space = ngsolve.comp.IntegrationRuleSpaceSurface if on_skin else ngsolve.comp.IntegrationRuleSpace
    values = rules_space(mesh, order=order)
    rules = values.GetIntegrationRules()
    integral = ngsolve.BilinearForm(trialspace=values, testspace=space)
    measure = ngsolve.ds if on_skin else ngsolve.dx
    integral += values.TrialFunction() * space.TestFunction() * measure(definedon=region, intrules=rules)
    integral.Assemble()
    entries, columns, first = (np.array(part) for part in integral.mat.CSR())
    matrix = csr_array((np.real(entries), columns, first), shape=(integral.mat.height, integral.mat.width))
    places = mesh.MapToAllElements(rules, region)
    each = len(places) // len(np.unique(places["nr"]))
    chosen = matrix.tocsc()[:, places["nr"].astype(np.int64) * each + np.tile(np.arange(each), len(places) // each)]
    points = np.asarray(ngsolve.CF((ngsolve.x, ngsolve.y, ngsolve.z))(places)).reshape(-1, 3)
    normals = -np.asarray(ngsolve.specialcf.normal(3)(places)).reshape(-1, 3) if on_skin else np.zeros_like(points)
    ones = np.zeros(space.ndof)
    ones[: mesh.nv] = 1.0
    kinds = mesh.BoundaryCF if on_skin else mesh.MaterialCF
    body = np.asarray(kinds({f"{kind}{number}": number for number in owner[owner >= 0]}, default=-1)(places)).ravel()
    return Spots(points, normals, chosen.T @ ones, body.round().astype(np.int64), csr_array(chosen))
