"""Force on beads against closed forms, other solvers and other packages.

    python -m benchmarks.traps [ROW ...] [--peers PYTHON]

PYTHON is the interpreter of an environment with AcousTools and levitate.
"""

import argparse
import time
from collections.abc import Callable, Iterator

import numpy as np

import airtact as at
from airtact.traps import gorkov
from benchmarks.common import timed
from benchmarks.others import run_case
from references.standing_wave import AIR, BOTH, ENERGY, FOAM, PAIR, K, standing_wave_function

OPEN_AIR = at.Scene(AIR)
IN_PHASE = at.Drive(np.ones(72, dtype=np.complex128))

# Two fingers of 12 mm, 24 mm apart, and beads between them
FINGERS = at.Scene(
    AIR,
    [
        at.sound_hard(at.capsule((side * 0.012, 0, 0), (side * 0.032, 0, 0), 6e-3, 2e-3))
        for side in (-1, 1)
    ],
)
BETWEEN = np.array([[0.0, 2.82e-3, 0.0], [2e-3, 3e-3, 1e-3]])


def tinylev(element: at.transducers.Element) -> at.PhasedArray:
    """Return TinyLev; its caps face each other along y."""
    return at.transducers.known_array("tinylev", element)


PISTONS = tinylev(at.piston(4.5e-3, sensitivity=3.4))
POINTS = tinylev(at.monopole(3.4))


def wave_rows() -> Iterator[str]:
    """Yield the error of Gor'kov's force in a plane standing wave, over its largest value."""
    height = np.linspace(-4e-3, 4e-3, 41)
    points = np.stack([0 * height, height, 0 * height], axis=1)
    pull = at.traps.force(OPEN_AIR, PAIR, BOTH, points, radius=0.5e-3)[:, 1]
    ratio = FOAM.density / AIR.density
    contrast = (1 - (AIR.sound_speed / FOAM.sound_speed) ** 2 / ratio) / 3
    contrast += (ratio - 1) / (2 * ratio + 1)
    # H. Bruus, Lab Chip 12, 1014 (2012), equation (6), whose energy density is twice ENERGY
    scale = 4 * np.pi * contrast * K * 0.5e-3**3 * 2 * ENERGY
    error = np.abs(pull - scale * np.sin(2 * K * height)).max() / scale
    yield f"Gor'kov's force in a plane standing wave: {error:.2%} off"


def series_rows() -> Iterator[str]:
    """Yield the error of boundary elements beside a hard ball, against its series."""
    scene = at.Scene(AIR, [at.sound_hard(at.sphere(8e-3, 2e-3))])
    points = np.array([[9e-3, 2e-3, 0.0], [1e-3, 10e-3, 1e-3], [7e-3, 7e-3, 7e-3]])
    for word, compute in (("force", at.traps.force), ("stiffness", at.traps.stiffness)):
        exact = compute(scene, POINTS, IN_PHASE, points, solver=at.SphereSeries()).reshape(3, -1)
        found = compute(scene, POINTS, IN_PHASE, points).reshape(3, -1)
        error = np.linalg.norm(found - exact, axis=1) / np.linalg.norm(exact, axis=1)
        yield f"{word} 1.2 to 4 mm beside a ball of 8 mm, against its series: {error.max():.2%} off"


def tinylev_rows() -> Iterator[str]:
    """Yield positions and stiffnesses of a bead of 1 mm in TinyLev.

    The truth is a sum over the far fields of 72 pistons, with differences of 0.02 mm for the
    velocity and 0.2 mm for the stiffness, on a grid of 0.02 mm: "TinyLev all in phase: traps along
    y at [... -2.34 2.34 ...] mm; stiffness x, y, z [N/m]: [0.0129 0.2353 0.0129]", "TinyLev caps
    opposed: traps along y at [... -4.7 0. 4.7 ...] mm; [0.013 0.237 0.013]".
    """
    opposed = at.traps.signature(PISTONS, IN_PHASE, "twin", (0, 1, 0))
    cases = (
        ("in phase", IN_PHASE, 2.34e-3, (0.0129, 0.2353, 0.0129)),
        ("in phase", IN_PHASE, -2.34e-3, (0.0129, 0.2353, 0.0129)),
        ("opposed", opposed, 0.0, (0.0130, 0.2370, 0.0130)),
        ("opposed", opposed, 4.7e-3, None),
    )
    for name, drive, height, expected in cases:
        near = np.array([[0.0, height + 0.2e-3, 0.0]])
        place = at.traps.find(OPEN_AIR, PISTONS, drive, near, radius=1e-3)
        matrix = at.traps.stiffness(OPEN_AIR, PISTONS, drive, place, radius=1e-3)[0]
        stiffness = np.diag(matrix)
        shift = 1e3 * np.linalg.norm(place - [[0.0, height, 0.0]])
        words = f"TinyLev {name}, trap at {1e3 * height:.2f} mm: {shift:.3f} mm off"
        if expected is not None:
            words += f", stiffness {np.abs(stiffness / expected - 1).max():.1%} off"
        yield f"{words} ({', '.join(f'{value:.4f}' for value in stiffness)} N/m)"


