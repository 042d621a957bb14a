"""Send the hands that MediaPipe finds in a camera's pictures to airtact, as frames in JSON by websocket.

MediaPipe 0.10.21 wants NumPy 1, airtact NumPy 2, so this file imports nothing of airtact and runs
in an environment of its own::

    python3 -m venv camera
    camera/bin/pip install mediapipe==0.10.21 'websockets<17'
    camera/bin/python mediapipe_camera.py --to ws://127.0.0.1:8765

Landmarks are the 21 of MediaPipe in the camera's frame: origin at its lens, x to the right and y
down in its picture, z away from it, in metres. MediaPipe gives the shape of the hand twice, each
time with errors of its own: as *world landmarks*, metres round the middle of the hand, and as
landmarks in the picture with a depth; the mirror image is looked at as well, unless ``--once``. The
mean of all is moved and turned until it is seen in its place, by ``solvePnP`` with the focal
length. The size of the hand cannot be known from a picture: MediaPipe guesses, unless
``--hand-length`` is given, and distance grows with size. Time is this computer's, when the picture
was there.
"""

import argparse
import json
import math
import time
from collections.abc import Iterator
from contextlib import ExitStack
from itertools import pairwise
from pathlib import Path
from typing import Any

VIEW = 60.0
"""Angle of view of a camera from side to side unless its focal length is given [degrees]."""

MIDDLE_FINGER = (0, 9, 10, 11, 12)
"""Wrist to the tip of the middle finger, in MediaPipe's order."""

Picture = Any
"""Rows, columns and three colours of 8 bits: red, green, blue."""

Landmarks = list[list[float]]


def main() -> None:
    """Read the pictures, find the hands, send the frames, until there are no more."""
    options = _options()
    found = _hands_in(_pictures(options), options)
    if options.to is None:
        for frame in found:
            print(json.dumps(frame), flush=True)
        return
    from websockets.sync.client import connect

    with connect(options.to, compression=None) as receiver:
        for frame in found:
            receiver.send(json.dumps(frame))


def _hands_in(
    pictures: Iterator[tuple[float, Picture]], options: argparse.Namespace
) -> Iterator[dict[str, Any]]:
    """Give frames of each side seen in pictures with their times [s], and a lost one where a side is seen no longer."""
    import mediapipe  # pyright: ignore[reportMissingImports]
    import numpy as np

    seen: set[str] = set()
    solution = mediapipe.solutions.hands  # pyright: ignore[reportAttributeAccessIssue]
    settings = {"max_num_hands": options.hands, "min_detection_confidence": options.confidence}
    with ExitStack() as finders:
        # Each follows its own pictures from one to the next, so the mirror images have a finder of
        # their own.
        direct, mirrored = (
            finders.enter_context(
                solution.Hands(static_image_mode=options.pictures is not None, **settings)
            )
            for _ in range(2)
        )
        for sequence, (taken, picture) in enumerate(pictures):
            looks = _look(direct.process(picture), mirrored=False)
            if not options.once:
                looks += _look(
                    mirrored.process(np.ascontiguousarray(picture[:, ::-1])), mirrored=True
                )
            sides = {side: [look for own, look in looks if own == side] for side, _ in looks}
            for side in sorted(seen | set(sides) | ({options.side} if options.side else set())):
                if options.side in (None, side):
                    there = _placed(sides[side], picture.shape, options) if side in sides else None
                    yield {"time": taken, "side": side, "sequence": sequence, "landmarks": there}
            seen = set(sides)


def _look(result: Any, mirrored: bool) -> list[tuple[str, tuple[Any, Any]]]:
    """Read what was found in a picture, or in its mirror image: sides, landmarks in it and round the hand's middle."""
    import numpy as np

    found = {}
    lists: list[Any] = [
        result.multi_handedness,
        result.multi_hand_landmarks,
        result.multi_hand_world_landmarks,
    ]
    for label, image, world in zip(*(one or () for one in lists), strict=True):
        side = label.classification[0].label.lower()
        if not mirrored:  # MediaPipe takes every picture for that of a mirror
            side = "left" if side == "right" else "right"
        flat, body = (
            np.array([[one.x, one.y, one.z] for one in points.landmark])
            for points in (image, world)
        )
        if mirrored:
            flat, body = flat * [-1, 1, 1] + [1, 0, 0], body * [-1, 1, 1]
        found.setdefault(side, (flat, body))
    return list(found.items())


