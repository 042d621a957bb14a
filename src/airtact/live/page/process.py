"""The process that serves the page; it receives the newest moment and returns settings."""

import os
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from itertools import count
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any, NamedTuple, cast

from airtact.errors import InvalidInput, extra
from airtact.geometry.mesh.triangles import FlatMesh
from airtact.geometry.pose import Pose
from airtact.hands.tracking.frame import HandFrame
from airtact.hands.tracking.stream import HandStream
from airtact.live.moment import Controls, Moment, silent_moment
from airtact.live.scene import Joints, LiveScene
from airtact.live.worker import Mailbox, Worker
from airtact.live.world import World
from airtact.timing import give_way

# Kind and content of a message from the page. The first message is the address or a fault. Later
# messages are controls, "emergency", frames of hands, changes to the world, and the shapes that the
# page has received.
Message = tuple[str, Any]
Send = Callable[[Message], None]


class Placed(NamedTuple):
    """A virtual object, given by its name, an integer that identifies its shape, and its pose."""

    name: str
    key: int
    pose: Pose | None


@dataclass(frozen=True, eq=False)
class Shown:
    """Data that the live loop sends to the page for display.

    Attributes
    ----------
    moment : newest ``Moment``, without its objects.
    drives : number of drives shown so far.
    status : status of the live loop as text.
    objects : virtual objects, with the poses in which to show them.
    meshes : mapping from the numbers of shapes that the page has not received yet to their
        vertices [m] and triangles.
    """

    moment: Moment
    drives: int = 0
    status: str = ""
    objects: tuple[Placed, ...] = ()
    meshes: Mapping[int, FlatMesh] = field(default_factory=dict)


class PageProcess:
    """Low-priority process that serves the page; the live loop never waits for it.

    Use it in a ``with`` block. A separate thread sends only the newest ``Moment`` to the page, so
    slow or numerous pages do not delay the loop. If the process dies, the loop continues without a
    page.

    Parameters
    ----------
    scene : the parts of the scene that stay fixed during the run.
    port : port to listen on; 0 selects a free port, which then appears in
        ``address``.
    host : address to listen on. Unless it is ``127.0.0.1``, ``address`` contains a token that every
        request must include.
    hand : (25, 3) initial joints of a hand that can be dragged on the page [m]; none by
        default.
    stream : stream to which the page adds frames while it is open: those of the dragged hand, timed
        by ``time.monotonic``, and those of hands tracked by a headset. Closing the page counts as
        losing these hands.
    controls : initial settings.
    on_emergency : function called in a separate thread when the emergency stop is pressed.
    world : virtual objects, which the page can move; by default, the page shows those of each
        ``Moment``.
    certificate : PEM file with a certificate and its key, used to serve the page over
        HTTPS.

    Attributes
    ----------
    controls : newest settings from the page.
    address : URL of the page.

    Raises
    ------
    InvalidInput
        If the port is in use, the certificate cannot be read, or websockets is not installed.
    """

    def __init__(
        self,
        scene: LiveScene,
        port: int,
        host: str = "127.0.0.1",
        hand: Joints | None = None,
        stream: HandStream | None = None,
        controls: Controls | None = None,
        on_emergency: Callable[[], None] = lambda: None,
        world: World | None = None,
        certificate: Path | None = None,
    ) -> None:
        self._stream = stream
        self._on_emergency = on_emergency
        self._world = world
        self.controls: Controls = controls or Controls()
        self._shown = Shown(silent_moment(scene, 0.0, 0.0))
        # For each shape, by its identity: the shape itself, its number and its mesh.
        self._shapes: dict[int, tuple[object, int, FlatMesh]] = {}
        self._numbers = count()
        self._known: frozenset[int] = frozenset()  # numbers of the shapes sent to the page
        self._answers: SimpleQueue[Any] = SimpleQueue()
        settings = (scene, port, host, hand, stream is not None, self.controls, certificate)
        # Limit the page to 18 pictures a second.
        self._worker = Worker(serve_page, settings, self._received, pause=1.0 / 20.0)
        patience = 30.0  # [s]; importing the server takes a while
        try:
            answer = self._answers.get(timeout=patience)
        except Empty:
            answer = None
        if not isinstance(answer, str):
            self._worker.close()
            raise (
                answer
                if isinstance(answer, InvalidInput)
                else InvalidInput(
                    f"the page did not start within {patience:g} s; use --no-page to run without "
                    "a page.",
                    code="child_failed",
                )
            )
        self.address: str = answer

    def __enter__(self) -> "PageProcess":
        return self

    def __exit__(self, *fault: object) -> None:
        self.close()

    def show(self, moment: Moment) -> None:
        """Show a drive unless a newer one has arrived; the loop calls this in every iteration."""
        self._shown = replace(self._shown, moment=moment, drives=self._shown.drives + 1)
        self._put()

    def tell(self, status: object) -> None:
        """Show a text as the status of the live loop."""
        self._shown = replace(self._shown, status=str(status))
        self._put()

    def _put(self) -> None:
        objects = self._shown.moment.objects if self._world is None else self._world.objects
        before = self._shapes
        # Keep a reference to each known shape, so that its identity is not reused.
        self._shapes = {
            id(thing.shape): before.get(id(thing.shape))
            or (thing.shape, next(self._numbers), thing.solid.mesh())
            for thing in objects
        }
        shown = replace(
            self._shown,
            moment=replace(self._shown.moment, objects=()),
            objects=tuple(
                Placed(thing.name, self._shapes[id(thing.shape)][1], thing.pose)
                for thing in objects
            ),
            meshes={
                number: mesh
                for _, number, mesh in self._shapes.values()
                if number not in self._known
            },
        )
        self._worker.put(shown)

    @property
    def ended(self) -> bool:
        """Whether the page's process has ended."""
        return self._worker.ended

    def close(self) -> None:
        """End the page's process."""
        self._worker.close()

    def _received(self, message: Message | None) -> None:
        kind, content = message or cast(Message, ("ended", None))
        if kind == "controls":
            self.controls = content
        elif kind == "emergency":
            self._on_emergency()
        elif kind == "known":
            self._known = content
        elif kind == "object" and self._world is not None:
            self._world.take(content, "page")
            self._put()
        elif kind in ("frame", "gone") and self._stream is not None:
            if kind == "gone":
                self._stream.disconnect(content, interrupted=False)
            elif isinstance(content, HandFrame):
                self._stream.feed(content)
            else:
                self._stream.feed_json(*content)
        elif kind in ("address", "fault", "ended"):
            self._answers.put(content)


def serve_page(mailbox: Mailbox, send: Send, *settings: Any) -> None:
    """Serve ``Pages`` with some settings until the loop ends.

    The mailbox contains the newest ``Shown``.
    """
    try:
        with extra("live", "to serve the page (--no-page omits it), airtact needs websockets"):
            from airtact.live.page.pages import Pages

        pages = Pages(send, *settings)
    except InvalidInput as fault:
        send(("fault", fault))
        return
    send(("address", pages.address))
    # Libraries print tracebacks for malformed messages, which no browser sends.
    with open(os.devnull, "wb") as nothing:
        os.dup2(nothing.fileno(), sys.stderr.fileno())
    give_way(5)  # only after the start, because the user is waiting for the page
    pages.paint(mailbox)
