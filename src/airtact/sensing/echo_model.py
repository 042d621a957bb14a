"""The echoes of bodies at any pose near a start, and their derivatives by the pose, in closed form.

By reciprocity an element receives with the waves that it emits with. With w_e the regular waves of
element e of unit strength about the bodies, E[r, e] = w_rᵀ T w_e/(4πik). When the bodies move, all
w_e are multiplied by one matrix D, so the array is expanded once, about where the bodies are
believed to be, and every pose nearby follows in closed form.

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

from airtact.errors import InvalidInput
from airtact.sensing.echoes import Codes
from airtact.sensing.scattering import ScatteringMatrix
from airtact.sensing.waves import Waves, along_motions, monopole_waves, moved, wave_count
from airtact.transducers.layout import PhasedArray

Received = Complex[np.ndarray, "receivers transmissions"]
Twist = Float64[np.ndarray, "6"]
Motion = Float64[np.ndarray, "4 4"]
"""Rigid motion of the bodies' frame about the centre of their waves, on (x, y, z, 1)."""


@dataclass(frozen=True, eq=False)
class ArrayWaves:
    """Elements of an array as regular waves about the centre of a scattering matrix.

    Attributes
    ----------
    waves : (W, E) of each element at unit drive, times its gain, without the sensitivity.
    scale : sensitivity/(4πik) [Pa·m²], by which products of waves become pressures.
    """

    waves: Waves
    scale: complex

    def echo(
        self, scattering: ScatteringMatrix, codes: Codes
    ) -> Complex128[np.ndarray, "elements transmissions"]:
        """Scattered pressure at every element (E, M) [Pa], the bodies not moved."""
        waves = self.waves[: len(scattering.matrix)]
        return self.scale * (waves.T @ (scattering.matrix @ (waves @ codes)))


def array_waves(
    scattering: ScatteringMatrix, array: PhasedArray, order: int, *, single: bool = False
) -> ArrayWaves:
    """Expand the elements of an array in the bodies' frame; ``single`` precision is faster.

    Raises
    ------
    InvalidInput
        "bodies_overlap": an element stands within the ball about the bodies.
    """
    faces = array.face_points - scattering.centre
    weights = array.gains[:, None] * array.element.weights
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
    wavenumber = scattering.scene.wavenumber
    count = weights.shape[1]
    parts = []
    block = max(1000 // count, 1)  # elements expanded at once, which bounds the memory
    for first in range(0, len(array), block):
        rows = slice(first, first + block)
        points = faces[rows].reshape(-1, 3)
        strengths = weights[rows].reshape(-1).astype(np.complex128)
        waves = monopole_waves(order, points, wavenumber, strengths, single)
        parts.append(waves if count == 1 else waves.reshape(len(waves), -1, count).sum(axis=2))
    waves = parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1)
    return ArrayWaves(waves, array.element.sensitivity / (4j * np.pi * wavenumber))


@dataclass(frozen=True, eq=False)
class EchoModel:
    """Echoes of some transmissions at some receivers when the bodies move.

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
        codes: Codes,
        receivers: Int64[np.ndarray, "receivers"],
        valid: Bool[np.ndarray, "receivers transmissions"] | None = None,
    ) -> "EchoModel":
        """Gather what does not depend on the pose."""
        waves = array.waves.astype(np.complex64, copy=False)
        # Indexing copies; with all receivers, the usual case, the waves serve as they are.
        every = np.array_equal(receivers, np.arange(len(codes)))
        receiving = waves if every else waves[:, receivers]
        return cls(scattering, waves @ (array.scale * codes).astype(np.complex64), receiving, valid)

    def part(self, receivers: Int64[np.ndarray, "chosen"], transmissions: int) -> "EchoModel":
        """Return the model of some receivers and the first transmissions, which costs less."""
        return replace(
            self,
            emitted=np.ascontiguousarray(self.emitted[:, :transmissions]),
            receiving=np.ascontiguousarray(self.receiving[:, receivers]),
            valid=None if self.valid is None else self.valid[receivers, :transmissions],
        )

    def echoes(self, motion: Motion) -> Received:
        """Scattered pressure (R, M) [Pa] with the bodies moved."""
        twist = twist_of(motion)
        return self._received(twist, self._scattered(self._incident(twist)))[0]

    def with_derivatives(self, motion: Motion) -> Complex[np.ndarray, "7 receivers transmissions"]:
        """Return the echoes, then their derivatives by translations [Pa/m] and turns [Pa/rad]."""
        twist = twist_of(motion)
        incident = self._incident(twist)
        # All columns go through the matrix at once: one large product is faster than seven.
        along = np.concatenate([incident, *along_motions(incident, self._wavenumber)], axis=1)
        scattered = self._scattered(along)
        count = self.emitted.shape[1]
        # − V_i T D w: the motions act on the outgoing waves of the echo itself.
        back = along_motions(np.ascontiguousarray(scattered[:, :count]), self._wavenumber)
        scattered[:, count:] -= np.concatenate(back, axis=1)
        return self._received(twist, scattered)

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
        out[:count] = self.scattering.scatter(incident[:count])
        return out

    def _received(
        self, twist: Twist, scattered: Waves
    ) -> Complex[np.ndarray, "parts receivers transmissions"]:
        back = moved(-twist, scattered, self._wavenumber)
        # Faster than the transposed product, as there are few columns.
        received = back.T @ self.receiving[: len(back)]
        parts = np.swapaxes(received.reshape(-1, self.emitted.shape[1], received.shape[1]), 1, 2)
        return parts if self.valid is None else parts * self.valid


def motion_of(twist: Twist) -> Motion:
    """Exponential of a twist (translation, turn)."""
    out = np.eye(4)
    out[:3, :3] = Rotation.from_rotvec(twist[3:]).as_matrix()
    out[:3, 3] = _screw(twist[3:]) @ twist[:3]
    return out


def twist_of(motion: Motion) -> Twist:
    """Logarithm of a motion by less than half a turn."""
    turn = Rotation.from_matrix(motion[:3, :3]).as_rotvec()
    return np.concatenate([np.linalg.solve(_screw(turn), motion[:3, 3]), turn])


def _screw(turn: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "3 3"]:
    """Return ∫ exp(s [ω]×) ds from 0 to 1, by which the translation of a twist moves the centre."""
    angle = float(np.linalg.norm(turn))
    x, y, z = turn
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    # NumPy's sinc(x) is sin(πx)/(πx), which stays finite at 0.
    half = np.sinc(angle / (2 * np.pi)) ** 2 / 2  # (1 − cos θ)/θ²
    rest = (1.0 - np.sinc(angle / np.pi)) / angle**2 if angle > 1e-4 else 1 / 6  # (θ − sin θ)/θ³
    return np.eye(3) + half * cross + rest * cross @ cross
