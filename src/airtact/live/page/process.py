"""The process of the page, which gets the newest moment and returns settings."""

import os
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from itertools import count
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any, NamedTuple, cast

from airtact.errors import InvalidInput, extra
from airtact.geometry.mesh.arrays import FlatMesh
from airtact.geometry.pose import Pose
from airtact.hands.tracking.frame import HandFrame
from airtact.hands.tracking.stream import HandStream
from airtact.live.moment import Controls, Moment, silent_moment
from airtact.live.scene import Joints, LiveScene
from airtact.live.worker import Mailbox, Worker
from airtact.live.world import World
from airtact.timing import give_way

# Default port of the page.
PORT = 8940

# Kind and content of a message of the page: its address or a fault at first, then controls,
# "emergency", frames of hands, messages to the world, and the shapes that it has.
Message = tuple[str, Any]
Send = Callable[[Message], None]


class Placed(NamedTuple):
    """A virtual object: its name, the number of its shape, and its pose."""

    name: str
    key: int
    pose: Pose | None


@dataclass(frozen=True, eq=False)
class Shown:
    """Data that the loop sends to the page.

    Attributes
    ----------
    moment : newest moment, without its objects.
    drives : number of moments so far.
    status : status of the loop in words.
    objects : virtual objects.
    meshes : vertices [m] and triangles of shapes that the page does not have yet, by number.
    """

    moment: Moment
    drives: int = 0
    status: str = ""
    objects: tuple[Placed, ...] = ()
    meshes: Mapping[int, FlatMesh] = field(default_factory=dict)


class PageProcess:
    """Process of lower priority that serves the page; the loop never waits for it.

    Use it in a ``with`` block. A separate thread sends only the newest moment to the page, so slow
    or many open pages do not delay the loop. If the process dies, the loop continues without a
    page.

    Parameters
    ----------
    scene : the fixed part of the scene.
    port : port to listen at; 0 selects a free port, which is part of ``address``.
    host : address to listen at; unless it is ``127.0.0.1``, ``address`` contains a token that every
        request must have.
    hand : (25, 3) initial joints of a hand to drag on the page [m]; none by default.
    stream : receives the frames of this hand, with times of ``time.monotonic``, while the page is
        open, and the hands that a headset tracks. Closing the page counts as losing them.
    controls : initial settings.
    on_emergency : called at once, in a thread of this class, when the emergency stop is pressed.
    world : virtual objects, which the page can move; those of the moments by default.
    certificate : PEM file with a certificate and its key, to serve the page by HTTPS.

    Attributes
    ----------
    controls : newest settings of the page.
    address : URL of the page.

    Raises
    ------
    InvalidInput
        If the port is taken, the certificate cannot be read, or websockets is not installed.
    """

    def __init__(
        self,
        scene: LiveScene,
        port: int = PORT,
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
        # Each shape of an object with its number and mesh, by its identity.
        self._shapes: dict[int, tuple[object, int, FlatMesh]] = {}
        self._numbers = count()
        self._known: frozenset[int] = frozenset()  # numbers of the shapes that the page has
        self._answers: SimpleQueue[Any] = SimpleQueue()
        # The page is painted 18 times a second.
        settings = (scene, port, host, hand, stream is not None, self.controls, certificate)
        self._worker = Worker(serve_page, settings, self._received, pause=1.0 / 20.0)
        patience = 30.0  # the process imports its server
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
                    f"the page did not start within {patience:g} s; run without it (--no-page).",
                    code="child_failed",
                )
            )
        self.address: str = answer

    def __enter__(self) -> "PageProcess":
        return self

    def __exit__(self, *fault: object) -> None:
        self.close()

    def show(self, moment: Moment) -> None:
        """Show a moment, unless a newer one replaces it; call this in every pass of the loop."""
        self._shown = replace(self._shown, moment=moment, drives=self._shown.drives + 1)
        self._put()

    def tell(self, status: object) -> None:
        """Show a status in words."""
        self._shown = replace(self._shown, status=str(status))
        self._put()

    def _put(self) -> None:
        objects = self._shown.moment.objects if self._world is None else self._world.objects
        before = self._shapes
        # A known shape is held here, so that no other can have its identity.
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
        """End the page."""
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


def serve_page(
    mailbox: Mailbox,
    send: Send,
    scene: LiveScene,
    port: int,
    host: str,
    hand: Joints | None,
    follows: bool,
    controls: Controls,
    certificate: Path | None,
) -> None:
    """Serve the page until the loop ends; the mailbox contains the newest ``Shown``."""
    try:
        with extra("live", "the page needs websockets; to run without a page, set --no-page"):
            from airtact.live.page.pages import Pages

        pages = Pages(send, scene, port, host, hand, follows, controls, certificate)
    except InvalidInput as fault:
        send(("fault", fault))
        return
    send(("address", pages.address))
    # Libraries print tracebacks of messages that no browser sends.
    with open(os.devnull, "wb") as nothing:
        os.dup2(nothing.fileno(), sys.stderr.fileno())
    give_way(5)  # only after the start, because the user waits for the page
    pages.paint(mailbox)
