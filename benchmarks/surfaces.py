"""How well any surface is solved: every figure of scanned, drawn and damaged meshes, measured anew.

Run ``python -m benchmarks.surfaces [figure ...]``; ``hand`` and ``damaged`` take
minutes. The reference is fundamental solutions inside an ellipsoid, or the same body with smaller
panels.
"""

import sys
import time
from collections.abc import Iterator

import numpy as np
import trimesh

import airtact as at
from airtact.geometry.mesh.triangles import (
    enclosed_volume,
    longest_edges,
    smallest_angles,
)
from benchmarks.accuracy import FREQUENCY, PAPER_AIR, directions, far_points, one_each, relative
from benchmarks.peers.peak_memory import forget_peak, peak
from references import axisymmetric, before_a_plane, ellipsoid, two_spheres
from references.assorted_meshes import assorted
from references.damaged_meshes import damaged

HAND = at.example("generic-hand-right.glb")
OPEN_HAND = at.example("open_hand")
WAVENUMBER = 2 * np.pi / PAPER_AIR.wavelength(FREQUENCY)
EDGE = 0.638 * PAPER_AIR.wavelength(FREQUENCY)
"""Edge of the panels for an accuracy of 1 %."""


def scene_of(vertices: np.ndarray, triangles: np.ndarray) -> at.Scene:
    """Put a body of flat triangles into the air, as it comes from a file."""
    return at.Scene(
        PAPER_AIR, [at.sound_hard(at.Surface(vertices, triangles))], frequency=FREQUENCY
    )


def scanned(axes: np.ndarray, level: int, noise: float) -> at.Scene:
    """Mesh an ellipsoid by trimesh: 5,120 triangles at level 4, 81,920 at level 6, rough along its normals."""
    mesh = trimesh.creation.icosphere(level)
    points = np.array(mesh.vertices) * axes
    normals = points / axes**2
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    rough = noise * np.random.default_rng(1).standard_normal((len(points), 1))
    return scene_of(points + rough * normals, np.array(mesh.faces))


def scanned_error(
    axes: np.ndarray, gap: float, level: int, noise: float
) -> tuple[float, float, float, int]:
    """Worst error of 8 sources a gap off the skin, seconds with and without panelling, and unknowns."""
    skin, normals, _ = ellipsoid.surface_points(axes, 8)
    positions, points = skin + gap * normals, far_points()
    true, own = ellipsoid.pressure_at(axes, WAVENUMBER, positions, points)
    assert own < 1e-3, own
    scene = scanned(axes, level, noise)
    seconds = []
    for _ in range(3):
        began = time.perf_counter()
        field = at.BoundaryElement().radiate(scene, one_each(positions))
        seconds.append(time.perf_counter() - began)
    return (
        float(relative(field.at(points), true).max()),
        seconds[0],
        min(seconds[1:]),
        field.report.nodes,
    )


def against_smaller_panels(
    dimensions: tuple[float, float, float], positions: np.ndarray
) -> tuple[float, float, float]:
    """Worst error of a box at 1 % against 0.0005, relative error of its volume, smallest angle of its panels."""
    box = trimesh.creation.box(dimensions)
    scene = scene_of(np.array(box.vertices), np.array(box.faces))
    fields = [
        at.BoundaryElement(accuracy=asked).radiate(scene, one_each(positions))
        for asked in (0.01, 0.0005)
    ]
    found, true = (field.at(far_points()) for field in fields)
    panels = fields[0].surface.nodes.quadratic_triangles
    volume = enclosed_volume(panels) / np.prod(dimensions) - 1
    return float(relative(found, true).max()), abs(volume), float(smallest_angles(panels).min())


