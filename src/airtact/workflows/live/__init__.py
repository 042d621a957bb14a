"""The sound follows a hand: a scene file, frames from somewhere, boards or none. Prints nothing."""

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

from airtact.drives.amplitudes import check_cap
from airtact.drives.transfer import focus_by_distance
from airtact.emission.links import link_to
from airtact.errors import InvalidInput
from airtact.evaluation.thresholds import OCCUPATIONAL_LIMIT
from airtact.hands.tracking.recordings import load_recording
from airtact.live.clock import checked_latency
from airtact.live.drives.maker import HandAware
from airtact.live.loop import Followed, Status, follow
from airtact.live.output import Boards, Nowhere, Output
from airtact.live.page.process import PageProcess
from airtact.live.parts import Controls, LiveScene, MovingFoci
from airtact.live.scene import live_scene
from airtact.live.session import FILE, SessionWriter, recording_of
from airtact.live.sources import (
    HandSource,
    PageHands,
    ReceivedHands,
    RecordedHands,
    checked_seconds,
    moved_to,
)
from airtact.setup.building import Setup, read_scene
from airtact.setup.examples import example
from airtact.timing import Progress, no_progress
from airtact.transducers.drive_file import DriveFile
from airtact.workflows.emit import FULL, safe_cap

MOTION = "reaching.jsonl"
"""The motion that is followed unless another is given."""

LOG = "link.log"
"""Name of the file of what happened at the link."""

PORTS = {"websocket": 8765, "osc": 9000}
"""Ports that trackers send to unless another is given."""


@dataclass(frozen=True, eq=False)
class Prepared:
    """What is followed, and where the sound goes.

    Attributes
    ----------
    setup, scene : the scene file, and what of it stays the same.
    hands : where the frames come from.
    output : where drives go.
    board : name of the kind of board, or None.
    cap : largest amplitude of an element, a share of full scale.
    full : level half a metre off the array at full scale [dB], where the cap was chosen to keep a
        head under the limit.
    session : file that records what is done.
    """

    setup: Setup
    scene: LiveScene
    hands: HandSource
    output: Output
    board: str | None
    cap: float
    full: float | None
    session: Path

    def notes(self) -> list[str]:
        """Say why the level is what it is."""
        if self.full is None or self.cap == FULL:
            return []
        return [
            f"The cap of {self.cap:g} keeps a head to {OCCUPATIONAL_LIMIT:g} dB for the hand at rest; --full-scale "
            f"emits all, up to {self.full:.0f} dB there, and --cap another share."
        ]


def prepare(
    scene: Path,
    folder: Path,
    source: str | None = None,
    cap: float | None = None,
    board: str | None = None,
    link: str | None = None,
    report_step: Progress = no_progress,
    **where: str | None,
) -> Prepared:
    """Read the scene and open what the frames come from; nothing is emitted yet.

    Parameters
    ----------
    scene : file of a scene whose foci ride on a hand.
    folder : where the session is written.
    source : a recording, a session or its folder, "websocket" or "osc", with ":PORT" for another
        port and 0 for a free one; the motion that comes along, again and again, unless given;
        "page" for the hand on the page.
    cap : largest amplitude of an element, a share of full scale; with boards and unless given the
        one that keeps a head to 110 dB for the scene's hand at rest.
    board, link, where : the boards and the way to them, as for ``link_to``; none unless given.

    Raises
    ------
    InvalidInput
        What is given is at fault.
    """
    cap = None if cap is None else check_cap(cap)
    report_step("reading the scene")
    setup = read_scene(scene, followed=True)
    fixed = live_scene(setup)
    output = _output(setup, fixed.moving, folder, board, link, where)
    full = None
    if board is not None and cap is None and link != "file":
        report_step("choosing a level that keeps a head to 110 dB")
        cap, full = safe_cap(_at_rest(fixed, setup), board)
    hands = _hands(setup, source, folder / FILE)
    return Prepared(
        setup, fixed, hands, output, board, FULL if cap is None else cap, full, folder / FILE
    )


def _at_rest(scene: LiveScene, setup: Setup) -> DriveFile:
    """Return the drive of distances for the scene's own hand."""
    drive = focus_by_distance(scene.array, setup.target, scene.medium, scene.frequency)
    return DriveFile(
        drive.amplitudes[None],
        frequency=scene.frequency,
        medium=scene.medium,
        positions=scene.array.positions,
        normals=scene.array.normals,
        sensitivity=scene.array.element.sensitivity,
        modulation=scene.modulation,
    )


