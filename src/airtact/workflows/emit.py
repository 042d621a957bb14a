"""From a drive file to boards: what it takes, what it costs, and playing it. Prints nothing."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Complex128, Float64

from airtact.acoustics.medium import air
from airtact.checks import positive
from airtact.drives.drive import Drive
from airtact.drives.drive_file import SEQUENCE_FILE, DriveFile, read_drive_file
from airtact.drives.frame import Frame, share_under_cap
from airtact.drives.sequence import Sequence
from airtact.drives.transfer import TransferMatrix, rounding_error
from airtact.emission.amplitudes import faded, frames_of_period, modulated, pressures_around
from airtact.emission.codecs import Codec, codec_of
from airtact.emission.emission import Emission, Played
from airtact.emission.link import Link
from airtact.emission.links import link_to
from airtact.errors import InvalidInput, about
from airtact.evaluation.head_level import MAX_HEAD_LEVEL, sound_pressure_level
from airtact.evaluation.tactile_thresholds import CONSTANT_FORCE_NOTE, sensation
from airtact.geometry.pose import Pose
from airtact.timing import Progress, no_progress
from airtact.transducers.boards import Board, board_named, boards_needed, poses_of_boards
from airtact.transducers.element import DEFAULT_SENSITIVITY
from airtact.transducers.modulation import AmplitudeModulation

FREQUENCY = 40e3
"""What all boards here play [Hz]."""

MOST_LOOKED_AT = 32
"""Number of frames of a sequence, the most powerful ones, that rounding and the level at a head are computed for."""

TRIES = 10
"""How often a cap is lowered until the level is under the limit."""

FULL = 1.0
"""The cap at full scale."""


@dataclass(frozen=True, eq=False)
class Plan:
    """What would be emitted.

    Attributes
    ----------
    modulation : how the amplitude of a drive varies; None for a sequence or a constant drive.
    moving : the file beside a constant drive that holds its moving foci, if there is one.
    rounding : (F,) relative change of the pressure at each focus that the board's levels make, the
        worst over the most powerful frames; None without a transfer matrix in the file.
    peak, average : levels half a metre off the array [dB], of the strongest frame and over the
        time.
    full : the peak level at full scale [dB].
    focus : peak pressure at the weakest focus in its strongest frame [Pa]; None without a transfer
        matrix.
    cap : largest amplitude of an element, a share of full scale.
    limited : whether the cap was chosen so that the peak level is under the limit.
    """

    stored: DriveFile
    board: Board
    poses: tuple[Pose, ...]
    modulation: AmplitudeModulation | None
    moving: Path | None
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
        """Whether the force that is emitted does not vary."""
        return not self.sequence and self.modulation is None

    def facts(self, link: str) -> list[tuple[str, str]]:
        """Put what would be emitted through a link into words, each fact by its name."""
        drives, board = self.stored.drives, self.board
        facts = [
            (
                "boards",
                f"{len(self.poses)} {board.title}, {drives.shape[1]} transducers, through {link}",
            )
        ]
        if self.stored.rate is not None and len(drives) > 1:
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
        facts.append(
            ("at a head", f"up to {self.peak:.0f} dB SPL{average}, 0.5 m off the array in open air")
        )
        return facts

    def notes(self) -> list[str]:
        """Say why the level is what it is, and whether the drive is felt."""
        notes = []
        if self.limited:
            notes.append(
                f"The cap of {self.cap:g} keeps a head to {MAX_HEAD_LEVEL:g} dB; --full-scale emits all, up to "
                f"{self.full:.0f} dB there, and --cap another share."
            )
        if self.moving is not None:
            notes.append(
                f"These foci stand still: the moving ones are in {self.moving}; emit that."
            )
        elif self.constant:
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
    """Read a drive, check that boards of a kind can play it, and find what rounding costs and the level at a head.

    Parameters
    ----------
    path : the file of a drive or a sequence.
    board : name of the kind of board.
    cap : largest amplitude of an element, a share of full scale. None chooses the one whose level
        at a head is at the limit, or full scale where the level is below it.
    modulation : in place of the file's.
    constant : whether the drive is played without the file's modulation.

    Raises
    ------
    InvalidInput
        If the file is no drive, its transducers are not laid out like boards of that kind, it is for another frequency,
        the cap is not above 0 and at most 1, a modulation is given for a sequence, or boards that only switch their
        elements on and off cannot stay under the limit, or the cap silences all elements.
    """
    kind = board_named(board)
    stored = read_drive_file(path)
    with about(path.name):
        rate = stored.frame_rate()
        boards_needed(kind, stored.drives.shape[1])
        if stored.positions is None or stored.normals is None:
            raise InvalidInput(
                "the file holds 0 positions of transducers: save the drive with its array.",
                code="data_missing",
            )
        if not stored.drives.any():
            raise InvalidInput(
                f"the drive is silent: all {stored.drives.size} amplitudes are 0, so nothing would be emitted.",
                code="all_zero",
            )
        if modulation is not None and rate is not None:
            raise InvalidInput(
                f"a modulation goes with a drive, and the file holds {len(stored.drives)} frames at {rate:g} frames/s, "
                "which are modulated by themselves: leave it out.",
                code="options_clash",
            )
        speed = _sound_speed(stored)
        poses = tuple(poses_of_boards(kind, stored.positions, stored.normals))
    chosen = None if constant or rate is not None else modulation or stored.modulation
    head = _Head(stored, codec_of(kind), chosen, 2 * np.pi * FREQUENCY / speed)
    full, *_ = head.levels(FULL)
    limited = cap is None and full > MAX_HEAD_LEVEL
    share = head.cap_under_limit(full, kind) if limited else FULL if cap is None else cap
    peak, average = head.levels(share)
    _check_emits(peak, share, stored)
    still = chosen is None and rate is None
    beside = path.with_name(SEQUENCE_FILE)
    moving = beside if still and not constant and beside.is_file() else None
    rounding, focus = head.at_foci(share)
    return Plan(
        stored, kind, poses, chosen, moving, rounding, peak, average, full, focus, share, limited
    )


def _check_emits(peak: float, share: float, stored: DriveFile) -> None:
    if not np.isfinite(peak):
        raise InvalidInput(
            f"at a cap of {share:g} all {stored.drives.shape[1]} elements round to level 0, so nothing would be "
            "emitted: give a larger cap.",
            code="all_zero",
        )


def safe_cap(stored: DriveFile, board: str) -> tuple[float, float]:
    """Return the largest cap on a drive that keeps a head under the limit, and the peak level at full scale [dB].

    Raise "out_of_range" for boards that cannot be turned down so far.
    """
    kind = board_named(board)
    head = _Head(
        stored, codec_of(kind), stored.modulation, 2 * np.pi * FREQUENCY / _sound_speed(stored)
    )
    full, *_ = head.levels(FULL)
    return head.cap_under_limit(full, kind) if full > MAX_HEAD_LEVEL else FULL, full


@dataclass(frozen=True, eq=False)
class _Head:
    """The level that frames make around an array, by the cap on their amplitudes."""

    stored: DriveFile
    codec: Codec
    modulation: AmplitudeModulation | None
    wavenumber: float

    @property
    def strongest(self) -> Complex128[np.ndarray, "frames elements"]:
        drives = self.stored.drives
        return drives[np.argsort(-np.linalg.norm(drives, axis=1), kind="stable")[:MOST_LOOKED_AT]]

    def frames(self, cap: float) -> list[Frame]:
        """Return the frames that are played, of a sequence the most powerful ones."""
        levels = self.codec.levels
        share = share_under_cap(self.stored.drives, levels, cap)
        if self.modulation is not None:
            return modulated(Drive(self.stored.drives[0]), self.modulation, levels, np.inf, share)[
                0
            ]
        return [faded(Drive(row), levels, share) for row in self.strongest]

    def levels(self, cap: float) -> tuple[float, float]:
        """Return the peak and the average level [dB]."""
        played = np.stack([frame.drive().amplitudes for frame in self.frames(cap)])
        sensitivity = (
            DEFAULT_SENSITIVITY if self.stored.sensitivity is None else self.stored.sensitivity
        )
        assert self.stored.positions is not None
        found = pressures_around(self.stored.positions, played, sensitivity, self.wavenumber)
        peak, average = sound_pressure_level(np.array(found))
        return float(peak), float(average)

    def cap_under_limit(self, full: float, board: Board) -> float:
        """Return the largest cap whose peak level is under the limit, or ask for a level."""
        cap = min(1.0, float(np.abs(self.stored.drives).max())) * 10.0 ** (
            (MAX_HEAD_LEVEL - full) / 20.0
        )
        if not self.codec.levels.phase_only:
            for _ in range(TRIES):  # rounding to levels may add to the level
                cap = float(f"{0.9 * cap:.2g}")
                peak, _ = self.levels(cap)
                if np.isfinite(peak) and peak <= MAX_HEAD_LEVEL:
                    return cap
        raise InvalidInput(
            f"{board.title} boards cannot be turned down to {MAX_HEAD_LEVEL:g} dB at a head 0.5 m off the array, "
            f"and at full scale it gets up to {full:.0f} dB: give --full-scale, or a share such as --cap 0.3.",
            code="out_of_range",
        )

    def at_foci(self, cap: float) -> tuple[Float64[np.ndarray, "foci"] | None, float | None]:
        """Return the worst relative change at each focus by rounding, and the pressure at the weakest focus [Pa]."""
        stored, levels = self.stored, self.codec.levels
        drives = self.strongest
        if stored.matrix is None or stored.matrix.shape[1] != drives.shape[1]:
            return None, None
        transfer = TransferMatrix(stored.matrix, np.nan, stored.foci)
        share = share_under_cap(stored.drives, levels, cap)
        pairs = [
            (Drive(row if levels.phase_only else share * row), faded(Drive(row), levels, share))
            for row in drives
        ]
        pairs = [(drive, frame) for drive, frame in pairs if not frame.silent]
        if not pairs:
            return None, None
        changes = np.array([rounding_error(transfer, drive, frame) for drive, frame in pairs])
        frames = [faded(Drive(row), levels, share).drive() for row in stored.drives]
        pressures = np.array([np.abs(transfer.pressure(drive)) for drive in frames])
        foci = len(stored.matrix) if stored.foci is None else len(stored.foci)
        worst = changes[np.abs(changes).argmax(axis=0), np.arange(changes.shape[1])]
        return worst, float(pressures[:, :foci].max(axis=0).min())


def _sound_speed(stored: DriveFile) -> float:
    """Return the speed of sound that the drive was made with, in air at 20 °C where the file does not hold it."""
    if stored.frequency is not None and abs(stored.frequency - FREQUENCY) > 1.0:
        raise InvalidInput(
            f"the drive is for {stored.frequency:g} Hz, and boards emit {FREQUENCY:g} Hz: make it for that.",
            code="does_not_match",
        )
    return (stored.medium or air()).sound_speed


def link_for(made: Plan, link: str, **settings: str | Path | None) -> Link:
    """Build the link to a plan's boards by its name; raise as ``link_to``."""
    return link_to(link, made.board.name, made.poses, _sound_speed(made.stored), **settings)