def momentum_rows() -> Iterator[str]:
    """Yield Gor'kov's force over the flux of momentum, for beads of polystyrene in TinyLev."""
    point = (1e-3, 1.5e-3, 0.5e-3)
    for diameter in (0.5e-3, 1.0e-3, 1.3e-3, 2.0e-3):
        bead = at.filled(at.sphere(diameter / 2, diameter / 5, point), FOAM)
        exact, _ = at.traps.body_force(OPEN_AIR, POINTS, IN_PHASE, bead)
        place = np.array([point])
        pull = at.traps.force(OPEN_AIR, POINTS, IN_PHASE, place, radius=diameter / 2)[0]
        error = np.linalg.norm(pull - exact) / np.linalg.norm(exact)
        yield f"Gor'kov against momentum flux, bead of {1e3 * diameter:g} mm: {error:.1%} off"


def large_rows() -> Iterator[str]:
    """Yield the error of ``body_force`` in a plane standing wave, over πa²E."""
    for name, diameter in (("diameter", 0.3), ("radius", 0.6)):
        radius = diameter / 2 * AIR.sound_speed / 40e3
        surface = at.sphere(radius, radius / 3, (0.0, 1e-3, 0.0))
        scale = np.pi * radius**2 * ENERGY
        for filling in (None, FOAM):
            body = at.sound_hard(surface) if filling is None else at.filled(surface, filling)
            function = standing_wave_function(K * radius, filling)
            expected = scale * function * np.sin(2 * K * 1e-3)
            solvers: list[at.acoustics.Solver] = [at.SphereSeries()]
            if filling is None:
                solvers.append(at.BoundaryElement(accuracy=0.01))
            for solver in solvers:
                began = time.perf_counter()
                force, _ = at.traps.body_force(OPEN_AIR, PAIR, BOTH, body, solver=solver)
                took = time.perf_counter() - began
                kind = "hard" if filling is None else "polystyrene"
                error = (force[1] - expected) / scale
                yield (
                    f"{kind} sphere, {name} 0.3 wavelengths, {type(solver).__name__}: Y "
                    f"{function:.3f}, {error:+.4f} off, {took:.2f} s"
                )


def fingers_rows() -> Iterator[str]:
    """Yield the force between two fingers by boundary elements against finite elements."""
    pull = at.traps.force(FINGERS, PISTONS, IN_PHASE, BETWEEN)
    finite = at.traps.force(FINGERS, PISTONS, IN_PHASE, BETWEEN, solver=at.FiniteElement())
    alone = at.traps.force(OPEN_AIR, PISTONS, IN_PHASE, BETWEEN)
    size = np.linalg.norm(finite, axis=1)
    error = (np.linalg.norm(pull - finite, axis=1) / size).max()
    effect = (np.linalg.norm(alone - finite, axis=1) / size).max()
    yield f"bead between two fingers: {error:.2%} off finite elements; the fingers change {effect:.1%}"
    ball = at.sound_hard(at.sphere(2e-3, 1e-3, (0.5e-3, 2e-3, 0.0)))
    found, turn = at.traps.body_force(FINGERS, PISTONS, IN_PHASE, ball)
    finite, other = at.traps.body_force(FINGERS, PISTONS, IN_PHASE, ball, solver=at.FiniteElement())
    error = np.linalg.norm(found - finite) / np.linalg.norm(finite)
    twist = np.linalg.norm(turn - other) / (2e-3 * np.linalg.norm(finite))
    yield f"hard ball of 4 mm between them, body_force: {error:.2%} off; torque {twist:.1e} of F·a off"


def time_rows() -> Iterator[str]:
    """Yield the time of one more point on a solved scene, and of one more trap."""
    bead = gorkov.bead_of(FINGERS, 0.65e-3, 29.36, 900.0)
    field, _, _ = gorkov.solved(FINGERS, PISTONS, IN_PHASE, BETWEEN, 0.65e-3, 29.36, 900.0, None)
    point = BETWEEN[:1]

    def verdict() -> None:
        sound = gorkov.derivatives(field, point, bead)
        gorkov.force_of(sound, bead, FINGERS)
        gorkov.stiffness_of(sound, bead, FINGERS)

    yield f"force and stiffness at a point in a solved field: {timed([verdict] * 32)[0]}"
    solver = at.BoundaryElement().factorised(FINGERS)

    def hold() -> at.Drive:
        return at.traps.hold(FINGERS, PISTONS, point, axis=(0, 1, 0), solver=solver)

    yield f"drive of a trap in a factorised scene: {timed([hold] * 32)[0]}"


