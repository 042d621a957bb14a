"""Solves a factorised system for monopoles, part by part of their symmetry, and hears the solution anywhere."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Complex128, Float64, Int64, Real

from airtact.conventions import InvalidInput
from airtact.mesh.quadratic_triangles import points_at
from airtact.printing import in_short
from airtact.scene.sources import Monopoles
from airtact.solvers.fem.factorisation import Factor, factorised
from airtact.solvers.fem.meshing.symmetry import Mirror, images, parities, signs
from airtact.solvers.fem.quadrature import Spots
from airtact.solvers.fem.system import System
from airtact.solvers.monopoles import monopole_pressure
from airtact.solvers.velocity import open_air_gradient
from airtact.validation import in_mm

SILENT = 1e-10
"""A part whose load is below this share of all is left out."""


@dataclass(frozen=True, eq=False)
class Solution:
    """Pressure in the box: that of some monopoles in open air plus finite elements, even and odd about the mirrors.

    Attributes
    ----------
    places : (N, 3) monopoles whose open-air pressure is added [λ].
    strengths : (N, S) of e^{ikr}/r.
    parts : of each parity that is not silent, the (unknowns, S) finite elements on the positive side of the mirrors.
    """

    places: Float64[np.ndarray, "sources 3"]
    strengths: Complex128[np.ndarray, "sources sounds"]
    parts: dict[tuple[int, ...], Complex128[np.ndarray, "unknowns sounds"]]

    __repr__ = in_short


@dataclass(frozen=True, eq=False)
class ReadySystem:
    """A system and its factors, made when first needed.

    Attributes
    ----------
    system : the assembled equation.
    method : how it is factorised.
    factors : one for each parity that a sound had so far.
    """

    system: System
    method: str
    factors: dict[tuple[int, ...], Factor] = field(default_factory=dict)

    __repr__ = in_short

    @property
    def mirrors(self) -> tuple[Mirror, ...]:
        """Mirrors, in wavelengths."""
        return tuple(Mirror(one.axis, one.place / self.system.scene.wavelength) for one in self.system.box.mirrors)

    def solve(
        self,
        outer: tuple[Real[np.ndarray, "outer 3"], Complex128[np.ndarray, "outer sounds"]],
        inner: tuple[Real[np.ndarray, "inner 3"], Complex128[np.ndarray, "inner sounds"]],
    ) -> Solution:
        """Solve for monopoles.

        Parameters
        ----------
        outer : places [λ] and strengths of monopoles whose scattered pressure is sought.
        inner : the same of monopoles in the box whose total pressure is sought, as point loads.
        """
        loads = self._outer_loads(*outer) + self._inner_loads(*inner)
        least, parts = SILENT * np.linalg.norm(loads), {}
        for (parity, free), load in zip(self._free.items(), loads, strict=True):
            if np.linalg.norm(load[free]) > least:  # monopoles on a mirror make nothing that is odd about it
                parts[parity] = self._factor(parity).solve(load)
        return Solution(np.asarray(outer[0], dtype=np.float64), outer[1], parts)

    def _factor(self, parity: tuple[int, ...]) -> Factor:
        if parity not in self.factors:
            self.factors[parity] = factorised(self.system, self._odd(parity), self.method)
        return self.factors[parity]

    @cached_property
    def _free(self) -> dict[tuple[int, ...], Bool[np.ndarray, "unknowns"]]:
        """Which unknowns a sound of each parity may have."""
        return {parity: self.system.free(self._odd(parity), shared=False) for parity in parities(self.mirrors)}

    def _odd(self, parity: tuple[int, ...]) -> list[int]:
        """Axes of the mirrors that a parity is odd about."""
        return [mirror.axis for mirror, sign in zip(self.mirrors, parity, strict=True) if sign]

    def _outer_loads(
        self, places: Real[np.ndarray, "sources 3"], strengths: Complex128[np.ndarray, "sources sounds"]
    ) -> Complex128[np.ndarray, "parities unknowns sounds"]:
        ways = parities(self.mirrors)
        loads = np.zeros((len(ways), self.system.unknowns, strengths.shape[1]), dtype=np.complex128)
        if not len(places):
            return loads
        by_image = [self.system.load(image, strengths) for image in images(self.mirrors, places)]
        for row, parity in enumerate(ways):
            for sign, load in zip(signs(parity), by_image, strict=True):
                loads[row] += sign / len(ways) * load
        return loads

    def _inner_loads(
        self, places: Real[np.ndarray, "sources 3"], strengths: Complex128[np.ndarray, "sources sounds"]
    ) -> Complex128[np.ndarray, "parities unknowns sounds"]:
        ways = parities(self.mirrors)
        loads = np.zeros((len(ways), self.system.unknowns, strengths.shape[1]), dtype=np.complex128)
        folded, choice = self._folded(places)
        number, weights = self._held(folded)
        for source in range(len(places)):
            load = self.system.point_load(int(number[source]), weights[source])
            for row, parity in enumerate(ways):
                loads[row] += signs(parity)[choice[source]] / len(ways) * load[:, None] * strengths[source]
        return loads

    def _folded(
        self, points: Real[np.ndarray, "points 3"]
    ) -> tuple[Float64[np.ndarray, "points 3"], Int64[np.ndarray, "points"]]:
        """Bring points to the positive side of all mirrors; also the number of the image that each came from."""
        folded, choice = np.array(points, dtype=np.float64), np.zeros(len(points), dtype=np.int64)
        for mirror in self.mirrors:
            beyond = folded[:, mirror.axis] < mirror.place
            folded[beyond] = mirror.image(folded[beyond])
            choice = 2 * choice + beyond
        return folded, choice

    def _held(
        self, points: Real[np.ndarray, "points 3"]
    ) -> tuple[Int64[np.ndarray, "points"], Float64[np.ndarray, "points 4"]]:
        number, weights = self.system.tetrahedra.holding(points)
        if (number < 0).any():
            lost = points[int(np.argmax(number < 0))] * self.system.scene.wavelength
            raise InvalidInput(
                f"{int((number < 0).sum())} of {len(points)} points lie in no tetrahedron, the first at {in_mm(lost)}; "
                "ask for more elements_per_wavelength, which follow the skin more closely."
            )
        return number, weights

    def meshed_skin(self, points: Real[np.ndarray, "points 3"]) -> Float64[np.ndarray, "points 3"]:
        """Points of the skins as meshed that are nearest to points (P, 3) [λ]."""
        folded, choice = self._folded(points)
        panels = self.system.panels
        panel, foot, _ = panels.closest(folded)
        every = images(self.mirrors, points_at(panels.quadratic_triangles[panel], foot)[0])
        return np.stack([every[number][row] for row, number in enumerate(choice)])

    def near(self, solution: Solution, points: Real[np.ndarray, "points 3"]) -> Complex128[np.ndarray, "points sounds"]:
        """Total pressure at points (P, 3) [λ] in the box, by interpolation in the tetrahedra."""
        folded, choice = self._folded(points)
        number, weights = self._held(folded)
        found = self._open_air(solution, points)
        for parity, part in solution.parts.items():
            found += signs(parity)[choice][:, None] * self.system.values_at(number, weights, part)
        return found

    def slopes_near(
        self, solution: Solution, points: Real[np.ndarray, "points 3"]
    ) -> tuple[Complex128[np.ndarray, "points 3 sounds"], Float64[np.ndarray, "points"]]:
        """Slopes of the total pressure at points (P, 3) [λ] in the box, and the density there [kg/m³]."""
        folded, choice = self._folded(points)
        number, weights = self._held(folded)
        waves = Monopoles(solution.places, solution.strengths) if len(solution.places) else None
        found = np.zeros((len(points), 3, solution.strengths.shape[1]), dtype=np.complex128)
        for parity, part in solution.parts.items():
            found += signs(parity)[choice][:, None, None] * self.system.slopes_at(number, weights, part)
        found *= self._turned(choice)[:, :, None]
        if waves is not None:
            found += open_air_gradient(points, waves, self.system.wavenumber)
        return found, self.system.density_at(number, weights)

    def skin_normals(self, points: Real[np.ndarray, "points 3"]) -> Float64[np.ndarray, "points 3"]:
        """Find the unit normals, out of the bodies, of the meshed skins nearest to points (P, 3) [λ]."""
        folded, choice = self._folded(points)
        panel, foot, _ = self.system.panels.closest(folded)
        normals = points_at(self.system.panels.quadratic_triangles[panel], foot)[1] * self._turned(choice)
        return normals / np.linalg.norm(normals, axis=1, keepdims=True)

    def _turned(self, choice: Int64[np.ndarray, "points"]) -> Float64[np.ndarray, "points 3"]:
        """Signs that turn slopes at folded points into those at the points themselves."""
        found = np.ones((len(choice), 3))
        for bit, mirror in enumerate(reversed(self.mirrors)):
            found[:, mirror.axis] = 1.0 - 2.0 * (choice >> bit & 1)
        return found

    def away(
        self, solution: Solution, points: Real[np.ndarray, "points 3"], clear: bool = False
    ) -> Complex128[np.ndarray, "points sounds"]:
        """Scattered pressure at points (P, 3) [λ] off the bodies, by the surface integral over spots on them.

        Points that are clear of the bodies are heard from fewer spots in single precision.
        """
        skin, precision = (self.system.sparse, "float32") if clear else (self.system.skin, "float64")
        found = np.zeros((len(points), solution.strengths.shape[1]), dtype=np.complex128)
        skins, inner = self.on_spots(solution, skin), self.on_spots(solution, self.system.inner)
        for image, outside, inside in zip(images(self.mirrors, points), skins, inner, strict=True):
            found += self.system.heard(image, skin, outside, inside, precision)
        return found

    def on_spots(self, solution: Solution, spots: Spots) -> list[Complex128[np.ndarray, "spots sounds"]]:
        """Total pressure at the spots and at each of their images."""
        parts = {parity: spots.pressure(part) for parity, part in solution.parts.items()}
        found = []
        for number, points in enumerate(images(self.mirrors, spots.points)):
            total = self._open_air(solution, points)
            for parity, pressure in parts.items():
                total += signs(parity)[number] * pressure
            found.append(total)
        return found

    def _open_air(
        self, solution: Solution, points: Real[np.ndarray, "points 3"]
    ) -> Complex128[np.ndarray, "points sounds"]:
        if not len(solution.places) or not len(points):
            return np.zeros((len(points), solution.strengths.shape[1]), dtype=np.complex128)
        return monopole_pressure(points, solution.places, solution.strengths, self.system.wavenumber, "float64")


def nothing(sounds: int) -> tuple[Float64[np.ndarray, "0 3"], Complex128[np.ndarray, "0 sounds"]]:
    """No monopoles."""
    return np.zeros((0, 3)), np.zeros((0, sounds), dtype=np.complex128)


def joined(
    parts: Sequence[tuple[Real[np.ndarray, "_ 3"], Complex128[np.ndarray, "_ sounds"]]],
) -> tuple[Float64[np.ndarray, "sources 3"], Complex128[np.ndarray, "sources sounds"]]:
    """Several sets of monopoles as one."""
    return np.concatenate([places for places, _ in parts]), np.concatenate([strengths for _, strengths in parts])
