"""Start the live loop from a scene file, with the hand, the boards, the page and the session."""

import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

from airtact.drives.drive_file import DriveFile
from airtact.drives.transfer import focus_by_distance
from airtact.emission.links import link_to
from airtact.errors import InvalidInput, of_kind, path_of
from airtact.geometry.pose import Pose
from airtact.hands.tracking.clock import checked_latency
from airtact.hands.tracking.frame import HandFrame
from airtact.hands.tracking.recordings import ENDING, load_recording, save_recording
from airtact.hands.tracking.stream import StreamHealth
from airtact.live.drives.maker import HandAware
from airtact.live.drives.touching import TouchAware
from airtact.live.loop import Followed, Status, follow
from airtact.live.moment import Controls
from airtact.live.output import Output
from airtact.live.page.process import PageProcess
from airtact.live.scene import live_scene
from airtact.live.session import FILE, SessionWriter, recording_of
from airtact.live.sources import (
    HandSource,
    ReceivedHands,
    RecordedHands,
    checked_seconds,
    moved_to,
    touching_motion,
)
from airtact.live.world import World
from airtact.setup.examples import example, file_or_example
from airtact.setup.setup import Setup
from airtact.timing import Progress, no_progress

# Default ports to which trackers and applications send.
PORTS = {"websocket": 8765, "osc": 8766}


def run(
    setup: Setup,
    hands: HandSource,
    output: Output | None = None,
    *,
    folder: Path,
    seconds: float | None = None,
    latency: float = 0.0,
    cap: float | None = None,
    ignore_hand: bool = False,
    page: tuple[int, str] | None = None,
    certificate: Path | None = None,
    report_step: Progress = no_progress,
    report: Callable[[Status], None] = lambda status: None,
) -> Followed:
    """Make the sound follow a hand, and record the session.

    Parameters
    ----------
    setup : scene with virtual objects, or with foci on hands; see ``live_scene``.
    hands : source of the frames, as returned by ``hands_from``; this function closes it.
    output : boards that emit the drives, as returned by ``output_to``; by default, nothing is
        emitted.
    folder : folder in which ``session.h5`` is written; an existing file is replaced.
    seconds : duration [s]; by default, until the recording ends or Ctrl-C is
        pressed.
    latency : shortest time from the camera image to the frame's arrival, for trackers with their
        own clock [s], 0 to 0.5.
    cap : largest amplitude of an element, as a fraction of full scale, above 0 and at most 1. By
        default, the level at a head 0.5 m from the array is limited to 110 dB SPL; without boards,
        the cap is 1.
    ignore_hand : whether scattering by the hand is ignored, as in ``Controls``.
    page : port and host, such as ``(8000, "localhost")``, of a page in the browser that shows the
        run and controls it; no page by default.
    certificate : PEM file with a certificate and its key, used to serve the page over
        HTTPS.
    report_step : function called with a description of each step at the start of the run.
    report : function called twice a second with the ``Status``.

    Returns
    -------
    A ``Followed``, which summarises the run.

    Raises
    ------
    InvalidInput
        If an argument is invalid, or the live loop does not support the scene. Nothing has been
        emitted in this case.
    LinkFailed
        If the boards fail. All boards that still respond are silenced first.
    """
    checked_seconds(seconds)
    checked_latency(latency)
    scene = live_scene(setup)
    output = output or Output()
    controls = Controls(ignore_hand=ignore_hand)
    with ExitStack() as closing:
        shown = None
        if page is not None:
            report_step("starting the page")
            port, host = page
            # The page only supplies a hand if there is no other source.
            followed = type(hands) is HandSource
            joints = setup.hands[0].joints if followed and setup.hands else None
            shown = PageProcess(
                scene,
                port,
                host,
                joints,
                hands.stream if followed else None,
                controls,
                output.stop,
                hands.world,
                certificate,
            )
            closing.enter_context(shown)
        # Without a page, nothing can make the loop consider the hand again.
        solvers = [] if ignore_hand and page is None else None
        if scene.both:
            maker = TouchAware(scene, solvers=solvers, rest=setup.hands[0] if setup.hands else None)
        else:
            maker = HandAware(scene, solvers=solvers)
        address = "" if shown is None else f"; page: {shown.address}"
        report_step(f"following {hands.words}; sound to {output.words}{address}")
        session = SessionWriter(folder / FILE, scene, setup.text)
        return follow(
            scene,
            hands,
            maker,
            output=output,
            seconds=seconds,
            session=session,
            latency=latency,
            cap=cap,
            controls=controls,
            page=shown,
            report=report,
            world=hands.world,
        )


