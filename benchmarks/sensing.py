"""The pose of two fingers from echoes: how exact, how near to the Cramér-Rao bound, from how far off, how quick.

Run ``python -m benchmarks.sensing [TRIALS] [ROW ...]``; rows are matrix, noise,
coarse, few, capture, wrong, between, gap, hand, times and calibrate. Echoes are simulated by
direct solves of every code at an accuracy of 0.3 % (2 % in the row hand), with smaller panels than
those of the model (0.5 %; 2 % in the row coarse). The array is the box of 996 monopoles, in the row
hand four boards; each trial has its own noise and start. What is solved is kept in ``out/sensing``.
"""

import sys
import time
from dataclasses import replace
from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

import airtact as at
from airtact import Echoes
from airtact.live.drives.factors import part_of
from airtact.live.scene import pose_hand
from airtact.sensing import (
    Located,
    ScatteringFamily,
    ScatteringMatrix,
    hadamard_codes,
    random_codes,
    scattering_family,
    simulate_transmissions,
    unexplained,
)
from airtact.sensing.echo_model import EchoModel
from airtact.sensing.registration import SPARE_ORDERS
from airtact.sensing.self_calibration import moved
from airtact.sensing.transmission import boards_of

AIR = at.Medium(sound_speed=343.1, density=1.293)
BOX = at.surrounding_box(at.monopole())
TRUE = at.Pose.turn((1, 2, 3), 0.2, (2e-3, -1e-3, 4e-3))
STORE = "out/sensing"
TRUTH = at.Stored(at.BoundaryElement(accuracy=0.003, estimate=False), STORE)


@cache
def scene(gap: float = 0.012) -> at.Scene:
    fingers = at.pinch(gap=gap)
    return at.Scene(AIR, [at.sound_hard(surface) for surface in fingers.surfaces], frequency=40e3)


@cache
def model(accuracy: float = 0.005) -> ScatteringMatrix:
    return at.scattering_matrix(at.BoundaryElement(accuracy=accuracy, estimate=False), scene())


@cache
def perfect(codes: int, gap: float = 0.012) -> Echoes:
    return at.simulate_echoes(
        TRUTH, scene(gap), BOX.seen_from(TRUE), random_codes(996, codes, seed=1)
    )


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
    return TRUE @ at.Pose(
        turn.rotation, model().centre - turn.rotation @ model().centre + position * along
    )


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
    accuracy: float = 0.005,
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
    ratio = mean / [
        1e3 * np.sqrt(np.mean(least[0] ** 2)),
        np.degrees(np.sqrt(np.mean(least[1] ** 2))),
    ]
    print(
        f"{what} | {good.sum()} of {count} converged, {wrong} of them wrong | rms {mean[0]:.4f} mm, {mean[1]:.4f}° | "
        f"worst {worst[0]:.4f} mm, {worst[1]:.4f}° | over the bound {ratio[0]:.2f}, {ratio[1]:.2f} | "
        f"misfit {np.median([one.misfit for one in found]):.3f} | {np.median(seconds):.2f} s each",
        flush=True,
    )


def matrix(count: int) -> None:
    begun = time.perf_counter()
    used, found = time.process_time(), model()
    seconds = (
        f"{time.perf_counter() - begun:.1f} s, {time.process_time() - used:.1f} s of processors"
    )
    print(f"{found!r}: {seconds}", flush=True)
    codes, seen = random_codes(996, 4, seed=7), BOX.seen_from(TRUE)
    by_matrix = at.simulate_echoes(found, scene(), seen, codes).pressures
    for name, solver in (
        ("the model's solver", at.BoundaryElement(accuracy=0.005, estimate=False)),
        ("the truth's solver", TRUTH),
    ):
        direct = at.simulate_echoes(solver, scene(), seen, codes).pressures
        error = np.linalg.norm(by_matrix - direct) / np.linalg.norm(direct)
        print(
            f"echoes by the matrix against direct solves by {name}: {100 * error:.2f} %", flush=True
        )


def noise(count: int) -> None:
    for decibels in (30.0, 10.0):
        trials(
            f"16 codes, 996 receivers, {decibels:g} dB, from 1 mm, 2°",
            count,
            perfect(16),
            decibels,
            996,
            (1e-3, 2),
        )


def coarse(count: int) -> None:
    what = "16 codes, 996 receivers, 30 dB, from 1 mm, 2°, a model of 2 %"
    trials(what, count, perfect(16), 30.0, 996, (1e-3, 2), accuracy=0.02)


def few(count: int) -> None:
    trials("32 codes, 64 receivers, 20 dB, from 1 mm, 2°", count, perfect(32), 20.0, 64, (1e-3, 2))


def capture(count: int) -> None:
    for off in ((2e-3, 3.0), (5e-3, 8.0)):
        what = f"16 codes, 996 receivers, 20 dB, from {1e3 * off[0]:g} mm, {off[1]:g}°"
        trials(what, count, perfect(16), 20.0, 996, off)