def emit(
    made: Plan,
    link: Link,
    seconds: float,
    report_step: Progress = no_progress,
    log: Path | None = None,
) -> Played | None:
    """Play a plan for some time, then silence the boards; return what was played, None for one constant drive.

    Each event is a line of the log, if one is given; ``Emission`` has what it holds.

    Raises
    ------
    InvalidInput
        If the link cannot be opened, or the boards cannot play the sequence; nothing was emitted then.
    LinkFailed
        If the link fails, with what was sent last.
    """
    seconds = positive(seconds, "how long to emit", "s")
    stored, played = made.stored, None
    if made.sequence and stored.rate is not None:
        link.check_sequence(len(stored.drives), stored.rate)
    if made.modulation is not None:
        frames_of_period(made.modulation.frequency, link.fastest_frames)
    report_step(f"opening the {link.name} link to {link.devices}")
    with Emission(link, cap=made.cap, log=log) as emission:
        report_step(f"emitting for {seconds:g} s")
        if made.sequence and stored.rate is not None:
            played = emission.play(Sequence(stored.drives, stored.rate), seconds)
        elif made.modulation is not None:
            played = emission.modulate(Drive(stored.drives[0]), seconds, made.modulation)
        else:
            emission.send(Drive(stored.drives[0]))
            emission.hold(seconds)
        report_step("silencing")
    return played
