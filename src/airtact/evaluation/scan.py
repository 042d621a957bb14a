"""A virtual microphone, and a measured scan compared with a prediction up to one complex scale."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Complex128, Float64, Real

from airtact.acoustics.scene import Scene
from airtact.acoustics.solvers.problem import RadiatedField
from airtact.errors import (
    InvalidInput,
    Vector,
    about,
    between,
    check_finite,
    complex_numbers,
    counted,
    in_short,
    of_kind,
    path_of,
    points_of,
    real_numbers,
    shaped,
    within,
)
from airtact.files.text_table import read_text_table
from airtact.geometry.primitives import turn_from_z
from airtact.transducers.element import piston

# Smallest number of positions; almost any field would fit fewer positions.
MIN_POSITIONS = 3


@dataclass(frozen=True, eq=False)
class Scan:
    """The readings of a microphone at many positions, as read by ``load_scan``.

    Readings at the same position are averaged; in this case, the positions are sorted by x, y and
    z.

    Attributes
    ----------
    points : (N, 3) positions of the centre of the microphone's face [m], in the frame of the scene
        with which the scan is compared.
    pressures : (N,) complex readings for the time factor e^{−iωt}, in any unit; real
        amplitudes, stored as complex numbers, if no phase was measured.
    phased : whether the phase was measured. If not, only magnitudes are compared.
    repeated : number of positions that occurred more than once; computed, not passed.

    Raises
    ------
    InvalidInput
        If the number of readings differs from that of the positions, if a number is NaN or
        infinite, if there are fewer than 3 different positions, if a position is more than 2 m from
        the frame's origin, or if all readings are 0.
    """

    points: Float64[np.ndarray, "points 3"]
    pressures: Complex128[np.ndarray, "points"]
    phased: bool
    repeated: int = field(default=0, init=False)

    __repr__ = in_short

    def __post_init__(self) -> None:
        points = points_of(self.points, "positions of a scan", least=0)
        pressures = complex_numbers(self.pressures, "pressures of a scan")
        if pressures.shape != (len(points),):
            raise InvalidInput(
                f"a scan of {len(points)} positions requires one pressure per position, not an "
                f"array of shape {pressures.shape}.",
                code="wrong_shape",
            )
        check_finite(pressures, "pressures of a scan")
        # Repeated positions would be weighted twice in the fit.
        once, place, counts = np.unique(points, axis=0, return_inverse=True, return_counts=True)
        if len(once) < len(points):
            sums = np.zeros(len(once), complex)
            np.add.at(sums, place.ravel(), pressures)
            points = once
            pressures = sums / counts
        if len(points) < MIN_POSITIONS:
            raise InvalidInput(
                f"the scan has {counted(len(points), 'position', 'positions')}; use "
                f"{MIN_POSITIONS} or more.",
                code="too_few",
            )
        away = np.linalg.norm(points, axis=1)
        worst = int(away.argmax())
        # The scene is a few decimetres wide, so positions beyond 2 m are probably in millimetres.
        if away[worst] > 2.0:
            raise InvalidInput(
                f"position {worst} of the scan is {away[worst]:.4g} m from the origin: is it in "
                "millimetres? Use metres.",
                points[worst],
                code="not_in_metres",
            )
        if not pressures.any():
            raise InvalidInput(
                "all pressures of the scan are 0. Use measured pressures.", code="all_zero"
            )
        # ``vars`` bypasses the frozen dataclass.
        vars(self).update(points=points, pressures=pressures, repeated=int(np.sum(counts > 1)))

    def comparable(
        self, predicted: Complex128[np.ndarray, "points"], used: Bool[np.ndarray, "points"]
    ) -> tuple[Complex128[np.ndarray, "used"], Complex128[np.ndarray, "used"]]:
        """Return the measured and the predicted pressures where the mask ``used`` is True.

        If no phase was measured, the magnitudes are returned.
        """
        pressures = self.pressures[used], predicted[used]
        if self.phased:
            return pressures
        measured, model = (np.abs(part).astype(np.complex128) for part in pressures)
        return measured, model


def load_scan(path: str | Path) -> Scan:
    """Read a scan from a .csv file.

    Parameters
    ----------
    path : file with the columns x, y, z (position of the microphone [m]), pressure (amplitude in
        any unit) and, if it was measured, phase [rad] of the phasor p in Re[p e^{−iωt}]. The first
        line names the columns, in any order; further columns are ignored.

    Returns
    -------
    The ``Scan``, with complex pressures if the file has phases. Positions keep the frame of the
    file; readings at the same position are averaged.

    Raises
    ------
    InvalidInput
        If the file cannot be read, if a column is missing, if a value is not a finite number, if
        there are fewer than 3 different positions, if a position is more than 2 m from the origin
        of the file's frame, if the magnitude of a phase exceeds 2π (as in degrees), or if all
        pressures are 0.
    """
    table = read_text_table(path_of(path, "the file of a scan"))
    table.require("x", "y", "z", "pressure")
    points = np.stack([table.numbers(name) for name in "xyz"], axis=1)
    pressures = table.numbers("pressure").astype(np.complex128)
    phased = "phase" in table.names
    if phased:
        phases = table.numbers("phase")
        largest = float(np.abs(phases).max(initial=0.0))
        # Wrapped phases end at 2π; phases in degrees and unwrapped phases exceed it.
        if largest > 2.0 * np.pi + 0.1:
            raise InvalidInput(
                f"{Path(path).name}: the column phase reaches {largest:.4g}. Is it in degrees? "
                "Use radians from -π to π.",
                code="out_of_range",
            )
        pressures = pressures * np.exp(1j * phases)
    with about(Path(path).name):
        return Scan(points, pressures, phased)


@dataclass(frozen=True, eq=False)
class Overlay:
    """A scan and the pressures predicted at its N positions, with a common scale factor.

    ``overlay_scan`` returns it. If no phase was measured, magnitudes are compared.

    Attributes
    ----------
    scan : the measured ``Scan``.
    predicted : (N,) complex predicted pressures, without the scale [Pa]; NaN at positions where a
        body overlaps the microphone.
    used : (N,) mask of the positions with a prediction; only these are compared.
    scale : factor for the predicted pressures that fits the measured ones best by least squares, in
        the unit of the scan per Pa; complex, but real and positive if no phase was measured.
    error : rms of the difference between measured and scaled predicted pressures, divided by the
        rms of the measured ones; 0 if they agree.
    """

    scan: Scan
    predicted: Complex128[np.ndarray, "points"]
    used: Bool[np.ndarray, "points"]
    scale: complex
    error: float

    __repr__ = in_short

    @property
    def warnings(self) -> tuple[str, ...]:
        """Sentences about positions that were measured twice or could not be predicted."""
        sentences = []
        if self.scan.repeated:
            sentences.append(
                f"{counted(self.scan.repeated, 'position was', 'positions were')} measured more "
                "than once; the readings are averaged."
            )
        left_out = int(np.sum(~self.used))
        if left_out:
            sentences.append(
                f"{left_out} of {len(self.used)} positions are skipped, because a body overlaps "
                "the microphone."
            )
        return tuple(sentences)


def overlay_scan(scan: Scan, predicted: Complex128[np.ndarray, "points"]) -> Overlay:
    """Compare a scan with a prediction after fitting one complex scale by least squares.

    The scale accounts for the unknown sensitivity and phase of the measurement. If no phase was
    measured, magnitudes are compared, and the scale is real and positive.

    Parameters
    ----------
    scan : the measurement at N positions.
    predicted : (N,) complex peak pressures at ``scan.points`` [Pa], such as the first column of
        ``Microphone.read``; NaN where unknown. These positions are skipped.

    Returns
    -------
    An ``Overlay`` with the scan, the prediction, the scale and the relative error.

    Raises
    ------
    InvalidInput
        If ``predicted`` does not have one pressure per position of the scan, if fewer than 3
        positions can be compared, or if the prediction is 0 at all of them. The error is also
        raised if the relative error is above 20 %, but would be less than half as large if the
        phases of the scan were negated.

    Examples
    --------
    >>> points = np.array([[0.0, 0, 0], [0, 0, 0.01], [0, 0, 0.02]])
    >>> scan = Scan(points, np.array([2.0, 4.0, 6.0 + 0j]), True)
    >>> overlay = overlay_scan(scan, np.array([1j, 2j, 3j]))
    >>> complex(round(overlay.scale.real, 9), round(overlay.scale.imag, 9)), round(overlay.error, 9)
    (-2j, 0.0)
    """
    of_kind(scan, Scan, "the scan", "load_scan(path)")
    predicted = shaped(predicted, (-1,), "the prediction")
    if predicted.shape != scan.pressures.shape:
        raise InvalidInput(
            f"got {len(predicted)} predictions for a scan of {len(scan.points)} positions; use "
            "one per position.",
            code="sizes_differ",
        )
    used = np.isfinite(predicted)
    if used.sum() < MIN_POSITIONS:
        raise InvalidInput(
            f"only {int(used.sum())} of {len(used)} positions of the scan can be predicted: at "
            "the others, a body overlaps the microphone. Is the scan in the scene's frame?",
            code="signal_unusable",
        )
    measured, model = scan.comparable(predicted, used)
    if not model.any():
        raise InvalidInput(
            "the prediction is 0 Pa at all positions of the scan. Check the drive and the "
            "positions.",
            code="all_zero",
        )
    scale, error = fitted(measured, model)
    # Instruments with the convention e^(+iωt) store conjugated phases.
    mirrored = fitted(measured, model.conj())[1] if scan.phased else error
    # An error of up to 20 % is treated as agreement.
    if mirrored < 0.5 * error and error > 0.2:
        raise InvalidInput(
            f"the scan deviates from the prediction by {error:.1%}, but only by {mirrored:.1%} "
            "with negated phases. The phases seem to be those of e^(+iωt). Negate the column "
            "phase.",
            code="does_not_match",
        )
    return Overlay(scan, predicted, used, scale, error)


def best_shift(
    scan: Scan, read: Callable[[Float64[np.ndarray, "points 3"]], Complex128[np.ndarray, "points"]]
) -> tuple[Float64[np.ndarray, "3"], float]:
    """Find the shift of the positions that makes a scan agree best with the prediction.

    Agreement is measured by the error of ``Overlay``, with a fitted scale factor. The search
    varies one coordinate at a time, first by up to ±9 mm in steps of 3 mm and finally in steps of
    0.25 mm. It ignores shifts for which less than 30 %, or fewer than 3, of the predictions are
    known.

    Parameters
    ----------
    scan : the measurement.
    read : function that returns the complex prediction (N,) at positions (N, 3) in the frame of the
        scan [m], with NaN where it is unknown.

    Returns
    -------
    The shift (3,) to add to the positions of the scan [m], and the relative error that remains: the
    rms of the deviation divided by the rms of the scan. The shift is 0 if none lowers the error.
    The error is 1 if the search ignores all shifts.
    """
    of_kind(scan, Scan, "the scan", "load_scan(path)")
    of_kind(read, Callable, "read", "a function of positions")  # pyright: ignore[reportArgumentType]

    def error(shift: Float64[np.ndarray, "3"]) -> float:
        model = read(scan.points + shift)
        used = np.isfinite(model)
        # A shift into a body leaves few positions, and almost any field fits few positions.
        if used.sum() < max(MIN_POSITIONS, 0.3 * len(used)):
            return 1.0
        return fitted(*scan.comparable(model, used))[1]

    best = np.zeros(3)
    lowest = error(best)
    # Steps of 3 mm, a third of a wavelength, find the right minimum; finer steps refine it.
    for reach, step in ((9e-3, 3e-3), (2e-3, 1e-3), (0.5e-3, 0.25e-3)):
        for _ in range(2):
            for axis in np.eye(3):
                for along in np.arange(-reach, reach + step / 2, step):
                    shift = best + along * axis
                    left = error(shift)
                    if left < lowest:
                        best = shift
                        lowest = left
    return best, lowest


def fitted(
    measured: Complex128[np.ndarray, "points"], model: Complex128[np.ndarray, "points"]
) -> tuple[complex, float]:
    """Return the least-squares factor that fits a model to a measurement, and the error."""
    # Least squares: s = ⟨model, measured⟩ / ‖model‖²; ``vdot`` conjugates its first argument
    scale = complex(np.vdot(model, measured) / np.vdot(model, model).real)
    return scale, float(np.linalg.norm(measured - scale * model) / np.linalg.norm(measured))


@dataclass(frozen=True)
class Microphone:
    """A round microphone at the end of a straight housing, used to predict what a scan measures.

    ``read`` returns the mean complex pressure over the face, or NaN where a body overlaps the face
    or the housing. The position of the microphone is the centre of its face. Scattering by the
    microphone is ignored.

    Attributes
    ----------
    diameter : diameter of the face and the housing [m], above 0 and at most 0.02; by default a
        quarter of an inch, as in Inoue, Makino and Shinoda (2014), section 4.2.
    axis : (3,) vector of any length that points outward from the face, in the frame of the scene;
        by default −z, so that the face looks down and the housing extends upward.
    housing : length of the housing behind the face [m], 0 to 1.

    Raises
    ------
    InvalidInput
        If a length is outside its range, or the axis is zero or does not have three components.
    """

    diameter: float = 6.35e-3
    axis: Vector = (0.0, 0.0, -1.0)
    housing: float = 0.05

    def __post_init__(self) -> None:
        # A diameter of over two wavelengths at 40 kHz is probably in millimetres.
        within(self.diameter, 0.0, 0.02, "the diameter of a microphone", "m")
        between(self.housing, 0.0, 1.0, "the length of a microphone's housing", "m")
        axis = real_numbers(np.asarray(self.axis), "the axis of a microphone")
        if axis.shape != (3,) or not np.linalg.norm(axis) > 0.0:
            raise InvalidInput(
                f"the axis of a microphone is {axis.tolist()}. Use three numbers that are not all "
                "0.",
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
        """Return a mask (N,) of the positions at which a body overlaps the face or the housing.

        Parameters
        ----------
        scene : the bodies.
        centres : (N, 3) positions of the centre of the microphone's face [m].
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
        """Return the mean pressure (N, S) [Pa] over the face, or NaN where ``blocked``.

        Parameters
        ----------
        field : field with S excitations.
        centres : (N, 3) positions of the centre of the microphone's face [m].
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