def wrong(count: int) -> None:
    trials(
        "the true gap is 13 mm, the model's 12 mm, 30 dB",
        count,
        perfect(16, 0.013),
        30.0,
        996,
        (1e-3, 2),
    )


@cache
def family() -> ScatteringFamily:
    solver = at.Stored(at.BoundaryElement(accuracy=0.005, estimate=False), STORE)
    return scattering_family(solver, scene, 0.010, 0.014)


def between(count: int) -> None:
    """Hold the matrix between the values of the family against one solved there."""
    value, made = 0.0107, family()
    ball = made.matrices[0].centre, made.matrices[0].radius
    solved = at.scattering_matrix(
        at.BoundaryElement(accuracy=0.005, estimate=False), scene(value), ball=ball
    ).matrix
    error = np.linalg.norm(made.at(value).matrix - solved) / np.linalg.norm(solved)
    print(
        f"the matrix at {1e3 * value:g} mm against one solved there: {100 * error:.2f} %",
        flush=True,
    )


def gap(count: int) -> None:
    """Find pose and gap together, from a gap of 12 mm; the true gap is 1 mm more or less."""
    used, made = time.process_time(), family()
    print(f"{made!r}: {time.process_time() - used:.1f} s of processor", flush=True)
    for true in (0.011, 0.013):
        off, found, seconds = [], [], []
        for seed in range(count // 2):
            echoes, from_here = noisy(perfect(16, true), 30.0, 996, seed), start(1e-3, 2.0, seed)
            begun = time.process_time()
            found.append(at.locate(echoes, made, BOX, from_here))
            seconds.append(time.process_time() - begun)
            centre = made.matrices[0].centre
            apart = np.linalg.norm(found[-1].centre - TRUE.apply(centre[None])[0])
            off.append((1e3 * apart, errors(found[-1])[1], 1e3 * abs(found[-1].opening - true)))
        rms, worst = np.sqrt(np.mean(np.square(off), axis=0)), np.max(off, axis=0)
        names = "pose {:.4f} mm, {:.4f}°, gap {:.4f} mm"
        print(
            f"the true gap is {1e3 * true:g} mm, 16 codes, 996 receivers, 30 dB, from 12 mm, 1 mm, 2° | "
            f"{sum(one.converged for one in found)} of {len(found)} converged | rms {names.format(*rms)} | worst "
            f"{names.format(*worst)} | gap sure to {1e3 * np.median([one.opening_deviation for one in found]):.4f} mm"
            f" | misfit {np.median([one.misfit for one in found]):.3f} | {np.median(seconds):.2f} s of processor each",
            flush=True,
        )


def hand(count: int) -> None:
    """Locate the last phalanges of a hand over four boards by echoes of them alone, and of more and more of the hand.

    The model is the phalanges alone, of the true shape; starts are as far off as a tracker with 1
    mm of noise.
    """
    setup = at.read_scene(at.example("live_pinch"), followed=True)
    live, own = at.live.live_scene(setup), setup.hands[0]
    foci = pose_hand(live, own.joints).foci

    def air(surfaces: list[at.Surface]) -> at.Scene:
        return at.Scene(
            live.medium, [at.sound_hard(one) for one in surfaces], frequency=live.frequency
        )

    phalanges = air([part_of(own, "phalanges", [place], 3e-3) for place in live.places])
    own_matrix = at.scattering_matrix(at.BoundaryElement(accuracy=0.005, estimate=False), phalanges)
    codes, truth = (
        random_codes(len(live.array), 8, seed=1),
        at.BoundaryElement(accuracy=0.02, estimate=False),
    )
    for part in ("phalanges", "fingers", "hand"):
        there = phalanges if part == "phalanges" else air([part_of(own, part, live.places, 2e-3)])
        used = time.process_time()
        pure = at.simulate_echoes(truth, there, live.array, codes)
        used = time.process_time() - used
        size = np.linalg.norm(pure.pressures) / np.sqrt(np.size(pure.pressures))
        left = float(
            np.sqrt(np.mean(unexplained(pure, own_matrix, live.array, at.Pose.identity()) ** 2))
        )
        found, off, started, seconds = [], [], [], []
        for seed in range(count):
            random = np.random.default_rng(seed)
            turn = Rotation.from_rotvec(np.radians(1.0) * random.normal(size=3)).as_matrix()
            away = at.Pose(
                turn, foci.mean(axis=0) - turn @ foci.mean(axis=0) + 0.7e-3 * random.normal(size=3)
            )
            noise = 0.1 * size * (random.normal(size=(2, *pure.pressures.shape)) / np.sqrt(2))
            echoes = replace(
                pure, pressures=pure.pressures + noise[0] + 1j * noise[1], noise=0.1 * size
            )
            begun = time.process_time()
            found.append(at.locate(echoes, phalanges, live.array, away, scattering=own_matrix))
            seconds.append(time.process_time() - begun)
            for pose, some in ((away, started), (found[-1].pose, off)):
                some.append(1e3 * np.linalg.norm(pose.apply(foci) - foci, axis=1).max())
        left_over, believed = (
            np.median([one.misfit for one in found]),
            sum(one.converged for one in found),
        )
        print(f"echoes of the {part}, 8 codes, 20 dB, simulated in {used:.1f} s of processor:")
        print(
            f"  the phalanges leave {left:.2f} at the true pose | foci {np.median(started):.2f} mm off at the start, "
            f"{np.median(off):.2f} after, at worst {np.max(off):.2f} | misfit {left_over:.2f}, {believed} of {count} "
            f"believed | {np.median(seconds):.2f} s of processor each",
            flush=True,
        )


def times(count: int) -> None:
    """Print medians; model and echoes are made before, and each is done once to warm up."""
    codes = random_codes(996, 16, seed=1)

    def expanded() -> EchoModel:
        seen = BOX.seen_from(TRUE)
        return EchoModel.of(model(), seen, codes, np.arange(996), spare=SPARE_ORDERS)

    echo = expanded()
    twist = np.array([5e-4, -3e-4, 2e-4, 0.01, 0.005, -0.01])
    echoes = noisy(perfect(16), 30.0, 996, 0)
    at_start = start(1e-3, 2.0, 0)
    for name, work in (
        ("the echoes of a pose", lambda: echo.echoes(twist)),
        ("their six derivatives", lambda: echo.derivatives(twist)),
        ("the array's waves, once a start", expanded),
        (
            "a registration from 1 mm, 2°",
            lambda: at.locate(echoes, scene(), BOX, at_start, scattering=model()),
        ),
    ):
        work()
        took, used = [], time.process_time()
        for _ in range(9):
            begun = time.perf_counter()
            work()
            took.append(time.perf_counter() - begun)
        used = (time.process_time() - used) / 9
        print(
            f"{name}, 16 codes, 996 receivers: {1e3 * np.median(took):.1f} ms, {1e3 * used:.1f} ms of processors"
        )


def calibrate(count: int) -> None:
    """Calibrate the box, whose boards are 1 mm and 0.7° off, the gains by 10 % and 20°, the sound speed by 2 m/s."""
    boards, off, seconds = boards_of(BOX), [], []
    for seed in range(count):
        random = np.random.default_rng(seed)
        motions = random.normal(size=(4, 6)) * np.repeat([1e-3, np.radians(0.7)], 3)
        motions[0] = 0.0
        gains = np.exp(
            0.1 * random.normal(size=(2, 996)) + 1j * np.radians(20) * random.normal(size=(2, 996))
        )
        true = at.transducers.join(
            [moved(*pair) for pair in zip(boards, motions, strict=True)]
        ).calibrated(gains[0])
        air, codes = (
            at.Medium(AIR.sound_speed + 2 * random.normal(), AIR.density),
            hadamard_codes(996),
        )
        heard = simulate_transmissions(true, air, codes, reception=gains[1], noise=30.0, seed=seed)
        begun = time.process_time()
        found = at.calibrate(heard, BOX, AIR)
        seconds.append(time.process_time() - begun)
        pairs = list(zip(boards_of(found.array), boards_of(true), strict=True))
        apart = max(
            float(np.linalg.norm(one.positions.mean(0) - other.positions.mean(0)))
            for one, other in pairs
        )
        frames = [(one.normals[0], one.tangents[0]) for pair in pairs for one in pair]
        turn = max(
            np.linalg.norm(np.subtract(*pair))
            for pair in zip(frames[::2], frames[1::2], strict=True)
        )
        ratios = [
            one / other for one, other in zip((found.emission, found.reception), gains, strict=True)
        ]
        ratio = np.concatenate([one / one.mean() for one in ratios])
        size, phase = np.std(np.abs(ratio)), np.degrees(np.std(np.angle(ratio)))
        off.append(
            (
                1e3 * apart,
                np.degrees(turn),
                100 * size,
                phase,
                abs(found.sound_speed - air.sound_speed),
            )
        )
        assert found.converged, found
    names = (
        "worst board {:.4f} mm | {:.4f}° | gains {:.3f} % | phases {:.3f}° | sound speed {:.5f} m/s"
    )
    print("calibrate, 30 dB, rms: " + names.format(*np.sqrt(np.mean(np.square(off), axis=0))))
    print(
        f"worst of {count}: {names.format(*np.max(off, axis=0))} | {np.median(seconds):.1f} s of processor each"
    )


ROWS = {
    "matrix": matrix,
    "noise": noise,
    "coarse": coarse,
    "few": few,
    "capture": capture,
    "wrong": wrong,
    "between": between,
    "gap": gap,
    "hand": hand,
    "times": times,
    "calibrate": calibrate,
}

if __name__ == "__main__":
    wanted = sys.argv[2:] or list(ROWS)
    for row in wanted:
        ROWS[row](int(sys.argv[1]) if len(sys.argv) > 1 else 20)