def live(
    made: Prepared,
    seconds: float | None = None,
    latency: float = 0.0,
    ignore_hand: bool = False,
    page: tuple[int, str] | None = None,
    report_step: Progress = no_progress,
    report: Callable[[Status], None] = lambda status: None,
) -> Followed:
    """Let the sound follow a hand, and record what is done.

    Parameters
    ----------
    made : what is followed.
    seconds : how long; to the end of a recording, or until Ctrl-C, unless given.
    latency : least time from the picture to the frame's arrival, of trackers with a clock of their
        own [s].
    ignore_hand : whether drives are made from distances alone.
    page : port and host of the page; none unless given.
    report_step, report : called with each step, and with how it does.

    Raises
    ------
    InvalidInput
        What is given is at fault; nothing was emitted then.
    LinkFailed
        The boards fail.
    """
    checked_seconds(seconds)
    checked_latency(latency)
    with ExitStack() as closing:
        hands, shown = made.hands, None
        controls = Controls(ignore_hand=ignore_hand)
        if page is not None:
            stream = hands.stream if isinstance(hands, PageHands) else None
            report_step("starting the page")
            rest = None if stream is None else made.setup.hands[0].joints
            shown = PageProcess(made.scene, *page, rest, stream, controls, made.output.stop)
            closing.enter_context(shown)
        at_page = "" if shown is None else f"; page: {shown.address}"
        report_step(f"following {hands.words}; sound to {made.output.words}{at_page}")
        session = SessionWriter(made.session, made.scene, made.setup.text)
        return follow(
            made.scene,
            hands,
            HandAware(made.scene),
            output=made.output,
            seconds=seconds,
            session=session,
            latency=latency,
            cap=made.cap,
            controls=controls,
            page=shown,
            report=report,
        )


def _hands(setup: Setup, source: str | None, session: Path) -> HandSource:
    """Return where frames come from; the session that is written cannot be the one that they come from."""
    if source is None:
        return RecordedHands(moved_to(load_recording(example(MOTION)), setup.hands[0]), loop=True)
    if source == "page":
        return PageHands()
    kind, colon, port = source.partition(":")
    if kind in PORTS:
        if colon and not port.isdecimal():
            raise InvalidInput(
                f"--from {source} names no port: give one such as {kind}:{PORTS[kind]}.",
                code="not_a_number",
            )
        return ReceivedHands(kind, int(port) if colon else PORTS[kind], setup.tracker)
    path = Path(source)
    path = path / FILE if path.is_dir() else path
    if path.suffix == Path(FILE).suffix:
        if path.resolve() == session.resolve():
            raise InvalidInput(
                f"--from {source} is the session of 1 run, and this run would write over it: give another --out.",
                code="options_clash",
            )
        return RecordedHands(recording_of(path))  # its frames are in the scene's frame
    if not path.is_file() and path.name == source:
        path = example(source, (".jsonl",))
    recording = load_recording(path, leave_out=True)
    return RecordedHands(
        replace(recording, frames=tuple(one.moved(setup.tracker) for one in recording.frames))
    )


def _output(
    setup: Setup,
    moving: MovingFoci | None,
    folder: Path,
    board: str | None,
    link: str | None,
    where: dict[str, str | None],
) -> Output:
    """Return where drives go; the folder gets what the link writes."""
    if link is None and board is None:
        given = next((name for name, value in where.items() if value is not None), None)
        if given is not None:
            raise InvalidInput(
                f"--{given} {where[given]} goes with boards, and 0 are given: give --board and --link.",
                code="key_missing",
            )
        return Nowhere()
    if link is None or board is None:
        raise InvalidInput(
            "1 of --board and --link is missing: give both, or none.", code="key_missing"
        )
    if setup.board != board:
        raise InvalidInput(
            f"the array of {setup.path.name} is made of {setup.board or '0 boards'}, not of {board}: give --board "
            f"{setup.board}.",
            code="does_not_match",
        )
    out = str(folder / "frames.npz") if link == "file" else None
    folder.mkdir(parents=True, exist_ok=True)
    opened = link_to(link, board, setup.poses, setup.medium.sound_speed, **where, out=out)
    if moving is not None:
        opened.check_sequence(len(moving.places), moving.rate)
    return Boards(opened, folder / LOG)