def scanned_figures() -> Iterator[str]:
    for name, axes in (
        ("sphere 10 mm", np.full(3, 0.01)),
        ("ellipsoid 15, 10, 7 mm", np.array([15, 10, 7]) * 1e-3),
    ):
        for gap in (0.002, 0.02):
            few, many = scanned_error(axes, gap, 4, 0.0), scanned_error(axes, gap, 6, 2e-5)
            yield (
                f"{name}, sources {1e3 * gap:g} mm off: 5,120 triangles {100 * few[0]:.2f} %, 81,920 rough ones "
                f"{100 * many[0]:.2f} %; solves {few[2]:.2f} and {many[2]:.2f} s, ratio {many[2] / few[2]:.2f}; first "
                f"ones, with curving and panelling, {few[1]:.2f} and {many[1]:.2f} s, ratio {many[1] / few[1]:.2f}; "
                f"{few[3]} and {many[3]} unknowns"
            )


def box_figures() -> Iterator[str]:
    beside = (
        np.array([[0, 0, 9.5], [3, 5, 9.5], [9.5, 9, 2], [20, 10, 3], [10, 10, 10], [0, 0, 30]])
        * 1e-3
    )
    error, volume, angle = against_smaller_panels((0.015, 0.015, 0.015), beside)
    yield f"cube of 15 mm: {100 * error:.2f} %, volume {100 * volume:.1g} % off, smallest angle {angle:.0f} degrees"
    before = (
        np.array([[0, 0, 2], [3, 5, 1], [10.5, 4, 1], [0, 0, 10], [10, 0, 10], [0, 0, 30]]) * 1e-3
    )
    error, volume, angle = against_smaller_panels((0.02, 0.02, 0.0006), before)
    off = f"volume {100 * volume:.1g} % off, smallest angle {angle:.0f} degrees"
    yield f"plate 20 x 20 x 0.6 mm: {100 * error:.2f} %, {off}"


def hand_figures() -> Iterator[str]:
    import tomllib

    points = [focus["point"] for focus in tomllib.loads(OPEN_HAND.read_text())["foci"]][:5]
    beacons, points_above = (
        one_each(np.array(points)),
        np.array([0.01, -0.02, 0.0]) + 0.25 * directions(200, 3),
    )
    air = at.air(celsius=20.0, humidity=0.5, frequency=FREQUENCY)
    found = []
    for asked in (0.03, 0.003):
        held = forget_peak()
        scene = at.Scene(air, [at.sound_hard(at.load_surface(HAND))], frequency=FREQUENCY)
        began = time.perf_counter()
        field = at.BoundaryElement(accuracy=asked).radiate(scene, beacons)
        found.append(
            (field.at(points_above), field.report, time.perf_counter() - began, peak() - held)
        )
    (coarse, report, seconds, memory), (fine, verified, _, _) = found
    yield (
        f"open hand at 3 %, five fingertips: {100 * relative(coarse, fine).max():.1f} % from the solve at "
        f"{verified.nodes / report.nodes:.2f} times the nodes ({report.nodes}, {verified.nodes}); estimated "
        f"{100 * report.estimated_error:.1f} %; {seconds:.0f} s, {memory / 1e9:.1f} GB; panels "
        f"up to {1e3 * report.farthest_off_triangles:.1f} mm off the file, {1e3 * report.mean_off_triangles:.2f} mm in "
        "the mean"
    )


def panelling_figures() -> Iterator[str]:
    def timed(surfaces: list[at.Surface], edge: float) -> tuple[float, int]:
        began = time.perf_counter()
        panels = [surface.panelled(edge) for surface in surfaces]
        return time.perf_counter() - began, sum(len(part.quadratic_triangles) for part in panels)

    at.load_surface(HAND).panelled(0.01)  # MMG's libraries are loaded once
    for edge in (8.0e-3, EDGE):
        seconds, count = min(timed([at.load_surface(HAND)], edge) for _ in range(3))
        yield f"panelling the hand, edge {1e3 * edge:.1f} mm: {seconds:.2f} s, {count} panels"
    fingers = [(surface.vertices, surface.triangles) for surface in at.pinch().surfaces]
    seconds, count = min(timed([at.Surface(*finger) for finger in fingers], EDGE) for _ in range(3))
    yield f"panelling two fingers from flat triangles, edge {1e3 * EDGE:.1f} mm: {seconds:.2f} s, {count} panels"
    seconds, count = min(timed(list(at.pinch().surfaces), EDGE) for _ in range(3))
    yield f"panelling two fingers from capsules: {seconds:.3f} s, {count} panels"


