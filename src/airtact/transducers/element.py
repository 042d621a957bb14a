"""A transducer: points and weights on its face, and its sensitivity."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float64, Real

from airtact.errors import (
    InvalidInput,
    between,
    counted,
    one_line,
    points_of,
    positive,
    real_numbers,
    within,
)

# Peak pressure of one transducer at full scale, 1 m away on its axis [Pa·m]: √2 times 3.10 Pa rms,
# the amplitude in the AUTD3 SDK. It is not calibrated, and other sources differ by a factor of 2.
# Measure your own device if absolute pressures matter.
DEFAULT_SENSITIVITY = 4.38

# Largest product of wavenumber and radius for each number of points; the error of the far-field
# pattern is then 1.5e-3
MAX_PISTON_SIZE = {12: 3.5, 19: 4.8}


@dataclass(frozen=True, eq=False)
class Element:
    """A transducer, represented by weighted monopoles on its face.

    ``piston`` and ``monopole`` build elements, and all transducers of a ``PhasedArray`` have the
    same element. In the frame of the element, the position of the transducer is the origin, and the
    face lies in the plane z = 0 and radiates toward +z. In open air, the pressure is the sum of
    weight × sensitivity × amplitude × e^{ikr}/r over the points.

    Attributes
    ----------
    points : (Q, 3) points on the face in the frame of the element [m].
    weights : (Q,) real weights, the fraction that each point contributes to the pressure; their sum
        is 1.
    sensitivity : peak pressure at full scale, 1 m away on the axis [Pa·m]. The default is 4.38, the
        value in the AUTD3 SDK, which is not calibrated.
    directional : whether the element radiates only into the half-space in front of its face. All
        foci and bodies must then be in this half-space. False by default.
    radius : radius of the face [m], 0 to 0.1; 0, the default, for a single point. The field depends
        only on ``points`` and ``weights``; the radius is used to describe the element, and to check
        that it has enough points and that elements do not overlap.

    Raises
    ------
    InvalidInput
        If a number is not finite, if the weights do not match the points or do not add up to 1, if
        the sensitivity is not above zero, or if the radius is outside its range.

    Examples
    --------
    >>> len(piston(radius=4.5e-3).weights)
    19
    """

    points: Float64[np.ndarray, "face 3"]
    weights: Float64[np.ndarray, "face"]
    sensitivity: float = DEFAULT_SENSITIVITY
    directional: bool = False
    radius: float = 0.0

    def __repr__(self) -> str:
        return one_line(self, self.kind, f"{self.sensitivity:.4g} Pa·m")

    def __post_init__(self) -> None:
        points = points_of(self.points, "face points")
        weights = real_numbers(self.weights, "face weights")
        if weights.shape != (len(points),):
            raise InvalidInput(
                f"the weights have shape {weights.shape}, but the element has "
                f"{counted(len(points), 'face point', 'face points')}. Pass one weight for each "
                "point.",
                code="wrong_shape",
            )
        if not abs(weights.sum() - 1.0) < 1e-9:
            raise InvalidInput(
                f"the weights of an element must add up to 1, not {weights.sum():g}.",
                code="out_of_range",
            )
        sensitivity = positive(self.sensitivity, "the sensitivity of an element", "Pa·m")
        radius = between(self.radius, 0.0, 0.1, "the radius of an element", "m")
        # ``vars`` bypasses the frozen dataclass.
        vars(self).update(points=points, weights=weights, sensitivity=sensitivity, radius=radius)

    @property
    def kind(self) -> str:
        """Description of the element, such as "monopoles" or "pistons of 4.5 mm"."""
        if self.radius:
            return f"pistons of {1e3 * self.radius:g} mm"
        count = len(self.points)
        return "monopoles" if count == 1 else f"elements of {count} points"

    @property
    def reach(self) -> float:
        """Largest distance of a face point from the element's position [m]."""
        return float(np.linalg.norm(self.points, axis=1).max())

    def pattern_in_words(self, wavenumber: float) -> str:
        """Return a phrase that describes the directivity at a wavenumber k [rad/m].

        >>> piston(4.0e-3).pattern_in_words(732.5)
        'pistons of 4 mm radius (-6 dB at 49 degrees) that only radiate forward'
        """
        if self.radius == 0.0:
            return "directional" if self.directional else "monopoles (equal in all directions)"
        size = wavenumber * self.radius
        half = 2.2151  # argument at which 2 J₁(x)/x is a half, −6 dB
        width = (
            f"-6 dB at {np.degrees(np.arcsin(half / size)):.0f} degrees"
            if size > half
            else "above -6 dB in all directions"
        )
        return f"pistons of {self.radius * 1e3:.3g} mm radius ({width}) that only radiate forward"

    def same_as(self, element: "Element") -> bool:
        """Return whether another element has the same values."""
        return (
            np.array_equal(self.points, element.points)
            and np.array_equal(self.weights, element.weights)
            and (self.sensitivity, self.directional, self.radius)
            == (element.sensitivity, element.directional, element.radius)
        )

    def far_pattern(
        self, directions: Real[np.ndarray, "directions 3"], wavenumber: float
    ) -> Complex[np.ndarray, "directions"]:
        """Return the far-field pressure in the given directions, relative to that on the axis.

        Parameters
        ----------
        directions : (D, 3) unit vectors in the element's frame.
        wavenumber : k = 2πf/c [rad/m].

        Returns
        -------
        (D,) complex Σ_j w_j exp(−i k u·x_j) for each direction u; 1 on the axis.
        """
        return np.exp(-1j * wavenumber * (directions @ self.points.T)) @ self.weights

    def directivity(
        self, cosines: Float64[np.ndarray, "*angles"], wavenumber: float
    ) -> Float64[np.ndarray, "*angles"]:
        """Return the far-field pressure at angles from the axis, relative to that on the axis.

        ``cosines`` are the cosines of the angles, and ``wavenumber`` is k = 2πf/c [rad/m]. The
        result is interpolated in a table of 400 angles.
        """
        if len(self.weights) == 1:
            return np.ones_like(cosines)
        table = np.linspace(0.0, 1.0, 400)
        directions = np.stack([table, np.zeros_like(table), np.sqrt(1.0 - table**2)], axis=1)
        sines = np.sqrt(np.maximum(1.0 - cosines**2, 0.0))
        return np.interp(sines, table, np.real(self.far_pattern(directions, wavenumber)))


