"""Sound field of one sphere in closed form: sound-hard, with an impedance, or filled with a fluid.

With γ the angle between point and source, z = ka and h_n the outgoing spherical Hankel function,
the scattered pressure of a monopole e^{ikR}/R at radius r0 >= a is Σ t_n [h_n(kr)/h_n(z)]
[h_n(kr0)/h_n(z)] P_n(cos γ) outside and Σ u_n [j_n(k1 r)/j_n(k1 a)] [h_n(kr0)/h_n(z)] P_n(cos γ)
inside a fluid sphere (Bowman, Senior & Uslenghi, Electromagnetic and Acoustic Scattering by Simple
Shapes, 1987, sections 10.3 and 10.4; Anderson, J. Acoust. Soc. Am. 22, 426, 1950, for the fluid). A
boundary condition imposes f' + β_n f = 0 at r = a.

If source and point are near the surface, the terms decrease only as (a²/(r r0))^n. Two steps
shorten the sum. The static images, which contain the singular part, are summed in closed form. The
rest of the tail is summed by parts (Yennie, Ravenhall & Wilson, Phys. Rev. 95, 500, 1954).
"""

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import repeat

import numpy as np
from jaxtyping import Complex128, Float64
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist

from airtact.acoustics.scene import CONTACT, Scene, admittances, check_sources
from airtact.acoustics.solvers.problem import (
    RadiatedField,
    Solver,
    SolveReport,
    SurfaceField,
)
from airtact.acoustics.solvers.shared import (
    ComplexPairs,
    Lengths,
    Mask,
    Pairs,
    Points,
    Pressures,
    Vectors,
    sphere_rule,
)
from airtact.acoustics.solvers.spherical.radial_functions import (
    image_sums,
    legendre_polynomials,
    outgoing_derivatives,
    outgoing_ratios,
    regular_derivatives,
    regular_ratios,
)
from airtact.acoustics.sources import STANDS_ON, Monopoles, nearest_source
from airtact.errors import InvalidInput, NotConverged
from airtact.geometry.primitives import Capsule
from airtact.timing import Clock

# Largest error of the summed series, relative to the open-air pressure of the same source there.
ACCURACY = 1e-8

_MAX_TERMS = 20_000

_Term = tuple[ComplexPairs, Pairs]


