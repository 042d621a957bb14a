"""Solves an assembled system for monopoles, part by part of their symmetry, and evaluates the solution."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Complex128

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
from airtact.acoustics.solvers.fem.meshing.netgen import ngsolve_library
from airtact.acoustics.solvers.fem.meshing.symmetry import images, parities, signs
from airtact.acoustics.solvers.fem.quadrature import QuadraturePoints
from airtact.acoustics.solvers.fem.surface_integral import surface_integral
from airtact.acoustics.solvers.fem.system import System
from airtact.acoustics.solvers.monopoles import monopole_pressure
from airtact.acoustics.solvers.velocity import open_air_gradient
from airtact.acoustics.sources import Monopoles
from airtact.printing import in_short

NEGLIGIBLE = 1e-10
"""A part whose right-hand side is below this fraction of all is left out."""


@dataclass(frozen=True, eq=False)
class PointSources:
    """Some monopoles, or none: positions [λ] and the strengths of e^{ikr}/r."""

    positions: SourcePoints
    strengths: Strengths

    __repr__ = in_short

    def chosen(self, some: Bool[np.ndarray, "sources"]) -> "PointSources":
        """Those that are chosen."""
        return PointSources(self.positions[some], self.strengths[some])

    def and_also(self, others: Sequence["PointSources"]) -> "PointSources":
        """Join these and others."""
        every = [self, *others]
        return PointSources(
            np.concatenate([one.positions for one in every]),
            np.concatenate([one.strengths for one in every]),
        )

    def pressure(self, points: Points, wavenumber: complex) -> Pressures:
        """Their free field at points (P, 3) [λ]."""
        if not len(self.positions) or not len(points):
            return np.zeros((len(points), self.strengths.shape[1]), dtype=np.complex128)
        return monopole_pressure(points, self.positions, self.strengths, wavenumber, "float64")


@dataclass(frozen=True, eq=False)
class Solution:
    """Pressure in the box: the free field of some monopoles plus finite elements, even and odd about the mirrors.

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

    __repr__ = in_short

    def total(self, points: Points) -> Pressures:
        """Total pressure at points (P, 3) [λ] in the box, by interpolation in the tetrahedra."""
        return self.finite_elements(points) + self.outer.pressure(points, self.system.wavenumber)

    def finite_elements(self, points: Points) -> Pressures:
        """Total pressure less the free field of the outer monopoles at points (P, 3) [λ] in the box."""
        folded, choice = self.system.folded(points)
        mapped = self.system.mesh_points(*self.system.holding(folded))
        found = np.zeros((len(points), self.outer.strengths.shape[1]), dtype=np.complex128)
        for sign, column, pressure in self._columns(choice):
            found[:, column] += sign * np.asarray(pressure(mapped)).ravel()
        return found

    def gradients(self, points: Points) -> tuple[Gradients, Lengths]:
        """Gradient of the total pressure at points (P, 3) [λ] in the box [1/λ²], and the density there [kg/m³]."""
        folded, choice = self.system.folded(points)
        number, weights = self.system.holding(folded)
        mapped = self.system.mesh_points(number, weights)
        found = np.zeros((len(points), 3, self.outer.strengths.shape[1]), dtype=np.complex128)
        for sign, column, pressure in self._columns(choice):
            found[:, :, column] += sign[:, None] * np.asarray(
                ngsolve_library().grad(pressure)(mapped)
            ).reshape(-1, 3)
        found *= self.system.axis_signs(choice)[:, :, None]
        if len(self.outer.positions):
            waves = Monopoles(self.outer.positions, self.outer.strengths)
            found += open_air_gradient(points, waves, self.system.wavenumber)
        return found, self.system.density_at(number, weights)

    def _columns(self, choice: Indices) -> Iterator[tuple[Lengths, int, Any]]:
        """Each part and excitation as a function of NGSolve's with its signs at images; the next one replaces it."""
        pressure = ngsolve_library().GridFunction(self.system.space)
        for parity, part in self.parts.items() if len(choice) else ():
            for column in range(part.shape[1]):
                pressure.vec.FV().NumPy()[:] = part[:, column]
                yield signs(parity)[choice], column, pressure

    def scattered(self, points: Points, clear: bool = False) -> Pressures:
        """Scattered pressure at points (P, 3) [λ] off the bodies, by the surface integral.

        Fewer quadrature points serve points that are ``clear`` of the bodies.
        """
        system = self.system
        w_d, w_s, w_v = system.weights
        on, within = system.coarse_surface if clear else system.surface, system.interior
        positions = np.concatenate([on.points, within.points])
        normals = np.concatenate([on.normals, within.normals])
        dipole_weights = np.concatenate([w_d[on.body] * on.areas, np.zeros(len(within.body))]) / (
            4 * np.pi
        )
        monopole_weights = np.concatenate(
            [w_s[on.body] * on.areas, w_v[within.body] * within.areas]
        ) / (4 * np.pi)
        found = np.zeros((len(points), self.outer.strengths.shape[1]), dtype=np.complex128)
        parts = zip(
            images(system.mirrors, points), self.at_nodes(on), self.at_nodes(within), strict=True
        )
        for image, on_surface, inside in parts:
            pressure = np.concatenate([on_surface, inside])
            monopoles, dipoles = (
                monopole_weights[:, None] * pressure,
                dipole_weights[:, None] * pressure,
            )
            found += surface_integral(
                image, positions, normals, monopoles, dipoles, system.wavenumber
            )
        return found

    def at_nodes(
        self, nodes: QuadraturePoints
    ) -> list[Complex128[np.ndarray, "nodes excitations"]]:
        """Total pressure at quadrature points and at each of their images."""
        parts = {parity: nodes.pressure(part) for parity, part in self.parts.items()}
        found = []
        for number, points in enumerate(images(self.system.mirrors, nodes.points)):
            total = self.outer.pressure(points, self.system.wavenumber)
            for parity, pressure in parts.items():
                total += signs(parity)[number] * pressure
            found.append(total)
        return found


def solve(system: System, outer: PointSources, inner: PointSources) -> Solution:
    """Solve for ``outer`` monopoles by the pressure that they scatter, for ``inner`` ones (in the box) as loads."""
    ways = parities(system.mirrors)
    right = np.zeros((len(ways), system.unknowns, outer.strengths.shape[1]), dtype=np.complex128)
    if len(outer.positions):
        by_image = [
            system.right_hand_side(image, outer.strengths)
            for image in images(system.mirrors, outer.positions)
        ]
        for row, parity in enumerate(ways):
            for sign, one in zip(signs(parity), by_image, strict=True):
                right[row] += sign / len(ways) * one
    folded, choice = system.folded(inner.positions)
    number, weights = system.holding(folded)
    for source in range(len(inner.positions)):
        load = system.point_load(int(number[source]), weights[source])
        for row, parity in enumerate(ways):
            right[row] += (
                signs(parity)[choice[source]] / len(ways) * load[:, None] * inner.strengths[source]
            )
    least, parts = NEGLIGIBLE * np.linalg.norm(right), {}
    for parity, one in zip(ways, right, strict=True):
        if (
            np.linalg.norm(one[system.free[parity]]) > least
        ):  # monopoles on a mirror make nothing that is odd about it
            parts[parity] = system.factor(parity).solve(one)
    return Solution(system, outer, parts)
