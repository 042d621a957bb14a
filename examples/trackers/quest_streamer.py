"""Send the hands of a Meta Quest to airtact, as JSON over a websocket.

The app hand-tracking-streamer on the Quest sends lines of text to this computer over UDP, by
default to port 9000. This script only requires the package ``websockets``::

    python quest_streamer.py --to ws://127.0.0.1:8765

The landmarks are 21 joints in metres. As on the Quest, x points to the right and y upward. z points
toward the user; the app's z points the other way, which makes its axes left-handed. The app does
not send times, so the time of a frame is the time of its arrival.

Source: ``CONNECTIONS.md`` of hand-tracking-streamer.
"""

import argparse
import json
import socket
import time
from collections.abc import Iterator
from typing import Any


def main() -> None:
    """Receive lines and send frames until the receiver ends."""
    from websockets.exceptions import ConnectionClosed
    from websockets.sync.client import connect

    parser = argparse.ArgumentParser(description="Send the hands of a Meta Quest to airtact.")
    parser.add_argument("--to", default="ws://127.0.0.1:8765", help="address of the receiver")
    parser.add_argument("--port", type=int, default=9000, help="UDP port that the app sends to")
    options = parser.parse_args()
    with (
        connect(options.to, compression=None) as receiver,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as app,
    ):
        app.bind(("", options.port))
        app.settimeout(1.0)
        try:
            for frame in frames_in(_lines(app, receiver)):
                receiver.send(json.dumps(frame))
        except ConnectionClosed:
            return


def _lines(app: socket.socket, receiver: Any) -> Iterator[tuple[float, str]]:
    """Yield lines with the times of their arrival [s]."""
    while True:
        try:
            packet = app.recv(65536)
        except TimeoutError:
            receiver.ping()  # raises an error if the receiver has ended
            continue
        for line in packet.decode(errors="replace").splitlines():
            yield time.monotonic(), line


def frames_in(lines: Iterator[tuple[float, str]]) -> Iterator[dict[str, Any]]:
    """Yield a frame for each line of landmarks; the wrist is in an earlier line."""
    wrists: dict[str, list[float]] = {}
    sequence = 0
    for arrived, line in lines:
        label, _, text = line.partition(":")
        side, _, kind = label.strip().lower().partition(" ")
        try:
            numbers = [float(number) for number in text.strip(", ").split(",")]
        except ValueError:
            continue
        if kind == "wrist" and len(numbers) == 7:
            wrists[side] = numbers
        elif kind == "landmarks" and side in wrists and len(numbers) == 63:
            points = [numbers[start : start + 3] for start in range(0, 63, 3)]
            yield {
                "time": arrived,
                "side": side,
                "sequence": sequence,
                "landmarks": [_placed(point, wrists[side]) for point in points],
            }
            sequence += 1


def _placed(point: list[float], wrist: list[float]) -> list[float]:
    """Turn a point by the wrist's quaternion (x, y, z, w), shift it, and reverse z."""
    a, b, c = point
    x, y, z, w = wrist[3:]
    # Twice the cross product of the vector part and the point: the rotation is
    # p + w t + (x, y, z) x t.
    t = (2 * (y * c - z * b), 2 * (z * a - x * c), 2 * (x * b - y * a))
    turned = (
        a + w * t[0] + y * t[2] - z * t[1],
        b + w * t[1] + z * t[0] - x * t[2],
        c + w * t[2] + x * t[1] - y * t[0],
    )
    u, v, depth = (round(turned[axis] + wrist[axis], 6) for axis in range(3))
    return [u, v, -depth]


if __name__ == "__main__":
    main()
