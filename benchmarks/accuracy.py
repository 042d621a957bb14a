"""Accuracy of the boundary element solver: every accuracy figure of benchmarks/MEASUREMENTS.md, measured anew.

Run ``make bench``, or ``python -m benchmarks.accuracy [figure ...]``. The
reference is the sphere's series, multipoles about two spheres, or fundamental solutions; each error
is the worst of at least 8 random directions.
"""

import sys
import time
from collections.abc import Callable, Iterator, Sequence

import numpy as np

import airtact as at
from benchmarks import common as scenes
from references import fundamental_solutions, two_spheres

PAPER_AIR, FREQUENCY = scenes.AIR, scenes.FREQUENCY
INTERIOR_EIGENVALUES = (4.493409, 5.763459, 6.987932, 9.355812)


def directions(count: int, seed: int) -> np.ndarray:
    """Random unit vectors (count, 3)."""
    vectors = np.random.default_rng(seed).normal(size=(count, 3))
    return vectors / np.linalg.norm(vectors, axis=1)[:, None]


def far_points(count: int = 60, seed: int = 7) -> np.ndarray:
    """Points 60 to 100 mm from the origin (count, 3)."""
    radius = np.random.default_rng(seed).uniform(0.06, 0.1, size=(count, 1))
    return directions(count, seed + 1) * radius


