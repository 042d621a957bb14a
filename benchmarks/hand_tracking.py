"""Error of a predicted pad, time of frames, and detections of MediaPipe in pictures of our hands.

Run ``python -m benchmarks.hand_tracking [--mediapipe PYTHON]``; PYTHON is one
that has mediapipe
0.10.21 and websockets. The motion is synthesised: reaching 150 mm to and fro at up to 0.5 m/s by
minimum jerk, while thumb and index finger open from 5 to 45 mm and close once a second; the
tracker's noise is white, 1 mm in each coordinate.
"""

import argparse
import tempfile
import time
from itertools import pairwise
from pathlib import Path

import numpy as np

from airtact.hands.hand import hand_from_joints
from airtact.hands.tracking.frame import FaultyFrame, HandFrame
from airtact.hands.tracking.messages import from_json, to_json
from airtact.hands.tracking.prediction import Predictor
from airtact.hands.tracking.stream import HandStream
from references.motions import Pinching
from references.seen_by_mediapipe import seen_by_mediapipe

SECONDS, NOISE = 3.0, 1e-3
CUTOFF, CUTOFF_PER_SPEED, CUTOFF_OF_VELOCITY = 8.0, 100.0, 8.0
"""Of the one-euro filter [Hz, 1/m, Hz]: best or nearly of 64 settings on this very motion."""


def pad(joints: np.ndarray, radii: np.ndarray) -> np.ndarray:
    return hand_from_joints(joints, radii, side="left").pads[1]


def one_euro(frames: list[HandFrame], latency: float) -> list[np.ndarray]:
    """Smooth and extrapolate by the filter of Casiez, Roussel and Vogel (CHI 2012) and its derivative."""

    def share(cutoff: np.ndarray | float, step: float) -> np.ndarray | float:
        return 1.0 / (1.0 + 1.0 / (2.0 * np.pi * cutoff * step))

    position, velocity, carried = frames[0].landmarks, np.zeros((25, 3)), [frames[0].landmarks]
    for before, frame in pairwise(frames):
        step = frame.time - before.time
        change = (frame.landmarks - before.landmarks) / step
        velocity = velocity + share(CUTOFF_OF_VELOCITY, step) * (change - velocity)
        cutoff = CUTOFF + CUTOFF_PER_SPEED * np.linalg.norm(velocity, axis=1, keepdims=True)
        position = position + share(cutoff, step) * (frame.landmarks - position)
        carried.append(position + latency * velocity)
    return carried


def kalman(frames: list[HandFrame], latency: float) -> list[np.ndarray]:
    predictor, carried = Predictor(latency, NOISE), []
    for frame in frames:
        predictor.take(frame)
        carried.append(predictor.at(frame.time).landmarks)
    return carried


def free_points(frames: list[HandFrame], latency: float) -> list[np.ndarray]:
    """Extrapolate each landmark by itself: a Kalman filter of its position and velocity."""
    state, covariance = (
        np.stack([frames[0].landmarks, np.zeros((25, 3))]),
        np.diag([NOISE**2, 0.25]),
    )
    carried = [frames[0].landmarks]
    for before, frame in pairwise(frames):
        step = frame.time - before.time
        ahead = np.array([[1.0, step], [0.0, 1.0]])
        push = 0.3 * np.array([[step**3 / 3.0, step**2 / 2.0], [step**2 / 2.0, step]])
        state, covariance = np.tensordot(ahead, state, 1), ahead @ covariance @ ahead.T + push
        gain = covariance[:, 0] / (covariance[0, 0] + NOISE**2)
        state = state + np.multiply.outer(gain, frame.landmarks - state[0])
        covariance = covariance - np.outer(gain, covariance[0])
        carried.append(state[0] + latency * state[1])
    return carried


def prediction() -> None:
    motion = Pinching()
    print(
        "| frames | latency | last frame | one-euro | free points | bones | bones, 95 of 100 "
        "| thumb to index: last frame | free points | bones |\n" + 10 * "|---" + "|"
    )
    for rate in (30, 90):
        frames = motion.frames(rate, SECONDS, NOISE)
        stale = np.array([pad(frame.landmarks, motion.radii) for frame in frames])
        for latency in (0.02, 0.05, 0.1):
            true = np.array(
                [pad(motion.at(frame.time + latency), motion.radii) for frame in frames]
            )
            errors = [np.linalg.norm(stale - true, axis=1)]
            gaps = [gap_error([frame.landmarks for frame in frames], frames, motion, latency)]
            for method in (one_euro, free_points, kalman):
                carried = method(frames, latency)
                gaps.append(gap_error(carried, frames, motion, latency))
                pads = []
                for joints in carried:
                    try:
                        pads.append(pad(joints, motion.radii))
                    except (ValueError, FaultyFrame):
                        pads.append(np.full(3, np.nan))
                errors.append(np.linalg.norm(np.array(pads) - true, axis=1))
            means = " | ".join(f"{1e3 * np.nanmean(one[10:]):.1f} mm" for one in errors)
            most = 1e3 * np.quantile(errors[3][10:], 0.95)
            of_gaps = " | ".join(f"{1e3 * gaps[index]:.1f} mm" for index in (0, 2, 3))
            print(
                f"| {rate} /s | {1e3 * latency:.0f} ms | {means} | {most:.1f} mm | {of_gaps} |",
                flush=True,
            )


def gap_error(
    carried: list[np.ndarray], frames: list[HandFrame], motion: Pinching, latency: float
) -> float:
    """Mean error of the vector between the tips of thumb and index finger after a second [m]."""
    true = np.array([motion.at(frame.time + latency) for frame in frames])
    off = np.array(carried) - true
    after = [frame.time >= 1.0 for frame in frames]
    return float(np.linalg.norm(off[after, 4] - off[after, 9], axis=1).mean())


def speed() -> None:
    frames = Pinching(3).frames(90, 2.0)
    messages = [to_json(frame) for frame in frames]
    began = time.perf_counter()
    for message in messages:
        from_json(message)
    print(f"a frame ({len(messages[0]):,} bytes) read and checked: {_each(began, frames)}")
    stream, predictor = HandStream(), Predictor(0.05)
    began = time.perf_counter()
    for frame in frames:
        stream.feed(frame)
        predictor.take(frame)
        predictor.at(frame.time)
    print(f"through the stream and the predictor: {_each(began, frames)}")


def _each(began: float, frames: list[HandFrame]) -> str:
    return f"{1e3 * (time.perf_counter() - began) / len(frames):.2f} ms"


def pictures(python: str) -> None:
    for turns in (20.0, 40.0):  # palms turned this far are harder
        with tempfile.TemporaryDirectory() as folder:
            found = seen_by_mediapipe(Path(folder), python, turns)
        kinds = (found.shape_errors, found.rigid_errors, found.placed_errors)
        scaled, rigid, placed = (
            f"{1e3 * np.mean(one):.1f} (median {1e3 * np.median(one):.1f}) mm" for one in kinds
        )
        print(
            f"palm turned up to {turns:.0f}°: {len(found.shape_errors)} of 20 found by MediaPipe, off by {scaled}"
        )
        print(
            f"  after motion and scale, {rigid} after motion, {placed} where the camera sees them",
            flush=True,
        )


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--mediapipe", help="a Python that has mediapipe and websockets")
    chosen = parser.parse_args()
    prediction()
    speed()
    if chosen.mediapipe:
        pictures(chosen.mediapipe)
