"""Landmarks to pictures to MediaPipe and back: our hands drawn, found by the adapter in its own process, compared."""

import os
import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.image import imsave
from scipy.spatial.transform import Rotation

from airtact.hands.joints import hand_length
from airtact.hands.tracking.receivers import WebSocketReceiver
from airtact.hands.tracking.stream import HandStream, StreamHealth
from references.hand_pictures import FOCAL, pictured
from references.hand_poses_seen import twenty

TRACKERS = Path(__file__).parents[1] / "examples" / "trackers"

MEDIAPIPE = os.environ.get("AIRTACT_MEDIAPIPE")
"""A Python that has mediapipe 0.10.21 and websockets, or None."""

TRACKED = np.delete(np.arange(25), [5, 10, 15, 20])


@dataclass(frozen=True, eq=False)
class Seen:
    """Mean errors of the 21 landmarks of each hand that was found [m], and what the stream counted.

    ``shape_errors`` after the best motion, turn and scale; ``rigid_errors`` after motion and turn,
    the hand's length being known; ``placed_errors`` as they come, in the camera's frame.
    """

    shape_errors: np.ndarray
    rigid_errors: np.ndarray
    placed_errors: np.ndarray
    health: StreamHealth


def brought_onto(shape: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Move, turn and scale points so that they lie best on others."""
    centred, aim = shape - shape.mean(axis=0), other - other.mean(axis=0)
    rotation, _ = Rotation.align_vectors(aim, centred)
    turned = rotation.apply(centred)
    return other.mean(axis=0) + (turned * aim).sum() / (turned**2).sum() * turned


def seen_by_mediapipe(folder: Path, python: str, turns: float = 20.0) -> Seen:
    """Draw twenty hands, let MediaPipe find them, compare.

    Parameters
    ----------
    folder : for the pictures.
    python : that has mediapipe.
    turns : the palm is turned from the camera by so many degrees at most, about each axis.
    """
    true = {}
    for index, (hand, pose) in enumerate(twenty(turns)):
        imsave(folder / f"{index:02d}.png", pictured(hand, pose).colours)
        true[index] = pose.apply(hand.joints)
    frames = []
    stream = HandStream(on_frame=frames.append, silence=60.0)
    length = np.median([hand_length(joints) for joints in true.values()])
    with WebSocketReceiver(stream) as receiver:
        command = [
            python,
            str(TRACKERS / "mediapipe_camera.py"),
            "--pictures",
            str(folder),
            "--focal",
            str(FOCAL),
            "--hands",
            "1",
        ]
        command += [
            "--side",
            "left",
            "--hand-length",
            f"{length:.4f}",
            "--to",
            f"ws://127.0.0.1:{receiver.port}",
        ]
        done = subprocess.run(command, capture_output=True, text=True, timeout=300)
        assert done.returncode == 0, done.stderr[-2000:]
    errors = []
    for frame in frames:
        if frame.landmarks is not None:
            joints, found = true[frame.sequence][TRACKED], frame.landmarks
            scaled = brought_onto(found, joints)
            size = np.linalg.norm(found - found.mean(axis=0)) / np.linalg.norm(
                scaled - scaled.mean(axis=0)
            )
            rigid = joints.mean(axis=0) + size * (scaled - joints.mean(axis=0))
            errors.append(
                [np.linalg.norm(one - joints, axis=1).mean() for one in (scaled, rigid, found)]
            )
    return Seen(*np.array(errors).reshape(-1, 3).T, stream.health)
