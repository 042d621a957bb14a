"""The pose of two fingers from echoes: how exact, how near to the Cramér-Rao bound, from how far off, how quick.

Run ``PYTHONPATH=. python benchmarks/sensing.py [TRIALS] [ROW ...]``; rows are matrix, noise, fine, few, capture, wrong
and times. Echoes are simulated by direct solves of every code at an accuracy of 0.5 %, with smaller panels than those
of the model (2 %; 1 % in the row fine). The array is the box of 996 monopoles; each trial has its own noise and start.
"""

import sys
import time
from functools import cache

import numpy as np

import airtact as at
from airtact.sensing import Echoes, Located, ScatteringMatrix, random_codes
from airtact.sensing.array_waves import array_waves
from airtact.sensing.echo_model import EchoModel, motion_of
from airtact.sensing.registration import SPARE_ORDERS

AIR = at.Medium(sound_speed=343.1, density=1.293)
BOX = at.surrounding_box(at.monopole())
TRUE = at.Pose.turn((1, 2, 3), 0.2, (2e-3, -1e-3, 4e-3))
TRUTH = at.BoundaryElement(accuracy=0.005, estimate=False)


@cache
def scene(gap: float = 0.012) -> at.Scene:
    fingers = at.pinch(gap=gap)
    return at.Scene(AIR, [at.sound_hard(surface) for surface in fingers.surfaces], frequency=40e3)


@cache
def model(accuracy: float = 0.02) -> ScatteringMatrix:
    return at.scattering_matrix(at.BoundaryElement(accuracy=accuracy, estimate=False), scene())


@cache
def perfect(codes: int, gap: float = 0.012) -> Echoes:
    return at.simulate_echoes(TRUTH, scene(gap), BOX.seen_from(TRUE), random_codes(996, codes, seed=1))


def noisy(pure: Echoes, decibels: float, receivers: int, seed: int) -> Echoes:
    """Add noise, and leave so many receivers, chosen at random."""
    random = np.random.default_rng(seed)
    some = np.sort(random.permutation(996)[:receivers])
    pressures = np.asarray(pure.pressures)[some]
    deviation = float(np.sqrt(np.mean(np.abs(pressures) ** 2))) * 10 ** (-decibels / 20)
    noise = random.normal(size=pressures.shape) + 1j * random.normal(size=pressures.shape)
    return Echoes(pure.codes, pressures + deviation / np.sqrt(2) * noise, some, noise=deviation)


def start(position: float, degrees: float, seed: int) -> at.Pose:
    random = np.random.default_rng(1000 + seed)
    along, axis = (vector / np.linalg.norm(vector) for vector in random.normal(size=(2, 3)))
    turn = at.Pose.turn(axis, np.radians(degrees))
    return TRUE @ at.Pose(turn.rotation, model().centre - turn.rotation @ model().centre + position * along)


def errors(found: Located) -> tuple[float, float]:
    """Distance of the middle of the bodies [mm] and angle [degree] from the truth."""
    apart = np.linalg.norm(found.centre - TRUE.apply(model().centre[None])[0])
    turn = np.linalg.norm(found.pose.rotation.T @ TRUE.rotation - np.eye(3)) / np.sqrt(2)
    return 1e3 * float(apart), float(np.degrees(turn))