@dataclass(frozen=True)
class SphereModes:
    """The boundary condition of a sphere, for each mode.

    Attributes
    ----------
    radius : radius a [m].
    wavenumber : wavenumber k outside the sphere [1/m].
    admittance : ρc/Z of the surface; 0 for a sound-hard sphere, and unused if there is a fluid
        inside.
    inner_wavenumber : wavenumber k1 in the fluid inside [1/m], or None.
    density_ratio : density outside divided by density inside; not used if there is no fluid inside.
    """

    radius: float
    wavenumber: complex
    admittance: complex = 0j
    inner_wavenumber: complex | None = None
    density_ratio: float = 0.0

    @property
    def size(self) -> complex:
        """The dimensionless radius z = ka."""
        return self.wavenumber * self.radius

    def surface_ratios(self) -> Iterator[complex]:
        """Yield β_n of the boundary condition f'(z) + β_n f(z) = 0 for n = 0, 1, 2, ..."""
        if self.inner_wavenumber is None:
            yield from repeat(1j * self.admittance)
            return
        factor = self.density_ratio * self.inner_wavenumber / self.wavenumber
        for derivative in regular_derivatives(self.inner_wavenumber * self.radius):
            yield -factor * derivative

    def terms(self, inside: bool) -> Iterator[complex]:
        """Yield the coefficients t_n (outside) or u_n (inside) [1/m] of the series.

        The formulas follow from the Wronskian j h' - j' h = i/z².
        """
        factor = self.wavenumber / self.size**2
        laws = zip(
            outgoing_derivatives(self.size),
            regular_derivatives(self.size),
            self.surface_ratios(),
            strict=False,
        )
        for order, (outgoing, regular, ratio) in enumerate(laws):
            if inside:
                yield -factor * (2 * order + 1) / (outgoing + ratio)
            else:
                yield (
                    factor
                    * (2 * order + 1)
                    * (regular + ratio)
                    / ((outgoing - regular) * (outgoing + ratio))
                )

    def images(self, inside: bool) -> tuple[complex, complex]:
        """Strengths (A, B) of the static point and line images [1/m].

        t_n or u_n = A - B/(n + 1) + O(1/n²).
        """
        if self.inner_wavenumber is None:
            return complex(1.0 / self.radius), (
                1.0 - 2j * self.admittance * self.size
            ) / self.radius
        total = 1.0 + self.density_ratio
        if inside:
            point = 2.0 / total / self.radius
            return complex(point), complex(point * (1.0 / total - 0.5))
        point = (1.0 - self.density_ratio) / total / self.radius
        return complex(point), complex(point / total)

    def scattered(
        self,
        inside: bool,
        radii: Lengths,
        source_radii: Float64[np.ndarray, "sources"],
        versine: Pairs,
        scale: Pairs,
    ) -> ComplexPairs:
        """Return the scattered pressure outside the sphere or the total pressure inside [Pa].

        The sources are unit monopoles. If ``inside`` is True, all points are inside the fluid
        sphere, and otherwise all are outside the sphere. ``versine`` is 1 - cos γ, where γ is the
        angle between a point and a source, as seen from the centre. The error is ``ACCURACY`` times
        ``scale`` [Pa].

        Raises
        ------
        NotConverged
            If 20000 terms do not reach ``ACCURACY``, for example at a point within micrometres of a
            source on the surface.
        """
        point_waves = (
            regular_ratios(self.inner_wavenumber * radii, self.inner_wavenumber * self.radius)
            if inside and self.inner_wavenumber is not None
            else outgoing_ratios(self.wavenumber * radii, self.size)
        )
        waves = zip(
            self.terms(inside),
            point_waves,
            outgoing_ratios(self.wavenumber * source_radii, self.size),
            legendre_polynomials(versine),
            strict=False,
        )
        # The ratio x of successive terms is a²/(r r0) outside and r/r0 inside.
        strength = np.broadcast_to((self.radius / source_radii)[None, :], versine.shape)
        if inside:
            ratio = radii[:, None] / source_radii
        else:
            # The image of a source at r0 is at a²/r0.
            ratio = (self.radius / radii)[:, None] * strength
            strength = ratio
        # Static images contain the singular part of sources near the surface.
        tail = _Tail(ratio, versine, strength, self.images(inside))
        # Above this order, which is larger than ka outside and inside the sphere, terms decrease.
        largest = max(abs(self.size), abs((self.inner_wavenumber or 0.0) * self.radius))
        safe_order = int(largest + 5.0 * np.cbrt(largest) + 10.0)
        pressure = _summed(waves, tail, safe_order, 1e-10 * scale)
        if pressure is None:
            raise NotConverged(
                f"the series of a sphere of radius {1e3 * self.radius:g} mm did not reach "
                f"{ACCURACY:g} within {_MAX_TERMS} terms at a point "
                f"{1e3 / float(np.max(scale)):.3g} mm from a source; move points away from sources "
                "that touch the surface.",
                code="not_converged",
            )
        return pressure


@dataclass(frozen=True, eq=False)
class _Tail:
    """Sums over the static part of the terms, scale·x^n (A - B/(n+1)), and over the rest."""

    ratio: Pairs
    versine: Pairs
    scale: Pairs
    images: tuple[complex, complex]

    def beyond(self, partial: ComplexPairs, recent: list[_Term], order: int) -> ComplexPairs:
        """Estimate the complete sum from the partial sum up to order + 2, summing twice by parts.

        Multiplying a Legendre series of terms d_n by q = 1 - 2x cos γ + x² results in the series of
        (1 + x²) d_n - 2x [α_(n-1) d_(n-1) + β_(n+1) d_(n+1)] with α_n = (n+1)/(2n+1) and β_n =
        n/(2n+1). Its terms are smaller by 1/n² for smooth d_n/x^n. The part of this series that the
        cut at ``order`` omits is known exactly.
        """
        (before, _), (here, legendre), (after, legendre_after), (last, legendre_last) = recent
        partial = partial - after * legendre_after - last * legendre_last
        square = (1.0 - self.ratio) ** 2 + 2.0 * self.ratio * self.versine
        weight = 2.0 * self.ratio / square

        def up(n: int) -> float:
            return (n + 1) / (2 * n + 1)

        def down(n: int) -> float:
            return n / (2 * n + 1)

        def left_over(term: ComplexPairs, following: ComplexPairs) -> ComplexPairs:
            return weight * (
                up(order) * term * legendre_after - down(order + 1) * following * legendre
            )

        reduced = (1.0 + self.ratio**2) * here - 2.0 * self.ratio * (
            up(order - 1) * before + down(order + 1) * after
        )
        reduced_after = (1.0 + self.ratio**2) * after - 2.0 * self.ratio * (
            up(order) * here + down(order + 2) * last
        )
        # Close to the image, the second step would divide the rounding errors of the terms by the
        # fourth power of a small distance.
        second = np.where(square > 0.01**2, left_over(reduced, reduced_after) / square, 0.0)
        return partial + left_over(here, after) + second