def angle_figures() -> Iterator[str]:
    worst = []
    for name, mesh in assorted():
        panels = at.Surface(*mesh).panelled(EDGE)
        angles = smallest_angles(panels.quadratic_triangles)
        worst.append((float(angles.min()), name, float(np.mean(angles < 15)), len(angles)))
        assert np.isfinite(longest_edges(panels.quadratic_triangles)).all()
    worst.sort()
    above = sum(angle >= 15 for angle, *_ in worst)
    below = ", ".join(
        f"{name} {angle:.1f} ({100 * share:.1f} % of {count})"
        for angle, name, share, count in worst
        if angle < 15
    )
    yield f"{above} of {len(worst)} meshes have no angle below 15 degrees, edge {1e3 * EDGE:.1f} mm; others: {below}"


def tip_figures(count: int = 20) -> Iterator[str]:
    """Pressure on prolate spheroids given as triangles, aspects 1.2 to 3, against rings of monopoles."""
    draw = np.random.default_rng(46)
    errors, quiet, truth = {0.03: [], 0.01: [], 0.003: []}, 0, 0.0
    for index in range(count):
        equatorial = draw.uniform(3.5e-3, 6.5e-3)
        meridian = axisymmetric.spheroid(equatorial, equatorial * (1.2 + 1.8 * index / (count - 1)))
        direction = draw.normal(size=(1, 3))
        source = 60e-3 * direction / np.linalg.norm(direction)
        exact = axisymmetric.fitted([meridian], WAVENUMBER, source, 4.0)
        truth = max(truth, exact.residual)
        mesh = axisymmetric.surface(meridian, (0.25e-3, 0.5e-3)[index % 2])
        scene = scene_of(mesh.vertices, mesh.triangles)
        for asked, found in errors.items():
            field = at.BoundaryElement(accuracy=asked).radiate(scene, one_each(source))
            skin = field.on_surface
            true = exact.pressure(skin.points)
            weight = np.sqrt(skin.areas)[:, None]
            found.append(float(relative(weight * skin.pressure, weight * true)[0]))
            quiet += found[-1] > 2 * asked and not field.report.warnings
    total = sum(len(found) for found in errors.values())
    yield (
        "pressure on spheroids of triangles, root mean square, median and worst: "
        + "; ".join(
            f"{100 * asked:g} % asked: {100 * np.median(found):.2f}, {100 * max(found):.2f} %"
            for asked, found in errors.items()
        )
        + f"; {quiet} of {total} over twice what was asked without a warning (truth to {truth:.0e})"
    )


def gap_case(draw: np.random.Generator, index: int) -> tuple[at.Scene, np.ndarray, np.ndarray]:
    """Scene of two bodies, or of one before a plane, with a source and points in its gap of 0.3 to 10 mm.

    Half are spheres, whose field is known; half are two capsules, every other pair before a plane.
    Every other body is sound-hard, the rest have an impedance.
    """
    known, plane, yielding = index % 2 == 0, index // 2 % 2 == 0, index // 4 % 2 == 0
    gap = np.exp(draw.uniform(np.log(0.3e-3), np.log(10e-3)))
    bodies, lowest = [], np.inf
    for side in (-1, 1):
        radius, tilt = draw.uniform(3e-3, 8e-3), draw.uniform(-0.6, 0.6)
        half = 0.0 if known else draw.uniform(0, 7.5e-3)
        axis = half * np.array([0.0, np.sin(tilt), np.cos(tilt)])
        centre = np.array([side * (gap / 2 + radius), 0.0, 0.0])
        bodies.append(at.capsule(centre - axis, centre + axis, radius, radius / 2))
        lowest = min(lowest, -abs(axis[2]) - radius)
    ratio = PAPER_AIR.density * PAPER_AIR.sound_speed * complex(*draw.uniform((0.3, -1), (2.9, 1)))
    table = at.plane((0, 0, lowest - draw.uniform(0.3e-3, 5e-3)), (0, 0, 1))
    if known and plane:
        bodies, table = bodies[:1], at.plane((gap / 2, 0, 0), (-1, 0, 0))
    scene = at.Scene(
        PAPER_AIR,
        [at.impedance(body, ratio) if yielding else at.sound_hard(body) for body in bodies],
        frequency=float(draw.choice([25e3, 40e3, 70e3])),
        planes=[table] if plane else [],
    )
    source = draw.normal(size=3) * [-1, 1, 1]
    source[0 if known else 2] = np.copysign(source[0 if known else 2], -1 if known else 1)
    points = np.stack(
        [np.linspace(-0.45, 0.45, 7) * gap, *draw.uniform(-1.5e-3, 1.5e-3, (2, 7))], 1
    )
    source *= 60e-3 / np.linalg.norm(source)
    return scene, source[None], points[scene.depth(points) < -2e-5]


