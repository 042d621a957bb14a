"""Send the hands that MediaPipe finds in camera images to airtact, as JSON over a websocket.

MediaPipe 0.10.21 requires NumPy 1, whereas airtact requires NumPy 2. This script does not import
airtact and can run in a separate environment::

    python3 -m venv camera
    camera/bin/pip install mediapipe==0.10.21 'websockets<17'
    camera/bin/python mediapipe_camera.py --to ws://127.0.0.1:8765

The landmarks are the 21 landmarks of MediaPipe in the frame of the camera, in metres. The origin is
the lens; x points to the right and y down in the image, and z away from the camera.

MediaPipe returns the shape of a hand twice, with independent errors: as *world landmarks* in metres
about the centre of the hand, and as landmarks in the image with a depth. Unless ``--once`` is set,
the script also processes the mirror image. The mean of all shapes is moved and rotated until its
projection matches the image (``solvePnP`` with the focal length). The size of the hand cannot be
determined from an image: MediaPipe guesses it unless ``--hand-length`` is set, and the distance is
proportional to the size. The time of a frame is the time of this computer when the image arrived.
"""

import argparse
import json
import math
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

Picture = Any
"""Array of rows and columns with three colours of 8 bits: red, green and blue."""


def main() -> None:
    """Read images, find hands, and send frames until there are no more images."""
    options = _options()
    frames = _hands_in(_pictures(options), options)
    if options.to is None:
        for frame in frames:
            print(json.dumps(frame), flush=True)
        return
    from websockets.sync.client import connect

    with connect(options.to, compression=None) as receiver:
        for frame in frames:
            receiver.send(json.dumps(frame))


def _hands_in(
    pictures: Iterator[tuple[float, Picture]], options: argparse.Namespace
) -> Iterator[dict[str, Any]]:
    """Yield a frame for each hand in timed images, and a lost frame when a hand disappears."""
    import mediapipe
    import numpy as np

    seen: set[str] = set()
    finder = partial(
        mediapipe.solutions.hands.Hands,
        static_image_mode=options.pictures is not None,
        max_num_hands=options.hands,
        min_detection_confidence=options.confidence,
    )
    # A detector tracks its hand from image to image, so mirror images have a separate one.
    with finder() as direct, finder() as mirrored:
        for sequence, (taken, picture) in enumerate(pictures):
            looks = _look(direct.process(picture), mirrored=False)
            if not options.once:
                looks += _look(
                    mirrored.process(np.ascontiguousarray(picture[:, ::-1])), mirrored=True
                )
            by_side: dict[str, list[tuple[Any, Any]]] = {}
            for side, look in looks:
                by_side.setdefault(side, []).append(look)
            seen_or_asked = sorted(seen | set(by_side)) if options.side is None else [options.side]
            for side in seen_or_asked:
                joints = None
                if side in by_side:
                    joints = _placed(by_side[side], picture.shape, options)
                yield {"time": taken, "side": side, "sequence": sequence, "landmarks": joints}
            seen = set(by_side)


def _look(result: Any, mirrored: bool) -> list[tuple[str, tuple[Any, Any]]]:
    """Return the sides of the hands in an image, and their landmarks in the image and in metres."""
    import numpy as np

    def array(points: Any) -> Any:
        return np.array([[point.x, point.y, point.z] for point in points.landmark])

    hands = {}
    for label, image, world in zip(
        result.multi_handedness or (),
        result.multi_hand_landmarks or (),
        result.multi_hand_world_landmarks or (),
        strict=True,
    ):
        side = label.classification[0].label.lower()
        if not mirrored:  # MediaPipe assumes mirrored images
            side = "left" if side == "right" else "right"
        flat = array(image)
        body = array(world)
        if mirrored:
            flat = flat * [-1, 1, 1] + [1, 0, 0]
            body = body * [-1, 1, 1]
        hands.setdefault(side, (flat, body))
    return list(hands.items())


