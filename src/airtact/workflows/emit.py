"""From a drive file to boards: what it takes, what it costs, and playing it. Prints nothing."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Complex128, Float64

from airtact.conventions import InvalidInput, about
from airtact.evaluation.thresholds import sound_pressure_level
from airtact.hardware.amplitudes import faded, largest_pressure_around, share_under_cap
from airtact.hardware.codecs import codec_of
from airtact.hardware.emission import Emission, Played
from airtact.hardware.link import Link
from airtact.hardware.links import link_to
from airtact.pose import Pose
from airtact.scene.medium import air
from airtact.synthesis.quantise import quantise, rounding_error
from airtact.synthesis.sequence import Sequence
from airtact.timing import Progress, no_progress
from airtact.transducers.boards import Board, board_named, boards_needed, poses_of_boards
from airtact.transducers.drive_file import DriveFile, read_drive_file
from airtact.transducers.element import DEFAULT_SENSITIVITY
from airtact.transducers.levels import Levels
from airtact.transfer import Drive, TransferMatrix
from airtact.validation import positive

FREQUENCY = 40e3
"""What all boards here play [Hz]."""

MOST_LOOKED_AT = 32
"""Number of frames of a sequence, the most powerful ones, that rounding and the level at a head are computed for."""


@dataclass(frozen=True, eq=False)
class Plan:
    """What would be emitted.

    Attributes
    ----------
    rounding : (F,) relative change of the pressure at each focus that the board's levels make, the worst over the
        most powerful frames; None without a transfer matrix in the file.
    head : largest level half a metre off the array [dB].
    cap : largest amplitude of an element, in per cent of full scale.
    """

    stored: DriveFile
    board: Board
    poses: tuple[Pose, ...]
    rounding: Float64[np.ndarray, "foci"] | None
    head: float
    cap: float

    def facts(self, link: str) -> list[tuple[str, str]]:
        """Put what would be emitted through a link into words, each fact by its name."""
        drives, board = self.stored.drives, self.board
        facts = [("boards", f"{len(self.poses)} {board.title}, {drives.shape[1]} transducers, through {link}")]
        if self.stored.rate is not None and len(drives) > 1:
            facts.append(("sequence", f"{len(drives)} frames at {self.stored.rate:g} frames/s"))
        levels = "on and off" if board.amplitudes == 2 else f"{board.amplitudes} amplitudes"
        facts.append(("levels", f"{levels}, {board.phases} phases"))
        if self.rounding is not None:
            worst = float(self.rounding[np.abs(self.rounding).argmax()])
            held = " at equal energy" if board.amplitudes == 2 else ""
            facts.append(("rounding", f"{worst:+.2%} at the focus that it changes most{held}"))
        largest = float(np.abs(drives).max())
        facts.append(("largest amplitude", f"{100 * largest:.3g} % of full scale, cap {self.cap:g} %"))
        facts.append(("at a head", f"up to {self.head:.0f} dB SPL, 0.5 m off the array in open air"))
        return facts


def plan(path: Path, board: str, cap: float = 100.0) -> Plan:
    """Read a drive, check that boards of a kind can play it, and find what rounding costs and the level at a head.

    ``cap`` is the largest amplitude of an element, in per cent of full scale.

    Raises
    ------
    InvalidInput
        If the file is no drive, its transducers are not laid out like boards of that kind, it is for another frequency,
        or the cap is not above 0 and at most 100.
    """
    kind = board_named(board)
    stored = read_drive_file(path)
    with about(path.name):
        stored.frame_rate()
        boards_needed(kind, stored.drives.shape[1])
        if stored.positions is None or stored.normals is None:
            raise InvalidInput(
                "the file holds 0 positions of transducers: save the drive with its array.", code="positions_missing"
            )
        if not stored.drives.any():
            raise InvalidInput(
                f"the drive is silent: all {stored.drives.size} amplitudes are 0, so nothing would be emitted.",
                code="drive_silent",
            )
        speed = _sound_speed(stored)
        poses = tuple(poses_of_boards(kind, stored.positions, stored.normals))
    levels = codec_of(kind).levels
    share = share_under_cap(stored.drives, levels, cap)
    strongest = stored.drives[np.argsort(-np.linalg.norm(stored.drives, axis=1), kind="stable")[:MOST_LOOKED_AT]]
    played = np.stack([faded(Drive(row), levels, share).drive().amplitudes for row in strongest])
    sensitivity = DEFAULT_SENSITIVITY if stored.sensitivity is None else stored.sensitivity
    around = largest_pressure_around(stored.positions, played, sensitivity, 2 * np.pi * FREQUENCY / speed)
    head = float(sound_pressure_level(np.array([around]))[0])
    return Plan(stored, kind, poses, _rounding(stored, strongest, levels), head, cap)


def _rounding(
    stored: DriveFile, drives: Complex128[np.ndarray, "frames elements"], levels: Levels
) -> Float64[np.ndarray, "foci"] | None:
    if stored.matrix is None or stored.matrix.shape[1] != drives.shape[1]:
        return None
    transfer = TransferMatrix(stored.matrix, np.nan, stored.foci)
    pairs = [(drive, quantise(drive, levels)) for drive in (Drive(row) for row in drives)]
    found = [rounding_error(transfer, drive, frame) for drive, frame in pairs if not frame.silent]
    if not found:
        return None
    changes = np.array(found)
    return changes[np.abs(changes).argmax(axis=0), np.arange(changes.shape[1])]


def _sound_speed(stored: DriveFile) -> float:
    """Return the speed of sound that the drive was made with, in air at 20 °C where the file does not hold it."""
    if stored.frequency is not None and abs(stored.frequency - FREQUENCY) > 1.0:
        raise InvalidInput(
            f"the drive is for {stored.frequency:g} Hz, and boards emit {FREQUENCY:g} Hz: make it for that.",
            code="wrong_frequency",
        )
    return (stored.medium or air()).sound_speed


def link_for(made: Plan, link: str, **settings: str | Path | None) -> Link:
    """Build the link to a plan's boards by its name; raise as ``link_to``."""
    return link_to(link, made.board.name, made.poses, _sound_speed(made.stored), **settings)


def emit(made: Plan, link: Link, seconds: float, report_step: Progress = no_progress) -> Played | None:
    """Play a plan for some time, then silence the boards; return what was played of a sequence, None for one drive.

    Raises
    ------
    InvalidInput
        If the link cannot be opened, or the boards cannot play the sequence; nothing was emitted then.
    LinkFailed
        If the link fails, with what was sent last.
    """
    seconds = positive(seconds, "how long to emit", "s")
    stored, played = made.stored, None
    if stored.rate is not None and len(stored.drives) > 1:
        link.check_sequence(len(stored.drives), stored.rate)
    report_step(f"opening the {link.name} link to {link.devices}")
    with Emission(link, cap=made.cap) as emission:
        report_step(f"emitting for {seconds:g} s")
        if stored.rate is not None and len(stored.drives) > 1:
            played = emission.play(Sequence(stored.drives, stored.rate), seconds)
        else:
            emission.send(Drive(stored.drives[0]))
            emission.hold(seconds)
        report_step("silencing")
    return played
