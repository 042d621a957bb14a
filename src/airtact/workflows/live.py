"""The sound follows a hand: a scene file, frames from somewhere, boards or none. Prints nothing."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from airtact.conventions import InvalidInput
from airtact.examples import example
from airtact.hardware.links import link_to
from airtact.live.drives.maker import HandAware
from airtact.live.loop import Followed, Status, follow
from airtact.live.output import Boards, Nowhere, Output
from airtact.live.parts import LiveScene
from airtact.live.scene import live_scene
from airtact.live.session import FILE, SessionWriter
from airtact.live.sources import HandSource, ReceivedHands, RecordedHands, checked_seconds, moved_to
from airtact.scene_file.building import Setup, read_scene
from airtact.timing import Progress, no_progress
from airtact.tracking.recordings import load_recording

MOTION = "reaching.jsonl"
"""The motion that is followed unless another is given."""

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
    session : file that records what is done.
    """

    setup: Setup
    scene: LiveScene
    hands: HandSource
    output: Output
    session: Path


def prepare(
    scene: Path,
    folder: Path,
    source: str | None = None,
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
    source : a recording, "websocket" or "osc", with ":PORT" for another port and 0 for a free one; the motion that
        comes along, again and again, unless given.
    board, link, where : the boards and the way to them, as for ``link_to``; none unless given.

    Raises
    ------
    InvalidInput
        What is given is at fault.
    """
    report_step("reading the scene")
    setup = read_scene(scene)
    fixed = live_scene(setup)
    output = _output(setup, board, link, {**where, "out": str(folder / "frames.npz") if link == "file" else None})
    return Prepared(setup, fixed, _hands(setup, source), output, folder / FILE)


def live(
    made: Prepared,
    seconds: float | None = None,
    latency: float = 0.0,
    cap: float = 1.0,
    report: Callable[[Status], None] = lambda status: None,
) -> Followed:
    """Let the sound follow a hand, and record what is done; parameters and errors are those of ``follow``."""
    checked_seconds(seconds)
    session = SessionWriter(made.session, made.scene, made.setup.text)
    return follow(
        made.scene,
        made.hands,
        HandAware(made.scene),
        output=made.output,
        seconds=seconds,
        session=session,
        latency=latency,
        cap=cap,
        report=report,
    )


def _hands(setup: Setup, source: str | None) -> HandSource:
    """Return where frames come from."""
    if source is None:
        return RecordedHands(moved_to(load_recording(example(MOTION)), setup.hands[0]), loop=True)
    kind, colon, port = source.partition(":")
    if kind in PORTS:
        if colon and not port.isdecimal():
            raise InvalidInput(
                f"--from {source} names no port: give one such as {kind}:{PORTS[kind]}.", code="not_a_number"
            )
        return ReceivedHands(kind, int(port) if colon else PORTS[kind], setup.tracker)
    path = Path(source)
    if not path.is_file() and path.name == source:
        path = example(source)
    recording = load_recording(path, leave_out=True)
    return RecordedHands(replace(recording, frames=tuple(one.moved(setup.tracker) for one in recording.frames)))


def _output(setup: Setup, board: str | None, link: str | None, where: dict[str, str | None]) -> Output:
    """Return where drives go."""
    if link is None and board is None:
        given = next((name for name, value in where.items() if value is not None), None)
        if given is not None:
            raise InvalidInput(
                f"--{given} {where[given]} goes with boards, and 0 are given: give --board and --link.",
                code="setting_missing",
            )
        return Nowhere()
    if link is None or board is None:
        raise InvalidInput("1 of --board and --link is missing: give both, or none.", code="setting_missing")
    if setup.board != board:
        raise InvalidInput(
            f"the array of {setup.path.name} is made of {setup.board or '0 boards'}, not of {board}: give --board "
            f"{setup.board}.",
            code="wrong_board",
        )
    return Boards(link_to(link, board, setup.poses, setup.medium.sound_speed, **where))
