"""What robust drives keep: every figure of benchmarks/MEASUREMENTS.md, measured anew.

Run ``python -m benchmarks.robust``. Names of parts, such as ``times``, run these
alone. Drives are made for 64 samples of seed 0 and tried on 400 of seed 1, at equal energy; the
pressure is that of the weakest focus.
"""

import sys
import time
from collections.abc import Iterator

import numpy as np

import airtact as at
from airtact.drives import goal_value, robust_phase_only
from benchmarks.robust_bound import robust_upper_bound
from references.rigid_poses import matrices_at

AIR = at.Medium(sound_speed=343.1, density=1.293)
DRIVES = {"time reversal": at.time_reversal, "robust": at.robust}
HELD_OUT = 400


def pinch() -> tuple[at.acoustics.RadiatedField, at.Target]:
    fingers = at.pinch(gap=0.012)
    scene = at.Scene(AIR, [at.sound_hard(surface) for surface in fingers.surfaces], frequency=40e3)
    target = at.Target(fingers.foci(offset=0.5e-3))
    solver = at.BoundaryElement(accuracy=0.02, estimate=False)
    return at.multipole_expansion(solver.radiate(scene, target.beacons())), target


def open_hand() -> tuple[at.acoustics.RadiatedField, at.Target, at.PhasedArray]:
    setup = at.read_scene(at.example("open_hand"))
    solver = at.BoundaryElement(accuracy=0.06, estimate=False)
    return (
        at.multipole_expansion(solver.radiate(setup.scene, setup.target.beacons())),
        setup.target,
        setup.array,
    )


