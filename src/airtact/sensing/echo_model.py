"""The echoes of bodies at any pose near a start, and their derivatives by the pose, in closed form.

A pose is a twist of the bodies' frame from the start: translation and turn about the centre of the scattering matrix.
With V_i the six motions of regular waves and D = exp(Σ twist_i V_i), echoes are w_rᵀ Dᵀ T D w_e/(4πik), and their
derivatives by a further motion i are w_rᵀ Dᵀ (T V_i − V_i T) D w_e/(4πik), as V_i is antisymmetric.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex128, Float64, Int64
from scipy.linalg import expm, logm

from airtact.sensing.array_waves import ArrayWaves
from airtact.sensing.scattering import ScatteringMatrix
from airtact.sensing.waves import Waves, motions, moved, order_of

Received = Complex128[np.ndarray, "receivers transmissions"]
Motion = Float64[np.ndarray, "4 4"]
"""A rigid motion of the bodies' frame about the centre of their waves, as a matrix on (x, y, z, 1)."""


@dataclass(frozen=True, eq=False)
class EchoModel:
    """What some receivers get of some transmissions when the bodies move from where the array was expanded.

    Attributes
    ----------
    scattering : of the bodies.
    emitted : (W, M) regular waves of each transmission about the centre at the start.
    receiving : (W, R) regular waves of each receiver there, times the scale of ``ArrayWaves``.
    """

    scattering: ScatteringMatrix
    emitted: Waves
    receiving: Complex128[np.ndarray, "waves receivers"]

    @classmethod
    def of(
        cls,
        scattering: ScatteringMatrix,
        array: ArrayWaves,
        codes: Complex128[np.ndarray, "elements transmissions"],
        receivers: Int64[np.ndarray, "receivers"],
    ) -> "EchoModel":
        """Gather what does not depend on the pose."""
        return cls(scattering, array.waves @ codes, np.ascontiguousarray(array.scale * array.waves[:, receivers]))

    def part(self, receivers: Int64[np.ndarray, "some"], transmissions: int) -> "EchoModel":
        """Return the model of some receivers and the first transmissions, which costs less."""
        emitted = np.ascontiguousarray(self.emitted[:, :transmissions])
        return EchoModel(self.scattering, emitted, np.ascontiguousarray(self.receiving[:, receivers]))

    def echoes(self, motion: Motion) -> Received:
        """Scattered pressure (R, M) [Pa] with the bodies moved."""
        twist = twist_of(motion)
        return self._received(twist, self._scattered(moved(twist, self.emitted, self._wavenumber)))

    def derivatives(self, motion: Motion) -> Complex128[np.ndarray, "6 receivers transmissions"]:
        """Differentiate the echoes by further translations [Pa/m] and turns [Pa/rad] of the moved frame."""
        twist, count = twist_of(motion), self.emitted.shape[1]
        incident = moved(twist, self.emitted, self._wavenumber)
        scattered = self._scattered(incident)
        kinds = motions(order_of(incident))
        units = [self._wavenumber] * 3 + [1.0] * 3
        along = np.concatenate([unit * (one @ incident) for unit, one in zip(units, kinds, strict=True)], axis=1)
        back = np.concatenate([unit * (one @ scattered) for unit, one in zip(units, kinds, strict=True)], axis=1)
        received = self._received(twist, self._scattered(along) - back)
        return np.moveaxis(received.reshape(-1, 6, count), 1, 0)

    @property
    def _wavenumber(self) -> float:
        return self.scattering.scene.wavenumber.real

    def _scattered(self, incident: Waves) -> Waves:
        """Outgoing waves, with zeros for the orders above those of the scattering matrix."""
        out, count = np.zeros_like(incident), len(self.scattering.matrix)
        out[:count] = self.scattering.matrix @ incident[:count]
        return out

    def _received(self, twist: Float64[np.ndarray, "6"], scattered: Waves) -> Received:
        return self.receiving.T @ moved(-twist, scattered, self._wavenumber)


def motion_of(twist: Float64[np.ndarray, "6"]) -> Motion:
    """Exponential of a twist (translation, turn)."""
    return expm(_generator(twist))


def twist_of(motion: Motion) -> Float64[np.ndarray, "6"]:
    """Logarithm of a motion by less than half a turn."""
    one = np.real(logm(motion))
    return np.array([*one[:3, 3], one[2, 1], one[0, 2], one[1, 0]])


def _generator(twist: Float64[np.ndarray, "6"]) -> Motion:
    x, y, z = twist[3:]
    out = np.zeros((4, 4))
    out[:3, :3] = [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]
    out[:3, 3] = twist[:3]
    return out