def gap_figures(count: int = 156) -> Iterator[str]:
    """Pressure in gaps, against series for spheres and a solve at 0.15 % for capsules."""
    draw = np.random.default_rng(13)
    found: dict[float, list[tuple[float, float, bool, int]]] = {0.1: [], 0.03: [], 0.01: []}
    truth = 0.0
    for index in range(count):
        scene, source, points = gap_case(draw, index)
        if index % 2:
            exact = at.BoundaryElement(accuracy=0.0015).radiate(scene, one_each(source)).at(points)
        elif scene.planes:
            exact, own = before_a_plane.sphere_pressure(scene, source, points)
            truth = max(truth, own)
        else:
            spheres = [obstacle.surface.primitive for obstacle in scene.obstacles]
            ratios = [obstacle.ratio for obstacle in scene.obstacles]
            exact, own = two_spheres.pressure_at(
                spheres,
                scene.wavenumber,
                source,
                points,
                admittances=[1 / ratio if ratio else 0.0 for ratio in ratios],
            )
            truth = max(truth, own)
        for asked, rows in found.items():
            field = at.BoundaryElement(accuracy=asked).radiate(scene, one_each(source))
            pressure = field.at(points)
            error = float(relative(pressure, exact)[0])
            # at the worst point, as the warning states it
            size = np.maximum(np.abs(exact), 0.1 * np.abs(exact).max())
            worst = float((np.abs(pressure - exact) / size).max())
            warned = bool(field.report_at(points).warnings)
            rows.append((error / asked, worst / asked, warned, field.report.nodes))
    for asked, rows in found.items():
        errors, worst, warned, nodes = (np.array(column) for column in zip(*rows, strict=True))
        warned = warned.astype(bool)
        over = errors > 1.5
        yield (
            f"{count} cases, {100 * asked:g} % asked: error over it {np.median(errors):.2f} in the median, "
            f"{np.quantile(errors, 0.95):.2f} in 95 %, {errors.max():.2f} at worst; {over.sum()} over 1.5, "
            f"{(over & ~warned).sum()} of them without a warning; {warned.sum()} warnings, "
            f"{(warned & (errors < 1.5)).sum()} of them needless; at the worst point {(worst > 1.5).sum()} "
            f"over 1.5, {((worst > 1.5) & ~warned).sum()} without a warning, {(warned & (worst < 1.5)).sum()} "
            "needless warnings; "
            f"{nodes.mean():.0f} unknowns in the mean (series to {truth:.0e})"
        )


def bored_ball(bore: float) -> trimesh.Trimesh:
    """Ball of 16 mm with a cylindrical bore of a diameter [m]."""
    # A fine revolution: its rims are sharp edges.
    angle = np.linspace(np.arcsin(bore / 16e-3), np.pi - np.arcsin(bore / 16e-3), 21)
    arc = 8e-3 * np.stack([np.sin(angle), -np.cos(angle)], axis=1)
    return trimesh.creation.revolve(np.concatenate([arc, arc[:1]]), sections=40)


