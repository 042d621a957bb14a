"""Closed-form echoes of bodies near an initial pose, and derivatives with respect to pose.

By reciprocity, the regular waves w_e that element e of unit strength emits toward the bodies also
describe its reception: E[r, e] = w_rᵀ T w_e/(4πik). A motion of the bodies multiplies all w_e by
the same matrix D. The array is therefore expanded only once, about the initial pose.

A pose is a twist (6,) of the bodies' frame from the initial pose: translation [m] and rotation
[rad] about the centre of the scattering matrix. With V_i the generators of the six motions of
regular waves and D = exp(Σ twist_i V_i), the echoes are w_rᵀ Dᵀ T D w_e/(4πik). Their derivatives
with respect to a further motion i are w_rᵀ Dᵀ (T V_i − V_i T) D w_e/(4πik), because V_i is
antisymmetric. The computation is in single precision: rounding changes echoes by 1e-6, far less
than noise.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

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


@dataclass(frozen=True, eq=False)
class EchoModel:
    """Echoes of transmissions at receivers as functions of the pose of the bodies.

    Attributes
    ----------
    scattering : scattering matrix of the bodies.
    emitted : (W, M) coefficients of the regular waves of each transmission about the initial
        centre. They include orders above that of ``scattering``, which are required for
        translations. The coefficients are multiplied by sensitivity/(4πik), so that the echoes are
        in pascals.
    receiving : (W, R) coefficients of the regular waves of each receiver about the initial centre,
        for the same orders as in ``emitted``.
    valid : (R, M) whether each pressure was received; None if all were received. Where a pressure
        was not received, the modelled echo and its derivatives are 0.
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
        """Expand the waves of an array in the bodies' frame, with ``spare`` additional orders.

        A translation by a distance d requires about k d additional orders.

        Raises
        ------
        InvalidInput
            If an element is inside the ball around the bodies.
        """
        waves = _array_waves(scattering, array, scattering.order + spare)
        scale = array.element.sensitivity / (4j * np.pi * scattering.scene.wavenumber)
        emitted = waves @ (scale * codes).astype(np.complex64)
        return cls(scattering, emitted, waves[:, receivers], valid)

    def part(self, receivers: Int64[np.ndarray, "chosen"], transmissions: int) -> "EchoModel":
        """Return the model restricted to selected receivers and the first few ``transmissions``."""
        return replace(
            self,
            emitted=np.ascontiguousarray(self.emitted[:, :transmissions]),
            receiving=np.ascontiguousarray(self.receiving[:, receivers]),
            valid=None if self.valid is None else self.valid[receivers, :transmissions],
        )

    def echoes(self, twist: Twist) -> Received:
        """Return the pressures (R, M) that the moved bodies scatter to the receivers [Pa]."""
        return self._received(twist, self._scattered(self._incident(twist)))[0]

    def derivatives(self, twist: Twist) -> Complex[np.ndarray, "6 receivers transmissions"]:
        """Differentiate the echoes with respect to a further motion.

        The first three derivatives are with respect to translations [Pa/m], the others to rotations
        [Pa/rad].
        """
        incident = self._incident(twist)
        # One large matrix product is faster than seven.
        along = np.concatenate([incident, *along_motions(incident, self._wavenumber)], axis=1)
        scattered = self._scattered(along)
        count = self.emitted.shape[1]
        # These are − V_i T D w: the motions act on the outgoing waves of the echo.
        back = along_motions(np.ascontiguousarray(scattered[:, :count]), self._wavenumber)
        return self._received(twist, scattered[:, count:] - np.concatenate(back, axis=1))

    @property
    def _wavenumber(self) -> float:
        return self.scattering.scene.wavenumber.real

    def _incident(self, twist: Twist) -> Waves:
        # These are regular waves about the moved centre, with the additional orders that the
        # translation requires. A translation by d mixes orders up to about k d apart.
        spare = 1 + int(np.ceil(self._wavenumber * np.linalg.norm(twist[:3])))
        count = wave_count(self.scattering.order + spare)
        return moved(twist, self.emitted[:count], self._wavenumber)

    def _scattered(self, incident: Waves) -> Waves:
        # The outgoing waves are zero for orders above those of the scattering matrix.
        out = np.zeros_like(incident)
        count = len(self.scattering.matrix)
        out[:count] = self.scattering.single @ incident[:count]
        return out

    def _received(
        self, twist: Twist, scattered: Waves
    ) -> Complex[np.ndarray, "parts receivers transmissions"]:
        back = moved(-twist, scattered, self._wavenumber)
        # This is faster than the transposed product, because there are few columns.
        received = back.T @ self.receiving[: len(back)]
        parts = np.swapaxes(received.reshape(-1, self.emitted.shape[1], received.shape[1]), 1, 2)
        return parts if self.valid is None else parts * self.valid


@lru_cache(maxsize=1)
def _array_waves(
    scattering: ScatteringMatrix, array: PhasedArray, order: int
) -> Complex64[np.ndarray, "waves elements"]:
    # Return each element's regular waves about the bodies at unit drive, without the sensitivity.
    faces = array.face_points - scattering.centre
    nearest = np.linalg.norm(faces, axis=2).min(axis=1)
    element = int(nearest.argmin())
    if nearest[element] <= scattering.radius:
        raise InvalidInput(
            f"element {element} of {len(array)} is {1e3 * nearest[element]:.3g} mm from the centre "
            f"of the bodies, but must be outside the ball of {1e3 * scattering.radius:.3g} mm "
            "radius around the bodies. Move the bodies away from the array, or remove parts that "
            "are far from the foci.",
            code="bodies_overlap",
        )
    waves = np.zeros((wave_count(order), len(array)), dtype=np.complex64)
    # Process one point of all faces at a time to limit the memory.
    for weight, points in zip(array.element.weights, np.swapaxes(faces, 0, 1), strict=True):
        waves += monopole_waves(order, points, scattering.scene.wavenumber, weight * array.gains)
    waves.flags.writeable = False
    return waves


def _cross(vector: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "3 3"]:
    return np.cross(np.eye(3), vector)


def motion_of(twist: Twist) -> Pose:
    """Return the exponential of a twist: a rigid motion about the centre of the waves."""
    generator = np.zeros((4, 4))
    generator[:3, :3] = _cross(twist[3:])
    generator[:3, 3] = twist[:3]
    motion = expm(generator)
    return Pose(motion[:3, :3], motion[:3, 3])


def further_motion(twist: Twist) -> Float64[np.ndarray, "6 6"]:
    """Return the Jacobian that maps changes of a twist to further motions of the moved bodies.

    The Jacobian is (1 − exp(−ad))/ad, where ad is the commutator with the twist
    (K. M. Lynch, F. C. Park, Modern Robotics, 2017, section 8.3).
    """
    turn = _cross(twist[3:])
    commutator = np.block([[turn, _cross(twist[:3])], [np.zeros((3, 3)), turn]])
    block = np.block([[-commutator, np.eye(6)], [np.zeros((6, 12))]])
    return expm(block)[:6, 6:]