def peers_rows(python: str | None) -> Iterator[str]:
    """Yield the errors of three packages on TinyLev as 72 monopoles, against exact derivatives.

    The time is that of the force.
    """
    draw = np.random.default_rng(0)
    points = draw.uniform(-4e-3, 4e-3, (200, 3))
    drive = at.Drive(np.exp(1j * draw.uniform(0.0, 0.5, 72)))
    case = {
        "elements": POINTS.positions,
        "normals": POINTS.normals,
        "drive": drive.amplitudes,
        "points": points,
        "strength": 3.4,
        "wavenumber": K,
        "frequency": 40e3,
        "radius": 0.65e-3,
        "density": AIR.density,
        "sound_speed": AIR.sound_speed,
        "bead_density": FOAM.density,
        "bead_speed": FOAM.sound_speed,
        "runs": 31,
    }
    truth = _exact(points, drive.amplitudes, 1.0)
    flipped = _exact(points, drive.amplitudes, -1.0)
    answers = {}
    own = at.traps.force(OPEN_AIR, POINTS, drive, points)
    jobs = [lambda: at.traps.force(OPEN_AIR, POINTS, drive, points)] * 32
    took = timed(jobs)[0].median
    potential = at.traps.potential(OPEN_AIR, POINTS, drive, points)
    answers[f"airtact {at.__version__}"] = np.column_stack([potential, own]), took
    if python is not None:
        for package in range(2):  # AcousTools, levitate
            answer = run_case("traps", python, {**case, "package": package})
            answers[answer.version] = np.real(answer.matrix[:, 1:]), np.median(answer.seconds)
    for name, (values, took) in answers.items():
        force = values[:, 1:]
        size = np.linalg.norm(truth[:, 1:], axis=1)
        error = np.linalg.norm(force - truth[:, 1:], axis=1) / np.median(size)
        ratio = np.sum(force * truth[:, 1:]) / np.sum(truth[:, 1:] ** 2)
        energy = np.abs(values[:, 0] - truth[:, 0]).max() / np.ptp(truth[:, 0])
        yield (
            f"{name}: potential {energy:.2e} off, force {np.median(error):.2e} off (worst "
            f"{error.max():.2e}), ratio {ratio:.5f}, {1e6 * took / len(points):.0f} µs a point"
        )
        if name.startswith("AcousTools"):
            apart = np.abs(values[:, 0] - flipped[:, 0]).max() / np.ptp(truth[:, 0])
            error = np.linalg.norm(force - flipped[:, 1:], axis=1) / np.median(size)
            yield (
                f"  against a gradient with the sign of its 1/r term flipped: potential "
                f"{apart:.2e} off, force {np.median(error):.2e} (worst {error.max():.2e})"
            )


def _exact(points: np.ndarray, drive: np.ndarray, sign: float) -> np.ndarray:
    """Return potential and force by derivatives of e^{ikr}/r, (P, 4).

    ``sign`` -1 flips the 1/r term of the gradient, ∇(e^{ikr}/r) = (ik - 1/r) e^{ikr}/r, alone.
    """
    offset = points[:, None] - POINTS.positions
    r = np.linalg.norm(offset, axis=2)
    way = offset / r[:, :, None]
    wave = 3.4 * drive * np.exp(1j * K * r) / r
    slope = 1j * K - 1.0 / r
    curve = -(K**2) - 2j * K / r + 2.0 / r**2
    pressure = wave.sum(axis=1)
    gradient = np.einsum("pe,pei->pi", wave * (1j * K - sign / r), way)
    across = np.eye(3) - np.einsum("pei,pej->peij", way, way)
    second = np.einsum("pe,pei,pej->pij", wave * curve, way, way)
    second += np.einsum("pe,peij->pij", wave * slope / r, across)
    bead = gorkov.bead_of(OPEN_AIR, 0.65e-3, FOAM.density, FOAM.sound_speed)
    sound = gorkov.Derivatives(pressure, gradient, second, np.zeros((len(points), 3, 3, 3)) + 0j)
    energy = gorkov.potential_of(pressure, gradient, bead, OPEN_AIR)
    return np.column_stack([energy, gorkov.force_of(sound, bead, OPEN_AIR)])


ROWS: dict[str, Callable[[], Iterator[str]]] = {
    "wave": wave_rows,
    "series": series_rows,
    "tinylev": tinylev_rows,
    "momentum": momentum_rows,
    "large": large_rows,
    "fingers": fingers_rows,
    "time": time_rows,
}


def main() -> None:
    """Print the rows that are chosen, or all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("rows", nargs="*", choices=[*ROWS, "peers", []])
    parser.add_argument("--peers", metavar="PYTHON")
    chosen = parser.parse_args()
    rows = {**ROWS, "peers": lambda: peers_rows(chosen.peers)}
    for name in chosen.rows or rows:
        for line in rows[name]():
            print(line, flush=True)


if __name__ == "__main__":
    main()
