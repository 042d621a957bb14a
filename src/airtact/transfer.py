"""From drive to pressure at the foci, p = H d: solvers and transducers meet here."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex128, Float64

from airtact.conventions import InvalidInput
from airtact.printing import in_short
from airtact.scene.medium import Medium
from airtact.scene.target import Target
from airtact.solvers.problem import RadiatedField
from airtact.transducers.element import check_pattern
from airtact.transducers.layout import PhasedArray
from airtact.transducers.placement import check_placement, check_reach
from airtact.validation import check_finite, check_frequency, complex_numbers, counted, in_mm, of_kind

FULL_SCALE = 1.0 + 1e-9
"""Largest magnitude of a drive: full scale, and what rounding adds to it."""


@dataclass(frozen=True, eq=False)
class Drive:
    """What every element of an array emits.

    Attributes
    ----------
    amplitudes : (E,) complex amplitudes, 1 at full scale; phases in the phasor Re[d e^{−iωt}].

    Raises
    ------
    InvalidInput
        If there is no element, a number is not finite, or a magnitude passes 1 (how many, the largest).
    """

    amplitudes: Complex128[np.ndarray, "elements"]

    __repr__ = in_short

    def __post_init__(self) -> None:
        amplitudes = complex_numbers(self.amplitudes, "the drive's amplitudes")
        if amplitudes.ndim != 1 or len(amplitudes) == 0:
            raise InvalidInput(f"a drive needs one amplitude per element, not an array of shape {amplitudes.shape}.")
        check_finite(amplitudes, "the drive's amplitudes")
        magnitude = np.abs(amplitudes)
        if magnitude.max() > FULL_SCALE:
            count = counted(int(np.sum(magnitude > FULL_SCALE)), "element is", "elements are")
            raise InvalidInput(
                f"{count} driven over full scale, the loudest at {magnitude.max():.4g}: divide the drive by that."
            )
        amplitudes.flags.writeable = False
        object.__setattr__(self, "amplitudes", amplitudes)

    def __len__(self) -> int:
        return len(self.amplitudes)

    def phase_only(self) -> "Drive":
        """Keep the phases, all at full scale; an element with amplitude 0 has no phase and stays silent."""
        return Drive(np.sign(self.amplitudes))


def check_drive(drive: Drive, what: str) -> None:
    """Refuse what is no drive, such as a frame.

    Parameters
    ----------
    drive : what the caller gave.
    what : its name, for the sentence.

    Raises
    ------
    InvalidInput
        Saying what to give instead.
    """
    of_kind(drive, Drive, what, "frame.drive()" if hasattr(drive, "drive") else "Drive(amplitudes)")


@dataclass(frozen=True, eq=False)
class TransferMatrix:
    """Pressure at every focus per unit drive of every element, with all scattering in it.

    Attributes
    ----------
    matrix : (F, E) pressure at focus f when element e alone is at full scale [Pa].
    estimated_error : relative error of the matrix, as the solver of the beacons estimates it.
    foci : (F, 3) where the beacons stood, in the obstacles' frame [m]; None where nobody said.
    wavelength : of the sound in the air [m]; None where nobody said.

    Raises
    ------
    InvalidInput
        If the matrix is empty, an entry is not finite (how many, where first), or every entry is zero.
    """

    matrix: Complex128[np.ndarray, "foci elements"]
    estimated_error: float
    foci: Float64[np.ndarray, "foci 3"] | None = None
    wavelength: float | None = None

    __repr__ = in_short

    def __post_init__(self) -> None:
        matrix = complex_numbers(self.matrix, "the transfer matrix")
        if matrix.ndim != 2 or matrix.size == 0:
            raise InvalidInput(f"a transfer matrix has the shape (foci, elements), not {matrix.shape}.")
        check_finite(matrix, "the transfer matrix (focus, element)")
        if not matrix.any():
            raise InvalidInput(f"all {matrix.size} entries of the transfer matrix are 0: no element is heard.")
        matrix.flags.writeable = False
        object.__setattr__(self, "matrix", matrix)

    def pressure(self, drive: Drive) -> Complex128[np.ndarray, "foci"]:
        """Pressure at each focus [Pa] under a drive, p = H d.

        Raises
        ------
        InvalidInput
            If the drive is for another number of elements.
        """
        check_drive(drive, "the drive")
        if len(drive) != self.matrix.shape[1]:
            raise InvalidInput(
                f"a drive of {counted(len(drive), 'element', 'elements')} does not fit a transfer matrix of "
                f"{counted(self.matrix.shape[1], 'element', 'elements')}."
            )
        return self.matrix @ drive.amplitudes


def transfer_matrix(beacons: RadiatedField, array: PhasedArray) -> TransferMatrix:
    """Build the transfer matrix by reciprocity: unit beacons at the foci, heard by the elements.

    H[f, e] = g_e sensitivity Σ_j w_j b_f(x_ej) with b_f the field of a beacon of 1 Pa·m at focus f, x_ej and w_j the
    points and weights on the face of element e, and g_e its gain (1 unless calibrated, 0 where it is dead). Reciprocity
    (equation 3 of the paper) makes that what focus f hears of element e; one solve serves every translation and
    rotation of the array (section 3.3 of the paper).

    Parameters
    ----------
    beacons : field of unit beacons, one sound per focus, as ``solver.radiate(scene, target.beacons())`` gives it.
    array : the transducers in the obstacles' frame, see ``PhasedArray.seen_from``.

    Returns
    -------
    The matrix, with the solver's own estimate of its error: at the elements if the field can tell (the largest over
    the beacons), else that of its report.

    Raises
    ------
    InvalidInput
        If the sources are not unit beacons, an element is inside a body, a focus or a body is behind the face of a
        directional element, or the field is not known at an element.
    """
    of_kind(beacons, RadiatedField, "the field of the beacons", "solver.radiate(scene, target.beacons())")
    of_kind(array, PhasedArray, "the array", "one such as surrounding_box()")
    sources = beacons.sources
    count = len(sources.positions)
    if sources.strengths.shape != (count, count) or not np.array_equal(sources.strengths, np.eye(count)):
        raise InvalidInput(
            f"the field must be that of unit beacons, one sound of 1 Pa·m per point, not strengths of shape "
            f"{sources.strengths.shape} with the largest {np.abs(sources.strengths).max():g} Pa·m: solve for "
            "target.beacons()."
        )
    check_placement(beacons.scene, array, sources.positions)
    element = array.element
    heard = beacons.at(array.face_points.reshape(-1, 3)).reshape(len(array), -1, count)
    _check_unknown(heard, array)
    matrix = element.sensitivity * np.einsum("eqf,q->fe", heard, element.weights) * array.gains
    error = _estimated_error(beacons, array.positions)
    return TransferMatrix(matrix, error, sources.positions, beacons.scene.wavelength)


def _check_unknown(heard: Complex128[np.ndarray, "elements face foci"], array: PhasedArray) -> None:
    unknown = ~np.isfinite(heard).all(axis=(1, 2))
    if unknown.any():
        first = int(unknown.argmax())
        raise InvalidInput(
            f"{int(unknown.sum())} of {len(array)} elements stand where the field is not known, first element {first} "
            f"at {in_mm(array.positions[first])}; give a field that reaches them all.",
            array.positions[first],
        )


def _estimated_error(beacons: RadiatedField, positions: Float64[np.ndarray, "elements 3"]) -> float:
    """Return the largest relative error over the beacons: at the elements where the field knows it, else in general."""
    error_at = getattr(beacons, "error_at", None)
    if error_at is None:
        return float(beacons.report.estimated_error)
    return float(np.max(error_at(positions)))


def focus_by_distance(array: PhasedArray, target: Target, medium: Medium, frequency: float) -> Drive:
    """Focus as if there were no hand, the control: each element's phase from its distances to the foci alone.

    d_e = Σ_f e^{−ik r_ef}, the paper's equation 11 in its equation 5, loudest element 1. Foci count alike whatever
    pressure they ask for, and k is the real wavenumber.

    Parameters
    ----------
    array : the transducers in the target's frame.
    target : the foci.
    medium : the air.
    frequency : frequency of the sound [Hz].

    Raises
    ------
    InvalidInput
        If a focus is behind the face of a directional element, the frequency is outside 1 kHz to 1 MHz, or something is
        of the wrong kind.
    """
    amplitudes = _by_distance(array, target, medium, frequency)
    return Drive(amplitudes / np.abs(amplitudes).max())


def focus_by_distance_phase_only(array: PhasedArray, target: Target, medium: Medium, frequency: float) -> Drive:
    """Keep the phases of ``focus_by_distance`` with every element at full scale; parameters and refusals as there."""
    return Drive(np.exp(1j * np.angle(_by_distance(array, target, medium, frequency))))


def _by_distance(
    array: PhasedArray, target: Target, medium: Medium, frequency: float
) -> Complex128[np.ndarray, "elements"]:
    """Sum over the foci e^{−ik r_ef} for every element."""
    of_kind(array, PhasedArray, "the array", "one such as surrounding_box()")
    of_kind(target, Target, "the target", "Target(points, pressures)")
    of_kind(medium, Medium, "the medium", "air() or Medium(sound_speed, density)")
    check_frequency(frequency)
    check_pattern(array.element, medium.wavenumber(frequency))
    check_reach(array, target.points)
    distance = np.linalg.norm(array.positions[:, None, :] - target.points[None, :, :], axis=-1)
    return np.exp(-1j * medium.wavenumber(frequency).real * distance).sum(axis=1)
