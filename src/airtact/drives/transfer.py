"""The transfer matrix H, which maps a drive d to the pressures p = H d at foci, and its rows."""

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from statistics import median

import numpy as np
from jaxtyping import Complex, Complex128, Float64, Int64

from airtact.acoustics.medium import Medium
from airtact.acoustics.scene import Scene
from airtact.acoustics.solvers.problem import FreeField, RadiatedField
from airtact.acoustics.solvers.shared import monopole_pressure
from airtact.acoustics.target import Target
from airtact.drives.drive import Drive, check_drive
from airtact.drives.frame import Frame
from airtact.errors import (
    InvalidInput,
    check_finite,
    check_frequency,
    complex_numbers,
    counted,
    in_mm,
    millimetres,
    number,
    of_kind,
    one_line,
    shaped,
)
from airtact.transducers.element import check_pattern
from airtact.transducers.layout import PhasedArray
from airtact.transducers.placement import check_apart, check_placement, check_reach, strength_in


@dataclass(frozen=True, eq=False)
class TransferMatrix:
    """Complex pressure at every focus per unit drive of every element, p = H d.

    ``transfer_matrix`` and ``open_air_matrix`` compute it with and without the scattering by the
    bodies. The drive methods, such as ``max_min``, take it to compute a drive.

    Attributes
    ----------
    matrix : (F, E) complex pressure H[f, e] at focus f when element e alone is at full scale, with
        its gain [Pa]. The rows of suppression points, if there are any, follow those of the foci
        and count toward F.
    estimated_error : relative error of the matrix, as estimated by the solver (0.01 is 1 %); NaN if
        unknown.
    foci : (F, 3) position to which each row belongs, in the frame of the bodies [m], or None if
        unknown. If they are known, methods check that they are the target's points.
    wavelength : wavelength of the sound in the air [m], or None if unknown.

    Raises
    ------
    InvalidInput
        If the matrix is empty or not (F, E), if an entry is not finite, or if every entry is zero.
    """

    matrix: Complex128[np.ndarray, "foci elements"]
    estimated_error: float
    foci: Float64[np.ndarray, "foci 3"] | None = None
    wavelength: float | None = None

    def __repr__(self) -> str:
        foci, elements = self.matrix.shape
        error = self.estimated_error
        return one_line(
            self,
            counted(foci, "focus", "foci"),
            counted(elements, "element", "elements"),
            f"estimated error {100 * error:.2g} %" if np.isfinite(error) else "",
        )

    def __post_init__(self) -> None:
        matrix = complex_numbers(self.matrix, "the transfer matrix")
        if matrix.ndim != 2 or matrix.size == 0:
            raise InvalidInput(
                f"a transfer matrix must have shape (foci, elements), not {matrix.shape}.",
                code="wrong_shape",
            )
        check_finite(matrix, "the transfer matrix (focus, element)")
        if not matrix.any():
            raise InvalidInput(
                "the transfer matrix is 0: no element produces pressure at a focus. Check the "
                "gains and the placement of the array.",
                code="all_zero",
            )
        number(self.estimated_error, "the estimated error", "")
        matrix.flags.writeable = False
        object.__setattr__(self, "matrix", matrix)

    def pressure(self, drive: Drive) -> Complex128[np.ndarray, "foci"]:
        """Return the complex pressure [Pa] that a drive produces at each focus, p = H d.

        Returns
        -------
        (F,) complex peak pressures p [Pa], for the time dependence Re[p e^{−iωt}].

        Raises
        ------
        InvalidInput
            If the drive does not have as many elements as the matrix.
        """
        self.check_fits(drive)
        return self.matrix @ drive.amplitudes

    def check_fits(self, drive: Drive) -> None:
        """Raise ``InvalidInput`` unless the drive has as many elements as the matrix."""
        check_drive(drive, "the drive", "transfer matrix", self.matrix.shape[1])

    def of_rows(self, rows: Int64[np.ndarray, "rows"]) -> "TransferMatrix":
        """Return the transfer matrix with only the given rows, in this order."""
        rows = shaped(rows, (-1,), "rows")
        foci = None if self.foci is None else self.foci[rows]
        return replace(self, matrix=self.matrix[rows], foci=foci)


# A function that computes a drive, such as ``phase_conjugate``.
MakeDrive = Callable[[TransferMatrix, Target], Drive]


