"""Error and time of fitting a hand to what a depth camera saw of one side of it.

The reference is the GLB hand, and a slender and a stout build of it, bent by their own rig; the fit
was never tuned on ``child``, another build. Run ``python -m benchmarks.capture
[views [builds]]``, with so many views of each pose.
"""

import sys
import time
from itertools import product

import numpy as np

from airtact.hands.fitting.fit import FittedHand, fit_hand
from airtact.hands.joints import FINGERS
from references.rigged_hand import (
    BENDS,
    BUILDS,
    Rigged,
    off_each_other,
    posed,
    rough,
    seen,
    turned_to_camera,
)

CAMERA = np.zeros(3)
NAMES = (*FINGERS, "palm")


def report(what: str, fitted: FittedHand, true: Rigged, seconds: float) -> float:
    """Print how far the skins are apart in the mean, both ways, for each part, and return it."""
    from_true, from_fitted, part, other = off_each_other(fitted.hand, true)
    by_part = ", ".join(
        f"{name} {1e3 * from_true[part == index].mean():.1f}/{1e3 * from_fitted[other == index].mean():.1f}"
        for index, name in enumerate(NAMES)
    )
    mean = 0.5 * (from_true.mean() + from_fitted.mean())
    joints = np.linalg.norm(fitted.hand.joints - true.joints, axis=1).mean()
    print(
        f"{what}: {1e3 * mean:.2f} mm ({1e3 * from_true.mean():.2f} from the true skin, {1e3 * from_fitted.mean():.2f} "
        f"to it), joints {1e3 * joints:.1f} mm, {1e3 * seconds:.0f} ms; {by_part}",
        flush=True,
    )
    return float(mean)


def single_frames(views: int, builds: list[str]) -> None:
    """Fit single frames with the population's prior sizes, seen from random directions."""
    means = []
    for build, name, view in product(builds, BENDS, range(views)):
        true = turned_to_camera(posed(name, build=build), view, palm=view % 2 == 0)
        cloud, landmarks = seen(true, view), rough(true.joints, view)
        began = time.perf_counter()
        fitted = fit_hand(cloud, landmarks, "right", CAMERA)
        seconds = time.perf_counter() - began
        means.append(
            report(f"{build}, {name}, {'back' if view % 2 else 'palm'} seen", fitted, true, seconds)
        )
    print(
        f"{len(means)} single frames: {1e3 * np.mean(means):.2f} mm, the worst {1e3 * max(means):.2f} mm"
    )


def sequence(frames: int = 20) -> None:
    """Follow a hand that opens and closes while it turns."""
    before, means, seconds = None, [], []
    for frame in range(frames):
        share = 0.5 - 0.5 * np.cos(2 * np.pi * frame / frames)
        true = turned_to_camera(posed("pinch", share), 3, tilt=20.0 + frame)
        cloud, landmarks = seen(true, frame), rough(true.joints, frame)
        began = time.perf_counter()
        before = fit_hand(cloud, landmarks, "right", CAMERA, before)
        seconds.append(time.perf_counter() - began)
        means.append(
            report(
                f"frame {frame}, sizes {'kept' if before.anatomy.settled else 'learned'}",
                before,
                true,
                seconds[-1],
            )
        )
    print(
        f"first frame {1e3 * seconds[0]:.0f} ms, later ones {1e3 * np.median(seconds[1:]):.0f} ms, at most "
        f"{1e3 * max(seconds[1:]):.0f} ms; {1e3 * np.mean(means[-8:]):.2f} mm in the last 8 frames"
    )


if __name__ == "__main__":
    if sys.argv[1:] != ["0"]:
        builds = sys.argv[2].split(",") if len(sys.argv) > 2 else list(BUILDS)
        single_frames(int(sys.argv[1]) if len(sys.argv) > 1 else 2, builds)
    sequence()
