"""Sequences of drives, which make ultrasound perceptible; by itself it is too fast to be felt.

Skin feels changes of a few to a few hundred hertz. They come from varying the amplitude (amplitude
modulation), from moving a focus to and fro (lateral modulation; R. Takahashi, K. Hasegawa, H.
Shinoda, IEEE Trans. Haptics 13, 334, 2020) or from leading it along a path (spatiotemporal
modulation; W. Frier et al., EuroHaptics 2018).
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Complex128, Int64

from airtact.acoustics.scene import Scene
from airtact.acoustics.target import Target
from airtact.drives.drive import Amplitudes, Drive, check_drive
from airtact.drives.drive_file import save_drives
from airtact.drives.linear_methods import phase_conjugate
from airtact.drives.reach import check_foci
from airtact.drives.transfer import MakeDrive, TransferMatrix
from airtact.errors import InvalidInput, check_finite, complex_numbers, of_kind, positive
from airtact.printing import in_short
from airtact.transducers.layout import PhasedArray
from airtact.transducers.levels import EIGHT_BITS, FULL_SCALE, Levels
from airtact.transducers.modulation import DEFAULT_FREQUENCY, AmplitudeModulation

MIN_FRAMES = 4
"""Smallest number of frames in one period of a modulation."""


@dataclass(frozen=True, eq=False)
class Sequence:
    """Drives that are played one after another, repeatedly.

    Attributes
    ----------
    drives : (N, E) complex amplitudes of each frame, 1 at full scale.
    rate : frames a second [Hz].

    Raises
    ------
    InvalidInput
        If there is no frame, a number is not finite, a magnitude exceeds 1, or the rate is not
        above zero.
    """

    drives: Complex128[np.ndarray, "frames elements"]
    rate: float

    __repr__ = in_short

    def __post_init__(self) -> None:
        drives = complex_numbers(self.drives, "the drives of a sequence")
        if drives.ndim != 2 or drives.size == 0:
            raise InvalidInput(
                f"a sequence has the shape (frames, elements), not {drives.shape}.",
                code="wrong_shape",
            )
        check_finite(drives, "the drives of a sequence (frame, element)")
        largest = np.abs(drives).max(axis=1)
        if largest.max() > FULL_SCALE:
            raise InvalidInput(
                f"frame {int(largest.argmax())} of a sequence drives an element at "
                f"{largest.max():.4g} of full scale; divide the sequence by that.",
                code="over_full_scale",
            )
        drives.flags.writeable = False
        object.__setattr__(self, "drives", drives)
        object.__setattr__(self, "rate", positive(self.rate, "the rate of a sequence", "frames/s"))

    def __len__(self) -> int:
        return len(self.drives)

    @property
    def seconds(self) -> float:
        """Duration of all frames [s]."""
        return len(self.drives) / self.rate

    def drive(self, index: int) -> Drive:
        """Return one frame, counted from 0; raise ``InvalidInput`` if there is no such frame."""
        if not 0 <= index < len(self):
            raise InvalidInput(
                f"there is no frame {index}; the sequence has frames 0 to {len(self) - 1}.",
                code="out_of_range",
            )
        return Drive(self.drives[index])

    def pressure(self, transfer: TransferMatrix) -> Complex128[np.ndarray, "frames foci"]:
        """Return the pressure at each focus in every frame [Pa]."""
        of_kind(transfer, TransferMatrix, "the transfer matrix", "transfer_matrix(beacons, array)")
        transfer.check_fits(self.drive(0))
        return self.drives @ transfer.matrix.T

    def save(
        self,
        path: str | Path,
        array: PhasedArray | None = None,
        scene: Scene | None = None,
        transfer: TransferMatrix | None = None,
        target: Target | None = None,
        *,
        levels: Levels = EIGHT_BITS,
        texts: Mapping[str, str] | None = None,
    ) -> None:
        """Write all frames to a file, which ``load_drive`` reads and ``airtact emit`` sends.

        Parameters and errors are those of ``Drive.save``. A .csv has one line for each element in
        each frame, and its times give the rate where there are 2 frames or more.
        """
        save_drives(
            path,
            self.drives,
            self.rate,
            array=array,
            scene=scene,
            transfer=transfer,
            target=target,
            levels=levels,
            texts=texts,
        )


def amplitude_modulation(
    drive: Drive, frequency: float = DEFAULT_FREQUENCY, rate: float = 4000.0, depth: float = 1.0
) -> Sequence:
    """Vary the amplitude of a drive so that the force on the skin follows a cosine.

    The force varies between 1 and 1 − depth with no overtone, as ``AmplitudeModulation.envelope``
    has it. Boards need no such frames: ``Emission.modulate`` makes them at the rate of the board.

    Parameters
    ----------
    drive : at its largest amplitude.
    frequency : of the modulation [Hz]; fingers feel 200 Hz best.
    rate : frames a second, a whole number of times the frequency.
    depth : of the modulation of the force, above 0 to 1.

    Raises
    ------
    InvalidInput
        If the rate is no whole multiple of the frequency, or less than four times it, or the depth
        is outside 0 to 1.

    Examples
    --------
    >>> drive = Drive(np.ones(2, dtype=complex))
    >>> modulated = amplitude_modulation(drive, frequency=200.0, rate=800.0)
    >>> (np.abs(modulated.drives[:, 0]) ** 2).round(12).tolist()
    [1.0, 0.5, 0.0, 0.5]
    """
    check_drive(drive, "the drive")
    envelope = AmplitudeModulation(frequency, depth).envelope(_frames_of_period(frequency, rate))
    return Sequence(envelope[:, None] * drive.amplitudes, rate)


def spatiotemporal_modulation(
    transfer: TransferMatrix,
    target: Target,
    frequency: float = 100.0,
    rate: float = 4000.0,
    method: MakeDrive = phase_conjugate,
) -> Sequence:
    """Lead a focus along the points of a closed path, such as ``circle`` gives, once a period.

    Parameters
    ----------
    transfer : of all the points.
    target : points of the path in their order, one focus at a time.
    frequency : rounds a second [Hz].
    rate : frames a second, a whole number of times the frequency.
    method : makes the drive of each point from its row of the matrix.

    Raises
    ------
    InvalidInput
        As ``amplitude_modulation``, the target does not fit the matrix, it has 1 point, or a period
        has too few frames to stop at every point.
    """
    of_kind(target, Target, "the target", "Target(points, pressures)")
    points = len(target.points)
    if points < 2:
        raise InvalidInput(
            "spatiotemporal modulation leads a focus along points, and the target has one; give 2 "
            "or more.",
            code="too_few",
        )
    count = _frames_of_period(frequency, rate, minimum=points)
    chosen = points * np.arange(count, dtype=np.int64) // count
    return sequence_through(transfer, target, chosen[:, None], rate, method)


def sequence_through(
    transfer: TransferMatrix,
    target: Target,
    foci: Int64[np.ndarray, "frames foci"],
    rate: float,
    method: MakeDrive = phase_conjugate,
) -> Sequence:
    """Make the sequence that focuses on some points of a target in each frame.

    Each frame has the global phase that brings it nearest to the one before, so that steps between
    frames are small.

    Parameters
    ----------
    transfer : of all the points, and of the target's suppression points after them or not.
    target : the points and the pressures asked there.
    foci : (N, F) indices of the points of each frame.
    rate : frames a second.
    method : makes the drive of each frame.

    Raises
    ------
    InvalidInput
        If the target does not fit the matrix, or as the method.
    """
    check_foci(transfer, target)
    # Paths repeat positions; each set of foci is made once.
    made: dict[tuple[int, ...], Amplitudes] = {}
    frames = []
    before = None
    for indices in foci:
        key = tuple(indices.tolist())
        if key not in made:
            amplitudes = _frame_amplitudes(transfer, target, indices, method)
            # The first frame keeps its phase; each later one is turned towards the one before.
            if before is not None:
                turn = np.vdot(amplitudes, before)
                amplitudes = amplitudes * (turn / abs(turn) if abs(turn) > 0.0 else 1.0)
            # A silent frame has no phase to turn towards.
            if amplitudes.any():
                before = amplitudes
            made[key] = amplitudes
        frames.append(made[key])
    return Sequence(np.stack(frames), rate)


def _frame_amplitudes(
    transfer: TransferMatrix, target: Target, foci: Int64[np.ndarray, "foci"], method: MakeDrive
) -> Amplitudes:
    """Make the drive of one frame; a frame in which nothing is asked is silent."""
    weights = target.weights[foci]
    if not weights.any():
        return np.zeros(transfer.matrix.shape[1], dtype=np.complex128)
    phases = 1.0 if target.phases is None else np.exp(1j * target.phases[foci])
    # Shares also hold between frames: a frame of weaker foci is weaker as a whole.
    scale = 1.0
    asked = {}
    if target.shares is not None:
        scale = float(weights.max() / target.shares.max())
        asked = {"shares": weights * phases}
    elif target.pressures is not None:
        asked = {"pressures": weights * phases}
    suppressed = len(transfer.matrix) - len(target.points)
    frame_target = Target(
        target.points[foci], **asked, suppression_points=target.suppression_points[:suppressed]
    )
    rows = np.append(foci, np.arange(len(target.points), len(transfer.matrix)))
    # Without their positions the foci of one frame may be at one place.
    frame_transfer = replace(transfer.of_rows(rows), foci=None, wavelength=None)
    return scale * method(frame_transfer, frame_target).amplitudes


def _frames_of_period(frequency: float, rate: float, minimum: int = MIN_FRAMES) -> int:
    """Count the frames of a period, and check that the rate fits the frequency."""
    frequency = positive(frequency, "the frequency of the modulation", "Hz")
    rate = positive(rate, "the rate of a sequence", "frames/s")
    minimum = max(minimum, MIN_FRAMES)
    count = round(rate / frequency)
    if count < minimum:
        raise InvalidInput(
            f"{rate:g} frames/s give {rate / frequency:.3g} frames in a period of {frequency:g} "
            f"Hz, and {minimum} are needed: give {minimum * frequency:g} frames/s or more.",
            code="out_of_range",
        )
    if abs(count * frequency - rate) > 1e-6 * rate:
        raise InvalidInput(
            f"{rate:g} frames/s are no whole multiple of {frequency:g} Hz: the nearest is "
            f"{count * frequency:.7g}.",
            code="out_of_range",
        )
    return count