def transfer_matrix(beacons: RadiatedField, array: PhasedArray) -> TransferMatrix:
    """Build the transfer matrix by reciprocity, from a single solve with unit beacons.

    Its product with a drive is the complex pressure at each focus; all drive methods require
    it. A beacon is a virtual unit source at a focus. Its pressure at an element equals the pressure
    that the element, with the same source strength, produces at the focus (reciprocity; Inoue,
    Makino and Shinoda, 2014, equation 3). Therefore

        H[f, e] = g_e · sensitivity · Σ_j w_j b_f(x_ej),

    where b_f is the field of a beacon of 1 Pa·m at focus f, x_ej and w_j are the points and weights
    on the face of element e, and g_e is its gain (1 unless calibrated, 0 if it is dead). One solve
    covers every translation and rotation of the array relative to the bodies (section 3.3 of the
    same paper).

    If the scene contains the array's boards (``reflecting_boards``), b_f is the pressure on their
    faces. This pressure is halved, because an infinite face doubles the pressure and the
    sensitivity of an element already includes the board behind it.

    Parameters
    ----------
    beacons : field of the unit beacons, with one excitation for each beacon:
        ``solver.radiate(scene, target.beacons())``.
    array : the E transducers in the obstacles' frame; see ``PhasedArray.seen_from``.

    Returns
    -------
    A ``TransferMatrix`` (F, E) [Pa], with one row for each of the F beacons: the foci of the
    target, then its suppression points. Its estimated error is the solver's estimate at the
    elements, for the beacon with the largest error.

    Raises
    ------
    InvalidInput
        If the sources are not unit beacons, if an element reaches into a body, if a focus or a body
        is behind the face of a directional element, or if the field is unknown at an element.

    Warns
    -----
    UserWarning
        If the estimated error is above 50 % of the pressure, which happens in the shadow of a body.
    """
    of_kind(
        beacons,
        RadiatedField,
        "the field of the beacons",
        "solver.radiate(scene, target.beacons())",
    )
    of_kind(array, PhasedArray, "the array", "one such as surrounding_box()")
    sources = beacons.sources
    if not np.array_equal(sources.strengths, np.eye(len(sources.positions))):
        raise InvalidInput(
            "the field must be that of unit beacons, with one excitation of 1 Pa·m per point. The "
            f"strengths of its sources have shape {sources.strengths.shape} and a largest "
            f"magnitude of {np.abs(sources.strengths).max():g} Pa·m. Solve for target.beacons().",
            code="wrong_kind",
        )
    check_placement(beacons.scene, array, sources.positions)
    return transfer_to(beacons, array)


def transfer_to(beacons: RadiatedField, array: PhasedArray) -> TransferMatrix:
    """Return the transfer matrix for an array whose placement has already been checked."""
    sources = beacons.sources
    means = _means_on_faces(beacons, array)
    # Stored fields are NaN outside their samples.
    unknown = ~np.isfinite(means).all(axis=0)
    if unknown.any():
        first = int(unknown.argmax())
        raise InvalidInput(
            f"the field is unknown at {int(unknown.sum())} of {len(array)} elements. The first is "
            f"element {first} at {in_mm(array.positions[first])}. Use a field that reaches all "
            "elements.",
            array.positions[first],
            code="data_missing",
        )
    element = array.element
    matrix = strength_in(beacons.scene, array) * element.sensitivity * means * array.gains
    errors = beacons.error_at(array.positions)
    error = float(np.max(errors))
    # The estimate is up to five times too large for foci in gaps, and meaningless on the faces of
    # reflecting boards.
    if error > 0.5 and not beacons.scene.boards:
        worst = int(np.argmax(errors))
        warnings.warn(
            f"the estimated error of the transfer matrix is {error:.0%} for the focus at "
            f"{in_mm(sources.positions[worst])}, which receives little sound from the array. Turn "
            "the body or the array, or solve with a smaller value of accuracy.",
            stacklevel=2,
        )
    return TransferMatrix(matrix, error, sources.positions, beacons.scene.wavelength)


def _means_on_faces(
    beacons: RadiatedField, array: PhasedArray
) -> Complex128[np.ndarray, "foci elements"]:
    """Return the weighted mean of the pressure of each beacon over the face of each element."""
    count = len(beacons.sources.positions)
    weights = array.element.weights
    scattering = beacons.scattering_sources if count > 64 else None
    if scattering is None:
        received = beacons.at(array.face_points.reshape(-1, 3)).reshape(len(array), -1, count)
        return np.einsum("eqf,q->fe", received, weights)
    # With many beacons most of the time goes into the product with the strengths of the scattering
    # monopoles. The mean over each face is taken first, so the product has one column per element.
    emitting = np.concatenate([beacons.sources.positions, scattering.positions])
    wavenumber = beacons.scene.wavenumber
    strengths = weights[:, None].astype(np.complex128)
    means = np.empty((count, len(array)), dtype=np.complex128)
    for first in range(0, len(array), 64):
        faces = array.face_points[first : first + 64]
        columns = [
            monopole_pressure(emitting, face, strengths, wavenumber, "float64") for face in faces
        ]
        pressures = np.concatenate(columns, axis=1)
        scattered = scattering.strengths.T @ pressures[count:]
        means[:, first : first + 64] = pressures[:count] + scattered
    return means


