"""The echoes of bodies at any pose near a start, and their derivatives by the pose, in closed form.

By reciprocity an element receives with the waves that it emits with. With w_e the regular waves of
element e of unit strength about the bodies, E[r, e] = w_rᵀ T w_e/(4πik). When the bodies move, all
w_e are multiplied by one matrix D, so the array is expanded once, about where the bodies are
believed to be, and every pose nearby follows in closed form.

A pose is a twist (6,) of the bodies' frame from the start: translation [m] and turn [rad] about the
centre of the scattering matrix. With V_i the six motions of regular waves and D = exp(Σ twist_i
V_i), echoes are w_rᵀ Dᵀ T D w_e/(4πik), and their derivatives by a further motion i are w_rᵀ Dᵀ (T
V_i − V_i T) D w_e/(4πik), as V_i is antisymmetric. All of it is in single precision: rounding
changes echoes by a millionth, and noise by far more.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Complex, Complex64, Float64, Int64
from scipy.linalg import expm

from airtact.errors import InvalidInput
from airtact.geometry.pose import Pose
from airtact.sensing.echoes import Codes
from airtact.sensing.scattering import ScatteringMatrix
from airtact.sensing.waves import Waves, along_motions, monopole_waves, moved, wave_count
from airtact.transducers.layout import PhasedArray

Received = Complex[np.ndarray, "receivers transmissions"]
Twist = Float64[np.ndarray, "6"]

# The twist of bodies that do not move.
STILL = np.zeros(6)


@dataclass(frozen=True, eq=False)
class EchoModel:
    """Echoes of some transmissions at some receivers when the bodies move.

    Attributes
    ----------
    scattering : of the bodies.
    emitted : (W, M) regular waves of each transmission about the centre at the start, to higher
        orders, times sensitivity/(4πik), which makes pressures [Pa] of products of waves.
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
        array: PhasedArray,
        codes: Codes,
        receivers: Int64[np.ndarray, "receivers"],
        valid: Bool[np.ndarray, "receivers transmissions"] | None = None,
        spare: int = 0,
    ) -> "EchoModel":
        """Expand an array in the bodies' frame, to ``spare`` orders more than the bodies have.

        Translations mix orders, about one for each 1/k.

        Raises
        ------
        InvalidInput
            "bodies_overlap": an element stands within the ball about the bodies.
        """
        waves = _array_waves(scattering, array, scattering.order + spare)
        scale = array.element.sensitivity / (4j * np.pi * scattering.scene.wavenumber)
        emitted = waves @ (scale * codes).astype(np.complex64)
        return cls(scattering, emitted, waves[:, receivers], valid)

    def part(self, receivers: Int64[np.ndarray, "chosen"], transmissions: int) -> "EchoModel":
        """Return the model of some receivers and the first transmissions, which costs less."""
        return replace(
            self,
            emitted=np.ascontiguousarray(self.emitted[:, :transmissions]),
            receiving=np.ascontiguousarray(self.receiving[:, receivers]),
            valid=None if self.valid is None else self.valid[receivers, :transmissions],
        )

    def echoes(self, twist: Twist = STILL) -> Received:
        """Scattered pressure (R, M) [Pa] with the bodies moved."""
        return self._received(twist, self._scattered(self._incident(twist)))[0]

    def derivatives(self, twist: Twist) -> Complex[np.ndarray, "6 receivers transmissions"]:
        """Return derivatives by a further translation [Pa/m] and turn [Pa/rad] of moved bodies."""
        incident = self._incident(twist)
        # All columns go through the matrix at once: one large product is faster than seven.
        along = np.concatenate([incident, *along_motions(incident, self._wavenumber)], axis=1)
        scattered = self._scattered(along)
        count = self.emitted.shape[1]
        # − V_i T D w: the motions act on the outgoing waves of the echo itself.
        back = along_motions(np.ascontiguousarray(scattered[:, :count]), self._wavenumber)
        return self._received(twist, scattered[:, count:] - np.concatenate(back, axis=1))

    @property
    def _wavenumber(self) -> float:
        return self.scattering.scene.wavenumber.real

    def _incident(self, twist: Twist) -> Waves:
        """Regular waves about the moved centre, with the orders that the translation needs."""
        # Translation by d mixes orders up to about k d apart.
        spare = 1 + int(np.ceil(self._wavenumber * np.linalg.norm(twist[:3])))
        count = wave_count(self.scattering.order + spare)
        return moved(twist, self.emitted[:count], self._wavenumber)

    def _scattered(self, incident: Waves) -> Waves:
        """Outgoing waves, with zeros for the orders above those of the scattering matrix."""
        out = np.zeros_like(incident)
        count = len(self.scattering.matrix)
        out[:count] = self.scattering.single @ incident[:count]
        return out

    def _received(
        self, twist: Twist, scattered: Waves
    ) -> Complex[np.ndarray, "parts receivers transmissions"]:
        back = moved(-twist, scattered, self._wavenumber)
        # Faster than the transposed product, as there are few columns.
        received = back.T @ self.receiving[: len(back)]
        parts = np.swapaxes(received.reshape(-1, self.emitted.shape[1], received.shape[1]), 1, 2)
        return parts if self.valid is None else parts * self.valid


def _array_waves(
    scattering: ScatteringMatrix, array: PhasedArray, order: int
) -> Complex64[np.ndarray, "waves elements"]:
    """Regular waves about the bodies of each element at unit drive, without the sensitivity."""
    faces = array.face_points - scattering.centre
    nearest = np.linalg.norm(faces, axis=2).min(axis=1)
    element = int(nearest.argmin())
    if nearest[element] <= scattering.radius:
        raise InvalidInput(
            f"element {element} of {len(array)} is {1e3 * nearest[element]:.3g} mm from the middle "
            f"of the bodies, inside the ball of {1e3 * scattering.radius:.3g} mm around them, "
            "where spherical waves do not hold. Move the bodies away from the array, or leave out "
            "parts that are far from the foci.",
            code="bodies_overlap",
        )
    waves = np.zeros((wave_count(order), len(array)), dtype=np.complex64)
    # One point of all faces after the other, which bounds the memory.
    for weight, points in zip(array.element.weights, np.swapaxes(faces, 0, 1), strict=True):
        gains = (weight * array.gains).astype(np.complex64)
        waves += monopole_waves(order, points, scattering.scene.wavenumber) * gains
    return waves


def _cross(vector: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "3 3"]:
    return np.cross(np.eye(3), vector)


def motion_of(twist: Twist) -> Pose:
    """Exponential of a twist: the motion about the centre of the waves."""
    generator = np.zeros((4, 4))
    generator[:3, :3] = _cross(twist[3:])
    generator[:3, 3] = twist[:3]
    motion = expm(generator)
    return Pose(motion[:3, :3], motion[:3, 3])


def further_motion(twist: Twist) -> Float64[np.ndarray, "6 6"]:
    """Further motion of bodies that moved by a twist, for each change of its six numbers.

    It is (1 − exp(−ad))/ad, for ad the commutator with the twist (K. M. Lynch, F. C. Park, Modern
    Robotics, 2017, section 8.3).
    """
    turn = _cross(twist[3:])
    commutator = np.block([[turn, _cross(twist[:3])], [np.zeros((3, 3)), turn]])
    block = np.block([[-commutator, np.eye(6)], [np.zeros((6, 12))]])
    return expm(block)[:6, 6:]
