"""Sensitivity of an array, gains of its elements and misalignment of the stage, from scans.

The scans are of the array alone, without bodies. The pressure at a point x is s Σ_e d_e (1 + ε_e)
h_e(x), where d is the drive, h_e the field of element e per unit of sensitivity, s the common scale
and ε_e the deviation of an element's gain. The positions of all scans are displaced by one rigid
motion. Scale and motion are found by nonlinear least squares. The residual is that of the best ε,
which solves a linear least-squares problem (variable projection: G. Golub and V. Pereyra, SIAM J.
Numer. Anal. 10, 413, 1973). A prior of spread τ holds the deviations near 0, so the gains of
elements that the scans do not distinguish stay nominal. The noise and τ are estimated from the data
by expectation maximisation (C. Bishop, Pattern Recognition and Machine Learning, 2006, section
9.3.4).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Complex128, Float64
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from airtact.acoustics.scene import Scene
from airtact.drives.drive import Drive
from airtact.errors import InvalidInput, NotConverged, counted, of_kind, one_line
from airtact.evaluation.metrics import drive_sources
from airtact.evaluation.scan import Microphone, Scan, fitted, overlay_scan
from airtact.geometry.pose import Pose
from airtact.transducers.calibration import save_calibration
from airtact.transducers.element import Element, piston
from airtact.transducers.layout import PhasedArray

# Expected misalignment of a stage: three turns [rad] and three shifts [m]
EXPECTED_MISALIGNMENT = np.repeat([0.2, 5e-3], 3)

Unknowns = Float64[np.ndarray, "8"]
Gains = Complex128[np.ndarray, "driven"]


@dataclass(frozen=True, eq=False)
class ScanCalibration:
    """Properties of an array, determined from scans by ``calibrate_from_scans``.

    Attributes
    ----------
    array : the array with the fitted sensitivity and gains, at its original position. The gains are
        relative to this sensitivity and to the mean phase. Elements whose gain is not determined
        keep their previous gain.
    sensitivity : peak pressure of the average element at full scale, 1 m away on its axis [Pa·m].
    deviation : standard deviation of ``sensitivity`` [Pa·m], without the microphone's own
        uncertainty.
    gain_deviations : (E,) standard deviation of each gain relative to its magnitude, or of its
        phase [rad] if that is larger.
    determined : (E,) mask of the elements whose gain is determined by the scans: its uncertainty is
        less than half of the standard deviation of the gains from element to element. Without
        phases, no gain is determined.
    pose : rigid motion that maps the positions stated in the scans to the true positions of the
        microphone in the array's frame.
    misalignment : (6,) rotation vector of ``pose`` about x, y and z [rad], followed by the shift of
        the mean position of all scans along x, y and z [m].
    misalignment_deviation : (6,) standard deviation of each entry of ``misalignment`` [rad, m].
    errors : for each scan, the rms of the deviation from the fitted field divided by the rms of the
        readings. It includes noise.
    """

    array: PhasedArray
    sensitivity: float
    deviation: float
    gain_deviations: Float64[np.ndarray, "elements"]
    determined: Bool[np.ndarray, "elements"]
    pose: Pose
    misalignment: Float64[np.ndarray, "6"]
    misalignment_deviation: Float64[np.ndarray, "6"]
    errors: tuple[float, ...]

    def __repr__(self) -> str:
        return one_line(
            self,
            f"sensitivity {self.sensitivity:.4g} ± {self.deviation:.2g} Pa·m",
            f"{self.determined.sum()} of {len(self.array)} gains determined",
            f"error {max(self.errors):.2g}",
        )

    def save(self, path: str | Path) -> None:
        """Write the gains to a .csv file for the key ``calibration`` of a scene file.

        An existing file is replaced. The method raises ``InvalidInput`` if the file name does
        not end in .csv or the file cannot be written.
        """
        save_calibration(path, self.array.gains, [Pose.identity()] * len(self.array), self.array)


@dataclass(frozen=True, eq=False)
class _Fit:
    """Unknowns and deviations ε (real, then imaginary parts) for a given noise and spread."""

    unknowns: Unknowns
    deviations: Float64[np.ndarray, "parts"]
    # Covariance of the unknowns and ε
    covariance: Float64[np.ndarray, "all all"]
    # Estimates from this fit: the noise, and the spreads of the real and the imaginary parts,
    # because phases often differ more than amplitudes.
    noise: float
    spread: Float64[np.ndarray, "2"]


@dataclass(frozen=True, eq=False)
class _Readings:
    """The readings of all scans and their model.

    The unknowns (8,) are a rotation vector about the middle of the points [rad], its shift [m], and
    logarithm and phase of the common scale.

    Attributes
    ----------
    points : (N, 3) stated positions [m].
    measured : (N,) readings relative to their rms; real if phases are not used.
    phased : whether phases are used.
    drives : (N, D) amplitudes of the D elements that emit in any scan.
    array : array that consists of only these D elements.
    wavenumber : wavenumber of the sound [1/m].
    microphone : the microphone; None for a point.
    """

    points: Float64[np.ndarray, "points 3"]
    measured: Complex128[np.ndarray, "points"]
    phased: bool
    drives: Complex128[np.ndarray, "points driven"]
    array: PhasedArray
    wavenumber: complex
    microphone: Microphone | None

    def parts(self, unknowns: Unknowns) -> Complex128[np.ndarray, "points driven"]:
        """Return the contribution of each element to each reading if its gain is nominal."""
        element = self.array.element
        turn = Rotation.from_rotvec(unknowns[:3])
        middle = self.points.mean(axis=0)
        moved = turn.apply(self.points - middle) + middle + unknowns[3:6]
        rays = moved[:, None] - self.array.positions
        distances = np.linalg.norm(rays, axis=2)
        cosines = np.einsum("nes,es->ne", rays, self.array.normals) / distances
        far, nearer = _patterns(element, cosines, self.wavenumber)
        fields = self.drives * np.exp(unknowns[6] + 1j * unknowns[7])
        if self.microphone is not None:
            axis = turn.apply(np.array(self.microphone.axis, dtype=np.float64))
            cosines = rays @ axis / (distances * np.linalg.norm(axis))
            fields *= _patterns(piston(self.microphone.diameter / 2.0), cosines, self.wavenumber)[0]
        # The mean distance of the face from a point in front of it, to second order
        distances += element.weights @ np.sum(element.points**2, axis=1) / (2.0 * distances)
        fields *= (far + nearer / distances) * np.exp(1j * self.wavenumber * distances) / distances
        return fields

    def misfit(self, unknowns: Unknowns, gains: Gains) -> Float64[np.ndarray, "rows"]:
        """Return the residual for given gains, as real and imaginary parts or as magnitudes."""
        model = self.parts(unknowns) @ gains
        if not self.phased:
            return np.real(self.measured) - np.abs(model)
        left = self.measured - model
        return np.concatenate([np.real(left), np.imag(left)])

    def slopes(self, unknowns: Unknowns, gains: Gains) -> Float64[np.ndarray, "rows parts"]:
        """Return the derivatives of the model with respect to real, then imaginary parts of ε."""
        parts = self.parts(unknowns)
        if self.phased:
            both = np.hstack([parts, 1j * parts])
            return np.vstack([np.real(both), np.imag(both)])
        model = parts @ gains
        along = parts * (model.conj() / np.abs(model))[:, None]
        return np.hstack([np.real(along), -np.imag(along)])

    def start(self, tilt: tuple[float, float]) -> tuple[float, Unknowns]:
        """Return the relative error for a tilt at the best scale, and the unknowns found there."""
        unknowns = np.array([*tilt, *np.zeros(6)])
        model = self.parts(unknowns).sum(axis=1)
        scale, error = fitted(self.measured, model if self.phased else np.abs(model) + 0j)
        unknowns[6:] = np.log(np.abs(scale)), np.angle(scale)
        return error, unknowns

    def fit(self, before: _Fit) -> _Fit:
        """Fit the unknowns to the residual that remains with the best ε of the linearised model."""
        noise = before.noise
        number = len(self.array)
        spread = before.spread.repeat(number)
        gains = 1.0 + before.deviations.reshape(2, -1).T @ [1.0, 1.0j]
        slopes = self.slopes(before.unknowns, gains)
        offset = slopes @ before.deviations
        rows, parts = slopes.shape
        if_known = np.linalg.inv(slopes.T @ slopes / noise**2 + np.diag(spread**-2.0))
        solution = if_known @ slopes.T / noise**2

        def residual(unknowns: Unknowns) -> Float64[np.ndarray, "residuals"]:
            misfit = self.misfit(unknowns, gains) + offset
            deviations = solution @ misfit
            return np.concatenate(
                [
                    (misfit - slopes @ deviations) / noise,
                    deviations / spread,
                    unknowns[:6] / EXPECTED_MISALIGNMENT,
                    # Magnitudes do not depend on the common phase.
                    [] if self.phased else unknowns[7:],
                ]
            )

        found = least_squares(
            residual,
            before.unknowns,
            x_scale=np.array([*(0.1 * EXPECTED_MISALIGNMENT), 0.1, 0.1]),
            ftol=1e-6,
            max_nfev=50,
        )
        deviations = spread * found.fun[rows : rows + parts]
        # The best ε follow the unknowns, and are uncertain even for known unknowns.
        follows = np.vstack([np.eye(8), spread[:, None] * found.jac[rows : rows + parts]])
        covariance = follows @ np.linalg.inv(found.jac.T @ found.jac) @ follows.T
        covariance[8:, 8:] += if_known
        squares = (deviations**2 + np.diag(covariance)[8:]).reshape(2, number).sum(axis=1)
        # A few elements do not determine their spread, so a spread of 0.1 counts like two elements.
        # Without it, the tilt from a focus of 12 elements would be off by 1.4 of its deviations.
        squares += 2.0 * 0.1**2
        left = noise * found.fun[:rows]
        free = max(rows - np.sum(solution * slopes.T) - 8, 1.0)
        return _Fit(
            found.x,
            deviations,
            covariance,
            # Smaller values would not change the result.
            max(float(np.sqrt(left @ left / free)), 1e-6),
            np.sqrt(squares / (number + 2.0)),
        )


def calibrate_from_scans(
    scans: Sequence[Scan],
    drives: Sequence[Drive],
    array: PhasedArray,
    scene: Scene,
    microphone: Microphone | None = None,
) -> ScanCalibration:
    """Fit sensitivity, gains and misalignment to scans of single elements or of a focus.

    The misalignment is the rigid motion from the positions stated in the scans to the true
    positions of the microphone in the array's frame. Its prior is normal, with standard deviations
    of 5 mm along and 0.2 rad about each axis; above 10 mm or 10 degrees, the fit may fail. Gains of
    elements that do not emit, or that the scans do not distinguish, keep their values.

    Parameters
    ----------
    scans : scans of the field of the array alone, in pascals (peak). All scans have the same
        misalignment and reference phase. If any scan has no phases, only magnitudes are compared
        in all scans, and no gain is determined.
    drives : the drive of each scan, one complex amplitude per element.
    array : the array at its assumed position, in the frame of the scans; its gains are included in
        the model.
    scene : medium and frequency, without bodies and planes.
    microphone : size and direction (in the frame of the scans) of the microphone; by default, it is
        a point.

    Returns
    -------
    A ``ScanCalibration`` with the fitted array, its sensitivity and gains, the misalignment, and
    the uncertainty of these results.

    Raises
    ------
    InvalidInput
        If there is no scan, if the number of drives differs from that of the scans, if a drive is
        silent or does not have as many elements as the array, or if the scene has bodies or planes.
        The error is also raised if a scan deviates from the fitted field by more than 20 % (rms),
        but would deviate by less than half as much if its phases were negated.
    NotConverged
        With the code "pose_not_found", if the rms deviation of a scan from the fitted field exceeds
        50 % of the scan's rms pressure.
    """
    of_kind(scans, Sequence, "the scans", "a list of Scan")
    of_kind(drives, Sequence, "the drives", "a list with one drive per scan")
    if not scans or len(scans) != len(drives):
        raise InvalidInput(
            f"got {counted(len(scans), 'scan', 'scans')} and "
            f"{counted(len(drives), 'drive', 'drives')}. Pass at least one scan, and one drive per "
            "scan.",
            code="sizes_differ",
        )
    if of_kind(scene, Scene, "the scene", "Scene(medium)").obstacles or scene.planes:
        raise InvalidInput(
            "calibration requires scans of the array alone: use a scene without bodies and planes.",
            code="not_supported",
        )
    drive_sources(array, drives)  # checks that the drives fit the array and are not silent
    count = len(array)
    amplitudes = array.gains * np.stack([drive.amplitudes for drive in drives])
    driven = amplitudes.any(axis=0)
    number = int(driven.sum())
    sizes = [len(scan.points) for scan in scans]
    measured = np.concatenate([scan.pressures for scan in scans])
    phased = all(scan.phased for scan in scans)
    if not phased:
        measured = np.abs(measured) + 0j
    rms = float(np.sqrt(np.mean(np.abs(measured) ** 2)))
    readings = _Readings(
        np.concatenate([scan.points for scan in scans]),
        measured / rms,
        phased,
        amplitudes[:, driven].repeat(sizes, axis=0),
        PhasedArray(array.positions[driven], array.normals[driven], array.element),
        scene.wavenumber,
        microphone,
    )
    # Phases of a tilted plane are ambiguous by 2π, so the best of 25 tilts is the start.
    tilts = product(np.radians([-8.0, -4.0, 0.0, 4.0, 8.0]), repeat=2)
    _, unknowns = min(map(readings.start, tilts), key=lambda start: start[0])
    # The spread is not known before the misalignment is.
    start = _Fit(unknowns, np.zeros(2 * number), np.zeros((8, 8)), 0.1, np.full(2, 0.1))
    fit = replace(readings.fit(start), spread=start.spread)
    for _ in range(15):
        before = fit
        fit = readings.fit(before)
        step = np.abs(fit.unknowns - before.unknowns)
        if (step < 0.05 * np.sqrt(np.diag(fit.covariance)[:8])).all():
            break
    factors = np.ones(count, dtype=np.complex128)
    factors[driven] += fit.deviations[:number] + 1j * fit.deviations[number:]
    predicted = rms * (readings.parts(fit.unknowns) @ factors[driven])
    errors = tuple(
        overlay_scan(scan, model).error
        for scan, model in zip(scans, np.split(predicted, np.cumsum(sizes)[:-1]), strict=True)
    )
    if max(errors) > 0.5:
        raise NotConverged(
            "no sensitivity and misalignment explain the scans: the best fit leaves "
            f"{max(errors):.0%} of a scan unexplained. Likely causes are a different drive or "
            "frame, a body in the field, or a misalignment of more than 10 mm or 10 degrees.",
            code="pose_not_found",
        )
    mean = np.mean(factors)
    level = np.mean(np.abs(factors))
    sensitivity = float(rms * np.exp(fit.unknowns[6]) * level)
    # The mean gain changes with the scale, with ε, and with the elements that do not emit.
    slope = np.concatenate([np.eye(8)[6], np.repeat([1.0 / count, 0.0], number)])
    silent = (count - number) / count**2
    variance = slope @ fit.covariance @ slope + fit.spread[0] ** 2 * silent
    # Relative error of the model of a piston within 30 degrees of its axis, by a finer rule
    variance += 1e-3**2
    # Gains relative to the mean share its errors.
    centred = np.kron(np.eye(2), np.eye(number) - 1.0 / count)
    variances = np.diag(centred @ fit.covariance[8:, 8:] @ centred.T).reshape(2, number)
    gain_deviations = np.full(count, fit.spread.max())
    gain_deviations[driven] = np.sqrt(variances.max(axis=0))
    determined = np.zeros(count, dtype=bool)
    determined[driven] = (variances < (0.5 * fit.spread[:, None]) ** 2).all(axis=0) & phased
    factors *= abs(mean) / (mean * level)
    turn = Rotation.from_rotvec(fit.unknowns[:3]).as_matrix()
    middle = readings.points.mean(axis=0)
    return ScanCalibration(
        PhasedArray(
            array.positions,
            array.normals,
            replace(array.element, sensitivity=sensitivity),
            array.tangents,
            array.gains * np.where(determined, factors, 1.0),
        ),
        sensitivity,
        sensitivity * float(np.sqrt(variance)),
        gain_deviations,
        determined,
        Pose(turn, middle - turn @ middle + fit.unknowns[3:6]),
        fit.unknowns[:6],
        np.sqrt(np.diag(fit.covariance)[:6]),
        errors,
    )


def _patterns(
    element: Element, cosines: Float64[np.ndarray, "*axes"], wavenumber: complex
) -> tuple[Complex128[np.ndarray, "*axes"], Complex128[np.ndarray, "*axes"]]:
    """Return the field of a round element at angles from its axis in powers of 1/distance.

    A face point x is at the distance r − u·x + (|x|² − (u·x)²) / 2r in direction u. With the mean
    ⟨|x|²⟩ / 2r added to r, the field is (first + second / r) e^{ikr} / r.
    """
    sines = np.linspace(0.0, 1.0, 513)
    directions = np.stack([sines, 0.0 * sines, np.sqrt(1.0 - sines**2)], axis=1)
    ahead = directions @ element.points.T
    squares = np.sum(element.points**2, axis=1)
    across = squares - element.weights @ squares - ahead**2
    waves = element.weights * np.exp(-1j * wavenumber * ahead)
    near = np.sum(waves * (ahead + 0.5j * wavenumber * across), axis=1)
    at = np.sqrt(1.0 - np.minimum(cosines**2, 1.0))
    return np.interp(at, sines, waves.sum(axis=1)), np.interp(at, sines, near)
