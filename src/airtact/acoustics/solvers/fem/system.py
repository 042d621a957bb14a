"""The Helmholtz equation in weak form, assembled on curved tetrahedra, and its right-hand sides.

Equation (8) of Inoue, Makino and Shinoda (2014), divided by the density of the air and 4π, with
lengths in units of the wavelength, is: find p with

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
from functools import cached_property
from math import factorial
from typing import Any

import numpy as np
from jaxtyping import Complex128, Float64, Int64, Real, Shaped
from scipy.sparse import csr_array
from scipy.spatial import KDTree

from airtact import _kernels
from airtact.acoustics.medium import Medium
from airtact.acoustics.scene import Scene
from airtact.acoustics.solvers.fem.factorisation import Factor, factorised
from airtact.acoustics.solvers.fem.libraries import (
    AssembledForm,
    CurvedMesh,
    Expression,
    FiniteSpace,
    NetgenMesh,
    many_threads,
    ngsolve_library,
)
from airtact.acoustics.solvers.fem.mesh import EDGES, SAME_POINT, Box, SurfaceMesh, Tetrahedra
from airtact.acoustics.solvers.shared import (
    Barycentric,
    Coefficients,
    Indices,
    Points,
    SourcePoints,
    Strengths,
    Vectors,
    monopole_pressure,
)
from airtact.errors import InvalidInput, in_mm
from airtact.geometry.mesh.triangles import PanelTree, panel_tree, points_at

# Thickness of the perfectly matched layer [λ].
LAYER_THICKNESS = 0.55


def weak_form(scene: Scene, box: Box, mesh: CurvedMesh, space: FiniteSpace) -> Expression:
    """Return the left-hand side of the weak Helmholtz equation, as a symbolic form of NGSolve."""
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
    low = box.low / scene.wavelength
    high = box.high / scene.wavelength
    axes = (ngsolve.x, ngsolve.y, ngsolve.z)
    stretches = []  # derivatives of the layer's complex coordinates along x, y and z
    for x, bottom, top in zip(axes, low.tolist(), high.tolist(), strict=True):
        beyond = ngsolve.IfPos(x - top, 1, ngsolve.IfPos(bottom - x, 1, 0))
        # Across the layer and back, a wave decays by the factor e^{-2 · 2π · 1.4 · 0.55} = 6e-5.
        stretches.append(1 + 1j * 1.4 * beyond)
    volume = stretches[0] * stretches[1] * stretches[2]
    layer = ngsolve.dx(definedon=mesh.Materials("layer"))
    gradients = zip(ngsolve.grad(trial), ngsolve.grad(test), stretches, strict=True)
    form += sum(volume / along**2 * left * right for left, right, along in gradients) * layer
    form -= squared * volume * trial * test * layer
    for body, obstacle in enumerate(scene.obstacles):
        if obstacle.ratio is not None:
            factor = -1j * np.sqrt(complex(squared)) / obstacle.ratio
            form += factor * trial * test * ngsolve.ds(f"surface{body}")
    return form


def boundary_weights(scene: Scene) -> Complex128[np.ndarray, "3 bodies"]:
    """Return the weights w_d, w_s and w_v of each body in the right-hand side of the equation."""
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
    """Return quadrature points on all bodies (kind "surface") or in all filled bodies ("body")."""
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
    integral += (
        values.TrialFunction() * space.TestFunction() * measure(definedon=region, intrules=rules)
    )
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
    normals = (
        -np.asarray(ngsolve.specialcf.normal(3)(mapped)).reshape(-1, 3)
        if on_surface
        else np.zeros_like(points)
    )
    # Integrating 1 against each point gives the area or volume of that point.
    ones = np.zeros(space.ndof)
    ones[: mesh.nv] = 1.0  # the shape functions of the vertices add up to 1 everywhere
    body = np.asarray(owner_of(mapped)).ravel().round().astype(np.int64)
    return QuadraturePoints(points, normals, chosen.T @ ones, body, csr_array(chosen))


@dataclass(frozen=True, eq=False, repr=False)
class System:
    """The assembled equation of a scene at one polynomial order.

    Attributes
    ----------
    panels : the meshed surfaces of the bodies [λ].
    mesh, space, form : NGSolve's mesh, finite element space and assembled matrix, from which the
        unknowns inside tetrahedra are eliminated.
    surface, interior : quadrature points for right-hand sides, on the surfaces and inside the
        filled bodies.
    coarse_surface : a smaller set of quadrature points on the surfaces, which suffices to evaluate
        the field at a distance of a wavelength or more.
    weights : (3, bodies) weights w_d, w_s and w_v of the right-hand side.
    method : solver that factorises the matrix, "pardiso" or "sparsecholesky".
    """

    scene: Scene
    tetrahedra: Tetrahedra
    panels: PanelTree
    order: int
    mesh: CurvedMesh
    space: FiniteSpace
    form: AssembledForm
    surface: QuadraturePoints
    interior: QuadraturePoints
    coarse_surface: QuadraturePoints
    weights: Complex128[np.ndarray, "3 bodies"]
    method: str

    @property
    def unknowns(self) -> int:
        """Number of unknowns."""
        return int(self.space.ndof)

    @property
    def wavenumber(self) -> complex:
        """Wavenumber times the wavelength: 2π, plus i times the absorption per wavelength."""
        return complex(self.scene.wavenumber * self.scene.wavelength)

    @cached_property
    def factor(self) -> Factor:
        """The factorised matrix, computed when it is first needed."""
        free = np.array(self.space.FreeDofs(True), dtype=np.bool_)  # those shared by tetrahedra
        return factorised(self.form, free, self.order, self.method)

    def right_hand_side(self, positions: SourcePoints, strengths: Strengths) -> Coefficients:
        """Return the right-hand side for the scattered pressure of monopoles at positions [λ]."""
        # This is L_y(v) of the weak form, summed over the sources y.
        w_d, w_s, w_v = self.weights
        surface = self.surface
        interior = self.interior
        wavenumber = self.wavenumber
        value = w_d[surface.body, None] * _kernels.normal_derivative(
            surface.points, surface.normals, positions, strengths, wavenumber
        )
        if w_s.any():
            value += w_s[surface.body, None] * monopole_pressure(
                surface.points, positions, strengths, wavenumber, "float64"
            )
        right = surface.weighted @ value
        if len(interior.points):
            pressure = monopole_pressure(
                interior.points, positions, strengths, wavenumber, "float64"
            )
            right += interior.weighted @ (w_v[interior.body, None] * pressure)
        return right

    def point_load(
        self, number: int, weights: Real[np.ndarray, "4"]
    ) -> Complex128[np.ndarray, "unknowns"]:
        """Return the right-hand side of a unit monopole at barycentric coordinates."""
        ngsolve = ngsolve_library()
        element = ngsolve.ElementId(ngsolve.VOL, number)
        load = np.zeros(self.unknowns, dtype=np.complex128)
        shape = np.asarray(self.space.GetFE(element).CalcShape(*weights[:3])).ravel()
        # e^{ikr}/r is 4π times the fundamental solution of the Helmholtz equation.
        load[list(self.space.GetDofNrs(element))] = 4 * np.pi * shape
        return load

    def holding(self, points: Points) -> tuple[Indices, Barycentric]:
        """Return the tetrahedron of each point [λ], and the point's barycentric coordinates in it.

        Raise ``InvalidInput`` if a point does not lie in any tetrahedron.
        """
        number, weights = self.tetrahedra.holding(points)
        lost = np.flatnonzero(number < 0)
        if len(lost):
            raise InvalidInput(
                f"{len(lost)} of {len(points)} points do not lie in any tetrahedron, the first at "
                f"{in_mm(points[lost[0]] * self.scene.wavelength)}. Increase "
                "elements_per_wavelength, so that tetrahedra follow the surface more closely.",
                code="misplaced",
            )
        return number, weights

    def nearest_on_surface(self, points: Points) -> Vectors:
        """Return the nearest points (P, 3) [λ] on the meshed surfaces."""
        panel, reference, _ = self.panels.closest(points)
        return points_at(self.panels.quadratic_triangles[panel], reference)[0]

    def mesh_points(self, number: Indices, weights: Barycentric) -> Shaped[np.ndarray, "points"]:
        """Convert barycentric coordinates in tetrahedra to mesh points of NGSolve."""
        # NGSolve stores all points in one array of records, because mapping single points is slow.
        points: Any = np.zeros(len(number), dtype=self._mesh_point.dtype)
        points[:] = self._mesh_point
        points["nr"] = number
        points["x"] = weights[:, 0]
        points["y"] = weights[:, 1]
        points["z"] = weights[:, 2]
        return points

    @cached_property
    def _mesh_point(self) -> Any:
        ngsolve = ngsolve_library()
        return self.mesh.MapToAllElements(ngsolve.IntegrationRule(ngsolve.TET, 0), ngsolve.VOL)[0]


def assembled(
    scene: Scene,
    box: Box,
    surface: SurfaceMesh,
    tetrahedra: Tetrahedra,
    netgen_mesh: NetgenMesh,
    order: int,
    method: str,
    graded: float | None,
) -> System:
    """Assemble the equation on a Netgen mesh with coordinates in units of the wavelength.

    Edges of length ``graded`` [λ] use ``order``, longer edges use higher orders, and shorter edges
    lower orders. If ``graded`` is None, all edges use ``order``.
    """
    ngsolve = ngsolve_library()
    panels = surface.quadratic_triangles / scene.wavelength
    with many_threads():
        mesh = ngsolve.Mesh(netgen_mesh)
        _bend(mesh, tetrahedra)
        space = ngsolve.H1(mesh, order=order, complex=True)
        if graded is not None:
            grade_orders(space, mesh, scene, box, order, graded, panels.reshape(-1, 3))
        equation = weak_form(scene, box, mesh, space)
        # Static condensation eliminates the unknowns inside tetrahedra, so that the matrix to
        # factorise is far smaller.
        form = ngsolve.BilinearForm(equation, symmetric=True, symmetric_storage=True, condense=True)
        form.Assemble()
        return System(
            scene=scene,
            tetrahedra=tetrahedra,
            panels=panel_tree(panels),
            order=order,
            mesh=mesh,
            space=space,
            form=form,
            surface=quadrature(mesh, space, "surface", order + 2),
            # NGSolve 6.2.2608 mixes up the quadrature points of tetrahedra at orders above 5.
            interior=quadrature(mesh, space, "body", min(order + 1, 5)),
            coarse_surface=quadrature(mesh, space, "surface", max(order - 2, 3)),
            weights=boundary_weights(scene),
            method=method,
        )


def _bend(mesh: CurvedMesh, tetrahedra: Tetrahedra) -> None:
    ngsolve = ngsolve_library()
    deformation = ngsolve.GridFunction(ngsolve.VectorH1(mesh, order=2))
    plain = ngsolve.H1(mesh, order=2)
    bend = deformation.vec.FV().NumPy().reshape(3, plain.ndof)
    for number in np.flatnonzero((tetrahedra.bends != 0).any(axis=(1, 2))):
        element = ngsolve.ElementId(ngsolve.VOL, int(number))
        unknowns = np.array(plain.GetDofNrs(element))
        shape = plain.GetFE(element)
        for edge in np.flatnonzero((tetrahedra.bends[number] != 0).any(axis=1)):
            weights = np.zeros(4)
            weights[EDGES[edge]] = 0.5
            values = np.asarray(shape.CalcShape(*weights[:3])).ravel()
            # The edges follow the four vertices. Only one of their shape functions is nonzero here.
            bubble = 4 + int(np.argmax(np.abs(values[4:])))
            bend[:, unknowns[bubble]] = tetrahedra.bends[number, edge] / values[bubble]
    mesh.SetDeformation(deformation)


# Largest difference between the order of an element and the nominal order.
MAX_ABOVE = 4


def grade_orders(
    space: FiniteSpace,
    mesh: CurvedMesh,
    scene: Scene,
    box: Box,
    order: int,
    size: float,
    surface: Real[np.ndarray, "nodes 3"],
) -> None:
    """Set the polynomial orders of edges, faces and tetrahedra according to their lengths.

    Edges of length ``size`` [λ] use ``order``. ``surface`` contains points on the surfaces [λ].
    """
    ngsolve = ngsolve_library()
    points = np.array([vertex.point for vertex in mesh.vertices])
    ends = np.array([[vertex.nr for vertex in edge.vertices] for edge in mesh.edges])
    lengths = np.linalg.norm(points[ends[:, 0]] - points[ends[:, 1]], axis=1)
    # Sound may be slower in a filling, so edges next to it span more of its wavelengths.
    factors = np.ones(mesh.nedge)
    for body, obstacle in enumerate(scene.obstacles):
        if obstacle.medium is not None:
            shorter = scene.medium.sound_speed / obstacle.medium.sound_speed
            for cell in mesh.Materials(f"body{body}").Elements():
                factors[[edge.nr for edge in cell.edges]] = max(shorter, 1.0)
    lengths *= factors
    middles = points[ends].mean(axis=1)
    low = box.low / scene.wavelength - SAME_POINT
    high = box.high / scene.wavelength + SAME_POINT
    near = KDTree(surface)
    edges_of = {
        ngsolve.EDGE: np.arange(len(ends))[:, None],
        ngsolve.FACE: np.array([[edge.nr for edge in face.edges] for face in mesh.faces]),
        ngsolve.CELL: np.array(
            [[edge.nr for edge in cell.edges] for cell in mesh.Elements(ngsolve.VOL)]
        ),
    }
    for kind, edges in edges_of.items():
        longest = lengths[edges].max(axis=1)
        middle = middles[edges].mean(axis=1)
        # Errors in the layer and far from the surfaces hardly affect the result, so three times
        # the error is allowed there.
        in_layer = ((middle < low) | (middle > high)).any(axis=1)
        eased = in_layer | (near.query(middle)[0] > 0.5)
        orders = np.where(
            eased, _served(longest, order, size, 3.0), _served(longest, order, size, 1.0)
        )
        for number in np.flatnonzero(orders != order).tolist():
            space.SetOrder(ngsolve.NodeId(kind, number), int(orders[number]))
    space.UpdateDofTables()


def _served(
    lengths: Real[np.ndarray, "nodes"], order: int, size: float, ease: float
) -> Int64[np.ndarray, "nodes"]:
    """Return the lowest order for each length [λ] at which the error is within a limit.

    On an edge of length h, a polynomial of order p approximates e^{ikx} with an error of 2
    (kh/4)^(p+1) / (p+1)! (Chebyshev interpolation). The limit is ``ease`` times the error of
    Netgen's longest edges, 1.5 times the nominal ``size`` [λ], with the nominal ``order``. With the
    same order everywhere, the largest tetrahedra would determine the error and the smallest ones
    the cost.
    """
    error = ease * (0.5 * np.pi * 1.5 * size) ** (order + 1) / factorial(order + 1)
    limits = [
        (error * factorial(power)) ** (1 / power) / (0.5 * np.pi)
        for power in range(2, order + MAX_ABOVE + 2)
    ]
    return np.clip(1 + np.searchsorted(limits, lengths), min(order, 3), order + MAX_ABOVE)
