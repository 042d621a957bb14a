"""An application's connection to the live loop."""

import time
from collections import deque
from contextlib import suppress
from threading import Event, Thread
from typing import TYPE_CHECKING

import msgspec

from airtact.errors import InvalidInput, extra, positive
from airtact.geometry.pose import Pose
from airtact.hands.tracking.frame import HandFrame
from airtact.hands.tracking.messages import to_json
from airtact.live.messages import (
    VERSION,
    ClearMessage,
    FociMessage,
    HandsMessage,
    Message,
    MoveMessage,
    ObjectMessage,
    ObjectsMessage,
    PoseMessage,
    RejectedMessage,
    StateMessage,
    read_answer,
)
from airtact.live.world import WantedFocus
from airtact.touch.objects import VirtualObject, objects_of

if TYPE_CHECKING:
    from websockets.sync.client import ClientConnection


class Client:
    """Connection of an application to ``airtact live SCENE --from websocket``.

    ``objects``, ``move`` and ``remove`` change the virtual objects of the live loop, ``foci``
    replaces this client's foci, and ``hands`` sends frames of hands. ``state`` and ``next_state``
    return the loop's answers, each a ``StateMessage``. Use the client in a ``with`` block; its
    objects and foci are removed at the end of the block. Foci are also removed if the client sends
    nothing for 0.5 s, so repeat them or send any other message several times per second. The
    methods raise ``InvalidInput`` with the code "link_failed" once the live loop has ended.

    Parameters
    ----------
    address : websocket address that the live loop prints when it starts; by default
        ``"ws://127.0.0.1:8765"``.
    timeout : longest time to wait for the live loop to accept the connection [s], above 0; 10 s by
        default.

    Attributes
    ----------
    rejected : ``deque`` with a sentence about each message that the live loop rejected, up to the
        16 newest; remove sentences after reading them.

    Raises
    ------
    InvalidInput
        If nothing listens at the address, or the optional package websockets is not installed.

    Examples
    --------
    >>> import airtact as at
    >>> with at.live.ReceivedHands(port=0) as loop, Client(loop.words) as client:  # or follow(...)
    ...     client.objects(at.VirtualObject(at.sphere(0.02, edge=0.005), name="ball"))
    ...     client.foci(at.live.WantedFocus("tip", place="index.pad", strength=0.5))
    ...     client.next_state(timeout=10.0).state
    'silent'
    """

    def __init__(self, address: str = "ws://127.0.0.1:8765", timeout: float = 10.0) -> None:
        with extra("tracking", "the client needs the package websockets"):
            from websockets.exceptions import InvalidHandshake, InvalidURI
            from websockets.sync.client import connect
        end = time.monotonic() + positive(timeout, "the timeout", "s")
        while True:
            try:
                self._connection: ClientConnection = connect(address, compression=None)
                break
            except (OSError, InvalidHandshake, InvalidURI) as fault:
                if not isinstance(fault, ConnectionRefusedError) or time.monotonic() > end:
                    raise InvalidInput(
                        f"cannot connect to {address}: {fault}. Start airtact live SCENE --from "
                        "websocket first.",
                        code="link_failed",
                    ) from None
                time.sleep(0.05)
        self.rejected: deque[str] = deque(maxlen=16)
        self._state: StateMessage | None = None
        self._new = Event()
        self._thread = Thread(target=self._receive, name="airtact client", daemon=True)
        self._thread.start()

    def __enter__(self) -> "Client":
        return self

    def __exit__(self, *fault: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the connection, which removes the foci and objects of this client."""
        self._connection.close()
        self._thread.join()

    @property
    def state(self) -> StateMessage | None:
        """The newest state of the live loop; None until the first state arrives."""
        return self._state

    def next_state(self, timeout: float = 1.0) -> StateMessage | None:
        """Wait up to ``timeout`` seconds for a state that this method has not returned yet.

        Returns
        -------
        The state; None if no new state arrived in time.
        """
        if not self._new.wait(timeout):
            return None
        self._new.clear()
        return self._state

    def objects(self, *objects: VirtualObject) -> None:
        """Add objects, or replace those with the same names; unnamed objects are given names."""
        added = [ObjectMessage.of(thing) for thing in objects_of(objects)]
        self._send(ObjectsMessage(VERSION, add=added))

    def move(self, name: str, pose: Pose) -> None:
        """Move an object to a new pose in the scene."""
        self._send(ObjectsMessage(VERSION, move=[MoveMessage(name, PoseMessage.of(pose))]))

    def remove(self, *names: str) -> None:
        """Remove objects by name."""
        self._send(ObjectsMessage(VERSION, remove=list(names)))

    def foci(self, *foci: WantedFocus) -> None:
        """Request foci, which replace all earlier foci of this client."""
        self._send(FociMessage(VERSION, [focus.message() for focus in foci]))

    def hands(self, *frames: HandFrame) -> None:
        """Send frames of the left hand, the right hand or both, in the tracker's coordinates."""
        self._send(HandsMessage(VERSION, [msgspec.Raw(to_json(frame)) for frame in frames]))

    def clear(self) -> None:
        """Remove all foci and objects of this client."""
        self._send(ClearMessage(VERSION))

    def _send(self, message: Message) -> None:
        from websockets.exceptions import ConnectionClosed

        try:
            self._connection.send(msgspec.json.encode(message), text=True)
        except ConnectionClosed:
            raise InvalidInput(
                "the live loop has closed the connection; start it again.", code="link_failed"
            ) from None

    def _receive(self) -> None:
        from websockets.exceptions import ConnectionClosed

        with suppress(ConnectionClosed):
            while True:
                answer = read_answer(self._connection.recv())
                if isinstance(answer, RejectedMessage):
                    self.rejected.append(answer.reason)
                elif isinstance(answer, StateMessage):
                    self._state = answer
                    self._new.set()
