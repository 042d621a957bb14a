"""Emit a drive at a safe level: the cap that keeps a head under 110 dB, and the plan."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from airtact.acoustics.medium import air
from airtact.drives.drive import Drive
from airtact.drives.drive_file import DriveFile, read_drive_file
from airtact.drives.frame import frame_at, share_under_cap
from airtact.drives.head_level import MAX_HEAD_LEVEL, HeadLevel
from airtact.drives.sequence import Sequence
from airtact.drives.transfer import TransferMatrix, rounding_error
from airtact.emission.codecs import codec_of
from airtact.emission.emission import Emission, Played, frames_of_period
from airtact.emission.link import Link
from airtact.errors import InvalidInput, about
from airtact.evaluation.tactile_thresholds import CONSTANT_FORCE_NOTE, sensation
from airtact.geometry.pose import Pose
from airtact.timing import Progress, no_progress
from airtact.transducers.boards import Board, board_named, boards_needed, poses_of_boards
from airtact.transducers.element import DEFAULT_SENSITIVITY
from airtact.transducers.modulation import AmplitudeModulation

# Frequency that all boards play [Hz]
FREQUENCY = 40e3


@dataclass(frozen=True, eq=False)
class Plan:
    """What would be emitted.

    Attributes
    ----------
    stored : the drive or sequence.
    board, poses : kind of board, and the pose of each.
    modulation : how the amplitude of a drive varies; None for a sequence or a constant drive.
    rounding : (F,) relative change of the pressure at each focus by the board's levels, the worst
        over the most powerful frames; None without a transfer matrix in the file.
    peak, average : levels 0.5 m off the array [dB], of the strongest frame and over time.
    full : peak level at full scale [dB].
    focus : peak pressure at the weakest focus in its strongest frame [Pa]; None without a transfer
        matrix.
    cap : largest amplitude of an element, a share of full scale.
    limited : whether the cap was chosen so that the peak level is under the limit.
    """

    stored: DriveFile
    board: Board
    poses: tuple[Pose, ...]
    modulation: AmplitudeModulation | None
    rounding: Float64[np.ndarray, "foci"] | None
    peak: float
    average: float
    full: float
    focus: float | None
    cap: float
    limited: bool

    @property
    def sequence(self) -> bool:
        """Whether the file holds several frames."""
        return self.stored.rate is not None and len(self.stored.drives) > 1

    @property
    def constant(self) -> bool:
        """Whether the force does not vary."""
        return not self.sequence and self.modulation is None

    def facts(self, link: str) -> list[tuple[str, str]]:
        """Describe the emission through a link, each fact by its name."""
        drives = self.stored.drives
        board = self.board
        transducers = drives.shape[1]
        words = f"{len(self.poses)} {board.title}, {transducers} transducers, through {link}"
        facts = [("boards", words)]
        if self.sequence:
            facts.append(("sequence", f"{len(drives)} frames at {self.stored.rate:g} frames/s"))
        levels = "on and off" if board.amplitudes == 2 else f"{board.amplitudes} amplitudes"
        facts.append(("levels", f"{levels}, {board.phases} phases"))
        if self.rounding is not None:
            worst = float(self.rounding[np.abs(self.rounding).argmax()])
            held = " at equal energy" if board.amplitudes == 2 else ""
            facts.append(("rounding", f"{worst:+.2%} at the focus that it changes most{held}"))
        if self.modulation is not None:
            depth = f", {self.modulation.depth:g} deep" if self.modulation.depth < 1.0 else ""
            facts.append(("modulation", f"amplitude, {self.modulation.frequency:g} Hz{depth}"))
        largest = float(np.abs(drives).max())
        facts.append(("largest amplitude", f"{largest:.3g} of full scale, cap {self.cap:g}"))
        if self.focus is not None:
            facts.append(("weakest focus", f"{self.focus:,.0f} Pa, peak"))
        average = "" if self.constant else f", {self.average:.0f} dB on average"
        words = f"up to {self.peak:.0f} dB SPL{average}, 0.5 m off the array in open air"
        return [*facts, ("at a head", words)]

    def notes(self) -> list[str]:
        """Explain the level, and whether the drive is felt."""
        notes = []
        if self.limited:
            notes.append(
                f"The cap of {self.cap:g} keeps a head to {MAX_HEAD_LEVEL:g} dB; --full-scale "
                f"emits all, up to {self.full:.0f} dB there, and --cap another share."
            )
        if self.constant:
            notes.append(CONSTANT_FORCE_NOTE)
        if self.focus is not None and self.modulation is not None:
            notes.append(sensation(self.focus, "amplitude", self.modulation.depth))
        return notes


def plan(
    path: Path,
    board: str,
    cap: float | None = None,
    modulation: AmplitudeModulation | None = None,
    constant: bool = False,
) -> Plan:
    """Read a drive for boards of a kind, and find the level at a head and the cost of rounding.

    Parameters
    ----------
    path : file of a drive or a sequence.
    board : name of the kind of board.
    cap : largest amplitude of an element, a share of full scale. By default the one whose level at
        a head is at the limit, or full scale where the level is below it.
    modulation : replaces the file's.
    constant : whether the drive is played without the file's modulation.

    Raises
    ------
    InvalidInput
        If the file is no drive, its transducers are not laid out like such boards, it is for
        another frequency, the cap is not above 0 and at most 1, a modulation is given for a
        sequence, or boards that only switch their elements on and off cannot stay under the limit,
        or the cap silences all elements.
    """
    kind = board_named(board)
    stored = read_drive_file(path)
    with about(path.name):
        rate = stored.frame_rate()
        boards_needed(kind, stored.drives.shape[1])
        if stored.positions is None or stored.normals is None:
            raise InvalidInput(
                "the file has no positions of transducers: save the drive with its array.",
                code="data_missing",
            )
        if not stored.drives.any():
            raise InvalidInput(
                "the drive is silent: all amplitudes are 0, so nothing would be emitted.",
                code="all_zero",
            )
        if modulation is not None and rate is not None:
            raise InvalidInput(
                f"the file is a sequence of {len(stored.drives)} frames at {rate:g} frames/s, "
                "which is not modulated further: leave the modulation out.",
                code="options_clash",
            )
        poses = tuple(poses_of_boards(kind, stored.positions, stored.normals))
        modulation = (modulation or stored.modulation) if rate is None and not constant else None
        # The level is evaluated in open air around the array, as the head's position is not known.
        head = _head_level(stored, kind, modulation)
    limited = cap is None and head.full > MAX_HEAD_LEVEL
    if cap is None:
        cap = head.safe_cap()
    peak, average = head.at(cap)
    if not np.isfinite(peak):
        raise InvalidInput(
            f"at a cap of {cap:g} all elements round to level 0, so nothing would be emitted: give "
            "a larger cap.",
            code="all_zero",
        )
    rounding, focus = _at_foci(stored, head, cap)
    return Plan(
        stored=stored,
        board=kind,
        poses=poses,
        modulation=modulation,
        rounding=rounding,
        peak=peak,
        average=average,
        full=head.full,
        focus=focus,
        cap=cap,
        limited=limited,
    )


def safe_cap(stored: DriveFile, board: str) -> tuple[float, float]:
    """Return the largest cap that keeps a head under the limit, and the level at full scale [dB].

    Raise "out_of_range" for boards that cannot be turned down so far.
    """
    head = _head_level(stored, board_named(board), stored.modulation)
    return head.safe_cap(), head.full


def _head_level(
    stored: DriveFile, board: Board, modulation: AmplitudeModulation | None
) -> HeadLevel:
    assert stored.positions is not None
    factors = (1.0,)
    if modulation is not None:
        count, _ = frames_of_period(modulation.frequency, np.inf)
        factors = tuple(modulation.envelope(count).tolist())
    return HeadLevel(
        stored.drives,
        stored.positions,
        codec_of(board).levels,
        2 * np.pi * FREQUENCY / sound_speed_of(stored),
        DEFAULT_SENSITIVITY if stored.sensitivity is None else stored.sensitivity,
        factors,
    )


def _at_foci(
    stored: DriveFile, head: HeadLevel, cap: float
) -> tuple[Float64[np.ndarray, "foci"] | None, float | None]:
    """Return the worst change at each focus by rounding, and the weakest pressure [Pa]."""
    levels = head.levels
    drives = head.strongest
    if stored.matrix is None or stored.matrix.shape[1] != drives.shape[1]:
        return None, None
    transfer = TransferMatrix(stored.matrix, np.nan, stored.foci)
    share = share_under_cap(stored.drives, levels, cap)
    changes = []
    for row in drives:
        frame = frame_at(row, levels, share)
        if not frame.silent:
            exact = Drive(row if levels.phase_only else share * row)
            pressures = np.abs(transfer.pressure(exact))
            # A frame of a sequence is made for some of the foci; what it leaves at the others
            # may change by any factor.
            meant = pressures > 0.1 * pressures.max()
            changes.append(np.where(meant, rounding_error(transfer, exact, frame), 0.0))
    if not changes:
        return None, None
    changes = np.array(changes)
    worst = changes[np.abs(changes).argmax(axis=0), np.arange(changes.shape[1])]
    frames = [frame_at(row, levels, share).drive() for row in stored.drives]
    pressures = np.array([np.abs(transfer.pressure(drive)) for drive in frames])
    foci = len(stored.matrix) if stored.foci is None else len(stored.foci)
    return worst, float(pressures[:, :foci].max(axis=0).min())


def sound_speed_of(stored: DriveFile) -> float:
    """Return the speed of sound of a drive; that of air at 20 °C if the file has none."""
    if stored.frequency is not None and abs(stored.frequency - FREQUENCY) > 1.0:
        raise InvalidInput(
            f"the drive is for {stored.frequency:g} Hz, and boards emit {FREQUENCY:g} Hz: make it "
            "for that.",
            code="does_not_match",
        )
    return (stored.medium or air()).sound_speed


def duration(made: Plan, link: Link) -> float:
    """Return how long a plan is played by default [s].

    Boards play it for 2 s. A file gets one round of a sequence or one period of a modulation, which
    a player repeats.
    """
    stored = made.stored
    if link.real_time:
        return 2.0
    if made.sequence and stored.rate is not None:
        return len(stored.drives) / stored.rate
    if made.modulation is not None:
        count, rate = frames_of_period(made.modulation.frequency, link.fastest_frames)
        return count / rate
    return 0.0


def emit(
    made: Plan,
    link: Link,
    seconds: float,
    progress: Progress = no_progress,
    log: Path | None = None,
) -> Played | None:
    """Play a plan for some time, then silence the boards; None for a constant drive.

    Parameters
    ----------
    log : file that gets a line on each event, see ``Emission``.

    Raises
    ------
    InvalidInput
        If the link cannot be opened, or the boards cannot play the sequence; nothing was emitted
        then.
    LinkFailed
        If the link fails, with what was sent last.
    """
    stored = made.stored
    # Checked before the link is opened, so that nothing is emitted where the boards cannot play it.
    played = None
    if made.sequence and stored.rate is not None:
        link.check_sequence(len(stored.drives), stored.rate)
    if made.modulation is not None:
        frames_of_period(made.modulation.frequency, link.fastest_frames)
    progress(f"opening the {link.name} link to {link.devices}")
    with Emission(link, cap=made.cap, log=log) as emission:
        progress(f"emitting for {seconds:g} s")
        if made.sequence and stored.rate is not None:
            played = emission.play(Sequence(stored.drives, stored.rate), seconds)
        elif made.modulation is not None:
            played = emission.modulate(Drive(stored.drives[0]), seconds, made.modulation)
        else:
            emission.send(Drive(stored.drives[0]))
            emission.hold(seconds)
        progress("silencing")
    return played