def trials(
    what: str,
    count: int,
    pure: Echoes,
    decibels: float,
    receivers: int,
    off: tuple[float, float],
    accuracy: float = 0.02,
) -> None:
    """Locate so often and print a row."""
    found, seconds = [], []
    for seed in range(count):
        echoes, from_here = noisy(pure, decibels, receivers, seed), start(*off, seed)
        begun = time.perf_counter()
        found.append(at.locate(echoes, scene(), BOX, from_here, scattering=model(accuracy)))
        seconds.append(time.perf_counter() - begun)
    off_by = np.array([errors(one) for one in found])
    good = np.array([one.converged for one in found])
    wrong = int(np.sum(good & (off_by[:, 0] > 0.3)))
    bounds = np.array([one.bound for one in found])
    least = (
        np.sqrt(np.trace(bounds[:, :3, :3], axis1=1, axis2=2)),
        np.sqrt(np.trace(bounds[:, 3:, 3:], axis1=1, axis2=2)),
    )
    mean = np.sqrt(np.mean(off_by[good] ** 2, axis=0)) if good.any() else np.full(2, np.nan)
    worst = off_by[good].max(axis=0) if good.any() else np.full(2, np.nan)
    ratio = mean / [1e3 * np.sqrt(np.mean(least[0] ** 2)), np.degrees(np.sqrt(np.mean(least[1] ** 2)))]
    print(
        f"{what} | {good.sum()} of {count} converged, {wrong} of them wrong | rms {mean[0]:.4f} mm, {mean[1]:.4f}° | "
        f"worst {worst[0]:.4f} mm, {worst[1]:.4f}° | over the bound {ratio[0]:.2f}, {ratio[1]:.2f} | "
        f"misfit {np.median([one.misfit for one in found]):.3f} | {np.median(seconds):.2f} s each",
        flush=True,
    )


def matrix(count: int) -> None:
    begun = time.perf_counter()
    found = model()
    print(f"{found!r}: {time.perf_counter() - begun:.1f} s, lost power {100 * found.lost_power:.2g} %", flush=True)
    codes, seen = random_codes(996, 4, seed=7), BOX.seen_from(TRUE)
    by_matrix = at.simulate_echoes(found, scene(), seen, codes).pressures
    for name, solver in (
        ("the model's solver", at.BoundaryElement(accuracy=0.02, estimate=False)),
        ("the truth's solver", TRUTH),
    ):
        direct = at.simulate_echoes(solver, scene(), seen, codes).pressures
        error = np.linalg.norm(by_matrix - direct) / np.linalg.norm(direct)
        print(f"echoes by the matrix against direct solves by {name}: {100 * error:.2f} %", flush=True)


def noise(count: int) -> None:
    for decibels in (30.0, 10.0):
        trials(f"16 codes, 996 receivers, {decibels:g} dB, from 1 mm, 2°", count, perfect(16), decibels, 996, (1e-3, 2))


def fine(count: int) -> None:
    what = "16 codes, 996 receivers, 30 dB, from 1 mm, 2°, a model of 1 %"
    trials(what, count, perfect(16), 30.0, 996, (1e-3, 2), accuracy=0.01)


def few(count: int) -> None:
    trials("32 codes, 64 receivers, 20 dB, from 1 mm, 2°", count, perfect(32), 20.0, 64, (1e-3, 2))


def capture(count: int) -> None:
    for off in ((2e-3, 3.0), (5e-3, 8.0)):
        what = f"16 codes, 996 receivers, 20 dB, from {1e3 * off[0]:g} mm, {off[1]:g}°"
        trials(what, count, perfect(16), 20.0, 996, off)


def wrong(count: int) -> None:
    trials("the true gap is 13 mm, the model's 12 mm, 30 dB", count, perfect(16, 0.013), 30.0, 996, (1e-3, 2))


def times(count: int) -> None:
    begun = time.perf_counter()
    waves = array_waves(model(), BOX.seen_from(TRUE), model().order + SPARE_ORDERS)
    echo = EchoModel.of(model(), waves, random_codes(996, 16, seed=1), np.arange(996))
    print(f"the array's waves, once a start: {time.perf_counter() - begun:.2f} s", flush=True)
    motion = motion_of(np.array([5e-4, -3e-4, 2e-4, 0.01, 0.005, -0.01]))
    for name, work in (("the echoes of a pose", echo.echoes), ("their six derivatives", echo.derivatives)):
        work(motion)
        took = []
        for _ in range(9):
            begun = time.perf_counter()
            work(motion)
            took.append(time.perf_counter() - begun)
        print(f"{name}, 16 codes, 996 receivers: median {1e3 * np.median(took):.1f} ms", flush=True)


ROWS = {"matrix": matrix, "noise": noise, "fine": fine, "few": few, "capture": capture, "wrong": wrong, "times": times}

if __name__ == "__main__":
    wanted = sys.argv[2:] or list(ROWS)
    for row in wanted:
        ROWS[row](int(sys.argv[1]) if len(sys.argv) > 1 else 20)
