"""How well touches place a tracker: trials with noise, bias and wrong touches.

python -m benchmarks.register                                # table
python -m benchmarks.register --figure docs/register.svg     # drawing of the how-to
"""

import argparse
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyArrowPatch

import airtact as at
from airtact.hands.tracking.registration import INDEX_TIP, Registration
from airtact.live.registering import elements_to_touch

TRIALS = 100
"""Number of trials of a row."""

NOISE, BIAS = 1e-3, 2e-3
"""Noise of each coordinate in a frame, and a constant error in the tracker's frame [m]."""


def trial(
    array: at.PhasedArray, random: np.random.Generator, slip: float, wrong: float
) -> tuple[Registration, int, float, float]:
    """Register a tracker at a random pose by six touches of a second at 60 frames/s.

    ``slip`` is the standard deviation of the touched place [m], ``wrong`` how far one touch is off
    [m]. Return the result, the wrong touch, and the errors 0.1 m over the middle [m] and of the
    rotation [°]. The hand is measured with the same bias as the touches.
    """
    elements = list(elements_to_touch(array))
    points, normals = array.positions[elements], array.normals[elements]
    offset = 6.6e-3
    tracker = at.Pose.turn(
        random.normal(size=3), random.uniform(0.0, np.pi), random.uniform(-0.5, 0.5, 3)
    )
    bias = random.normal(size=3)
    bias *= BIAS / np.linalg.norm(bias)
    noise = NOISE * random.normal(size=(60, 6, 3)).mean(axis=0) + slip * random.normal(size=(6, 3))
    touched = tracker.inverse().apply(points + offset * normals) + bias + noise
    index = int(random.integers(6))
    direction = random.normal(size=3)
    touched[index] += wrong * direction / np.linalg.norm(direction)
    found = at.hands.register(touched, points, normals, offset=offset)
    middle = points.mean(axis=0) + 0.1 * normals.mean(axis=0)
    off = found.tracker.apply(tracker.inverse().apply(middle) + bias) - middle
    turn = found.tracker.rotation @ tracker.rotation.T
    angle = np.degrees(np.arccos(min((np.trace(turn) - 1.0) / 2.0, 1.0)))
    return found, index, float(np.linalg.norm(off)), float(angle)


def main() -> None:
    """Print a table, or write the drawing."""
    parser = argparse.ArgumentParser(description="How well touches place a tracker.")
    parser.add_argument("--figure", type=Path, help="file of the drawing; no trials")
    options = parser.parse_args()
    if options.figure is not None:
        drawing().savefig(options.figure, bbox_inches="tight", metadata={"Date": None})
        return
    arrays = {
        "one AUTD3 board": at.autd3_board(),
        "four in a plane": at.flat_boards(2, 2),
        "box of four": at.surrounding_box(),
    }
    print("array | slip | wrong by | within 0.5 mm and 0.3° | 95th percentiles | named | misnamed")
    for name, array in arrays.items():
        for slip, wrong in ((0.0, 0.0), (0.0, 5e-3), (0.5e-3, 0.0), (0.5e-3, 10e-3)):
            random = np.random.default_rng(0)
            rows = [trial(array, random, slip, wrong) for _ in range(TRIALS)]
            errors = np.array([row[2:] for row in rows])
            good = int(((errors[:, 0] < 0.5e-3) & (errors[:, 1] < 0.3)).sum())
            position, angle = np.percentile(errors, 95, axis=0)
            named = sum(found.repeat == index for found, index, _, _ in rows) if wrong else 0
            misnamed = sum(found.repeat is not None for found, _, _, _ in rows) - named
            print(
                f"{name} | {1e3 * slip:.1f} mm | {1e3 * wrong:.0f} mm | {good} of {TRIALS} | "
                f"{1e3 * position:.2f} mm, {angle:.2f}° | {named} | {misnamed}"
            )


def drawing() -> Figure:
    """Draw a board with the transducers to touch, and a fingertip on one."""
    figure = Figure((7.2, 3.0))
    front, side = figure.subplots(1, 2, width_ratios=(1.7, 1.0))
    board = at.autd3_board()
    front.scatter(*1e3 * board.positions[:, :2].T, s=22, color="0.85")
    for number, element in enumerate(elements_to_touch(board), 1):
        x, y = 1e3 * board.positions[element, :2]
        front.add_patch(Circle((x, y), 5.0, facecolor="C0", edgecolor="none"))
        front.text(x, y, str(number), color="white", ha="center", va="center", fontsize=8)
        below = -10.5 if y < 60.0 else 10.5
        front.text(x, y + below, f"element {element}", ha="center", va="center", fontsize=7)
    front.set_title("six transducers, in this order", fontsize=9)
    _fingertip(side)
    for axes in (front, side):
        axes.set_aspect("equal")
        axes.autoscale_view()
        axes.axis("off")
    front.set_ylim(-17.0, 146.0)
    return figure


def _fingertip(axes: Axes) -> None:
    """Draw a fingertip on a transducer from the side [mm]."""
    radius = 6.6
    axes.plot([-14, 14], [0, 0], color="0.6", linewidth=6, solid_capstyle="butt")
    axes.text(0, -4.5, "face of the transducer", ha="center", va="center", fontsize=7)
    bone = np.array([[0.0, radius + 0.8], [18.0, radius + 12.0]])
    axes.plot(*bone.T, color="#e8c0a0", linewidth=30, solid_capstyle="round", zorder=0)
    axes.plot(*bone.T, "o-", color="C0", markersize=5)
    arrow = FancyArrowPatch(
        (-9, 0.8), (-9, radius + 0.8), arrowstyle="<->", mutation_scale=8, color="0.3"
    )
    axes.add_patch(arrow)
    axes.text(-10, 0.5 * radius + 0.8, "offset", ha="right", va="center", fontsize=7)
    axes.text(-1.5, radius + 7.0, f"joint {INDEX_TIP}:\nindex fingertip", ha="right", fontsize=7)
    axes.set_title("hold for a second", fontsize=9)
    axes.set_xlim(-24, 24)
    axes.set_ylim(-8, 30)


if __name__ == "__main__":
    main()