def open_air_matrix(scene: Scene, array: PhasedArray, target: Target) -> TransferMatrix:
    """Build the transfer matrix of the array without the bodies, in closed form.

    To find the benefit of modelling the bodies, compute one drive from this matrix and one from
    ``transfer_matrix`` with the same method. Compare them with the bodies present, at equal peak or
    equal energy (``compare``). Both matrices include the directivity and calibration of the
    elements.

    Parameters
    ----------
    scene : the medium, frequency and planes; its bodies and reflecting boards are ignored.
    array : the E transducers in the frame of the scene.
    target : the F foci and Q suppression points, which are the rows of the matrix in this order.

    Returns
    -------
    A ``TransferMatrix`` of shape (F + Q, E): the complex peak pressure at each point if one element
    emits alone at full scale with phase 0 [Pa]. Its estimated error is 0.

    Raises
    ------
    InvalidInput
        If a focus is behind the face of a directional element, if a focus or an element is behind a
        plane, or if an argument has the wrong type.
    """
    of_kind(scene, Scene, "the scene", "Scene(medium, obstacles)")
    of_kind(target, Target, "the target", "Target(points, pressures)")
    # The boards reflect sound like bodies, so they are left out too.
    empty = Scene(scene.medium, [], frequency=scene.frequency, planes=scene.planes)
    return transfer_matrix(FreeField().radiate(empty, target.beacons(suppression=True)), array)


def focus_by_distance(
    array: PhasedArray, target: Target, medium: Medium, frequency: float
) -> Drive:
    """Compute a drive from the distances between elements and foci alone.

    The drive is d_e = Σ_f e^{−ik r_ef} (Inoue, Makino and Shinoda, 2014, equations 5 and 11),
    scaled to a largest amplitude of 1. r_ef is the distance between the centre of element e and
    focus f, and k the real part of the wavenumber. Scattering by bodies, directivity and gains of
    the elements are ignored, and all foci have the same weight, regardless of their requests.

    Parameters
    ----------
    array : the E transducers in the frame of the target.
    target : the foci; suppression points are ignored.
    medium : the air.
    frequency : frequency of the sound [Hz], 1 kHz to 1 MHz.

    Returns
    -------
    The ``Drive`` of the E elements.

    Raises
    ------
    InvalidInput
        If a focus is behind the face of a directional element or more than 10 m from an element, if
        elements overlap or are too large for the frequency (see ``piston``), if the frequency is
        outside its range, or if an argument has the wrong type.
    """
    of_kind(array, PhasedArray, "the array", "one such as surrounding_box()")
    of_kind(target, Target, "the target", "Target(points, pressures)")
    of_kind(medium, Medium, "the medium", "air() or Medium(sound_speed, density)")
    check_frequency(frequency)
    # There is no scene to check the placement with, so only the elements and foci are checked.
    check_pattern(array.element, medium.wavenumber(frequency))
    check_apart(array)
    check_reach(array, target.points)
    distance = np.linalg.norm(array.positions[:, None, :] - target.points[None, :, :], axis=-1)
    amplitudes = np.exp(-1j * medium.wavenumber(frequency).real * distance).sum(axis=1)
    # The sum over several foci may exceed 1.
    return Drive(amplitudes / np.abs(amplitudes).max())


