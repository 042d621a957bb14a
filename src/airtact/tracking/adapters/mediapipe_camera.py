"""Send the hands that MediaPipe finds in a camera's pictures to airtact, as frames in JSON by websocket.

MediaPipe 0.10.21 wants NumPy 1, airtact NumPy 2, so this file imports nothing of airtact and runs in an environment of
its own::

    python3 -m venv camera
    camera/bin/pip install mediapipe==0.10.21 'websockets<17'
    camera/bin/python mediapipe_camera.py --to ws://127.0.0.1:8765

Landmarks are the 21 of MediaPipe in the camera's frame: origin at its lens, x to the right and y down in its picture,
z away from it, in metres. MediaPipe tells the shape of the hand twice, each time with errors of its own: as *world
landmarks*, metres round the middle of the hand, and as landmarks in the picture with a depth; the mean of both is moved
and turned until it is seen in its place, by ``solvePnP`` with the focal length. How large the hand is cannot be told
from a picture: MediaPipe guesses, unless ``--hand-length`` is given, and distance grows with size. Time is this
computer's, when the picture was there.
"""

import argparse
import json
import math
import time
from collections.abc import Iterator
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


def _hands_in(pictures: Iterator[tuple[float, Picture]], options: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """Find hands in pictures.

    Parameters
    ----------
    pictures : times [s] and pictures.
    options : of the command line.

    Yields
    ------
    Frames as airtact takes them: of each side that is seen, and one that is lost where a side is no longer seen.
    """
    import mediapipe  # pyright: ignore[reportMissingImports]

    seen: set[str] = set()
    solution = mediapipe.solutions.hands  # pyright: ignore[reportAttributeAccessIssue]
    still = options.pictures is not None
    with solution.Hands(
        static_image_mode=still, max_num_hands=options.hands, min_detection_confidence=options.confidence
    ) as finder:
        for sequence, (taken, picture) in enumerate(pictures):
            result = finder.process(picture)
            sides = {}
            for label, image, world in zip(
                result.multi_handedness or (),
                result.multi_hand_landmarks or (),
                result.multi_hand_world_landmarks or (),
                strict=True,
            ):
                side = label.classification[0].label.lower()
                if not options.mirrored:  # MediaPipe takes pictures for those of a mirror
                    side = "left" if side == "right" else "right"
                sides.setdefault(side, _placed(image.landmark, world.landmark, picture.shape, options))
            for side in sorted(seen | set(sides) | ({options.side} if options.side else set())):
                if options.side in (None, side):
                    yield {"time": taken, "side": side, "sequence": sequence, "landmarks": sides.get(side)}
            seen = set(sides)


def _placed(image: Any, world: Any, shape: tuple[int, ...], options: argparse.Namespace) -> Landmarks:
    """Bring the shape of a hand to where it is seen, in the camera's frame [m].

    Parameters
    ----------
    image, world : landmarks of MediaPipe: in shares of the picture's sides, and in metres round the hand's middle.
    shape : rows and columns of the picture.
    options : of the command line; focal length and hand length.
    """
    import cv2  # pyright: ignore[reportMissingImports]
    import numpy as np

    rows, columns = shape[:2]
    flat = np.array([[one.x * columns, one.y * rows, one.z * columns] for one in image])
    body = np.array([[one.x, one.y, one.z] for one in world])
    body = 0.5 * (body + _brought_onto(flat, body))
    if options.hand_length:
        body *= options.hand_length / sum(float(np.linalg.norm(body[b] - body[a])) for a, b in pairwise(MIDDLE_FINGER))
    pixels = np.ascontiguousarray(flat[:, :2])
    focal = options.focal or 0.5 * columns / math.tan(math.radians(0.5 * VIEW))
    lens = np.array([[focal, 0.0, columns / 2], [0.0, focal, rows / 2], [0.0, 0.0, 1.0]])
    # Begin with the shape as it is, so far off that it looks as large: it needs a small turn only.
    size = np.ptp(pixels, axis=0).max() / np.ptp(body[:, :2], axis=0).max()
    away = focal / size
    middle = (pixels.mean(axis=0) - lens[:2, 2]) / focal * away
    start = np.zeros(3), np.array([*middle, away])
    _, turn, shift = cv2.solvePnP(body, pixels, lens, None, start[0], start[1], useExtrinsicGuess=True)
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
            yield index / options.rate, cv2.cvtColor(cv2.imread(str(path)), cv2.COLOR_BGR2RGB)
        return
    camera = cv2.VideoCapture(int(options.camera) if options.camera.isdigit() else options.camera)
    if not camera.isOpened():
        raise SystemExit(f"camera {options.camera} cannot be opened; give another number, or the path of a video.")
    while True:
        there, picture = camera.read()
        if not there:
            return
        yield time.time(), cv2.cvtColor(picture, cv2.COLOR_BGR2RGB)


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="Send hands that MediaPipe finds in pictures to airtact.")
    parser.add_argument("--to", help="address of the receiver, ws://127.0.0.1:8765; JSON lines are printed without it")
    parser.add_argument("--camera", default="0", help="number of the camera, or a video file; 0 by default")
    parser.add_argument("--pictures", type=Path, help="take the .png files of this folder instead of a camera")
    parser.add_argument("--rate", type=float, default=30.0, help="pictures of a folder per second; 30 by default")
    parser.add_argument("--mirrored", action="store_true", help="the pictures are mirrored, as of a selfie camera")
    parser.add_argument("--focal", type=float, help="focal length in pixels; that of a view of 60 degrees by default")
    parser.add_argument("--hand-length", type=float, help="wrist to middle fingertip along the bones, in metres")
    parser.add_argument("--side", choices=("left", "right"), help="send this hand only")
    parser.add_argument("--hands", type=int, default=2, help="so many hands at most; 2 by default")
    parser.add_argument("--confidence", type=float, default=0.5, help="of a hand that is found, 0 to 1; 0.5 by default")
    return parser.parse_args()


if __name__ == "__main__":
    main()