def boards(element: at.transducers.Element | None = None) -> at.PhasedArray:
    return at.flat_boards(2, 2, element).facing((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 0.2)


def fingertip() -> tuple[at.acoustics.RadiatedField, at.Target]:
    scene = at.Scene(AIR, [at.sound_hard(at.sphere(radius=8e-3, edge=2e-3))], frequency=40e3)
    target = at.Target(np.array([[0.0, 0.0, 8.5e-3]]))
    return at.multipole_expansion(at.SphereSeries().radiate(scene, target.beacons())), target


FOUR = np.array([[0.01, 0.0, 0.0], [-0.01, 0.005, 0.0], [0.0, -0.012, 0.004], [0.0, 0.0, -0.01]])
SIX = 0.012 * np.stack(
    [np.cos(np.pi / 3 * np.arange(6)), np.sin(np.pi / 3 * np.arange(6)), np.zeros(6)], axis=1
)


def in_air(points: np.ndarray) -> tuple[at.acoustics.RadiatedField, at.Target]:
    target = at.Target(points)
    return at.FreeField().radiate(at.Scene(AIR, [], frequency=40e3), target.beacons()), target


def scenes() -> Iterator[
    tuple[str, at.acoustics.RadiatedField, at.Target, at.PhasedArray, float, float]
]:
    """Name, beacons, target, array, position [mm] and rotation [degree] of ten scenes."""
    flat, plain = (boards(element) for element in (None, at.monopole()))
    fingers = pinch()
    yield "box of monopoles, two fingers", *fingers, at.surrounding_box(at.monopole()), 1.0, 2.0
    yield "box of monopoles, two fingers", *fingers, at.surrounding_box(at.monopole()), 2.0, 3.0
    yield "box of pistons, two fingers", *fingers, at.surrounding_box(), 1.0, 2.0
    yield "flat boards of monopoles, two fingers", *fingers, plain, 2.0, 3.0
    yield "flat boards of monopoles, two fingers", *fingers, plain, 3.0, 5.0
    yield "flat boards, two fingers", *fingers, flat, 2.0, 3.0
    yield "flat boards, two fingers", *fingers, flat, 3.0, 5.0
    yield "flat boards, one fingertip", *fingertip(), flat, 2.0, 3.0
    yield "box of pistons, four foci in air", *in_air(FOUR), at.surrounding_box(), 1.0, 2.0
    yield "flat boards, open hand, six foci", *open_hand(), 2.0, 3.0


def at_equal_energy(
    samples: at.TransferMatrix, target: at.Target, drive: at.Drive, goal: str = "lowest tenth"
) -> float:
    return goal_value(samples, target, drive, goal) / float(np.linalg.norm(drive.amplitudes))  # pyright: ignore


def figures() -> None:
    """Print the table of scenes."""
    print(
        "| scene | off by | time reversal: expected, 9 of 10 | robust | 9 of 10, over time reversal |"
    )
    print("| expected given up | full scale, over phases of time reversal | worst over its bound |")
    shares = []
    for name, beacons, target, array, position, rotation in scenes():
        doubt = at.Uncertainty(position=1e-3 * position, rotation=rotation)
        design, others = (
            at.ensemble(beacons, array, doubt, *given) for given in ((64, 0), (HELD_OUT, 1))
        )
        usual, robust = (
            at_equal_energy(others, target, make(design, target)) for make in DRIVES.values()
        )
        expected = [
            np.abs(design.pressure(drive)).min() / np.linalg.norm(drive.amplitudes)
            for drive in (make(design, target) for make in DRIVES.values())
        ]
        full = [
            goal_value(others, target, make(design, target))
            for make in (at.drives.phase_conjugate, robust_phase_only)
        ]
        bound = robust_upper_bound(design, target)
        shares.append(bound.reached(design, target, at.robust(design, target, "worst")))
        pressures = f"{expected[0]:.0f}, {usual:.0f} | {expected[1]:.0f}, {robust:.0f} | {robust / usual:.2f}"
        rest = f"{1 - expected[1] / expected[0]:.0%} | {full[1] / full[0]:.2f} | {shares[-1]:.2f}"
        print(f"| {name} | {position:g} mm, {rotation:g}° | {pressures} | {rest} |", flush=True)
    print(f"worst over its bound, median {np.median(shares):.2f}")


def doubts() -> None:
    """Print what single doubts leave of the expected pressure, for the pinch in both arrays."""
    flat, (beacons, target) = boards(), pinch()
    given = [
        {"rotation": 2.0},
        {"own_position": 1e-3},
        {"along_skin": 1e-3},
        {"temperature": 2.0},
        {"humidity": 0.2},
    ]
    given += [
        {"gain": 0.1},
        {"phase": 20.0},
        {"dead": 0.1},
    ]
    print("| in doubt | box: time reversal, robust | flat boards |")
    for one in given:
        cells = [
            kept(beacons, target, array, at.Uncertainty(**one))
            for array in (at.surrounding_box(), flat)
        ]
        print(
            f"| {next(iter(one))} {next(iter(one.values())):g} | {' | '.join(cells)} |", flush=True
        )


def by_error() -> None:
    """Print what is kept 9 of 10 times of the expected pressure by the error of the position, for 1, 2 and 6 foci."""
    steps = 0.5, 1.0, 2.0, 3.0, 5.0
    print("| foci, array | " + " | ".join(f"{step:g} mm" for step in steps) + " |")
    tip, fingers, box, flat = fingertip(), pinch(), at.surrounding_box(), boards()
    rows = [
        ("fingertip, box", *tip, box),
        ("two fingers, box", *fingers, box),
        ("six in air, box", *in_air(SIX), box),
    ]
    rows += [("fingertip, flat boards", *tip, flat), ("two fingers, flat boards", *fingers, flat)]
    rows += [
        ("six in air, flat boards", *in_air(SIX), flat),
        ("open hand, flat boards", *open_hand()),
    ]
    for name, beacons, target, array in rows:
        cells = [
            kept(beacons, target, array, at.Uncertainty(position=1e-3 * step)) for step in steps
        ]
        print(f"| {name} | {' | '.join(cells)} |", flush=True)


def kept(
    beacons: at.acoustics.RadiatedField,
    target: at.Target,
    array: at.PhasedArray,
    doubt: at.Uncertainty,
) -> str:
    """Return what time reversal and the robust drive leave of the expected pressure, 9 of 10 times."""
    design, others = (at.ensemble(beacons, array, doubt, *of) for of in ((64, 0), (HELD_OUT, 1)))
    usual = at.time_reversal(design, target)
    best = np.abs(design.pressure(usual)).min() / np.linalg.norm(usual.amplitudes)
    shares = [
        at_equal_energy(others, target, make(design, target)) / best for make in DRIVES.values()
    ]
    return ", ".join(f"{share:.0%}" for share in shares)


def warmer() -> None:
    """Print what scaling the wavenumber neglects, against solves of the pinch in warmer air."""
    fingers = at.pinch(gap=0.012)
    target = at.Target(fingers.foci(offset=0.5e-3))

    def solved(celsius: float) -> at.acoustics.RadiatedField:
        bodies = [at.sound_hard(surface) for surface in fingers.surfaces]
        scene = at.Scene(at.air(celsius=celsius), bodies, frequency=40e3)
        return at.BoundaryElement(accuracy=0.01, estimate=False).radiate(scene, target.beacons())

    usual = at.multipole_expansion(solved(20.0))
    for warmer in (2.0, 5.0):
        scale = at.air(celsius=20.0).sound_speed / at.air(celsius=20.0 + warmer).sound_speed
        for name, array in (("box", at.surrounding_box()), ("flat boards", boards())):
            exact = at.transfer_matrix(solved(20.0 + warmer), array)
            nominal = at.transfer_matrix(usual, array)
            (scaled,) = matrices_at(usual, array, [at.Pose.identity()], scale)
            assert scaled is not None
            drive = at.time_reversal(nominal, target)
            size = np.linalg.norm(exact.matrix)
            off = [np.linalg.norm(one - exact.matrix) / size for one in (scaled, nominal.matrix)]
            share = np.abs(scaled @ drive.amplitudes).min() / np.abs(exact.pressure(drive)).min()
            print(
                f"{warmer:g} K, {name}: scaled {off[0]:.1%} off, not scaled {off[1]:.0%}; weakest focus {share:.4f}"
            )


def dead_and_out_of_phase() -> None:
    """Print the mean loss that 64 samples predict, and Ruze's, beside that of 400 others."""
    beacons, target = pinch()
    doubt = at.Uncertainty(dead=0.1, phase=20.0)
    design, others = (
        at.ensemble(beacons, at.surrounding_box(), doubt, *given)
        for given in ((64, 0), (HELD_OUT, 1))
    )
    drive = at.time_reversal(design, target)
    best = np.abs(design.pressure(drive)).min()
    shares = [goal_value(one, target, drive, "mean") / best for one in (design, others)]
    ruze = 0.9 * np.exp(-0.5 * np.radians(20.0) ** 2)
    print(
        f"10 % dead, 20 degrees: mean kept {shares[0]:.4f} of 64 samples, {shares[1]:.4f} of 400, Ruze {ruze:.4f}"
    )


def times() -> None:
    """Print the seconds of 64 samples of a solved pinch, and of the drive."""
    beacons, target = pinch()
    doubt = at.Uncertainty(position=1e-3, rotation=2.0)
    took = []
    for seed in range(5):
        start = time.perf_counter()
        samples = at.ensemble(beacons, at.surrounding_box(), doubt, 64, seed)
        middle = time.perf_counter()
        at.robust(samples, target)
        took.append((middle - start, time.perf_counter() - middle))
    print("64 samples, drive [ms]:", np.round(1e3 * np.median(took, axis=0)))


if __name__ == "__main__":
    parts = figures, by_error, doubts, dead_and_out_of_phase, warmer, times
    for part in parts:
        if part.__name__ in (sys.argv[1:] or [one.__name__ for one in parts]):
            part()