def rounding_error(
    transfer: TransferMatrix, drive: Drive, frame: Frame
) -> Float64[np.ndarray, "foci"]:
    """Return the relative change of the pressure at each focus due to rounding to levels.

    Boards with two amplitude levels raise weak elements to full scale. For these boards, the two
    drives are compared at equal energy Σ|d|²; for all other boards, they are compared without
    scaling.

    Parameters
    ----------
    transfer : (F, E) transfer matrix from which the drive was computed.
    drive : the computed drive of E elements, before rounding.
    frame : the drive rounded to the levels of the boards, ``quantise(drive, levels)``.

    Returns
    -------
    (F,) |p emitted| / |p computed| − 1, where −0.1 is a loss of 10 %; NaN for foci at which the
    computed pressure is 0.

    Raises
    ------
    InvalidInput
        If the drive or the frame has the wrong number of elements, or the frame is silent.
    """
    of_kind(transfer, TransferMatrix, "the transfer matrix", "transfer_matrix(beacons, array)")
    of_kind(frame, Frame, "the emitted frame", "quantise(drive, levels)")
    if frame.silent:
        raise InvalidInput(
            "all elements of the frame are off. Use a frame that emits sound.", code="all_zero"
        )
    rounded = frame.drive()
    exact = np.abs(transfer.pressure(drive))
    emitted = np.abs(transfer.pressure(rounded))
    # Raising weak elements to full scale adds energy but does not improve the focus.
    if frame.levels.phase_only:
        emitted = emitted * rounded.factor_to_match(drive)
    return np.where(exact > 0.0, emitted / np.where(exact > 0.0, exact, 1.0) - 1.0, np.nan)


# Rows of a transfer matrix at foci, often divided by the request of each focus.
FociRows = Complex128[np.ndarray, "foci elements"]

# Smallest distance between two foci that can be separated [wavelengths].
MIN_FOCUS_DISTANCE = 0.1


def check_foci(transfer: TransferMatrix, target: Target) -> None:
    """Raise ``InvalidInput`` if the target and the transfer matrix have different points.

    The rows of the matrix must correspond to the target's foci, or to its foci followed by its
    suppression points.
    """
    of_kind(transfer, TransferMatrix, "the transfer matrix", "transfer_matrix(beacons, array)")
    of_kind(target, Target, "the target", "Target(points, pressures)")
    rows = len(transfer.matrix)
    foci = len(target.points)
    suppressed = len(target.suppression_points)
    if rows not in (foci, foci + suppressed):
        points = counted(suppressed, "suppression point", "suppression points")
        raise InvalidInput(
            f"a transfer matrix for {counted(rows, 'focus', 'foci')} does not fit a target of "
            f"{counted(foci, 'focus', 'foci')}{f' and {points}' if suppressed else ''}. Use the "
            "matrix of this target.",
            code="sizes_differ",
        )
    if transfer.foci is not None:
        points = np.concatenate([target.points, target.suppression_points])[:rows]
        apart = np.linalg.norm(points - transfer.foci, axis=1)
        if apart.max() > 1e-6:  # metres
            raise InvalidInput(
                f"focus {int(apart.argmax())} of the target is {millimetres(apart.max(), 3)} from "
                "the corresponding focus of the matrix. Use the target for which the matrix was "
                "computed, in the obstacles' frame.",
                code="sizes_differ",
            )


def foci_rows(transfer: TransferMatrix, target: Target) -> FociRows:
    """Return the rows of the matrix for the foci, after checking them with ``check_foci``."""
    check_foci(transfer, target)
    return transfer.matrix[: len(target.points)]


def asked_rows(
    transfer: TransferMatrix, target: Target
) -> tuple[FociRows, Float64[np.ndarray, "foci"]]:
    """Return the matrix rows of foci with a requested pressure or share, and these requests."""
    rows = check_solvable(transfer, target)
    asked = target.weights > 0.0
    # If all foci have a request, nothing is copied.
    return (rows, target.weights) if asked.all() else (rows[asked], target.weights[asked])


