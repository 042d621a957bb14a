"""Plans for emitting a drive at a safe level, by limiting the amplitude of all elements."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Complex128

import airtact as at
from airtact.acoustics.medium import air
from airtact.acoustics.target import Target
from airtact.drives.drive import Drive
from airtact.drives.drive_file import DriveFile, read_drive_file
from airtact.drives.frame import frame_at, share_under_cap
from airtact.drives.head_level import MAX_HEAD_LEVEL, HeadLevel
from airtact.drives.sequence import Sequence
from airtact.drives.transfer import TransferMatrix
from airtact.emission.codecs import codec_of
from airtact.emission.emission import Emission, Played, frames_of_period
from airtact.emission.frame_file import write_frames
from airtact.emission.link import Link
from airtact.errors import InvalidInput, about
from airtact.evaluation.metrics import (
    constant_force_note,
    level_above_threshold,
    pascals,
    sensation,
)
from airtact.geometry.pose import Pose
from airtact.timing import Progress, no_progress
from airtact.transducers.boards import (
    Board,
    board_named,
    boards_needed,
    kind_of_array,
    poses_of_boards,
)
from airtact.transducers.element import DEFAULT_SENSITIVITY
from airtact.transducers.levels import AmplitudeModulation

# Frequency emitted by all boards [Hz]
FREQUENCY = 40e3


@dataclass(frozen=True, eq=False)
class Plan:
    """A drive or sequence for boards of one kind, with the level at which it is emitted.

    Attributes
    ----------
    stored : contents of the file with the drive or sequence.
    board : kind of board that emits the drive or sequence.
    modulation : amplitude modulation of a drive; None for a sequence or a constant
        drive.
    cap : largest amplitude of an element, as a fraction of full scale.
    limited : whether ``cap`` was chosen so that the level at a head stays below ``MAX_HEAD_LEVEL``.
    """

    stored: DriveFile
    board: Board
    modulation: AmplitudeModulation | None
    cap: float = 1.0
    limited: bool = False

    @property
    def poses(self) -> tuple[Pose, ...]:
        """Pose of each board."""
        stored = self.stored
        assert stored.positions is not None
        assert stored.normals is not None
        return tuple(poses_of_boards(self.board, stored.positions, stored.normals))

    @property
    def rate(self) -> float | None:
        """Frames per second of a sequence; None for a drive."""
        return self.stored.rate if len(self.stored.drives) > 1 else None

    @property
    def constant(self) -> bool:
        """Whether the drive is emitted without modulation."""
        return self.rate is None and self.modulation is None

    @cached_property
    def head(self) -> HeadLevel:
        """Sound pressure level at a head 0.5 m from the array, in the loudest direction."""
        stored = self.stored
        assert stored.positions is not None
        factors = (1.0,)
        if self.modulation is not None:
            count, _ = frames_of_period(self.modulation.frequency, np.inf)
            factors = tuple(self.modulation.envelope(count).tolist())
        return HeadLevel(
            stored.drives,
            stored.positions,
            codec_of(self.board).levels,
            2 * np.pi * FREQUENCY / sound_speed_of(stored),
            DEFAULT_SENSITIVITY if stored.sensitivity is None else stored.sensitivity,
            factors,
        )

    @cached_property
    def emitted(self) -> Complex128[np.ndarray, "frames elements"]:
        """(N, E) emitted amplitudes of the elements: limited by the cap, and rounded to levels."""
        levels = codec_of(self.board).levels
        drives = self.stored.drives
        share = share_under_cap(drives, levels, self.cap)
        return np.stack([frame_at(row, levels, share).drive().amplitudes for row in drives])

    @cached_property
    def weakest(self) -> float | None:
        """Peak pressure at the weakest focus [Pa]; None if the file has no transfer matrix."""
        stored = self.stored
        matrix = stored.transfer_matrix
        if matrix is None or matrix.shape[1] != stored.drives.shape[1]:
            return None
        foci = len(matrix) if stored.foci is None else len(stored.foci)
        # In a sequence, each focus only counts in the frame that was computed for it.
        pressures = np.abs(matrix[:foci] @ self.emitted.T).max(axis=1)
        if stored.foci is not None and stored.wanted_pressures is not None:
            target = Target(stored.foci, stored.wanted_pressures)
            return float(pressures[target.weakest(pressures)])
        # The file contains no shares, but foci with a share of 0 are silent before rounding.
        exact = np.abs(matrix[:foci] @ stored.drives.T).max(axis=1)
        return float(pressures[exact >= 1e-3 * exact.max()].min())

    def facts(self, link: str) -> list[tuple[str, str]]:
        """Return pairs of name and text that describe the emission through a link."""
        drives = self.stored.drives
        board = self.board
        facts = [
            (
                "boards",
                f"{len(self.poses)} {board.title}, {drives.shape[1]} transducers, through {link}",
            )
        ]
        if self.rate is not None:
            facts.append(("sequence", f"{len(drives)} frames at {self.rate:g} frames/s"))
        levels = "on and off" if board.amplitudes == 2 else f"{board.amplitudes} amplitudes"
        facts.append(("levels", f"{levels}, {board.phases} phases"))
        if self.modulation is not None:
            depth = f", {self.modulation.depth:g} deep" if self.modulation.depth < 1.0 else ""
            facts.append(("modulation", f"amplitude, {self.modulation.frequency:g} Hz{depth}"))
        words = f"{np.abs(self.emitted).max():.3g} of full scale, cap {self.cap:g}"
        if board.amplitudes == 2:
            # Their cap is a fraction of the elements.
            words += f" ({np.count_nonzero(self.emitted[0])} of {drives.shape[1]} transducers on)"
        facts.append(("largest amplitude", words))
        if self.weakest is not None:
            # The file does not contain the bodies, which the estimate for real air needs. One
            # board loses 1 % at 1 kPa.
            limit = ", without nonlinear steepening" if self.weakest > 1e3 else ""
            facts.append(("weakest focus", f"{self.weakest:,.0f} Pa, peak{limit}"))
        peak, average = self.head.at(self.cap)
        mean = "" if self.constant else f", {average:.0f} dB on average"
        return [
            *facts,
            ("at a head", f"up to {peak:.0f} dB SPL{mean}, 0.5 m from the array in open air"),
        ]

    def notes(self) -> list[str]:
        """Sentences about the level, and about whether the drive can be felt."""
        notes = []
        if self.limited:
            notes.append(
                f"The cap of {self.cap:g} limits the level at a head to {MAX_HEAD_LEVEL:g} dB. "
                f"--full-scale emits up to {self.head.full:.0f} dB; --cap sets another limit."
            )
        if self.constant:
            notes.append(
                constant_force_note(codec_of(self.board).fastest_frames(len(self.poses)) / 2.0)
            )
        if self.weakest is not None and self.modulation is not None:
            notes.append(sensation(self.weakest, "amplitude", self.modulation.depth))
            if self.weakest > 1e3:
                notes.append("This level ignores nonlinear steepening, which lowers it.")
        return notes


def plan(
    path: Path,
    board: str,
    cap: float | None = None,
    modulation: AmplitudeModulation | None = None,
    constant: bool = False,
) -> Plan:
    """Read a drive for boards of one kind, and choose the cap on its amplitudes.

    Parameters
    ----------
    path : file with a drive or a sequence.
    board : name of the kind of board.
    cap : largest amplitude of an element, as a fraction of full scale. By default, the largest cap
        that keeps the level at a head below ``MAX_HEAD_LEVEL``.
    modulation : modulation to use instead of the one in the file.
    constant : whether to play the drive without any modulation.

    Raises
    ------
    InvalidInput
        If the file contains no drive for such boards, a modulation is given for a sequence, the cap
        is not in the interval (0, 1], the cap silences all elements, or the boards cannot play the
        frame rate. Without a cap, the error is
        also raised if the boards can only switch elements on and off, and the level at full scale
        exceeds ``MAX_HEAD_LEVEL``.
    """
    kind = board_named(board)
    stored = read_drive_file(path)
    with about(path.name):
        rate = stored.frame_rate()
        boards = boards_needed(kind, stored.drives.shape[1])
        if stored.positions is None or stored.normals is None:
            raise InvalidInput(
                "the file contains no positions of transducers: save the drive again, together "
                "with the array.",
                code="data_missing",
            )
        if not stored.drives.any():
            raise InvalidInput(
                "all amplitudes of the drive are 0, so nothing would be emitted: use another file.",
                code="all_zero",
            )
        if modulation is not None and rate is not None:
            raise InvalidInput(
                f"the file contains a sequence of {len(stored.drives)} frames at {rate:g} "
                "frames/s, which cannot also be modulated: omit the modulation.",
                code="options_clash",
            )
        modulation = (modulation or stored.modulation) if rate is None and not constant else None
        # Whatever the link, the boards cannot play more frames than their line carries.
        codec = codec_of(kind)
        if modulation is not None:
            frames_of_period(modulation.frequency, codec.fastest_frames(boards))
        elif rate is not None:
            codec.check_rate(len(stored.drives), rate, boards)
        made = Plan(stored, kind, modulation)
        head = made.head
        made.poses  # noqa: B018 (raises if the transducers are not those of such boards)
    chosen = head.safe_cap() if cap is None else cap
    if not np.isfinite(head.at(chosen)[0]):
        raise InvalidInput(
            f"at a cap of {chosen:g}, the amplitudes of all elements are rounded to 0, so nothing "
            "would be emitted: use a larger cap.",
            code="all_zero",
        )
    return replace(made, cap=chosen, limited=cap is None and chosen < 1.0)


def default_level(
    setup: "at.Setup", drive: Drive, transfer: TransferMatrix, moving: "at.setup.MovingDrive | None"
) -> Iterator[str]:
    """State the default pressure of ``airtact emit`` if that command limits the drive.

    Parameters
    ----------
    setup, drive, transfer : the setup, its drive, and the transfer matrix of the drive.
    moving : sequence that is emitted instead of the drive; None if the foci do not move.
    """
    array = setup.array
    made = kind_of_array(array.positions, array.normals)
    if made is None or abs(setup.frequency - FREQUENCY) > 1.0:
        return
    target = setup.target if moving is None else moving.target
    stored = DriveFile(
        drive.amplitudes[None] if moving is None else moving.sequence.drives,
        rate=None if moving is None else moving.sequence.rate,
        medium=setup.medium,
        positions=array.positions,
        normals=array.normals,
        sensitivity=array.element.sensitivity,
        foci=target.points,
        wanted_pressures=target.pressures,
        transfer_matrix=(transfer if moving is None else moving.transfer).matrix,
    )
    modulation = setup.modulation if isinstance(setup.modulation, AmplitudeModulation) else None
    plan = Plan(stored, made[0], modulation)
    try:
        limited = replace(plan, cap=plan.head.safe_cap())
    except InvalidInput:
        yield (
            f"airtact emit requires --cap or --full-scale, because these boards produce up to "
            f"{plan.head.full:.0f} dB at a head 0.5 m away and cannot be turned down."
        )
        return
    if limited.cap < 1.0 and limited.weakest is not None:
        level = (
            level_above_threshold(limited.weakest, "spatiotemporal")
            if modulation is None
            else level_above_threshold(limited.weakest, "amplitude", modulation.depth)
        )
        yield (
            f"By default, airtact emit limits the level at a head to {MAX_HEAD_LEVEL:g} dB and "
            f"plays only {pascals(limited.weakest)} at the weakest focus, {level} this threshold; "
            "--full-scale plays the pressures above."
        )


def safe_cap(stored: DriveFile, board: str) -> tuple[float, float]:
    """Return a safe cap on the amplitudes, and the level [dB] at a head at full scale.

    With this cap, the level at a head 0.5 m away is at most ``MAX_HEAD_LEVEL``. The function raises
    ``InvalidInput`` if the boards cannot reduce the level to this limit.
    """
    head = Plan(stored, board_named(board), stored.modulation).head
    return head.safe_cap(), head.full


def sound_speed_of(stored: DriveFile) -> float:
    """Return the speed of sound [m/s] for a drive, by default that of air at 20 °C."""
    if stored.frequency is not None and abs(stored.frequency - FREQUENCY) > 1.0:
        raise InvalidInput(
            f"the drive is for {stored.frequency:g} Hz, but the boards emit {FREQUENCY:g} Hz: "
            "compute the drive again for the frequency of the boards.",
            code="does_not_match",
        )
    return (stored.medium or air()).sound_speed


def write(made: Plan, file: Path, seconds: float | None) -> tuple[int, float | None]:
    """Write the frames of a plan to a file; return their number and their rate [frames/s].

    ``seconds`` is the duration; None stands for one repetition (see ``write_frames``).
    """
    drives = made.stored.drives
    sound = Drive(drives[0]) if made.rate is None else Sequence(drives, made.rate)
    return write_frames(
        file, sound, made.board.name, modulation=made.modulation, seconds=seconds, cap=made.cap
    )


def emit(
    made: Plan,
    link: Link,
    seconds: float,
    progress: Progress = no_progress,
    log: Path | None = None,
) -> Played | None:
    """Play a plan for a number of seconds, then silence the boards.

    Parameters
    ----------
    log : file to which a line is written for each event; see ``Emission``.

    Returns
    -------
    Statistics of the playback; None for a constant drive.

    Raises
    ------
    InvalidInput
        If the link cannot be opened, or the boards cannot play the sequence. In both cases,
        nothing has been emitted.
    LinkFailed
        If the link fails; the message states what was sent last.
    """
    stored = made.stored
    # Check before opening the link, so that nothing is emitted if the boards cannot play it.
    played = None
    if made.rate is not None:
        link.check_sequence(len(stored.drives), made.rate)
    progress(f"opening the {link.name} link to {link.devices}")
    with Emission(link, cap=made.cap, log=log) as emission:
        progress(f"emitting for {seconds:g} s")
        if made.rate is not None:
            played = emission.play(Sequence(stored.drives, made.rate), seconds)
        elif made.modulation is not None:
            played = emission.modulate(Drive(stored.drives[0]), seconds, made.modulation)
        else:
            emission.send(Drive(stored.drives[0]))
            emission.hold(seconds)
        progress("silencing")
    return played