def _summed(
    waves: Iterator[
        tuple[complex, Complex128[np.ndarray, "radii"], Complex128[np.ndarray, "radii"], Pairs]
    ],
    tail: _Tail,
    first_check: int,
    tolerance: Pairs,
) -> ComplexPairs | None:
    """Add terms until two estimates of the complete sum agree; return None if they do not.

    The second estimate uses 25 % more terms than the first.
    """
    check = first_check
    last_estimate = None
    point, line = tail.images
    # The sum of the static terms over all orders, in closed form
    points, lines = image_sums(tail.ratio, tail.versine)
    partial = tail.scale * (point * points - line * lines)
    power = tail.scale
    recent: deque[_Term] = deque(maxlen=4)
    for order, (term, point_wave, source_wave, polynomial) in enumerate(waves):
        rest = term * point_wave[:, None] * source_wave - (point - line / (order + 1)) * power
        recent.append((rest, polynomial))
        power = power * tail.ratio
        partial = partial + rest * polynomial
        if order < max(check, 4):
            continue
        estimate = tail.beyond(partial, list(recent), order - 2)
        if last_estimate is not None and np.all(np.abs(estimate - last_estimate) <= tolerance):
            return estimate
        if order >= _MAX_TERMS:
            return None
        # The next estimate follows after a quarter more terms, so that agreement by chance is rare.
        check = min(int(1.25 * order) + 4, _MAX_TERMS)
        last_estimate = estimate
    return None


_CITATIONS = (
    "J. J. Bowman, T. B. A. Senior, P. L. E. Uslenghi, Electromagnetic and Acoustic Scattering by "
    "Simple Shapes (1987)",
    "V. C. Anderson, Sound scattering from a fluid sphere, J. Acoust. Soc. Am. 22, 426 (1950)",
    "D. R. Yennie, D. G. Ravenhall, R. N. Wilson, Phys. Rev. 95, 500 (1954)",
)


