"""The Helmholtz equation on curved tetrahedra: its matrix, factorised, and its right-hand sides.

The weak form of the paper's equation (8), divided by the density of the air and 4π, in wavelengths: find p with

    ∫ w (∇p · ∇v − k² p v) dV − ∮ (ik/ratio) p v dS = L(v),

w being 1 in air and the ratio of the densities in a filled body. A monopole G(x, y) = e^{ikr}/r makes the scattered
pressure with the load

    L_y(v) = ∮ (w_d ∂G/∂n + w_s G) v dS + ∫_body w_v G v dV,

and by the symmetry of the form L_y(p) is also the scattered pressure, times 4π, that a total pressure p makes at y
(Kirchhoff and Helmholtz): n points out of the body, w_d = 1 − w, w_s = ik/ratio, w_v = −w (k² − k_body²).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Complex128, Float64, Int64, Real
from scipy.sparse import csr_array

from airtact import _kernels
from airtact.mesh.panel_tree import PanelTree, panel_tree
from airtact.printing import in_short
from airtact.scene.scene import Scene
from airtact.solvers.fem.meshing.netgen import (
    AssembledForm,
    CurvedMesh,
    FiniteSpace,
    NetgenMesh,
    many_threads,
    ngsolve_library,
)
from airtact.solvers.fem.meshing.skin import SkinMesh
from airtact.solvers.fem.meshing.volume import Box
from airtact.solvers.fem.multifrontal.elimination import Entries, sorted_entries
from airtact.solvers.fem.multifrontal.nested_dissection import Dissection, dissected
from airtact.solvers.fem.orders import grade_orders
from airtact.solvers.fem.quadrature import LARGEST_RULE, Spots, quadrature
from airtact.solvers.monopoles import monopole_pressure
from airtact.solvers.tetrahedra import EDGES, Tetrahedra

ROWS_AT_ONCE = 64

NEVER = 1e5
"""A place [λ] that no layer begins beyond."""

STRETCH = 1.4
"""Strength of the matched layer: the imaginary part of its complex coordinate over the real one."""


@dataclass(frozen=True, eq=False)
class System:
    """The assembled equation of a scene at one order.

    Attributes
    ----------
    scene : what is solved.
    box : where.
    tetrahedra : the curved mesh.
    panels : the bodies' skins as meshed [λ].
    order : polynomial order.
    mesh, space, form : NGSolve's mesh, unknowns and assembled matrix, the unknowns inside tetrahedra left out.
    skin, inner : where loads are integrated: on the skins, and inside the filled bodies.
    sparse : fewer spots on the skins, enough to be heard from a wavelength off.
    weights : (3, bodies) w_d, w_s and w_v of the loads.
    """

    scene: Scene
    box: Box
    tetrahedra: Tetrahedra
    panels: PanelTree
    order: int
    mesh: CurvedMesh
    space: FiniteSpace
    form: AssembledForm
    skin: Spots
    inner: Spots
    sparse: Spots
    weights: Complex128[np.ndarray, "3 bodies"]

    __repr__ = in_short

    @property
    def unknowns(self) -> int:
        """Number of unknowns."""
        return int(self.space.ndof)

    def free(self, odd: Sequence[int], shared: bool) -> Bool[np.ndarray, "unknowns"]:
        """Which unknowns a sound that is odd about mirrors across some axes may have.

        Parameters
        ----------
        odd : axes of those mirrors: the sound is silent on them.
        shared : leave those out that a single tetrahedron has.
        """
        free = self.space.FreeDofs(shared)
        found = type(free)(free)
        for axis in odd:
            found &= ~self.space.GetDofs(self.mesh.Boundaries(f"wall{2 * axis}"))
        return np.array(found, dtype=np.bool_)

    @cached_property
    def dissection(self) -> Dissection:
        """In which order the unknowns that tetrahedra share are eliminated."""
        ngsolve, space = ngsolve_library(), self.space
        shared = self.free((), shared=True)
        each = [
            space.GetDofNrs(ngsolve.ElementId(ngsolve.VOL, number)) for number in range(len(self.tetrahedra.corners))
        ]
        tetrahedra = np.repeat(np.arange(len(each)), [len(one) for one in each])
        unknowns = np.concatenate([np.array(one, dtype=np.int64) for one in each])
        kept = shared[unknowns]
        return dissected(tetrahedra[kept], unknowns[kept], self.unknowns)

    @property
    def lower(self) -> csr_array:
        """(unknowns, unknowns) lower triangle of the matrix, with its diagonal."""
        entries, columns, first = (np.asarray(part) for part in self.form.mat.CSR())
        return csr_array((entries, columns, first.astype(np.int32)), shape=(self.unknowns, self.unknowns))

    @cached_property
    def entries(self) -> Entries:
        """Entries of the matrix by the fronts that gather them."""
        return sorted_entries(self.lower, self.dissection)

    @property
    def wavenumber(self) -> complex:
        """Wavenumber times the wavelength: 2π, and the absorption in a wavelength as its imaginary part."""
        return complex(self.scene.wavenumber * self.scene.wavelength)

    def load(
        self, places: Real[np.ndarray, "sources 3"], strengths: Complex128[np.ndarray, "sources sounds"]
    ) -> Complex128[np.ndarray, "unknowns sounds"]:
        """Load of the pressure that monopoles scatter.

        Parameters
        ----------
        places : (N, 3) [λ].
        strengths : (N, S) of e^{ikr}/r.
        """
        w_d, w_s, w_v = self.weights
        on, within, k = self.skin, self.inner, self.wavenumber
        value = w_d[on.body, None] * _normal_slopes(on, places, strengths, k)
        if w_s.any():
            value += w_s[on.body, None] * monopole_pressure(on.points, places, strengths, k, "float64")
        load = on.weighted @ value
        if len(within.points):
            load += within.weighted @ (
                w_v[within.body, None] * monopole_pressure(within.points, places, strengths, k, "float64")
            )
        return load

    def heard(
        self,
        points: Real[np.ndarray, "points 3"],
        skin: Spots,
        on_skin: Complex128[np.ndarray, "spots sounds"],
        inside: Complex128[np.ndarray, "inner sounds"],
        precision: str,
    ) -> Complex128[np.ndarray, "points sounds"]:
        """Scattered pressure at points (P, 3) [λ] off the skins, from the total one at spots on and in the bodies.

        In the precision "float32" the sums are good to some 1e-6, and take a third of the time of "float64".
        """
        w_d, w_s, w_v = self.weights
        points = np.ascontiguousarray(points, dtype=np.float64)
        found = np.empty((len(points), on_skin.shape[1]), dtype=np.complex128)
        dipoles = np.ascontiguousarray(w_d[skin.body, None] * on_skin)
        directions = np.ascontiguousarray(skin.normals * skin.areas[:, None])
        double_layer = getattr(_kernels, f"apply_double_layer_{precision}")
        double_layer(points, skin.points, directions, dipoles, self.wavenumber, 0.0, found)
        for spots, weight, pressure in ((skin, w_s, on_skin), (self.inner, w_v, inside)):
            if len(spots.points) and weight.any():
                strengths = (weight[spots.body] * spots.areas)[:, None] * pressure / (4 * np.pi)
                found += monopole_pressure(points, spots.points, strengths, self.wavenumber, precision)
        return found

    def point_load(self, number: int, weights: Real[np.ndarray, "4"]) -> Complex128[np.ndarray, "unknowns"]:
        """Load of a monopole of unit strength e^{ikr}/r at a place in a tetrahedron."""
        ngsolve = ngsolve_library()
        element = ngsolve.ElementId(ngsolve.VOL, number)
        load = np.zeros(self.unknowns, dtype=np.complex128)
        shape = np.asarray(self.space.GetFE(element).CalcShape(*weights[:3])).ravel()
        load[list(self.space.GetDofNrs(element))] = 4 * np.pi * shape
        return load

    def values_at(
        self,
        number: Int64[np.ndarray, "points"],
        weights: Real[np.ndarray, "points 4"],
        solution: Complex128[np.ndarray, "unknowns sounds"],
    ) -> Complex128[np.ndarray, "points sounds"]:
        """Pressure at places in tetrahedra."""
        found = np.empty((len(number), solution.shape[1]), dtype=np.complex128)
        if not len(number):
            return found
        places = self._mesh_points(number, weights)
        for column, pressure in self._columns(solution):
            found[:, column] = np.asarray(pressure(places)).ravel()
        return found

    def slopes_at(
        self,
        number: Int64[np.ndarray, "points"],
        weights: Real[np.ndarray, "points 4"],
        solution: Complex128[np.ndarray, "unknowns sounds"],
    ) -> Complex128[np.ndarray, "points 3 sounds"]:
        """Slopes of the pressure along x, y and z at places in tetrahedra [1/λ]."""
        places = self._mesh_points(number, weights)
        found = np.empty((len(number), 3, solution.shape[1]), dtype=np.complex128)
        for column, pressure in self._columns(solution):
            found[:, :, column] = np.asarray(ngsolve_library().grad(pressure)(places)).reshape(-1, 3)
        return found

    def _columns(self, solution: Complex128[np.ndarray, "unknowns sounds"]) -> Iterator[tuple[int, Any]]:
        """Give each sound of a solution as a function of the space; the next one takes its place."""
        pressure = ngsolve_library().GridFunction(self.space)
        for column in range(solution.shape[1]):
            pressure.vec.FV().NumPy()[:] = solution[:, column]
            yield column, pressure

    def density_at(
        self, number: Int64[np.ndarray, "points"], weights: Real[np.ndarray, "points 4"]
    ) -> Float64[np.ndarray, "points"]:
        """Density of what tetrahedra hold [kg/m³]."""
        fillings = enumerate(obstacle.medium for obstacle in self.scene.obstacles)
        densities = {f"body{body}": medium.density for body, medium in fillings if medium is not None}
        mesh: Any = self.mesh
        held = mesh.MaterialCF(densities, default=self.scene.medium.density)(self._mesh_points(number, weights))
        return np.asarray(held, dtype=np.float64).ravel()

    def _mesh_points(self, number: Int64[np.ndarray, "points"], weights: Real[np.ndarray, "points 4"]) -> Any:
        places: Any = np.zeros(len(number), dtype=self._mesh_point.dtype)
        places[:] = self._mesh_point
        places["nr"] = number
        places["x"], places["y"], places["z"] = weights[:, 0], weights[:, 1], weights[:, 2]
        return places

    @cached_property
    def _mesh_point(self) -> Any:
        ngsolve = ngsolve_library()
        return self.mesh.MapToAllElements(ngsolve.IntegrationRule(ngsolve.TET, 0), ngsolve.VOL)[0]


def _normal_slopes(
    spots: Spots,
    places: Real[np.ndarray, "sources 3"],
    strengths: Complex128[np.ndarray, "sources sounds"],
    wavenumber: complex,
) -> Complex128[np.ndarray, "spots sounds"]:
    """Slope of Σ_j s_j e^{ikr}/r along the normals of the spots."""
    found = np.zeros((len(spots.points), strengths.shape[1]), dtype=np.complex128)
    for first in range(0, len(places), ROWS_AT_ONCE):
        some = np.ascontiguousarray(places[first : first + ROWS_AT_ONCE], dtype=np.float64)
        rows = np.empty((len(some), len(spots.points)), dtype=np.complex128)
        _kernels.double_layer_matrix_float64(some, spots.points, spots.normals, wavenumber, rows)
        found += 4 * np.pi * (rows.T @ strengths[first : first + ROWS_AT_ONCE])
    return found


def assembled(
    scene: Scene,
    box: Box,
    skin: SkinMesh,
    tetrahedra: Tetrahedra,
    netgen_mesh: NetgenMesh,
    order: int,
    graded: float | None = None,
    workspace: bool = False,
) -> System:
    """Write the equation down on a mesh of Netgen's.

    Parameters
    ----------
    scene : what is solved.
    box : where.
    skin : the bodies' triangles.
    tetrahedra : how the mesh is curved.
    netgen_mesh : Netgen's mesh, in wavelengths.
    order : polynomial order.
    graded : the edge that this order is for [λ], others getting their own; None for the same order everywhere.
    workspace : whether pressure is read off the mesh far from the skins too.
    """
    ngsolve = ngsolve_library()
    with many_threads():
        mesh = ngsolve.Mesh(netgen_mesh)
        _bend(mesh, tetrahedra)
        space = ngsolve.H1(mesh, order=order, complex=True)
        if graded is not None:
            places = skin.quadratic_triangles.reshape(-1, 3) / scene.wavelength
            grade_orders(space, mesh, scene, box, order, graded, None if workspace else places)
        form = ngsolve.BilinearForm(
            _weak_form(scene, box, mesh, space), symmetric=True, symmetric_storage=True, condense=True
        )
        form.Assemble()
        on_skin = quadrature(mesh, space, "skin", order + 2)
        sparse = quadrature(mesh, space, "skin", max(order - 1, 2))
        inner = quadrature(mesh, space, "body", min(order + 1, LARGEST_RULE))
    panels = panel_tree(skin.quadratic_triangles / scene.wavelength)
    return System(
        scene, box, tetrahedra, panels, order, mesh, space, form, on_skin, inner, sparse, _load_weights(scene)
    )


def _bend(mesh: Any, tetrahedra: Tetrahedra) -> None:
    """Bend the tetrahedra beside the bodies by a deformation that is quadratic along their edges."""
    ngsolve = ngsolve_library()
    field = ngsolve.GridFunction(ngsolve.VectorH1(mesh, order=2))
    plain = ngsolve.H1(mesh, order=2)
    bend = field.vec.FV().NumPy().reshape(3, plain.ndof)
    for number in np.flatnonzero((tetrahedra.bends != 0).any(axis=(1, 2))):
        element = ngsolve.ElementId(ngsolve.VOL, int(number))
        unknowns, shape = np.array(plain.GetDofNrs(element)), plain.GetFE(element)
        for edge in np.flatnonzero((tetrahedra.bends[number] != 0).any(axis=1)):
            weights = np.zeros(4)
            weights[EDGES[edge]] = 0.5
            values = np.asarray(shape.CalcShape(*weights[:3])).ravel()
            bubble = 4 + int(np.argmax(np.abs(values[4:])))
            bend[:, unknowns[bubble]] = tetrahedra.bends[number, edge] / values[bubble]
    mesh.SetDeformation(field)


def _weak_form(scene: Scene, box: Box, mesh: Any, space: Any) -> Any:
    ngsolve = ngsolve_library()
    tested, test = space.TnT()
    squared = complex(scene.wavenumber * scene.wavelength) ** 2
    weights, squares = {}, {}
    extra = None
    for body, obstacle in enumerate(scene.obstacles):
        if obstacle.medium is not None:
            ratio, inner = _filling(scene, body)
            weights[f"body{body}"], squares[f"body{body}"] = ratio, _plain(ratio * inner)
        if obstacle.ratio is not None:
            term = -1j * np.sqrt(squared) / obstacle.ratio * tested * test * ngsolve.ds(f"skin{body}")
            extra = term if extra is None else extra + term
    inside, layer = (ngsolve.dx(definedon=mesh.Materials(name)) for name in ("air|body.*", "layer"))
    form = mesh.MaterialCF(weights, default=1.0) * ngsolve.grad(tested) * ngsolve.grad(test) * inside
    form -= mesh.MaterialCF(squares, default=_plain(squared)) * tested * test * inside
    stretch = _stretches(box, scene.wavelength)
    volume = stretch[0] * stretch[1] * stretch[2]
    pairs = zip(ngsolve.grad(tested), ngsolve.grad(test), stretch, strict=True)
    form += sum(volume / along**2 * one * other for one, other, along in pairs) * layer
    form -= squared * volume * tested * test * layer
    return form if extra is None else form + extra


def _stretches(box: Box, wavelength: float) -> list[Any]:
    """Stretch x, y and z in the layer, which swallows sound by complex coordinates.

    J.-P. Berenger 1994; F. Collino, P. Monk 1998. Written out, since NGSolve's own layer takes twice as long.
    """
    ngsolve = ngsolve_library()
    low, high = box.low / wavelength, box.high / wavelength
    for mirror in box.mirrors:
        low[mirror.axis] = -NEVER
    along = zip((ngsolve.x, ngsolve.y, ngsolve.z), low.tolist(), high.tolist(), strict=True)
    beyond = [ngsolve.IfPos(place - top, 1, ngsolve.IfPos(bottom - place, 1, 0)) for place, bottom, top in along]
    return [1 + 1j * STRETCH * one for one in beyond]


def _plain(number: complex) -> complex | float:
    """Give a real number as such: NGSolve is quicker with it."""
    return number if number.imag else number.real


def _filling(scene: Scene, body: int) -> tuple[float, complex]:
    """Density of the air over that of the filling, and the square of the filling's wavenumber [1/λ²]."""
    medium = scene.obstacles[body].medium
    assert medium is not None
    return scene.medium.density / medium.density, complex(medium.wavenumber(scene.frequency) * scene.wavelength) ** 2


def _load_weights(scene: Scene) -> Complex128[np.ndarray, "3 bodies"]:
    weights = np.zeros((3, len(scene.obstacles)), dtype=np.complex128)
    weights[0] = 1.0
    wavenumber = scene.wavenumber * scene.wavelength
    for body, obstacle in enumerate(scene.obstacles):
        if obstacle.ratio is not None:
            weights[1, body] = 1j * wavenumber / obstacle.ratio
        if obstacle.medium is not None:
            ratio, inner = _filling(scene, body)
            weights[0, body], weights[2, body] = 1 - ratio, -ratio * (wavenumber**2 - inner)
    return weights