def monopole(sensitivity: float = DEFAULT_SENSITIVITY) -> Element:
    """Return a transducer that radiates equally in all directions.

    Inoue, Makino and Shinoda (2014, section 4.1) use this model. ``piston`` returns a directional
    transducer.

    Parameters
    ----------
    sensitivity : peak pressure at full scale, 1 m away [Pa·m], above 0. The default is 4.38, the
        value for AUTD3, which is not calibrated.

    Returns
    -------
    An ``Element`` with a single face point.

    Raises
    ------
    InvalidInput
        If the sensitivity is not a finite number above zero.

    Examples
    --------
    >>> monopole().directional
    False
    """
    return Element(np.zeros((1, 3)), np.ones(1), sensitivity)


def piston(radius: float, sensitivity: float = DEFAULT_SENSITIVITY, points: int = 19) -> Element:
    """Return a rigid disc with the far-field pattern 2 J₁(x)/x, where x = ka sin θ.

    k is the wavenumber, a the radius, and θ the angle from the axis. The pattern is derived in
    Kinsler, Frey, Coppens and Sanders, Fundamentals of Acoustics (4th edition), section 7.4. The
    disc radiates only forward.

    With 19 points, the disc uses Albrecht's rule of degree 9 (ZAMM 40, 514, 1960; S2
    9-1 in Stroud, Approximate Calculation of Multiple Integrals, 1971). Its error in
    the far-field pattern is of order (ka)¹⁰: 1.8e-4 of the pressure on the axis at ka = 4 and 1e-3
    at ka = 4.8, which correspond to radii of 5.5 and 6.5 mm at 40 kHz. With 12 points,
    it uses the cheaper rule of degree 7 (S2 7-1 in Stroud), with errors of 3.3e-4 at ka
    = 2.9 and 1.3e-3 at ka = 3.5. Functions that know the frequency raise ``InvalidInput``
    if ka exceeds 4.8 with 19 points, or 3.5 with 12 points.

    Parameters
    ----------
    radius : radius of the disc a [m], above zero and at most 0.1.
    sensitivity : peak pressure at full scale, 1 m away on the axis [Pa·m], above zero.
    points : number of points on the face, 12 or 19.

    Returns
    -------
    A directional ``Element``, for use in a ``PhasedArray``.

    Raises
    ------
    InvalidInput
        If the radius or the sensitivity is not above zero, if the radius exceeds 0.1 m, or if the
        number of points is neither 12 nor 19.

    Examples
    --------
    At ka = 3.5, 60 degrees from the axis, the pattern is 2 J₁(3.031)/3.031 = 0.216:

    >>> sideways = np.array([[np.sin(np.pi / 3), 0.0, np.cos(np.pi / 3)]])
    >>> round(float(piston(4.8e-3).far_pattern(sideways, 3.5 / 4.8e-3)[0].real), 3)
    0.216
    """
    radius = within(radius, 0.0, 0.1, "the radius of a piston", "m")
    if points not in MAX_PISTON_SIZE:
        raise InvalidInput(
            f"a piston cannot have {points} points: use 12 or 19.", code="out_of_range"
        )
    # Boards use 12 points: their transducers have ka below 3.5, and more points would cost time.
    places, weights = _degree_7() if points == 12 else _degree_9()
    return Element(radius * places, weights, sensitivity, directional=True, radius=radius)


