"""Separation-of-variables series for one sphere in the field of point sources.

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

from airtact.acoustics.solvers.arrays import ComplexPairs, Lengths, Pairs
from airtact.acoustics.solvers.spherical.radial_functions import (
    image_sums,
    legendre_polynomials,
    outgoing_derivatives,
    outgoing_ratios,
    regular_derivatives,
    regular_ratios,
)
from airtact.errors import NotConverged

# Largest error of the summed series, relative to the open-air pressure of the same source there.
ACCURACY = 1e-8

_MAX_TERMS = 20_000

_Radial = Complex128[np.ndarray, "radii"]
_Term = tuple[ComplexPairs, Pairs]


@dataclass(frozen=True)
class SphereModes:
    """The boundary condition of a sphere, for each mode.

    Attributes
    ----------
    radius : radius a [m].
    wavenumber : wavenumber k outside [1/m].
    admittance : ρc/Z of the surface; 0 for a sound-hard sphere, and unused if there is a fluid
        inside.
    inner_wavenumber : wavenumber k1 of the fluid inside [1/m], or None.
    density_ratio : density outside divided by density inside; unused without a fluid inside.
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
        """Yield β_n of the boundary condition f'(z) + β_n f(z) = 0 for n = 0, 1, 2 ..."""
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

    def first_safe_order(self) -> int:
        """Order above which the terms decrease: larger than both ka and k1 a."""
        largest = max(abs(self.size), abs((self.inner_wavenumber or 0.0) * self.radius))
        return int(largest + 5.0 * np.cbrt(largest) + 10.0)

    def scattered(
        self,
        inside: bool,
        radii: Lengths,
        source_radii: Float64[np.ndarray, "sources"],
        versine: Pairs,
        scale: Pairs,
    ) -> ComplexPairs:
        """Return the scattered pressure [Pa] of unit monopoles, or the total pressure inside.

        The points are all ``inside`` a fluid sphere or all outside. ``versine`` is 1 - cos γ of
        each point and source. The error is ``ACCURACY`` times ``scale`` [Pa].

        Raises
        ------
        NotConverged
            If 20000 terms do not reach ``ACCURACY``, for example at a point within micrometres of a
            source on the surface.
        """
        if inside and self.inner_wavenumber is not None:
            point_waves = regular_ratios(
                self.inner_wavenumber * radii, self.inner_wavenumber * self.radius
            )
        else:
            point_waves = outgoing_ratios(self.wavenumber * radii, self.size)
        source_waves = outgoing_ratios(self.wavenumber * source_radii, self.size)
        waves = zip(
            self.terms(inside),
            point_waves,
            source_waves,
            legendre_polynomials(versine),
            strict=False,
        )
        # Static images contain the singular part of sources near the surface.
        tail = _Tail.between(self, inside, radii, source_radii, versine)
        pressure = _summed(waves, tail, self.first_safe_order(), 1e-10 * scale)
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

    @classmethod
    def between(
        cls,
        modes: SphereModes,
        inside: bool,
        radii: Lengths,
        source_radii: Float64[np.ndarray, "sources"],
        versine: Pairs,
    ) -> "_Tail":
        """Build the tail for the ratio x of successive terms: a²/(r r0) outside, r/r0 inside."""
        scale = np.broadcast_to((modes.radius / source_radii)[None, :], versine.shape)
        if inside:
            ratio = radii[:, None] / source_radii
        else:
            # The image of a source at r0 is at a²/r0.
            ratio = (modes.radius / radii)[:, None] * scale
            scale = ratio
        return cls(ratio, versine, scale, modes.images(inside))

    def closed_form(self) -> ComplexPairs:
        """Return the sum over all orders of the static terms times the Legendre polynomials."""
        point, line = image_sums(self.ratio, self.versine)
        return self.scale * (self.images[0] * point - self.images[1] * line)

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
    waves: Iterator[tuple[complex, _Radial, _Radial, Pairs]],
    tail: _Tail,
    first_check: int,
    tolerance: Pairs,
) -> ComplexPairs | None:
    """Add terms until two estimates of the complete sum agree; return None if they do not.

    The second estimate uses 25 % more terms than the first.
    """
    check = first_check
    last_estimate = None
    partial = tail.closed_form()
    power = tail.scale
    point, line = tail.images
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
