"""Sequences of drives: modulation makes ultrasound perceptible, which is too fast to be felt by itself.

Skin feels changes of a few to a few hundred hertz. They come from varying the amplitude (amplitude
modulation), from moving a focus to and fro (lateral modulation; R. Takahashi, K. Hasegawa, H.
Shinoda, IEEE Trans. Haptics 13, 334, 2020) or from leading it along a path (spatiotemporal
modulation; W. Frier et al., EuroHaptics 2018).
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Complex128, Float64, Int64

from airtact.acoustics.scene import Scene
from airtact.acoustics.target import Target
from airtact.checks import check_finite, complex_numbers, counted, of_kind, positive
from airtact.drives.drive import Drive, check_drive
from airtact.drives.drive_file import save_drives
from airtact.drives.linear_methods import phase_conjugate
from airtact.drives.methods import MakeDrive
from airtact.drives.reach import check_foci
from airtact.drives.transfer import TransferMatrix
from airtact.errors import InvalidInput
from airtact.printing import in_short
from airtact.transducers.layout import PhasedArray
from airtact.transducers.levels import EIGHT_BITS, FULL_SCALE, Levels
from airtact.transducers.modulation import FREQUENCY, AmplitudeModulation

FEWEST = 4
"""Frames that one period of a modulation takes at least."""

Amplitudes = Complex128[np.ndarray, "elements"]


@dataclass(frozen=True, eq=False)
class Sequence:
    """Drives that are played one after another, and again from the first.

    Attributes
    ----------
    drives : (N, E) complex amplitudes of each frame, 1 at full scale.
    rate : frames a second [Hz].

    Raises
    ------
    InvalidInput
        If there is no frame, a number is not finite, a magnitude passes 1 (in which frame), or the rate is not above
        zero.
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
                f"frame {int(largest.argmax())} of a sequence drives an element at {largest.max():.4g} of full scale; "
                "divide the sequence by that.",
                code="over_full_scale",
            )
        drives.flags.writeable = False
        object.__setattr__(self, "drives", drives)
        object.__setattr__(self, "rate", positive(self.rate, "the rate of a sequence", "frames/s"))

    def __len__(self) -> int:
        return len(self.drives)

    @property
    def seconds(self) -> float:
        """How long it takes until it begins again [s]."""
        return len(self.drives) / self.rate

    def drive(self, index: int) -> Drive:
        """Return one frame, counted from 0; raises ``InvalidInput`` if there is no such frame."""
        if not 0 <= index < len(self):
            raise InvalidInput(
                f"there is no frame {index}; the sequence has frames 0 to {len(self) - 1}.",
                code="out_of_range",
            )
        return Drive(self.drives[index])

    def pressure(self, transfer: TransferMatrix) -> Complex128[np.ndarray, "frames foci"]:
        """Pressure at each focus in every frame [Pa]; raises ``InvalidInput`` if the elements differ in number."""
        of_kind(transfer, TransferMatrix, "the transfer matrix", "transfer_matrix(beacons, array)")
        if self.drives.shape[1] != transfer.matrix.shape[1]:
            raise InvalidInput(
                f"a sequence for {counted(self.drives.shape[1], 'element', 'elements')} does not fit a transfer matrix "
                f"of {counted(transfer.matrix.shape[1], 'element', 'elements')}.",
                code="sizes_differ",
            )
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
        """Write all frames to a file, which ``load_drive`` reads and ``airtact emit`` sends to boards.

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

    @property
    def slew(self) -> Float64[np.ndarray, "frames"]:
        """(N,) largest change |Δd| of an element from each frame to the next, the last to the first: 0 to 2.

        Steps of the amplitude make audible noise, and boards that smooth their output lag behind
        large ones.
        """
        return np.abs(np.roll(self.drives, -1, axis=0) - self.drives).max(axis=1)


def amplitude_modulation(
    drive: Drive, frequency: float = FREQUENCY, rate: float = 4000.0, depth: float = 1.0
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
        If the rate is no whole multiple of the frequency, or less than four times it (the nearest that is), or the
        depth is outside 0 to 1.

    Examples
    --------
    >>> modulated = amplitude_modulation(Drive(np.ones(2, dtype=complex)), frequency=200.0, rate=800.0)
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
    count = _frames_of_period(frequency, rate, least=points)
    chosen = points * np.arange(count, dtype=np.int64) // count
    return sequence_through(transfer, target, chosen[:, None], rate, method)


def sequence_through(
    transfer: TransferMatrix,
    target: Target,
    places: Int64[np.ndarray, "frames foci"],
    rate: float,
    method: MakeDrive = phase_conjugate,
) -> Sequence:
    """Focus on some points of a target after others, on those of each row at the same time.

    Each frame has the global phase that brings it nearest to the one before, so that steps between
    frames are small.

    Parameters
    ----------
    transfer : of all the points, and of the target's suppression points after them or not.
    target : the points, with what each asks.
    places : (N, F) indices of the points of each frame.
    rate : frames a second.
    method : makes the drive of each frame.

    Raises
    ------
    InvalidInput
        If the target does not fit the matrix, or as the method.
    """
    check_foci(transfer, target)
    _, first = np.unique(places, axis=0, return_index=True)
    made: dict[tuple[int, ...], Amplitudes] = {}
    before = None
    for index in np.sort(first):
        drive = _frame(transfer, target, places[index], method)
        if before is not None:
            turn = np.vdot(drive, before)
            drive = drive * (turn / abs(turn) if abs(turn) > 0.0 else 1.0)
        before = drive if drive.any() else before
        made[tuple(places[index].tolist())] = drive
    return Sequence(np.stack([made[tuple(row)] for row in places.tolist()]), rate)


def _frame(
    transfer: TransferMatrix, target: Target, chosen: Int64[np.ndarray, "foci"], method: MakeDrive
) -> Amplitudes:
    """Make the drive of one frame; a frame of which nothing is asked is silent."""
    phases = 1.0 if target.phases is None else np.exp(1j * target.phases[chosen])
    weights = target.weights[chosen]
    if not weights.any():
        return np.zeros(transfer.matrix.shape[1], dtype=np.complex128)
    given = (
        {}
        if target.pressures is None and target.shares is None
        else {"pressures": weights * phases}
    )
    share = 1.0
    if target.shares is not None:
        given, share = {"shares": weights * phases}, float(weights.max() / target.shares.max())
    suppressed = transfer.matrix[len(target.points) :]
    alone = Target(
        target.points[chosen],
        **given,
        suppression_points=target.suppression_points[: len(suppressed)],
    )
    rows = np.append(chosen, np.arange(len(target.points), len(transfer.matrix)))
    return (
        share
        * method(replace(transfer.of_rows(rows), foci=None, wavelength=None), alone).amplitudes
    )


def _frames_of_period(frequency: float, rate: float, least: int = FEWEST) -> int:
    """Count the frames of a period, and check that the rate fits the frequency."""
    frequency = positive(frequency, "the frequency of the modulation", "Hz")
    rate = positive(rate, "the rate of a sequence", "frames/s")
    least = max(least, FEWEST)
    count = round(rate / frequency)
    if count < least:
        raise InvalidInput(
            f"{rate:g} frames/s give {rate / frequency:.3g} frames a period of {frequency:g} Hz, and {least} are "
            f"needed: give {least * frequency:g} frames/s or more.",
            code="out_of_range",
        )
    if abs(count * frequency - rate) > 1e-6 * rate:
        raise InvalidInput(
            f"{rate:g} frames/s are no whole multiple of {frequency:g} Hz: the nearest is {count * frequency:.7g}.",
            code="out_of_range",
        )
    return count