def _degree_7() -> tuple[Float64[np.ndarray, "12 3"], Float64[np.ndarray, "12"]]:
    """Return the points and weights of Stroud's rule S2 7-1 on the unit disc."""
    root = np.sqrt(29.0)
    # Radius, weight and first angle of each ring of four points.
    rings = (
        (np.sqrt(3 / 4), 2 / 27, 0.0),
        (np.sqrt((27 - 3 * root) / 52), (551 + 41 * root) / 6264, np.pi / 4),
        (np.sqrt((27 + 3 * root) / 52), (551 - 41 * root) / 6264, np.pi / 4),
    )
    points = np.concatenate([_ring(distance, 4, start) for distance, _, start in rings])
    return points, np.repeat([weight for _, weight, _ in rings], 4)


def _degree_9() -> tuple[Float64[np.ndarray, "19 3"], Float64[np.ndarray, "19"]]:
    """Return the points and weights of Stroud's rule S2 9-1 on the unit disc."""
    root = np.sqrt(111.0)
    # Radius, weight and first angle of each ring of six points; one more point is in the centre.
    rings = (
        (np.sqrt((96 - 4 * root) / 155), (110297 + 5713 * root) / 2045952, 0.0),
        (np.sqrt(4 / 5), 125 / 3072, np.pi / 6),
        (np.sqrt((96 + 4 * root) / 155), (110297 - 5713 * root) / 2045952, 0.0),
    )
    points = [_ring(distance, 6, start) for distance, _, start in rings]
    weights = np.repeat([weight for _, weight, _ in rings], 6)
    return np.concatenate([np.zeros((1, 3)), *points]), np.append(251 / 2304, weights)


def _ring(distance: float, count: int, start: float) -> Float64[np.ndarray, "points 3"]:
    angles = start + 2.0 * np.pi / count * np.arange(count)
    return distance * np.stack([np.cos(angles), np.sin(angles), np.zeros(count)], axis=1)


def check_pattern(element: Element, wavenumber: complex | float) -> None:
    """Raise ``InvalidInput`` if a face has too few points for a wavenumber k [rad/m]."""
    # The rules are exact for polynomials up to their degree, and the phase varies more across a
    # face as ka grows.
    size = wavenumber.real * element.radius
    count = len(element.points)
    largest = MAX_PISTON_SIZE.get(count, MAX_PISTON_SIZE[19])
    if size > largest:
        finer = ", piston(radius, points=19)" if size <= MAX_PISTON_SIZE[19] else ""
        raise InvalidInput(
            f"a face with a radius of {element.radius * 1e3:.3g} mm has ka = {size:.2f}, but its "
            f"{count} points are accurate only up to ka = {largest}: use a radius of at most "
            f"{largest / wavenumber.real * 1e3:.3g} mm{finer} or a lower frequency.",
            code="out_of_range",
        )