def relative(found: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Relative error of each column."""
    return np.linalg.norm(found - true, axis=0) / np.linalg.norm(true, axis=0)


def ball(radius: float, frequency: float = FREQUENCY) -> at.Scene:
    """One sound-hard sphere at the origin."""
    return at.Scene(PAPER_AIR, [at.sound_hard(at.sphere(radius, radius / 2))], frequency=frequency)


def one_each(positions: np.ndarray) -> at.Monopoles:
    """Give each position a unit monopole that is an excitation of its own."""
    return at.Monopoles(positions, np.eye(len(positions)))


def sphere_error(
    radius: float,
    gap: float,
    frequency: float = FREQUENCY,
    solver: at.acoustics.Solver | None = None,
) -> float:
    """Worst error at 60 to 100 mm of 8 sources ``gap`` off a sphere."""
    scene, points = ball(radius, frequency), far_points()
    sources = one_each(directions(8, 0) * (radius + gap))
    found = (solver or at.BoundaryElement()).radiate(scene, sources).at(points)
    return float(relative(found, at.SphereSeries().radiate(scene, sources).at(points)).max())


def surface_error(radius: float, height: float, solver: at.acoustics.Solver | None = None) -> float:
    """Worst error over the surface of a sphere, ``height`` off it, of 8 sources 100 mm away."""
    scene, sources = ball(radius), one_each(directions(8, 0) * 0.1)
    points = directions(60, 5) * (radius + height)
    found = (solver or at.BoundaryElement()).radiate(scene, sources).at(points)
    return float(relative(found, at.SphereSeries().radiate(scene, sources).at(points)).max())


def two_fingers(radius: float, tilt: float, gap: float, length: float = 0.044) -> at.Scene:
    """Two capsules whose tips face each other, hanging down and leaning out by ``tilt`` degrees."""
    return scenes.two_fingers(gap, tilt, radius, length).scene


def finger_sources(scene: at.Scene, offset: float, count: int = 8, seed: int = 3) -> np.ndarray:
    """Points ``offset`` off the surfaces near the tips, in random directions, outside both bodies (count, 3)."""
    tips = [obstacle.surface.primitive.axis for obstacle in scene.obstacles]
    radius = scene.obstacles[0].surface.primitive.radius
    ends = np.array([axis[np.argmin(np.abs(axis[:, 0]))] for axis in tips])
    picks = np.random.default_rng(seed)
    found: list[np.ndarray] = []
    while len(found) < count:
        direction = directions(1, int(picks.integers(1 << 30)))
        point = ends[[len(found) % 2]] + direction * (radius + offset)
        if -0.999 * offset >= scene.depth(point)[0]:
            found.append(point[0])
    return np.array(found)


def outer_points(scene: at.Scene, count: int = 40, seed: int = 11) -> np.ndarray:
    """Points 40 to 60 mm outside the ball round the bodies (count, 3)."""
    corners = np.concatenate([obstacle.surface.vertices for obstacle in scene.obstacles])
    centre = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
    extent = np.linalg.norm(corners - centre, axis=1).max()
    return centre + directions(count, seed) * (
        extent + np.random.default_rng(seed).uniform(0.04, 0.06, size=(count, 1))
    )


def finger_error(
    radius: float,
    tilt: float,
    gap: float,
    offset: float = 0.5e-3,
    solver: at.acoustics.Solver | None = None,
) -> tuple[float, float]:
    """Worst error of 8 sources near two fingers, and the reference's own error."""
    scene = two_fingers(radius, tilt, gap)
    sources, points = finger_sources(scene, offset), outer_points(scene)
    shapes = [obstacle.surface.primitive for obstacle in scene.obstacles]
    true, own = fundamental_solutions.pressure_at(shapes, scene.wavenumber, sources, points)
    found = (solver or at.BoundaryElement()).radiate(scene, one_each(sources)).at(points)
    return float(relative(found, true).max()), own


def convergence(gap: float = 20e-3, radius: float = 0.01) -> tuple[np.ndarray, np.ndarray]:
    """Mean panel edge (in proportion) and error over four even meshes of a sphere, in float64."""
    edges, errors = [], []
    scene, points = ball(radius), far_points()
    sources = one_each(directions(8, 0) * (radius + gap))
    true = at.SphereSeries().radiate(scene, sources).at(points)
    for accuracy in (0.05, 0.012, 0.006, 0.003):
        field = at.BoundaryElement(accuracy=accuracy, precision="float64").radiate(scene, sources)
        edges.append(field.report.nodes_per_square_wavelength**-0.5)
        errors.append(relative(field.at(points), true).max())
    return np.array(edges), np.array(errors)


def order(edges: np.ndarray, errors: np.ndarray) -> float:
    """Order of convergence: exponent of the error as a power of the edge."""
    return float(np.polyfit(np.log(edges), np.log(errors), 1)[0])


def reciprocity(accuracy: float = 0.01, length: float = 0.044) -> float:
    """Worst relative difference when source and receiver swap, over 8 pairs 10 mm or more off the pinch's fingers."""
    scene = two_fingers(8e-3, 20, 12e-3, length)
    here, there = finger_sources(scene, 10e-3), outer_points(scene, 8)
    solver = at.BoundaryElement(accuracy=accuracy)
    forth = solver.radiate(scene, one_each(here)).at(there)
    back = solver.radiate(scene, one_each(there)).at(here).T
    return float(np.abs(forth - back).max() / np.abs(forth).mean())


def motion(precision: str, away: float = 1.0, length: float = 0.044) -> float:
    """Largest relative change of the pinch's transfer matrix when hand and array move together."""
    scene = two_fingers(8e-3, 20, 12e-3, length)
    sources, points = finger_sources(scene, 0.5e-3), outer_points(scene)
    pose = at.Pose.turn(
        np.array([1.0, 2.0, -1.0]), 0.7, translation=(away, -0.3 * away, 0.2 * away)
    )
    moved = at.Scene(
        PAPER_AIR,
        [at.sound_hard(o.surface.moved(pose)) for o in scene.obstacles],
        frequency=FREQUENCY,
    )
    solver = at.BoundaryElement(accuracy=0.03, precision=precision)
    rest = solver.radiate(scene, one_each(sources)).at(points)
    after = solver.radiate(moved, one_each(pose.apply(sources))).at(pose.apply(points))
    return float(relative(after, rest).max())


def estimate_scenes(
    count: int = 50, seed: int = 2014
) -> Iterator[tuple[str, at.Scene, np.ndarray]]:
    """Choose scenes by a seed: spheres, pairs of spheres down to a gap of 0.4 mm, thin capsules; 4 sources each."""
    pick = np.random.default_rng(seed)
    for index in range(count):
        kind = index % 5
        if kind < 2:
            radius = float(np.exp(pick.uniform(np.log(0.5e-3), np.log(20e-3))))
            shapes = [at.sphere(radius, radius)]
        elif kind < 4:
            radii = pick.uniform(3e-3, 12e-3, size=2)
            gap = float(np.exp(pick.uniform(np.log(0.4e-3), np.log(30e-3))))
            shapes = [
                at.sphere(float(r), float(r), centre=(float(side * (0.5 * gap + r)), 0.0, 0.0))
                for side, r in zip((-1, 1), radii, strict=True)
            ]
        else:
            radius, length = float(pick.uniform(0.5e-3, 3e-3)), float(pick.uniform(5e-3, 30e-3))
            shapes = [
                at.capsule((0.0, 0.0, -0.5 * length), (0.0, 0.0, 0.5 * length), radius, radius)
            ]
        scene = at.Scene(PAPER_AIR, [at.sound_hard(shape) for shape in shapes], frequency=FREQUENCY)
        offset = float(np.exp(pick.uniform(np.log(0.1e-3), np.log(20e-3))))
        yield (
            f"{['sphere', 'sphere', 'pair', 'pair', 'capsule'][kind]} {index}",
            scene,
            _off_surface(scene, offset, pick),
        )


def _off_surface(scene: at.Scene, offset: float, pick: np.random.Generator) -> np.ndarray:
    """Four random points about ``offset`` off the surfaces (4, 3)."""
    found: list[np.ndarray] = []
    while len(found) < 4:
        surface = scene.obstacles[int(pick.integers(len(scene.obstacles)))].surface
        base = surface.primitive.project(
            surface.vertices[[int(pick.integers(len(surface.vertices)))]] + 1e-6
        )
        axis = surface.primitive.axis
        along = axis[1] - axis[0]
        share = np.clip((base - axis[0]) @ along / max(along @ along, 1e-30), 0, 1)
        normal = (base - axis[0] - share * along) / surface.primitive.radius
        point = base + offset * normal
        if scene.depth(point)[0] < -0.99 * offset:
            found.append(point[0])
    return np.array(found)


def reference(scene: at.Scene, sources: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Pressure of unit monopoles by a method that is not the boundary element solver (P, N)."""
    shapes = [obstacle.surface.primitive for obstacle in scene.obstacles]
    if len(shapes) == 1 and shapes[0].length == 0:
        return at.SphereSeries().radiate(scene, one_each(sources)).at(points)
    method = fundamental_solutions if any(shape.length for shape in shapes) else two_spheres
    return method.pressure_at(shapes, scene.wavenumber, sources, points)[0]


def estimate_and_error(scene: at.Scene, sources: np.ndarray) -> tuple[float, float]:
    """Estimated and true relative error of the direct solution at 40 points where an array would be."""
    points = outer_points(scene)
    field = at.BoundaryElement().radiate(scene, one_each(sources))
    true = reference(scene, sources, points)
    size = np.linalg.norm(true, axis=0)
    estimate = np.linalg.norm(field.error_at(points) * size) / np.linalg.norm(size)
    return float(estimate), float(
        np.linalg.norm(field.direct_at(points) - true) / np.linalg.norm(true)
    )


def table(rows: Sequence[tuple[str, str, Callable[[], str]]], wanted: Sequence[str]) -> None:
    """Print a Markdown table of the figures whose names begin with one of the wanted words (all by default)."""
    print("| figure | asked | measured | seconds |\n|---|---|---|---|")
    for name, asked, measure in rows:
        if not wanted or any(name.startswith(word) for word in wanted):
            began = time.perf_counter()
            print(
                f"| {name} | {asked} | {measure()} | {time.perf_counter() - began:.0f} |",
                flush=True,
            )


def _per_cent(values: Sequence[float]) -> str:
    return " / ".join(f"{100 * value:.2f}" for value in values) + " %"


def _spheres() -> str:
    gaps = (0.0, 1e-4, 5e-4, 2e-3, 20e-3)
    worst = np.zeros(len(gaps))
    cases = [(radius, FREQUENCY) for radius in (0.5e-3, 1e-3, 2e-3, 4e-3, 8e-3, 16e-3, 30e-3)]
    cases += [(0.01, size * 343.1 / (2 * np.pi * 0.01)) for size in INTERIOR_EIGENVALUES]
    for radius, frequency in cases:
        worst = np.maximum(worst, [sphere_error(radius, gap, frequency) for gap in gaps])
    return _per_cent(list(worst))


def _surface() -> str:
    heights = (1e-4, 2e-4, 5e-4)
    return _per_cent(
        [max(surface_error(radius, height) for radius in (2e-3, 1e-2, 3e-2)) for height in heights]
    )


def _fingers() -> str:
    cases = [
        (r, t, g)
        for r, t, g in zip((6, 8, 12, 6, 12), (0, 20, 45, 45, 0), (2, 12, 40, 6, 2), strict=True)
    ]
    found = [finger_error(r * 1e-3, t, g * 1e-3) for r, t, g in cases]
    return f"{100 * max(e for e, _ in found):.2f} % (reference itself {100 * max(o for _, o in found):.2f} %)"


def _iterations() -> str:
    scene = two_fingers(8e-3, 20, 12e-3)
    report = (
        at.BoundaryElement(accuracy=0.1)
        .radiate(scene, one_each(finger_sources(scene, 0.5e-3)))
        .report
    )
    return f"{report.iterations} to {report.residual:.0e}"


def _estimates() -> str:
    ratios, worst, unseen = [], 0.0, 0
    for name, scene, sources in estimate_scenes():
        estimate, true = estimate_and_error(scene, sources)
        print(
            f"  {name}: estimated {100 * estimate:.4f} %, true {100 * true:.4f} %",
            file=sys.stderr,
            flush=True,
        )
        ratios.append(estimate / true)
        worst, unseen = max(worst, true), unseen + (true > 0.1 and estimate < 0.1)
    inside = np.mean([0.3 <= ratio <= 10 for ratio in ratios])
    return f"{100 * inside:.0f} % of {len(ratios)}; worst true error {100 * worst:.1f} %, {unseen} unseen past 10 %"


FIGURES = [
    ("sphere, source 0 / 0.1 / 0.5 / 2 / 20 mm off", "2 / 2 / 1 / 1 / 1 %", _spheres),
    ("surface pressure 0.1 / 0.2 / 0.5 mm off", "2 %", _surface),
    ("two fingers", "2 %", _fingers),
    ("convergence: order of the error in the edge", "3", lambda: f"{order(*convergence()):.1f}"),
    (
        "reciprocity by default, and at accuracy 0.003",
        "0.003, falling",
        lambda: f"{reciprocity():.4f}, {reciprocity(0.003):.4f}",
    ),
    (
        "motion, 1 m away, float32 / float64",
        "1e-4 / 1e-9",
        lambda: f"{motion('float32'):.0e} / {motion('float64'):.0e}",
    ),
    ("estimated over true error, 50 scenes", "0.3 to 10 in 95 %", _estimates),
    ("iterations, two fingers", "12 to 1e-2", _iterations),
]

if __name__ == "__main__":
    table(FIGURES, sys.argv[1:])