def record(
    file: Path, source: str, seconds: float | None = None, report_step: Progress = no_progress
) -> StreamHealth:
    """Record the frames sent by trackers, without computing drives.

    Parameters
    ----------
    file : path of the recording to write, which must end in ``.jsonl``; an existing file is
        replaced. The recording is in the tracker's coordinates. ``load_recording`` reads it.
    source : "websocket" (JSON, on port 8765) or "osc" (on port 8766). Append another port as in
        "websocket:9000"; port 0 selects a free one.
    seconds : duration [s], above 0; by default, until Ctrl-C is pressed.
    report_step : function called with the address once the port is open, and with a message
        whenever frames begin to be rejected or stop arriving.

    Returns
    -------
    A ``StreamHealth`` with the numbers of received frames and of frames with each kind of fault.

    Raises
    ------
    InvalidInput
        If an argument is invalid, the port is in use, or no frame was received.
    """
    duration = checked_seconds(seconds)
    file = path_of(file, "the file of a recording")
    if file.suffix != ENDING:
        raise InvalidInput(
            f"the name of a recording must end in {ENDING}, not in {file.suffix!r}: change "
            "the file name.",
            code="unknown_format",
        )
    hands = received(source)
    if hands is None:
        raise InvalidInput(
            f"only frames from trackers can be recorded, not {source}: use websocket or osc.",
            code="unknown_name",
        )
    frames: list[HandFrame] = []
    stream = hands.begin(lambda frame, arrived: frames.append(frame))
    end = time.monotonic() + duration
    before = stream.health
    reported, trouble = time.monotonic(), ""
    try:
        report_step(f"listening at {hands.words}")
        while time.monotonic() < end:
            time.sleep(min(0.1, max(end - time.monotonic(), 0.0)))
            if time.monotonic() - reported < 0.5:
                continue
            reported = time.monotonic()
            words = stream.health.rejected_since(before) or hands.remark()
            before = stream.health
            # Ignore the number of frames, because it changes all the time.
            if words and words.partition(" ")[2] != trouble:
                report_step(words)
            trouble = words.partition(" ")[2]
    except KeyboardInterrupt:
        report_step("interrupted; the frames received so far are recorded")
    finally:
        hands.close()
    if not frames:
        raise InvalidInput(
            f"no frame was received ({hands.words}; {stream.health}): check the address to which "
            "the tracker sends its frames.",
            code="empty",
        )
    save_recording(file, frames)
    return stream.health


def hands_from(setup: Setup, source: str | None, folder: Path) -> HandSource:
    """Open the source of frames for a run.

    Parameters
    ----------
    setup : setup whose attribute ``tracker`` transforms the frames of recordings and trackers to
        the scene, and whose objects are the initial objects of the run. Frames of a session are
        already in scene coordinates.
    source : path of a recording, of a session, or of the folder of a session; "websocket" or "osc"
        for messages at a port of this computer, optionally with ":PORT" (8765 or 8766 by default; 0
        selects a free port); or "page" for a hand that is dragged on the page. By default, an
        example motion is repeated.
    folder : folder in which this run is recorded. It must not contain the session given as source.

    Returns
    -------
    A ``HandSource``, which can be passed to ``run``.

    Raises
    ------
    InvalidInput
        If the source does not exist, cannot be read or is the session in ``folder``, or if its port
        is in use.
    """
    of_kind(setup, Setup, "the setup", "read_scene(path)")
    world = World(setup.objects)
    if source is None and setup.contacts is not None:
        return RecordedHands(touching_motion(setup.contacts, setup.hands), loop=True, world=world)
    if source is None:
        motion = load_recording(example("reaching.jsonl"))
        return RecordedHands(moved_to(motion, setup.hands[0]), loop=True, world=world)
    if source == "page":
        return HandSource("the hand on the page", world=world)
    hands = received(source, setup.tracker, world)
    if hands is not None:
        return hands
    path = Path(source)
    path = path / FILE if path.is_dir() else path
    if path.suffix == Path(FILE).suffix:
        if path.resolve() == (path_of(folder, "the folder") / FILE).resolve():
            raise InvalidInput(
                f"this run would overwrite the session given by --from {source}: change --out.",
                code="options_clash",
            )
        return RecordedHands(recording_of(path), world=world)  # already in scene coordinates
    recording = load_recording(file_or_example(source, (".jsonl",)), leave_out=True)
    frames = tuple(frame.moved(setup.tracker) for frame in recording.frames)
    hands = RecordedHands(replace(recording, frames=frames), world=world)
    hands.words += f" ({recording.note})" if recording.note else ""
    return hands