def check_solvable(transfer: TransferMatrix, target: Target) -> FociRows:
    """Return the rows for the foci, after checking that a drive can separate and reach all foci.

    Without this check, methods that balance the foci might diverge. The function raises
    ``InvalidInput``:

    - if the matrix was computed for points other than those of the target;
    - if there are more foci than elements;
    - if two foci are less than λ/10 apart or, for an unknown wavelength λ, their rows are parallel;
    - if the largest pressure that a focus can receive is less than 5 % (−26 dB) of the median for
      the other foci.
    """
    rows = foci_rows(transfer, target)
    if len(rows) > rows.shape[1]:
        raise InvalidInput(
            f"there are {len(rows)} foci, but the array has only {rows.shape[1]} elements. Use "
            "fewer foci.",
            code="too_many",
        )
    points = target.points
    apart = np.linalg.norm(points[:, None] - points, axis=2)
    # Without a wavelength, two foci count as the same place if their rows are parallel to 1e-4.
    if transfer.wavelength is None:
        norms = np.maximum(np.linalg.norm(rows, axis=1), np.finfo(float).tiny)
        near = np.abs(rows @ rows.conj().T) > (1.0 - 1e-4) * norms[:, None] * norms
    else:
        near = apart < MIN_FOCUS_DISTANCE * transfer.wavelength
    np.fill_diagonal(near, False)
    if near.any():
        first, second = divmod(int(np.argmin(np.where(near, apart, np.inf))), len(points))
        raise InvalidInput(
            f"foci {first} and {second} at {in_mm(points[first])} and {in_mm(points[second])} are "
            f"only {millimetres(apart[first, second], 3)} apart, too close to be controlled "
            "separately. Remove one, or move them at least a tenth of the wavelength apart.",
            points[first],
            code="foci_unreachable",
        )
    asked = np.flatnonzero(target.weights > 0.0)
    attainable = np.abs(rows).sum(axis=1)[asked]
    shares = attainable / target.weights[asked]
    worst = int(shares.argmin())
    # A shadowed focus gets little pressure, both in pascals and relative to its request. Both are
    # checked because a focus with a twenty times larger request may get as much as the others. The
    # comparison uses the median, so one strong focus does not make all others count as shadowed.
    # NumPy's would import its masked arrays, which takes longer than all of these checks.
    if len(asked) > 1 and all(
        values[worst] < 0.05 * median(np.delete(values, worst)) for values in (attainable, shares)
    ):
        point = target.points[asked[worst]]
        rest = median(np.delete(attainable, worst))
        raise InvalidInput(
            f"focus {asked[worst]} at {in_mm(point)} is shadowed: the pressure there can reach at "
            f"most {attainable[worst]:.3g} Pa, while the median for the other foci is {rest:.3g} "
            "Pa. Move it, remove it or request less pressure there.",
            point,
            code="foci_unreachable",
        )
    return rows


def suppression_rows(
    transfer: TransferMatrix, target: Target
) -> Complex128[np.ndarray, "suppressed elements"]:
    """Return the rows at the suppression points, after checking that the matrix contains them."""
    check_foci(transfer, target)
    suppressed = len(target.suppression_points)
    if len(transfer.matrix) == len(target.points) and suppressed:
        raise InvalidInput(
            f"the target has {counted(suppressed, 'suppression point', 'suppression points')}, but "
            "the transfer matrix has no rows for them; solve for "
            "target.beacons(suppression=True).",
            code="data_missing",
        )
    return transfer.matrix[len(target.points) :]


def achieved_fraction(
    transfer: TransferMatrix, target: Target, drive: Drive
) -> Float64[np.ndarray, "foci"]:
    """Return the ratio of the pressure at each focus to the requested one, |H d|_f / p_f.

    For a drive that a method such as ``best`` computed for this target, the smallest ratio is 1 if
    the drive reaches the target, and below 1 if full scale is not enough.

    Parameters
    ----------
    transfer : the (F, E) transfer matrix from which the drive was computed. To verify the drive
        with another solver, use ``airtact.evaluate``.
    target : the foci and their requested pressures.
    drive : the drive of the E elements.

    Returns
    -------
    (F,) ratios; NaN for foci whose request is 0 Pa, and for all foci of a target that requests no
    pressures, even if it has shares.

    Raises
    ------
    InvalidInput
        If the matrix was computed for other foci, or if the drive does not have as many elements as
        the matrix.
    """
    check_foci(transfer, target)
    return fraction(np.abs(transfer.pressure(drive))[: len(target.points)], target)


def fraction(
    magnitudes: Float64[np.ndarray, "foci"], target: Target
) -> Float64[np.ndarray, "foci"]:
    """Return the ratio (F,) of peak pressure to requested pressure; NaN if none is requested."""
    fractions = np.full(len(target.points), np.nan)
    if target.pressures is not None:
        asked = target.pressures > 0.0
        fractions[asked] = magnitudes[asked] / target.pressures[asked]
    return fractions


def scaled_to_target(
    transfer: TransferMatrix, target: Target, amplitudes: Complex[np.ndarray, "elements"]
) -> Drive:
    """Scale amplitudes so that the smallest ``achieved_fraction`` is 1.

    If the target requires more than full scale or requests no pressures, the largest amplitude is
    1. The function raises ``InvalidInput`` if every amplitude is 0.
    """
    largest = np.abs(amplitudes).max()
    if not largest > 0.0:
        raise InvalidInput(
            "the contributions of the foci cancel at every element, so all amplitudes are 0. "
            "Request other phases or move a focus.",
            code="all_zero",
        )
    # The fraction at full scale determines whether the drive must be scaled down.
    full = Drive(amplitudes / largest)
    if target.pressures is None:
        return full
    worst = np.nanmin(achieved_fraction(transfer, target, full))
    return Drive(full.amplitudes / max(worst, 1.0))
