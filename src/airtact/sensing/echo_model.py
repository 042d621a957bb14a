"""The echoes of bodies at any pose near a start, and their derivatives by the pose, in closed form.

A pose is a twist of the bodies' frame from the start: translation and turn about the centre of the
scattering matrix. With V_i the six motions of regular waves and D = exp(Σ twist_i V_i), echoes are
w_rᵀ Dᵀ T D w_e/(4πik), and their derivatives by a further motion i are w_rᵀ Dᵀ (T V_i − V_i T) D
w_e/(4πik), as V_i is antisymmetric. All of it is in single precision: rounding changes echoes by a
millionth, and noise by far more.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Complex, Complex64, Complex128, Float64, Int64
from scipy.spatial.transform import Rotation

from airtact.sensing.array_waves import ArrayWaves
from airtact.sensing.scattering import ScatteringMatrix
from airtact.sensing.waves import Waves, along_motions, moved, wave_count

Received = Complex[np.ndarray, "receivers transmissions"]
Motion = Float64[np.ndarray, "4 4"]
"""A rigid motion of the bodies' frame about the centre of their waves, as a matrix on (x, y, z, 1)."""


@dataclass(frozen=True, eq=False)
class EchoModel:
    """What some receivers get of some transmissions when the bodies move from where the array was expanded.

    Attributes
    ----------
    scattering : of the bodies.
    emitted : (W, M) regular waves of each transmission about the centre at the start, to higher
        orders, times the scale of ``ArrayWaves``.
    receiving : (W, R) regular waves of each receiver there.
    valid : (R, M) whether the receiver could receive; where not, echoes and derivatives are 0. None
        if all could.
    """

    scattering: ScatteringMatrix
    emitted: Waves
    receiving: Complex64[np.ndarray, "waves receivers"]
    valid: Bool[np.ndarray, "receivers transmissions"] | None = None

    @classmethod
    def of(
        cls,
        scattering: ScatteringMatrix,
        array: ArrayWaves,
        codes: Complex128[np.ndarray, "elements transmissions"],
        receivers: Int64[np.ndarray, "receivers"],
        valid: Bool[np.ndarray, "receivers transmissions"] | None = None,
    ) -> "EchoModel":
        """Gather what does not depend on the pose."""
        waves = array.waves.astype(np.complex64, copy=False)
        receiving = (
            waves if np.array_equal(receivers, np.arange(len(codes))) else waves[:, receivers]
        )
        return cls(scattering, waves @ (array.scale * codes).astype(np.complex64), receiving, valid)

    def part(self, receivers: Int64[np.ndarray, "some"], transmissions: int) -> "EchoModel":
        """Return the model of some receivers and the first transmissions, which costs less."""
        emitted = np.ascontiguousarray(self.emitted[:, :transmissions])
        valid = None if self.valid is None else self.valid[receivers, :transmissions]
        return replace(
            self,
            emitted=emitted,
            receiving=np.ascontiguousarray(self.receiving[:, receivers]),
            valid=valid,
        )

    def echoes(self, motion: Motion) -> Received:
        """Scattered pressure (R, M) [Pa] with the bodies moved."""
        twist = twist_of(motion)
        return self._received(twist, self._scattered(self._incident(twist)))[0]

    def derivatives(self, motion: Motion) -> Complex[np.ndarray, "6 receivers transmissions"]:
        """Differentiate the echoes by further translations [Pa/m] and turns [Pa/rad] of the moved frame."""
        return self.with_derivatives(motion)[1:]

    def with_derivatives(self, motion: Motion) -> Complex[np.ndarray, "7 receivers transmissions"]:
        """Return the echoes, and their derivatives after them."""
        twist = twist_of(motion)
        incident = self._incident(twist)
        along = np.concatenate([incident, *along_motions(incident, self._wavenumber)], axis=1)
        scattered, count = self._scattered(along), self.emitted.shape[1]
        back = along_motions(np.ascontiguousarray(scattered[:, :count]), self._wavenumber)
        scattered[:, count:] -= np.concatenate(back, axis=1)
        return self._received(twist, scattered)

    @property
    def _wavenumber(self) -> float:
        return self.scattering.scene.wavenumber.real

    def _incident(self, twist: Float64[np.ndarray, "6"]) -> Waves:
        """Regular waves about the moved centre, to as many orders as a translation so far takes waves from."""
        spare = 1 + int(np.ceil(self._wavenumber * np.linalg.norm(twist[:3])))
        return moved(
            twist, self.emitted[: wave_count(self.scattering.order + spare)], self._wavenumber
        )

    def _scattered(self, incident: Waves) -> Waves:
        """Outgoing waves, with zeros for the orders above those of the scattering matrix."""
        out, count = np.zeros_like(incident), len(self.scattering.matrix)
        out[:count] = self.scattering.scatter(incident[:count])
        return out

    def _received(
        self, twist: Float64[np.ndarray, "6"], scattered: Waves
    ) -> Complex[np.ndarray, "parts receivers transmissions"]:
        back = moved(-twist, scattered, self._wavenumber)
        received = (
            back.T @ self.receiving[: len(back)]
        )  # faster than the transposed product with few columns
        parts = np.swapaxes(received.reshape(-1, self.emitted.shape[1], received.shape[1]), 1, 2)
        return parts if self.valid is None else parts * self.valid


def motion_of(twist: Float64[np.ndarray, "6"]) -> Motion:
    """Exponential of a twist (translation, turn)."""
    out = np.eye(4)
    out[:3, :3] = Rotation.from_rotvec(twist[3:]).as_matrix()
    out[:3, 3] = _screw(twist[3:]) @ twist[:3]
    return out


def twist_of(motion: Motion) -> Float64[np.ndarray, "6"]:
    """Logarithm of a motion by less than half a turn."""
    turn = Rotation.from_matrix(motion[:3, :3]).as_rotvec()
    return np.concatenate([np.linalg.solve(_screw(turn), motion[:3, 3]), turn])


def _screw(turn: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "3 3"]:
    """Return ∫ exp(s [ω]×) ds from 0 to 1, by which the translation of a twist moves the centre."""
    angle = float(np.linalg.norm(turn))
    x, y, z = turn
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    half = np.sinc(angle / (2 * np.pi)) ** 2 / 2  # (1 − cos θ)/θ²
    rest = (1.0 - np.sinc(angle / np.pi)) / angle**2 if angle > 1e-4 else 1 / 6  # (θ − sin θ)/θ³
    return np.eye(3) + half * cross + rest * cross @ cross
