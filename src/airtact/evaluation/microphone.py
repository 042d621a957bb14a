"""A virtual microphone: it reads the mean pressure over its face, and nothing where a body is in its way."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Complex128, Float64, Real

from airtact.acoustics.scene import Scene
from airtact.acoustics.solvers.problem import RadiatedField
from airtact.checks import number, points_of, positive, real_numbers
from airtact.errors import InvalidInput, Vector
from airtact.geometry.primitives import turn_from_z
from airtact.transducers.element import piston

QUARTER_INCH = 6.35e-3
"""Diameter of the paper's microphone [m]."""

RINGS = 0.5
"""Distance of the rings at which a housing is probed, over its diameter."""


@dataclass(frozen=True)
class Microphone:
    """A microphone with a round face at the end of a straight housing; it does not scatter sound itself.

    Attributes
    ----------
    diameter : of the face and the housing [m]; the paper's is a quarter of an inch (section 4.2).
    axis : (3,) direction in which the face looks, of any length.
    housing : how far the housing reaches behind the face [m].

    Raises
    ------
    InvalidInput
        If the diameter is not above zero or over 20 mm, the axis has no length, or the housing is negative.
    """

    diameter: float = QUARTER_INCH
    axis: Vector = (0.0, 0.0, -1.0)
    housing: float = 0.05

    def __post_init__(self) -> None:
        if positive(self.diameter, "the diameter of a microphone", "m") > 0.02:
            raise InvalidInput(
                f"the diameter of a microphone is {self.diameter:g} m, more than 20 mm: give metres.",
                code="out_of_range",
            )
        if not 0.0 <= number(self.housing, "the housing of a microphone", "m") <= 1.0:
            raise InvalidInput(
                f"the housing of a microphone is {self.housing:g} m long; give 0 to 1 m.",
                code="out_of_range",
            )
        axis = real_numbers(np.asarray(self.axis), "the axis of a microphone")
        if axis.shape != (3,) or not np.linalg.norm(axis) > 0.0:
            raise InvalidInput(
                f"the axis of a microphone is {axis.tolist()}; give a direction of three numbers.",
                code="wrong_shape",
            )

    @property
    def _turn(self) -> Float64[np.ndarray, "3 3"]:
        axis = np.asarray(self.axis, dtype=np.float64)
        return turn_from_z(axis / np.linalg.norm(axis))

    def face(self, centres: Real[np.ndarray, "centres 3"]) -> Float64[np.ndarray, "centres face 3"]:
        """Return the points of the face (N, Q, 3) [m] for centres of it (N, 3) [m]."""
        disc = piston(self.diameter / 2.0).points @ self._turn.T
        return centres[:, None, :] + disc

    def blocked(
        self, scene: Scene, centres: Real[np.ndarray, "centres 3"]
    ) -> Bool[np.ndarray, "centres"]:
        """Return whether a body of a scene is in the way of the face or the housing (N,), for centres (N, 3) [m]."""
        given = points_of(centres, "positions of a microphone", least=0)
        angles = np.arange(24) * (2.0 * np.pi / 24)
        rim = self.diameter / 2.0 * np.stack([np.cos(angles), np.sin(angles), np.zeros(24)], axis=1)
        back = np.linspace(
            0.0, self.housing, 1 + int(np.ceil(self.housing / (RINGS * self.diameter)))
        )
        disc = np.concatenate([np.zeros((1, 3)), 0.5 * rim, rim])
        probes = (disc[None] - back[:, None, None] * [0.0, 0.0, 1.0]).reshape(-1, 3) @ self._turn.T
        depth = scene.depth((given[:, None] + probes).reshape(-1, 3)).reshape(
            len(given), len(probes)
        )
        return np.asarray(depth.max(axis=1) > 0.0)

    def read(
        self, field: RadiatedField, centres: Real[np.ndarray, "centres 3"]
    ) -> Complex128[np.ndarray, "centres excitations"]:
        """Return the mean pressure over the face (N, S) [Pa] in a field of S excitations, for centres (N, 3) [m].

        It is NaN where a body is in the way.
        """
        given = points_of(centres, "positions of a microphone", least=0)
        excitations = field.sources.strengths.shape[1]
        readings = np.full((len(given), excitations), np.nan, dtype=np.complex128)
        free = ~self.blocked(field.scene, given)
        points, weights = self.face(given[free]), piston(self.diameter / 2.0).weights
        pressure = field.at(points.reshape(-1, 3)).reshape(*points.shape[:2], excitations)
        readings[free] = np.einsum("nqs,q->ns", pressure, weights)
        return readings