def monotone_figures() -> Iterator[str]:
    """Unknowns at coarser and coarser accuracies, and seconds of processor time to plan them."""
    meshes = {f"ball with a bore of {1e3 * bore:g} mm": bored_ball(bore) for bore in (1e-3, 6e-3)}
    meshes["ball"] = trimesh.creation.icosphere(4, radius=8e-3)
    bodies = {
        name: (np.array(mesh.vertices), np.array(mesh.faces)) for name, mesh in meshes.items()
    }
    surfaces = {"flat finger": at.pinch().surfaces[0], "hand": at.load_surface(HAND)}
    for aspect in (1.3, 2.0, 3.0):
        meridian = axisymmetric.spheroid(5e-3, 5e-3 * aspect)
        surfaces[f"spheroid of aspect {aspect:g}"] = axisymmetric.surface(meridian, 0.25e-3)
    for name, surface in surfaces.items():
        bodies[name] = surface.vertices, surface.triangles
    source = one_each(np.array([[0, 0, 0.2]]))
    for name, body in bodies.items():
        unknowns = []
        began = time.process_time()
        for accuracy in (0.003, 0.005, 0.01, 0.02, 0.03, 0.05, 0.1):
            solver = at.BoundaryElement(accuracy=accuracy)
            unknowns.append(solver.unknowns(scene_of(*body), source))
        seconds = time.process_time() - began
        least = np.minimum.accumulate(unknowns)
        rise = max(0.0, float((unknowns[1:] / least[:-1]).max() - 1))
        yield f"{name}: {unknowns} unknowns from 0.3 to 10 %, rise {100 * rise:.1f} %, {seconds:.1f} s"


def damaged_figures(count: int = 500) -> Iterator[str]:
    outcome = {"repairs": 0, "rejected": 0}
    wrong, worst = [], 0.0
    for seed in range(count):
        name, whole, broken = damaged(np.random.default_rng(seed))
        try:
            with_fault = scene_of(*_repaired(broken))
        except at.InvalidInput:
            outcome["rejected"] += 1
            continue
        outcome["repairs"] += 1
        error = _difference(scene_of(*_repaired(whole)), with_fault)
        worst = max(worst, error)
        if error > 0.03:
            wrong.append(f"{seed} {name}: {100 * error:.1f} %")
        print(seed, name, f"{100 * error:.2f} %", file=sys.stderr, flush=True)
    yield f"{count} damaged meshes: {outcome}, {len(wrong)} wrong by more than 3 %, worst {100 * worst:.2f} %; {wrong}"


def _repaired(mesh: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    from airtact.geometry.mesh.repair import repaired

    found = repaired(*mesh)
    return found.vertices, found.triangles


def _difference(one: at.Scene, other: at.Scene) -> float:
    """Relative difference of two scenes' pressures, of sources off the body, where an array would be.

    Large bodies are solved at a lower frequency, at which they are 60 square wavelengths large.
    """
    surface = one.obstacles[0].surface
    skin = surface.vertices
    centre, radius = 0.5 * (skin.min(axis=0) + skin.max(axis=0)), np.ptp(skin, axis=0).max() / 2
    frequency = FREQUENCY * min(1.0, np.sqrt(60 * one.wavelength**2 / surface.area))
    sources = one_each(centre + (1.8 * radius + 0.005) * directions(4, 11))
    points = centre + (2 * radius + 0.08) * directions(60, 12)
    scenes = [at.Scene(PAPER_AIR, scene.obstacles, frequency=frequency) for scene in (one, other)]
    fields = [at.BoundaryElement().radiate(scene, sources).at(points) for scene in scenes]
    return float(relative(fields[1], fields[0]).max())


FIGURES = {
    "scanned": scanned_figures,
    "box": box_figures,
    "panelling": panelling_figures,
    "angle": angle_figures,
    "tip": tip_figures,
    "gap": gap_figures,
    "monotone": monotone_figures,
    "hand": hand_figures,
    "damaged": damaged_figures,
}

if __name__ == "__main__":
    for figure in sys.argv[1:] or FIGURES:
        for line in FIGURES[figure]():
            print(f"{figure}: {line}", flush=True)
