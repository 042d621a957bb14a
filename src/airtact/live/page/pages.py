"""The open pages: their requests, the pictures sent to them, and the dragged hand."""

import time
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from threading import Semaphore, Thread
from typing import Annotated, Any

import msgspec
import numpy as np
from jinja2 import FileSystemLoader
from scipy.spatial.transform import Rotation
from websockets.exceptions import ConnectionClosed
from websockets.sync.server import ServerConnection

from airtact.geometry.pose import Pose
from airtact.hands.kinematics import turned
from airtact.hands.tracking.frame import FaultyFrame, HandFrame
from airtact.live.moment import Controls, silent_moment
from airtact.live.page.process import Send, Shown
from airtact.live.page.server import start_server
from airtact.live.page.sound import Axis
from airtact.live.page.view import View, fixed_facts, packed
from airtact.live.scene import Joints, LiveScene
from airtact.live.worker import Mailbox
from airtact.reports.page import FOLDER, TEMPLATES
from airtact.reports.viewer import embedded

# A coordinate within the reach of a hand [m].
Length = Annotated[float, msgspec.Meta(ge=-3.0, le=3.0)]
# An angle at the base of a finger [degrees].
Angle = Annotated[float, msgspec.Meta(ge=-40.0, le=60.0)]


class Dragged(msgspec.Struct):
    """Pose to which a hand was dragged on the page.

    Attributes
    ----------
    position : mean position of the joints [m].
    turn : rotation relative to the initial pose, as a quaternion (x, y, z, w).
    fingers : angle by which each finger is opened at its base [degrees].
    """

    position: tuple[Length, Length, Length]
    turn: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)
    fingers: tuple[Angle, Angle, Angle, Angle, Angle] = (0.0, 0.0, 0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        if not 0.5 < np.linalg.norm(self.turn) < 2.0:
            raise ValueError("a rotation must be a unit quaternion")


class Said(msgspec.Struct, forbid_unknown_fields=True):
    """A message from a page; every part is optional.

    Attributes
    ----------
    drawn : whether a picture was drawn, so that the next one can be sent.
    emergency : whether the emergency stop was pressed.
    controls : changed settings, by name.
    levels : changed strengths of foci, by name.
    across, offset : axis normal to the slice of the field, and offset of the slice from the
        foci along this axis [m].
    hand : those parts of the dragged hand's pose that changed.
    frame : a hand tracked by a headset, in the format that trackers send.
    object : message that moves an object, in the format in which applications send it.
    """

    drawn: bool = False
    emergency: bool = False
    controls: dict[str, Any] = {}
    levels: dict[str, float] = {}
    across: Axis | None = None
    offset: Annotated[float, msgspec.Meta(ge=-0.06, le=0.06)] | None = None
    hand: dict[str, Any] = {}
    frame: msgspec.Raw | msgspec.UnsetType = msgspec.UNSET
    object: msgspec.Raw | msgspec.UnsetType = msgspec.UNSET


class Pages:
    """The server of the page and all open pages.

    Parameters
    ----------
    send : function that sends messages to the live loop.
    scene : the parts of the scene that stay fixed during the run.
    port, host : port and address to listen on; port 0 selects a free port.
    hand : (25, 3) initial joints of a hand that can be dragged [m]; None if there is none.
    follows : whether the live loop follows hands from the page.
    controls : initial settings of the live loop.
    certificate : PEM file with a certificate and its key, used to serve the page over HTTPS.

    Raises
    ------
    InvalidInput
        If the port is in use or invalid, or the certificate cannot be read.
    """

    def __init__(
        self,
        send: Send,
        scene: LiveScene,
        port: int,
        host: str,
        hand: Joints | None,
        follows: bool,
        controls: Controls,
        certificate: Path | None,
    ) -> None:
        self._send = send
        self._scene = scene
        self._controls = controls
        self._stopped = False
        self._across: Axis = "y"
        self._offset = 0.0
        self._open: set[Mailbox] = set()
        self._tracked = -np.inf  # when a headset sent its last hand [s]
        x, y, z = (np.zeros(3) if hand is None else hand.mean(axis=0)).tolist()
        self._hand = Dragged((x, y, z))
        self._first = None if hand is None else hand - (x, y, z)
        facts, numbers = fixed_facts(scene)
        facts |= {"dragged": hand is not None, "follows": follows}
        loader = FileSystemLoader([Path(__file__).parent, FOLDER])
        page = TEMPLATES.overlay(loader=loader).get_template("live.html.j2")
        html = page.render(facts=facts, space=embedded(facts, numbers), title="airtact live")
        self._server, self.address = start_server(port, host, html, self._serve, certificate)
        if hand is not None:
            Thread(target=self._give_hand, daemon=True).start()

    def paint(self, mailbox: Mailbox) -> None:
        """Send pictures of the newest data to the open pages until the live loop ends."""
        view = View(self._scene)
        known: frozenset[int] = frozenset()
        while not mailbox.ended:
            start = time.monotonic()
            if self._open:
                shown = mailbox.newest or Shown(silent_moment(self._scene, 0.0, 0.0))
                picture = view.picture(shown, self._across, self._offset, self._joints())
                picture.facts["controls"] = asdict(self._controls)
                picture.facts["stopped"] = self._stopped
                picture.facts["hand"] = msgspec.to_builtins(self._hand)
                for page in self._open.copy():
                    page.put(picture)
                if known != view.objects.keys():
                    known = frozenset(view.objects)
                    self._send(("known", known))
            # Send at most 18 pictures a second, because they may be drawn on the loop's processor.
            # Even on a slow computer, the loop then keeps at least 30 % of the time.
            spent = time.monotonic() - start
            time.sleep(max(1.0 / 18.0 - spent, 3.0 / 7.0 * spent))

    def _serve(self, connection: ServerConnection) -> None:
        """Send pictures to a page as fast as it can draw them, and process its messages."""
        pictures = Mailbox()
        drawn = Semaphore(2)  # one picture is transferred while another is drawn

        def deliver() -> None:
            kept: set[str] = set()
            with suppress(ConnectionClosed):
                while drawn.acquire() and (picture := pictures.take()) is not None:
                    arrays = dict(picture.arrays)
                    for key in picture.kept.keys() - kept:
                        arrays |= {f"{key} {name}": a for name, a in picture.kept[key].items()}
                    kept = set(picture.kept)
                    connection.send(packed({**picture.facts, "keys": sorted(kept)}, arrays))

        self._open.add(pictures)
        Thread(target=deliver, daemon=True).start()
        try:
            with suppress(ConnectionClosed):
                for text in connection:
                    # Ignore messages that the page itself would never send.
                    with suppress(msgspec.MsgspecError):
                        said = msgspec.json.decode(text, type=Said)
                        if said.drawn:
                            drawn.release()
                        self._take(said, str(connection.id))
        finally:
            self._open.discard(pictures)
            self._send(("gone", str(connection.id)))
            pictures.end()
            drawn.release()

    def _take(self, said: Said, source: str) -> None:
        if said.emergency:
            self._send(("emergency", None))
            self._stopped = True
        if (said.controls or said.levels) and not self._stopped:
            changed = {**asdict(self._controls), **said.controls}
            if said.levels:
                # Foci appear and disappear. Keep only the levels that changed last.
                levels = {**self._controls.levels, **said.levels}
                changed["levels"] = dict(list(levels.items())[-256:])
            # Converting to Controls checks every value.
            self._controls = msgspec.convert(changed, Controls)
            self._send(("controls", self._controls))
        if said.across is not None:
            self._across = said.across
        if said.offset is not None:
            self._offset = said.offset
        if said.hand:
            changed = {**msgspec.to_builtins(self._hand), **said.hand}
            self._hand = msgspec.convert(changed, Dragged)
        if said.frame is not msgspec.UNSET:
            self._tracked = time.monotonic()
            self._send(("frame", (bytes(said.frame), source)))
        if said.object is not msgspec.UNSET:
            self._send(("object", bytes(said.object)))

    def _joints(self) -> Joints | None:
        """Return the joints (25, 3) of the dragged hand [m]; None if a headset tracks hands."""
        joints = self._first
        if joints is None or time.monotonic() - self._tracked < 1.0:
            return None
        for finger, angle in enumerate(self._hand.fingers):
            if angle:
                joints = turned(joints, self._scene.side, finger, float(np.radians(angle)))
        turn = Rotation.from_quat(self._hand.turn).as_matrix()
        return Pose(turn, np.array(self._hand.position)).apply(joints)

    def _give_hand(self) -> None:
        """Send the dragged hand 60 times per second, as a tracker would."""
        sequence = 0
        while True:
            joints = self._joints()
            if joints is not None and self._open:
                # If fingers are bent beyond their limits, the hand counts as lost.
                with suppress(FaultyFrame):
                    frame = HandFrame(time.monotonic(), self._scene.side, sequence, joints)
                    self._send(("frame", frame))
                sequence += 1
            time.sleep(1.0 / 60.0)
