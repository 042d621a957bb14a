"""The Helmholtz equation in weak form, and the right-hand sides for its boundaries.

The paper's equation (8), divided by the density of the air and 4π, in wavelengths, is: find p with

    ∫ w (∇p · ∇v − k² p v) dV − ∮ (ik/ratio) p v dS = L(v),

where w is 1 in air and the ratio of the densities in a filled body. For a monopole G(x, y) =
e^{ikr}/r, the right-hand side of the scattered pressure is

    L_y(v) = ∮ (w_d ∂G/∂n + w_s G) v dS + ∫_body w_v G v dV,

where n points out of the body, w_d = 1 − w, w_s = ik/ratio and w_v = −w (k² − k_body²). Because the
form is symmetric, L_y(p) of the total pressure p is also 4π times the scattered pressure at y (the
Kirchhoff-Helmholtz integral).

The perfectly matched layer (PML) around the box absorbs outgoing sound without reflecting it. Its
coordinates are complex, so that a wave decays along them: J.-P. Berenger, J. Comput. Phys.
114 (1994) 185; F. Collino, P. Monk, SIAM J. Sci. Comput. 19 (1998) 2061. Its terms are written out,
because NGSolve's built-in layer takes twice as long.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex128, Float64, Int64
from scipy.sparse import csr_array

from airtact.acoustics.medium import Medium
from airtact.acoustics.scene import Scene
from airtact.acoustics.solvers.arrays import Coefficients
from airtact.acoustics.solvers.fem.libraries import (
    CurvedMesh,
    Expression,
    FiniteSpace,
    ngsolve_library,
)
from airtact.acoustics.solvers.fem.mesh import Box

# Thickness of the perfectly matched layer [λ].
LAYER_THICKNESS = 0.55


def weak_form(scene: Scene, box: Box, mesh: CurvedMesh, space: FiniteSpace) -> Expression:
    """Return the left-hand side of the equation, as a symbolic form of NGSolve."""
    ngsolve = ngsolve_library()
    trial, test = space.TnT()
    squared = _plain(complex(scene.wavenumber * scene.wavelength) ** 2)
    weights = {}
    squares = {}
    for body, obstacle in enumerate(scene.obstacles):
        if obstacle.medium is not None:
            ratio, inner = _filling(scene, obstacle.medium)
            weights[f"body{body}"] = ratio
            squares[f"body{body}"] = _plain(ratio * inner)
    inside = ngsolve.dx(definedon=mesh.Materials("air|body.*"))
    form = mesh.MaterialCF(weights, default=1.0) * ngsolve.grad(trial) * ngsolve.grad(test) * inside
    form -= mesh.MaterialCF(squares, default=squared) * trial * test * inside
    form += _layer_form(box, scene.wavelength, squared, trial, test, mesh)
    for body, obstacle in enumerate(scene.obstacles):
        if obstacle.ratio is not None:
            factor = -1j * np.sqrt(complex(squared)) / obstacle.ratio
            form += factor * trial * test * ngsolve.ds(f"surface{body}")
    return form


def _layer_form(
    box: Box,
    wavelength: float,
    squared: complex | float,
    trial: Expression,
    test: Expression,
    mesh: CurvedMesh,
) -> Expression:
    ngsolve = ngsolve_library()
    low = box.low / wavelength
    high = box.high / wavelength
    axes = (ngsolve.x, ngsolve.y, ngsolve.z)
    stretches = []  # derivatives of the complex coordinates along x, y and z
    for x, bottom, top in zip(axes, low.tolist(), high.tolist(), strict=True):
        beyond = ngsolve.IfPos(x - top, 1, ngsolve.IfPos(bottom - x, 1, 0))
        # Across the layer and back, a wave decays by the factor e^{-2 · 2π · 1.4 · 0.55} = 6e-5.
        stretches.append(1 + 1j * 1.4 * beyond)
    volume = stretches[0] * stretches[1] * stretches[2]
    layer = ngsolve.dx(definedon=mesh.Materials("layer"))
    gradients = zip(ngsolve.grad(trial), ngsolve.grad(test), stretches, strict=True)
    form = sum(volume / along**2 * left * right for left, right, along in gradients) * layer
    return form - squared * volume * trial * test * layer


def boundary_weights(scene: Scene) -> Complex128[np.ndarray, "3 bodies"]:
    """Return the weights w_d, w_s and w_v of each body, as defined at the top of this module."""
    weights = np.zeros((3, len(scene.obstacles)), dtype=np.complex128)
    weights[0] = 1.0
    wavenumber = scene.wavenumber * scene.wavelength
    for body, obstacle in enumerate(scene.obstacles):
        if obstacle.ratio is not None:
            weights[1, body] = 1j * wavenumber / obstacle.ratio
        if obstacle.medium is not None:
            ratio, inner = _filling(scene, obstacle.medium)
            weights[0, body] = 1 - ratio
            weights[2, body] = -ratio * (wavenumber**2 - inner)
    return weights


def _filling(scene: Scene, medium: Medium) -> tuple[float, complex]:
    """Return the ratio of the air's density to that of a filling, and the filling's k² [1/λ²]."""
    wavenumber = complex(medium.wavenumber(scene.frequency) * scene.wavelength)
    return scene.medium.density / medium.density, wavenumber**2


def _plain(number: complex) -> complex | float:
    """Convert a complex number without imaginary part to float, which is faster in NGSolve."""
    return number if number.imag else number.real


# Highest quadrature order in tetrahedra; NGSolve 6.2.2608 mixes up the points of higher orders.
MAX_RULE_ORDER = 5


@dataclass(frozen=True, eq=False, repr=False)
class QuadraturePoints:
    """Quadrature points on the surfaces of the bodies, or inside filled bodies.

    Attributes
    ----------
    points, normals : positions [λ] and outward unit normals; the normals are 0 inside a body.
    areas : (Q,) area [λ²] or volume [λ³] that each point represents.
    body : (Q,) index of each point's obstacle.
    weighted : (unknowns, Q) matrix that integrates values at the points against the test functions.
    """

    points: Float64[np.ndarray, "nodes 3"]
    normals: Float64[np.ndarray, "nodes 3"]
    areas: Float64[np.ndarray, "nodes"]
    body: Int64[np.ndarray, "nodes"]
    weighted: csr_array

    def pressure(self, solution: Coefficients) -> Complex128[np.ndarray, "nodes excitations"]:
        """Return the pressure of a solution at the points."""
        return (self.weighted.T @ solution) / self.areas[:, None]


def quadrature(mesh: CurvedMesh, space: FiniteSpace, kind: str, order: int) -> QuadraturePoints:
    """Return quadrature points on the boundaries "surface0" ... or in the materials "body0" ..."""
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
    # The matrix has columns for the points of all elements; those of the region are selected.
    mapped = mesh.MapToAllElements(rules, region)
    per_element = len(mapped) // len(np.unique(mapped["nr"]))
    within = np.tile(np.arange(per_element), len(mapped) // per_element)
    chosen = matrix.tocsc()[:, mapped["nr"].astype(np.int64) * per_element + within]
    points = np.asarray(ngsolve.CF((ngsolve.x, ngsolve.y, ngsolve.z))(mapped)).reshape(-1, 3)
    normals = np.zeros_like(points)
    if on_surface:
        normals = -np.asarray(ngsolve.specialcf.normal(3)(mapped)).reshape(-1, 3)
    # Integrating 1 against each point gives the area or volume of that point.
    ones = np.zeros(space.ndof)
    ones[: mesh.nv] = 1.0  # the shape functions of the vertices add up to 1 everywhere
    body = np.asarray(owner_of(mapped)).ravel().round().astype(np.int64)
    return QuadraturePoints(points, normals, chosen.T @ ones, body, csr_array(chosen))