def _placed(
    looks: list[tuple[Any, Any]], shape: tuple[int, ...], options: argparse.Namespace
) -> list[list[float]]:
    """Place the shape of a hand in the camera's frame as seen in an image [m].

    ``looks`` are landmarks of MediaPipe, as fractions of the picture's sides, and in
    metres about the hand's centre.
    """
    import cv2
    import numpy as np

    rows, columns = shape[:2]
    flats = [flat * [columns, rows, columns] for flat, _ in looks]
    first = looks[0][1]
    shapes = [*(body for _, body in looks), *flats]
    body = np.mean([_aligned(shape, first) for shape in shapes], axis=0)
    if options.hand_length:
        middle_finger = body[[0, 9, 10, 11, 12]]  # from the wrist to the tip
        lengths = np.linalg.norm(np.diff(middle_finger, axis=0), axis=1)
        body *= options.hand_length / float(lengths.sum())
    pixels = np.mean(flats, axis=0)[:, :2].copy()
    focal = options.focal or 0.5 * columns / math.tan(math.radians(0.5 * 60.0))
    lens = np.array([[focal, 0.0, columns / 2], [0.0, focal, rows / 2], [0.0, 0.0, 1.0]])
    # Start at the distance where the shape has the observed size; a small rotation remains.
    size = np.ptp(pixels, axis=0).max() / np.ptp(body[:, :2], axis=0).max()
    away = focal / size
    start = np.array([*((pixels.mean(axis=0) - lens[:2, 2]) / focal * away), away])
    _, turn, shift = cv2.solvePnP(
        body, pixels, lens, None, np.zeros(3), start, useExtrinsicGuess=True
    )
    rotation, _ = cv2.Rodrigues(turn)
    return (body @ rotation.T + shift.ravel()).round(6).tolist()


def _aligned(shape: Any, target: Any) -> Any:
    """Translate, rotate and scale points (P, 3) to fit target points (P, 3) by least squares.

    Source: S. Umeyama, IEEE Trans. Pattern Anal. Mach. Intell. 13, 376 (1991).
    """
    import numpy as np

    centred = shape - shape.mean(axis=0)
    aim = target - target.mean(axis=0)
    left, sizes, right = np.linalg.svd(aim.T @ centred)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    scale = (sizes * signs).sum() / (centred**2).sum()
    return scale * centred @ ((left * signs) @ right).T + target.mean(axis=0)


def _pictures(options: argparse.Namespace) -> Iterator[tuple[float, Picture]]:
    import cv2

    if options.pictures is not None:
        for index, path in enumerate(sorted(options.pictures.glob("*.png"))):
            yield index / options.rate, _upright(cv2.imread(str(path)), options)
        return
    camera = cv2.VideoCapture(int(options.camera) if options.camera.isdigit() else options.camera)
    if not camera.isOpened():
        raise SystemExit(
            f"camera {options.camera} cannot be opened; use another number or the path of a video."
        )
    while True:
        taken, picture = camera.read()
        if not taken:
            return
        yield time.time(), _upright(picture, options)


def _upright(picture: Picture, options: argparse.Namespace) -> Picture:
    """Convert the colours, and flip mirrored images."""
    import cv2
    import numpy as np

    colours = cv2.cvtColor(picture, cv2.COLOR_BGR2RGB)
    return np.ascontiguousarray(colours[:, ::-1]) if options.mirrored else colours


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description="Send the hands that MediaPipe finds in camera images to airtact."
    )
    parser.add_argument(
        "--to",
        help="address of the receiver, such as ws://127.0.0.1:8765; by default, frames are printed",
    )
    parser.add_argument(
        "--camera", default="0", help="number of the camera, or a video file (default: 0)"
    )
    parser.add_argument(
        "--pictures", type=Path, help="read the .png files in this folder instead of a camera"
    )
    parser.add_argument(
        "--rate", type=float, default=30.0, help="rate of these files per second (default: 30)"
    )
    parser.add_argument(
        "--mirrored", action="store_true", help="the images are mirrored, as from a selfie camera"
    )
    parser.add_argument(
        "--once", action="store_true", help="skip the mirror images: faster, but less accurate"
    )
    parser.add_argument(
        "--focal",
        type=float,
        help="focal length in pixels; by default, that of a field of view of 60 degrees",
    )
    parser.add_argument(
        "--hand-length", type=float, help="length of the bones from wrist to middle fingertip [m]"
    )
    parser.add_argument("--side", choices=("left", "right"), help="only send this hand")
    parser.add_argument("--hands", type=int, default=2, help="largest number of hands (default: 2)")
    parser.add_argument(
        "--confidence",
        type=float,
        default=0.5,
        help="smallest confidence of a detected hand, 0 to 1 (default: 0.5)",
    )
    return parser.parse_args()


if __name__ == "__main__":
    main()
