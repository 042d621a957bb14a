"""Solves an assembled system for monopoles, one parity at a time, and evaluates it."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Complex128

from airtact import _kernels
from airtact.acoustics.solvers.arrays import (
    Coefficients,
    Gradients,
    Indices,
    Lengths,
    Points,
    Pressures,
    SourcePoints,
    Strengths,
)
from airtact.acoustics.solvers.fem.libraries import ngsolve_library
from airtact.acoustics.solvers.fem.quadrature_points import QuadraturePoints
from airtact.acoustics.solvers.fem.symmetry import images, parities, signs
from airtact.acoustics.solvers.fem.system import System
from airtact.acoustics.solvers.open_air import monopole_pressure, open_air_gradient
from airtact.acoustics.sources import Monopoles


@dataclass(frozen=True, eq=False)
class PointSources:
    """Some monopoles, or none: positions [λ] and the strengths of e^{ikr}/r."""

    positions: SourcePoints
    strengths: Strengths

    def chosen(self, mask: Bool[np.ndarray, "sources"]) -> "PointSources":
        """Select some."""
        return PointSources(self.positions[mask], self.strengths[mask])

    def joined(self, added: Sequence["PointSources"]) -> "PointSources":
        """Join these and others."""
        return PointSources(
            np.concatenate([self.positions, *(sources.positions for sources in added)]),
            np.concatenate([self.strengths, *(sources.strengths for sources in added)]),
        )

    def pressure(self, points: Points, wavenumber: complex) -> Pressures:
        """Their free field at points (P, 3) [λ]."""
        if not len(self.positions) or not len(points):
            return np.zeros((len(points), self.strengths.shape[1]), dtype=np.complex128)
        return monopole_pressure(points, self.positions, self.strengths, wavenumber, "float64")


@dataclass(frozen=True, eq=False, repr=False)
class Solution:
    """Pressure in the box: the free field of some monopoles plus finite elements.

    Attributes
    ----------
    system : what was solved.
    outer : the monopoles whose free field is added.
    parts : of each parity that is not negligible, the (unknowns, S) finite elements on the mirrors'
        positive side.
    """

    system: System
    outer: PointSources
    parts: dict[tuple[int, ...], Coefficients]

    def total(self, points: Points) -> Pressures:
        """Total pressure at points (P, 3) [λ] in the box, by interpolation in the tetrahedra."""
        return self.finite_elements(points) + self.outer.pressure(points, self.system.wavenumber)

    def finite_elements(self, points: Points) -> Pressures:
        """Total pressure less the free field of the outer monopoles at points (P, 3) [λ]."""
        folded, image = self.system.folded(points)
        mapped = self.system.mesh_points(*self.system.holding(folded))
        pressure = np.zeros((len(points), self.outer.strengths.shape[1]), dtype=np.complex128)
        for sign, column, function in self._functions(image):
            pressure[:, column] += sign * np.asarray(function(mapped)).ravel()
        return pressure

    def gradients(self, points: Points) -> tuple[Gradients, Lengths]:
        """Gradient of the total pressure at points (P, 3) [λ], and the density [kg/m³] there."""
        ngsolve = ngsolve_library()
        folded, image = self.system.folded(points)
        number, weights = self.system.holding(folded)
        mapped = self.system.mesh_points(number, weights)
        gradients = np.zeros((len(points), 3, self.outer.strengths.shape[1]), dtype=np.complex128)
        for sign, column, function in self._functions(image):
            gradient = np.asarray(ngsolve.grad(function)(mapped)).reshape(-1, 3)
            gradients[:, :, column] += sign[:, None] * gradient
        # A mirrored point has the mirrored vector.
        gradients *= self.system.axis_signs(image)[:, :, None]
        if len(self.outer.positions):
            waves = Monopoles(self.outer.positions, self.outer.strengths)
            gradients += open_air_gradient(points, waves, self.system.wavenumber)
        return gradients, self.system.density_at(number, weights)

    def _functions(self, image: Indices) -> Iterator[tuple[Lengths, int, Any]]:
        """Yield sign at each image, excitation and NGSolve's function of each part.

        The next function replaces the one before it.
        """
        function = ngsolve_library().GridFunction(self.system.space)
        if not len(image):
            return
        for parity, part in self.parts.items():
            for column in range(part.shape[1]):
                function.vec.FV().NumPy()[:] = part[:, column]
                yield signs(parity)[image], column, function

    def scattered(self, points: Points, clear: bool = False) -> Pressures:
        """Scattered pressure at points (P, 3) [λ] off the bodies, by the surface integral.

        Fewer quadrature points serve points that are ``clear`` of the bodies.
        """
        system = self.system
        surface = system.coarse_surface if clear else system.surface
        interior = system.interior
        positions = np.concatenate([surface.points, interior.points])
        normals = np.concatenate([surface.normals, interior.normals])
        # Kirchhoff and Helmholtz: the solution itself is the test function of L_y.
        w_d, w_s, w_v = system.weights / (4 * np.pi)
        dipole_weights = w_d[surface.body] * surface.areas
        dipole_weights = np.concatenate([dipole_weights, np.zeros(len(interior.body))])[:, None]
        monopole_weights = np.concatenate(
            [w_s[surface.body] * surface.areas, w_v[interior.body] * interior.areas]
        )[:, None]
        scattered = np.zeros((len(points), self.outer.strengths.shape[1]), dtype=np.complex128)
        on_surface = self.at_nodes(surface)
        inside = self.at_nodes(interior)
        for number, image in enumerate(images(system.mirrors, points)):
            pressure = np.concatenate([on_surface[number], inside[number]])
            # Σ_j m_j G(x, y_j) + d_j ∂G(x, y_j)/∂n_j with G = e^{ikr}/r
            scattered += _kernels.surface_integral(
                image,
                positions,
                normals,
                monopole_weights * pressure,
                dipole_weights * pressure,
                system.wavenumber,
            )
        return scattered

    def at_nodes(
        self, nodes: QuadraturePoints
    ) -> list[Complex128[np.ndarray, "nodes excitations"]]:
        """Total pressure at quadrature points and at each of their images."""
        parts = {parity: nodes.pressure(part) for parity, part in self.parts.items()}
        totals = []
        for number, points in enumerate(images(self.system.mirrors, nodes.points)):
            total = self.outer.pressure(points, self.system.wavenumber)
            for parity, pressure in parts.items():
                total += signs(parity)[number] * pressure
            totals.append(total)
        return totals


def solve(system: System, outer: PointSources, inner: PointSources) -> Solution:
    """Solve for ``outer`` monopoles by what they scatter, for ``inner`` ones as loads."""
    every = parities(system.mirrors)
    right = np.zeros((len(every), system.unknowns, outer.strengths.shape[1]), dtype=np.complex128)
    if len(outer.positions):
        # The part of a source with some parity is its images with that parity's signs.
        for number, positions in enumerate(images(system.mirrors, outer.positions)):
            scattered = system.right_hand_side(positions, outer.strengths)
            for row, parity in enumerate(every):
                right[row] += signs(parity)[number] / len(every) * scattered
    folded, image = system.folded(inner.positions)
    number, weights = system.holding(folded)
    for source, strengths in enumerate(inner.strengths):
        load = system.point_load(int(number[source]), weights[source])
        for row, parity in enumerate(every):
            sign = signs(parity)[image[source]]
            right[row] += sign / len(every) * load[:, None] * strengths
    # Monopoles on a mirror make nothing that is odd about it: no factorisation is spent on that.
    negligible = 1e-10 * np.linalg.norm(right)
    parts = {
        parity: system.factor(parity).solve(side)
        for parity, side in zip(every, right, strict=True)
        if np.linalg.norm(side[system.free[parity]]) > negligible
    }
    return Solution(system, outer, parts)
