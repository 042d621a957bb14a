"""One transducer: points and weights on its face, and its sensitivity."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float64, Real

from airtact.conventions import InvalidInput
from airtact.printing import one_line
from airtact.validation import counted, number, points_of, positive, real_numbers

DEFAULT_SENSITIVITY = 4.38
"""Peak pressure of one transducer at full scale, 1 m away on its axis [Pa·m].

AUTD3's constant, 3.10 Pa rms at 1 m (the transducer amplitude of its SDK), times √2. Uncalibrated: other sources
differ by a factor of 2, so give the measured value of your own device where pascals matter."""

LARGEST_PISTON = 4.8
"""Largest product of wavenumber and piston radius at which the 19 points keep the far pattern to 1e-3."""


@dataclass(frozen=True, eq=False)
class Element:
    """One transducer as weighted monopoles on its face, in its own frame (face in the plane z = 0, radiating to +z).

    Attributes
    ----------
    points : (Q, 3) points of the face relative to the element's position [m].
    weights : (Q,) contribution of each point to the pressure; they add up to 1.
    sensitivity : peak pressure at full scale, 1 m away on the axis [Pa·m]; uncalibrated by default.
    directional : whether the element radiates to the half space in front of its face only; then foci and bodies must
        be in front of it.
    radius : radius of the face [m]; 0 for a point.

    Raises
    ------
    InvalidInput
        If a number is not finite, the weights do not match the points or do not add up to 1, the sensitivity is not
        positive, or the radius is negative.

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
        object.__setattr__(self, "points", points_of(self.points, "face points"))
        object.__setattr__(self, "weights", real_numbers(self.weights, "face weights"))
        if self.weights.shape != (len(self.points),):
            count = counted(len(self.points), "face point", "face points")
            raise InvalidInput(
                f"an element of {count} needs as many weights, not {self.weights.shape}.", code="wrong_shape"
            )
        if not abs(self.weights.sum() - 1.0) < 1e-9:
            raise InvalidInput(
                f"the weights of an element must add up to 1, not {self.weights.sum():g}.", code="weights_sum"
            )
        sensitivity = positive(self.sensitivity, "the sensitivity of an element", "Pa·m")
        object.__setattr__(self, "sensitivity", sensitivity)
        object.__setattr__(self, "radius", number(self.radius, "the radius of an element", "m"))
        if not 0.0 <= self.radius < np.inf:
            raise InvalidInput(
                f"the radius of an element cannot be {self.radius:g} m: give 0 or a length in metres.",
                code="out_of_range",
            )

    @property
    def kind(self) -> str:
        """What it is, in words: "monopoles", "pistons of 4.5 mm"."""
        shape = f"pistons of {1e3 * self.radius:g} mm" if self.radius else "monopoles"
        return shape if len(self.points) in (1, 19) else f"{shape}, {len(self.points)} points each"

    @property
    def reach(self) -> float:
        """Distance of the farthest face point from the element's position [m]."""
        return float(np.linalg.norm(self.points, axis=1).max())

    def same_as(self, other: "Element") -> bool:
        """Whether both elements are the same in every number."""
        return (
            np.array_equal(self.points, other.points)
            and np.array_equal(self.weights, other.weights)
            and (self.sensitivity, self.directional, self.radius)
            == (other.sensitivity, other.directional, other.radius)
        )

    def far_pattern(
        self, directions: Real[np.ndarray, "directions 3"], wavenumber: float
    ) -> Complex[np.ndarray, "directions"]:
        """Far pressure in some directions relative to that on the axis.

        Parameters
        ----------
        directions : (D, 3) unit vectors in the element's frame.
        wavenumber : k = 2πf/c [rad/m].

        Returns
        -------
        (D,) Σ_j w_j exp(−i k u·x_j), 1 on the axis.
        """
        return np.exp(-1j * wavenumber * (directions @ self.points.T)) @ self.weights


def monopole(sensitivity: float = DEFAULT_SENSITIVITY) -> Element:
    """Build a transducer that radiates alike in all directions, as the paper's simulation has it (its section 4.1).

    Parameters
    ----------
    sensitivity : peak pressure at full scale, 1 m away [Pa·m].

    Raises
    ------
    InvalidInput
        If the sensitivity is not positive.

    Examples
    --------
    >>> monopole().directional
    False
    """
    return Element(np.zeros((1, 3)), np.ones(1), sensitivity)


def piston(radius: float, sensitivity: float = DEFAULT_SENSITIVITY) -> Element:
    """Build a disc that moves as one, with the far pattern 2 J₁(x)/x, x = ka sin θ.

    The pattern is that of Kinsler, Frey, Coppens and Sanders, Fundamentals of Acoustics (4th edition), section 7.4.

    The disc is 19 points, the rule of degree 9 of Albrecht (ZAMM 40, 514, 1960; S2 9-1 in Stroud, Approximate
    Calculation of Multiple Integrals, 1971): in the far field the error is of order x¹⁰, 1.8e-4 of the axis at ka = 4
    and 1e-3 at ka = 4.8. At 40 kHz that is a radius of 5.5 and 6.5 mm; a larger piston raises an error where it
    meets a frequency.

    Parameters
    ----------
    radius : radius of the disc a [m].
    sensitivity : peak pressure at full scale, 1 m away on the axis [Pa·m].

    Raises
    ------
    InvalidInput
        If the radius or the sensitivity is not positive.

    Examples
    --------
    The pattern at ka = 3.5, 60 degrees off the axis, is 2 J₁(3.031)/3.031 = 0.216:

    >>> sideways = np.array([[np.sin(np.pi / 3), 0.0, np.cos(np.pi / 3)]])
    >>> round(float(piston(4.8e-3).far_pattern(sideways, 3.5 / 4.8e-3)[0].real), 3)
    0.216
    """
    radius = positive(radius, "the radius of a piston", "m")
    root = np.sqrt(111.0)
    rings = (
        (np.sqrt((96 - 4 * root) / 155), (110297 + 5713 * root) / 2045952, 0.0),
        (np.sqrt(4 / 5), 125 / 3072, np.pi / 6),
        (np.sqrt((96 + 4 * root) / 155), (110297 - 5713 * root) / 2045952, 0.0),
    )
    points, weights = [np.zeros((1, 3))], [np.array([251 / 2304])]
    for distance, weight, turn in rings:
        angles = turn + np.arange(6) * np.pi / 3
        points.append(radius * distance * np.stack([np.cos(angles), np.sin(angles), np.zeros(6)], axis=1))
        weights.append(np.full(6, weight))
    return Element(np.concatenate(points), np.concatenate(weights), sensitivity, directional=True, radius=radius)


def check_pattern(element: Element, wavenumber: complex | float) -> None:
    """Raise "piston_too_large" where k times the radius of the face passes ``LARGEST_PISTON``, k in rad/m."""
    size = wavenumber.real * element.radius
    if size > LARGEST_PISTON:
        raise InvalidInput(
            f"a face of {element.radius * 1e3:.3g} mm radius has ka = {size:.2f}, and its {len(element.points)} points "
            f"keep the pattern only up to {LARGEST_PISTON}: take a radius of at most "
            f"{LARGEST_PISTON / wavenumber.real * 1e3:.3g} mm or a lower frequency.",
            code="piston_too_large",
        )