@dataclass(frozen=True, eq=False, repr=False)
class SphereField(RadiatedField):
    """The field of monopoles around one sphere, and inside it if it is filled.

    The error of the field is 1e-8 of the open-air pressures. Evaluating the field within
    micrometres of a source that touches the surface raises ``NotConverged``. ``centre`` is the
    centre of the sphere [m].
    """

    modes: SphereModes
    centre: Float64[np.ndarray, "3"]

    @property
    def on_surface(self) -> SurfaceField:
        """Pressure at Gauss-Legendre latitudes and equally spaced longitudes."""
        directions, weights = sphere_rule(int(np.ceil(2.0 * abs(self.modes.size))) + 11)
        normals = directions.reshape(-1, 3)
        areas = np.repeat(weights, directions.shape[1]) * self.modes.radius**2
        points = self.centre + self.modes.radius * normals
        return SurfaceField(points, normals, areas, self.at(points))

    def _valid(self, points: Vectors) -> Mask:
        if self.modes.inner_wavenumber is not None:
            return np.ones(len(points), dtype=np.bool_)
        return ~self._inside(points)

    def _at(self, points: Vectors) -> Pressures:
        pressure = self.nowhere(points)
        inside = self._inside(points)
        outside = np.flatnonzero(~inside)
        pressure[outside] = self._incident(points[outside])
        pressure[outside] += self._scattered(points[outside], inside=False)
        if self.modes.inner_wavenumber is not None:
            pressure[inside] = self._scattered(points[inside], inside=True)
        return pressure

    def _scattered_at(self, points: Vectors) -> Pressures:
        pressure = self.nowhere(points)
        inside = self._inside(points)
        on_source = nearest_source(points, self.sources, STANDS_ON)[0] < STANDS_ON
        distance = np.linalg.norm(points - self.centre, axis=1)
        unbounded = on_source & (distance <= self.modes.radius + CONTACT)
        outside = np.flatnonzero(~inside & ~unbounded)
        pressure[outside] = self._scattered(points[outside], inside=False, alone=True)
        if self.modes.inner_wavenumber is not None:
            # Inside a fluid, the series is the total pressure.
            total = self._scattered(points[inside], inside=True)
            pressure[inside] = total - self._incident(points[inside])
        return pressure

    def _inside(self, points: Points) -> Mask:
        # Points on the surface count as outside despite rounding.
        return np.linalg.norm(points - self.centre, axis=1) < self.modes.radius - CONTACT

    def _scattered(self, points: Points, inside: bool, alone: bool = False) -> Pressures:
        """Sum the series at points on one side of the surface.

        The error is ``ACCURACY`` times the open-air pressure. If ``alone`` is set, the open-air
        pressure is evaluated no closer than the distance of the source's image, so that it is
        finite at the source itself.
        """
        pressure = np.zeros((len(points), self.excitations), dtype=np.complex128)
        radii, directions = self._polar(points)
        source_radii, source_directions = self._polar(self.sources.positions)
        # Rounding may place sources on the surface slightly below it.
        source_radii = np.maximum(source_radii, self.modes.radius)
        if not inside:
            radii = np.maximum(radii, self.modes.radius)
        # The points of a block need about the same number of terms, and the pairs of point and
        # source of a block fit into the cache.
        order = np.argsort(KDTree(self.sources.positions).query(points)[0])
        rows = max(1, 2**14 // len(self.sources.positions))
        for first in range(0, len(points), rows):
            index = order[first : first + rows]
            distance = cdist(points[index], self.sources.positions)
            if alone:
                # The image is as far below the surface as the source is above it.
                heights = radii[index, None] + source_radii - 2.0 * self.modes.radius
                distance = np.maximum(distance, heights)
            scale = np.exp(-self.scene.wavenumber.imag * distance) / distance
            # Half the square of the chord preserves the digits of 1 - cos γ at small angles.
            versine = 0.5 * cdist(directions[index], source_directions, "sqeuclidean")
            unit = self.modes.scattered(inside, radii[index], source_radii, versine, scale)
            pressure[index] = unit @ self.sources.strengths
        return pressure

    def _polar(self, points: Points) -> tuple[Lengths, Vectors]:
        offset = points - self.centre
        radius = np.linalg.norm(offset, axis=1)
        at_centre = radius == 0.0
        direction = offset / np.where(at_centre, 1.0, radius)[:, None]
        direction[at_centre] = (0.0, 0.0, 1.0)  # any direction is valid
        return radius, direction


@dataclass(frozen=True)
class SphereSeries(Solver):
    """Separation-of-variables solver for one sphere, a reference for other solvers.

    The sphere, built by ``sphere(radius, edge, centre)``, is sound-hard, has an impedance boundary,
    or is filled with a fluid. The series are summed to an error of 1e-8, relative to the open-air
    pressure of the same source. There are no settings. Sources lie outside the sphere or on it.
    ``radiate`` raises ``InvalidInput`` for other sources, and for scenes with another body, several
    bodies or a plane. The field raises ``NotConverged`` at points within micrometres of a source on
    the sphere.
    """

    def radiate(self, scene: Scene, sources: Monopoles) -> SphereField:
        """Return the field of monopoles around the single sphere of the scene.

        Raises
        ------
        InvalidInput
            If the scene is not a single sphere, if a source is inside the sphere, or if an argument
            has the wrong type.
        """
        check_sources(scene, sources)
        clock = Clock()
        with clock.step("prepare"):
            count = len(scene.obstacles)
            if count != 1:
                raise InvalidInput(
                    f"SphereSeries supports only one sphere, but the scene has {count} obstacles; "
                    "use BoundaryElement.",
                    code="not_supported",
                )
            obstacle = scene.obstacles[0]
            sphere = obstacle.surface.primitive
            if not isinstance(sphere, Capsule) or sphere.length != 0.0:
                kind = "a capsule" if isinstance(sphere, Capsule) else "a mesh"
                raise InvalidInput(
                    f"SphereSeries supports only exact spheres, but the obstacle is {kind}; build "
                    "it with sphere(radius, edge, centre), or use BoundaryElement.",
                    code="not_supported",
                )
            filling = obstacle.medium
            modes = SphereModes(
                float(sphere.radius),
                scene.wavenumber,
                admittance=complex(admittances(scene)[0]),
                inner_wavenumber=filling.wavenumber(scene.frequency) if filling else None,
                density_ratio=scene.medium.density / filling.density if filling else 0.0,
            )
        report = SolveReport(
            solver="SphereSeries",
            estimated_error=ACCURACY,
            seconds=clock.seconds,
            settings={"accuracy": ACCURACY, "boundary": obstacle.boundary},
            citations=_CITATIONS,
        )
        centre = np.asarray(sphere.pose.translation, dtype=np.float64)
        return SphereField(scene, sources, report, modes, centre)