def _placed(
    looks: list[tuple[Any, Any]], shape: tuple[int, ...], options: argparse.Namespace
) -> Landmarks:
    """Bring the shape of a hand to where it is seen in a picture of some shape, in the camera's frame [m].

    ``looks`` are landmarks of MediaPipe, in shares of the picture's sides and in metres round the
    hand's middle.
    """
    import cv2  # pyright: ignore[reportMissingImports]
    import numpy as np

    rows, columns = shape[:2]
    flats = [flat * [columns, rows, columns] for flat, _ in looks]
    first = looks[0][1]
    body = np.mean(
        [_brought_onto(one, first) for one in [*(body for _, body in looks), *flats]], axis=0
    )
    if options.hand_length:
        body *= options.hand_length / sum(
            float(np.linalg.norm(body[b] - body[a])) for a, b in pairwise(MIDDLE_FINGER)
        )
    pixels = np.mean(flats, axis=0)[:, :2].copy()
    focal = options.focal or 0.5 * columns / math.tan(math.radians(0.5 * VIEW))
    lens = np.array([[focal, 0.0, columns / 2], [0.0, focal, rows / 2], [0.0, 0.0, 1.0]])
    # Begin with the shape as it is, so far off that it looks as large: it needs a small rotation
    # only.
    size = np.ptp(pixels, axis=0).max() / np.ptp(body[:, :2], axis=0).max()
    away = focal / size
    middle = (pixels.mean(axis=0) - lens[:2, 2]) / focal * away
    start = np.zeros(3), np.array([*middle, away])
    _, turn, shift = cv2.solvePnP(
        body, pixels, lens, None, start[0], start[1], useExtrinsicGuess=True
    )
    rotation, _ = cv2.Rodrigues(turn)
    return (body @ rotation.T + shift.ravel()).round(6).tolist()


def _brought_onto(shape: Any, other: Any) -> Any:
    """Move, turn and scale points (P, 3) so that they lie best on other points (P, 3); no mirror.

    Source: S. Umeyama, IEEE Trans. Pattern Anal. Mach. Intell. 13, 376 (1991).
    """
    import numpy as np

    centred, aim = shape - shape.mean(axis=0), other - other.mean(axis=0)
    left, sizes, right = np.linalg.svd(aim.T @ centred)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    scale = (sizes * signs).sum() / (centred**2).sum()
    return scale * centred @ ((left * signs) @ right).T + other.mean(axis=0)


def _pictures(options: argparse.Namespace) -> Iterator[tuple[float, Picture]]:
    import cv2  # pyright: ignore[reportMissingImports]

    if options.pictures is not None:
        for index, path in enumerate(sorted(options.pictures.glob("*.png"))):
            yield index / options.rate, _upright(cv2.imread(str(path)), options)
        return
    camera = cv2.VideoCapture(int(options.camera) if options.camera.isdigit() else options.camera)
    if not camera.isOpened():
        raise SystemExit(
            f"camera {options.camera} cannot be opened; give another number, or the path of a video."
        )
    while True:
        there, picture = camera.read()
        if not there:
            return
        yield time.time(), _upright(picture, options)


def _upright(picture: Picture, options: argparse.Namespace) -> Picture:
    """Put colours in order and undo a mirror."""
    import cv2  # pyright: ignore[reportMissingImports]
    import numpy as np

    colours = cv2.cvtColor(picture, cv2.COLOR_BGR2RGB)
    return np.ascontiguousarray(colours[:, ::-1]) if options.mirrored else colours


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description="Send hands that MediaPipe finds in pictures to airtact."
    )
    parser.add_argument(
        "--to",
        help="address of the receiver, ws://127.0.0.1:8765; JSON lines are printed without it",
    )
    parser.add_argument(
        "--camera", default="0", help="number of the camera, or a video file; 0 by default"
    )
    parser.add_argument(
        "--pictures", type=Path, help="take the .png files of this folder instead of a camera"
    )
    parser.add_argument(
        "--rate", type=float, default=30.0, help="pictures of a folder per second; 30 by default"
    )
    parser.add_argument(
        "--mirrored", action="store_true", help="the pictures are mirrored, as of a selfie camera"
    )
    parser.add_argument(
        "--once", action="store_true", help="do not look at mirror images too: quicker, more off"
    )
    parser.add_argument(
        "--focal",
        type=float,
        help="focal length in pixels; that of a view of 60 degrees by default",
    )
    parser.add_argument(
        "--hand-length", type=float, help="wrist to middle fingertip along the bones, in metres"
    )
    parser.add_argument("--side", choices=("left", "right"), help="send this hand only")
    parser.add_argument("--hands", type=int, default=2, help="so many hands at most; 2 by default")
    parser.add_argument(
        "--confidence",
        type=float,
        default=0.5,
        help="of a hand that is found, 0 to 1; 0.5 by default",
    )
    return parser.parse_args()


if __name__ == "__main__":
    main()
