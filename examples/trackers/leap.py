"""Send the hands tracked by a Leap Motion controller to airtact, as JSON over a websocket.

The script reads the websocket of the Leap service (protocol 6, ws://127.0.0.1:6437/v6.json) and
only requires the package ``websockets``::

    python leap.py --to ws://127.0.0.1:8765

The landmarks are the 25 joints of WebXR in the frame of the controller, in metres (the service uses
millimetres). The origin is the middle of its top; x points to the right along its long side, y
upward, and z toward the user. Times are those of the controller's clock.

Source: *WebSocket Communication*, Leap Motion developer documentation 2.3.
"""

import argparse
import json
from collections.abc import Iterator
from typing import Any

JOINTS = ("carpPosition", "mcpPosition", "pipPosition", "dipPosition", "btipPosition")
"""Ends of the bones of a finger, from the wrist to the tip; the thumb does not have the first."""


def main() -> None:
    """Receive messages from the service and send frames until either connection ends."""
    from websockets.exceptions import ConnectionClosed
    from websockets.sync.client import connect

    parser = argparse.ArgumentParser(
        description="Send the hands tracked by a Leap Motion controller to airtact."
    )
    parser.add_argument("--to", default="ws://127.0.0.1:8765", help="address of the receiver")
    parser.add_argument(
        "--service", default="ws://127.0.0.1:6437/v6.json", help="address of the Leap service"
    )
    options = parser.parse_args()
    with (
        connect(options.service, max_size=None) as service,
        connect(options.to, compression=None) as receiver,
    ):
        service.send(json.dumps({"background": True}))
        try:
            for frame in hands_in(message for message in service if isinstance(message, str)):
                receiver.send(json.dumps(frame))
        except ConnectionClosed:
            return


def hands_in(messages: Iterator[str]) -> Iterator[dict[str, Any]]:
    """Yield a frame for each hand in the messages of the service.

    A frame without landmarks means that a hand was lost. Missing joints are null. Messages that do
    not contain frames are ignored.
    """
    seen: set[str] = set()
    for message in messages:
        frame = json.loads(message)
        if "hands" not in frame or "timestamp" not in frame:
            continue
        fingers: dict[Any, dict[int, dict[str, Any]]] = {}
        for finger in frame.get("pointables", []):
            fingers.setdefault(finger.get("handId"), {})[finger.get("type")] = finger
        by_side = {
            hand["type"]: _landmarks(hand, fingers.get(hand["id"], {})) for hand in frame["hands"]
        }
        for side in sorted(seen | set(by_side)):
            yield {
                "time": 1e-6 * frame["timestamp"],
                "side": side,
                "sequence": int(frame["id"]),
                "landmarks": by_side.get(side),
            }
        seen = set(by_side)


def _landmarks(
    hand: dict[str, Any], fingers: dict[int, dict[str, Any]]
) -> list[list[float] | None]:
    joints = [hand.get("wrist")]
    for kind in range(5):
        finger = fingers.get(kind, {})
        joints += [finger.get(joint) for joint in (JOINTS if kind else JOINTS[1:])]
    return [joint and [round(1e-3 * coordinate, 6) for coordinate in joint] for joint in joints]


if __name__ == "__main__":
    main()