def received(
    source: str, tracker: Pose | None = None, world: World | None = None
) -> ReceivedHands | None:
    """Open the port of a source such as "osc:8766"; return None for sources without a port."""
    kind, colon, port = of_kind(source, str, "the source", '"osc" or a file').partition(":")
    if kind not in PORTS:
        return None
    if colon and not port.isdecimal():
        raise InvalidInput(
            f"--from {source} has no port number; use, for example, {kind}:{PORTS[kind]}.",
            code="not_a_number",
        )
    return ReceivedHands(int(port) if colon else PORTS[kind], tracker, world, kind)


def output_to(
    setup: Setup, folder: Path, board: str | None, link: str | None, **settings: str | None
) -> Output:
    """Return the output for ``run``: boards connected by a link, or no boards if no link is given.

    The link is not opened yet.

    Parameters
    ----------
    setup : scene whose array consists of the connected boards.
    folder : folder in which the events at the link are written to link.log; created with the link.
    board, link : names of the kind of board and of the link, such as "autd3" and "udp"; both None
        for a run without boards.
    settings : further options of the link, as texts: the ``address`` of AUTD3 boards or the serial
        ``port`` of others; None or omitted if the link does not need it.

    Returns
    -------
    An ``Output``.

    Raises
    ------
    InvalidInput
        If the live loop does not support the scene; see ``live_scene``. If only one of ``board``
        and ``link`` is given, or the boards are not those of the scene. If a setting is missing or
        does not apply to the link. If the boards cannot play the paths of the foci.
    """
    scene = live_scene(setup)
    if not any([board, link, *settings.values()]):
        return Output()
    port = settings.get("port")
    if port is not None and (link is None or port.isdecimal()):
        raise InvalidInput(
            f"--port {port} cannot be used here: --port names the serial port of boards and "
            "requires --link serial. Use --page-port for the port of the page.",
            code="options_clash",
        )
    if link is None or board is None:
        raise InvalidInput(
            "boards require both --board and --link: set both, or omit all options for boards.",
            code="key_missing",
        )
    if setup.board != board:
        raise InvalidInput(
            f"the array of the scene consists of {setup.board or 'no known boards'}, not of "
            f"{board}: change --board or the scene.",
            code="does_not_match",
        )
    folder.mkdir(parents=True, exist_ok=True)
    opened = link_to(link, board, setup.poses, setup.medium.sound_speed, **settings)
    if scene.moving is not None:
        opened.check_sequence(len(scene.moving.places), scene.moving.rate)
    return Output(opened, folder / "link.log")


def drive_at_rest(setup: Setup) -> DriveFile:
    """Compute the drive for the scene's hand at rest, ignoring its scattering.

    The drive is used to find a safe sound level before the live loop starts: all foci are in phase
    and the strongest element is at full scale (see ``focus_by_distance``).

    Parameters
    ----------
    setup : the scene, the array and the foci.

    Returns
    -------
    A ``DriveFile`` with a single frame and the data required to find its level, as in ``drive.h5``.

    Raises
    ------
    InvalidInput
        If the live loop does not support the scene; see ``live_scene``.
    """
    scene = live_scene(setup)
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
