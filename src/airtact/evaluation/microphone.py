"""A virtual microphone, which measures the mean pressure over its face."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Complex128, Float64, Real

from airtact.acoustics.scene import Scene
from airtact.acoustics.solvers.problem import RadiatedField
from airtact.errors import InvalidInput, Vector, number, points_of, positive, real_numbers
from airtact.geometry.primitives import turn_from_z
from airtact.transducers.element import piston


@dataclass(frozen=True)
class Microphone:
    """A round microphone at the end of a straight housing; neither scatters sound.

    Attributes
    ----------
    diameter : diameter of the face and the housing [m]; a quarter of an inch in the paper (section
        4.2).
    axis : (3,) direction in which the face points, of any length.
    housing : length of the housing behind the face [m].

    Raises
    ------
    InvalidInput
        If the diameter is not above zero or exceeds 20 mm, if the axis has no length, or if the
        length of the housing is not between 0 and 1 m.
    """

    diameter: float = 6.35e-3
    axis: Vector = (0.0, 0.0, -1.0)
    housing: float = 0.05

    def __post_init__(self) -> None:
        # A diameter of over two wavelengths at 40 kHz is probably in millimetres.
        if positive(self.diameter, "the diameter of a microphone", "m") > 0.02:
            raise InvalidInput(
                f"the diameter of a microphone is {self.diameter:g} m, but at most 20 mm "
                "is allowed. Use metres.",
                code="out_of_range",
            )
        if not 0.0 <= number(self.housing, "the housing of a microphone", "m") <= 1.0:
            raise InvalidInput(
                f"the housing of a microphone is {self.housing:g} m long; use a length from 0 to "
                "1 m.",
                code="out_of_range",
            )
        axis = real_numbers(np.asarray(self.axis), "the axis of a microphone")
        if axis.shape != (3,) or not np.linalg.norm(axis) > 0.0:
            raise InvalidInput(
                f"the axis of a microphone is {axis.tolist()}. Use a direction of three numbers.",
                code="wrong_shape",
            )

    @property
    def _turn(self) -> Float64[np.ndarray, "3 3"]:
        axis = np.asarray(self.axis, dtype=np.float64)
        return turn_from_z(axis / np.linalg.norm(axis))

    def face(self, centres: Real[np.ndarray, "centres 3"]) -> Float64[np.ndarray, "centres face 3"]:
        """Return the Q points of the face (N, Q, 3) for each of N centres (N, 3) [m]."""
        # The quadrature over a piston's face is exact for polynomials of degree 9.
        return centres[:, None, :] + piston(self.diameter / 2.0).points @ self._turn.T

    def blocked(
        self, scene: Scene, centres: Real[np.ndarray, "centres 3"]
    ) -> Bool[np.ndarray, "centres"]:
        """Return whether a body overlaps the face or the housing at each position (N,).

        Parameters
        ----------
        scene : the bodies.
        centres : (N, 3) centres of the face [m].
        """
        centres = points_of(centres, "positions of a microphone", least=0)
        # A disc of 49 points: the centre, and rings at half the radius and at the rim.
        angles = np.arange(24) * (2.0 * np.pi / 24)
        rim = self.diameter / 2.0 * np.stack([np.cos(angles), np.sin(angles), 0.0 * angles], axis=1)
        disc = np.concatenate([np.zeros((1, 3)), 0.5 * rim, rim])
        # Discs along the housing, at most half a diameter apart.
        discs = 1 + int(np.ceil(self.housing / (0.5 * self.diameter)))
        back = np.linspace(0.0, self.housing, discs)
        probes = (disc[None] - back[:, None, None] * [0.0, 0.0, 1.0]).reshape(-1, 3) @ self._turn.T
        depth = scene.depth((centres[:, None] + probes).reshape(-1, 3))
        return np.asarray(depth.reshape(len(centres), len(probes)).max(axis=1) > 0.0)

    def read(
        self, field: RadiatedField, centres: Real[np.ndarray, "centres 3"]
    ) -> Complex128[np.ndarray, "centres excitations"]:
        """Return the mean pressure (N, S) over the face [Pa]; NaN where a body overlaps it.

        Parameters
        ----------
        field : a field of S excitations.
        centres : (N, 3) centres of the face [m].
        """
        centres = points_of(centres, "positions of a microphone", least=0)
        excitations = field.sources.strengths.shape[1]
        readings = np.full((len(centres), excitations), np.nan, dtype=np.complex128)
        # The field is not defined inside bodies, so skip blocked positions.
        free = ~self.blocked(field.scene, centres)
        points = self.face(centres[free])
        pressure = field.at(points.reshape(-1, 3)).reshape(*points.shape[:2], excitations)
        readings[free] = np.einsum("nqs,q->ns", pressure, piston(self.diameter / 2.0).weights)
        return readings
