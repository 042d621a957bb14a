"""What was solved once is found again, whole and never in place of something else."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import airtact as at
from airtact.acoustics.store import SUFFIX, name_of, unpacked
from faults import raises_code

AIR = at.Medium(343.1, 1.293)
SOLVER = at.BoundaryElement(accuracy=0.3)
POINTS = 0.06 * np.random.default_rng(0).normal(size=(30, 3)) / 3 + np.array([0.0, 0.0, 0.05])
AWAY = np.array([[0.0, 0.0, 0.012]])
READ = {"store"}


def ball(frequency: float = 40e3, medium: at.Medium = AIR, radius: float = 3e-3) -> at.Scene:
    return at.Scene(medium, [at.sound_hard(at.sphere(radius, 2e-3))], frequency=frequency)


SCENE, SOURCE = ball(), at.Monopoles(AWAY, np.ones(1))


def was_read(field: at.acoustics.RadiatedField) -> bool:
    return set(field.report.seconds) == READ


def entries(folder: Path) -> list[Path]:
    return sorted(folder.glob("*" + SUFFIX))


def test_a_field_that_is_read_answers_as_the_one_that_was_solved(tmp_path: Path) -> None:
    fingers = at.pinch(gap=0.02)
    scene = at.Scene(AIR, [at.sound_hard(skin) for skin in fingers.surfaces])
    beacons, array = at.Target(fingers.foci()).beacons(), at.surrounding_box()
    solved = SOLVER.radiate(scene, beacons)
    at.Stored(SOLVER, tmp_path).radiate(scene, beacons)
    found = at.Stored(SOLVER, tmp_path).radiate(scene, beacons)

    assert was_read(found)
    assert not was_read(solved)
    points = np.concatenate([fingers.foci(1e-4), POINTS, scene.obstacles[0].surface.vertices[:5]])
    assert np.array_equal(found.at(points), solved.at(points), equal_nan=True)
    assert np.array_equal(found.velocity(POINTS), solved.velocity(POINTS), equal_nan=True)
    for part in ("points", "normals", "areas", "pressure"):
        assert np.array_equal(getattr(found.on_surface, part), getattr(solved.on_surface, part))
    assert replace(found.report, seconds=solved.report.seconds) == solved.report
    moved = array.seen_from(
        at.Pose.turn(np.array([1.0, 2.0, 0.0]), 0.2, translation=(3e-3, 0, 1e-3))
    )
    assert np.array_equal(
        at.transfer_matrix(found, moved).matrix, at.transfer_matrix(solved, moved).matrix
    )
    assert entries(tmp_path)[0].stat().st_size < 250 * solved.report.nodes


def with_surface(**changes: np.ndarray | None) -> at.Scene:
    """Build a tetrahedron-like mesh of the ball without its closed form, something about it changed."""
    skin = SCENE.obstacles[0].surface
    given = {
        "vertices": skin.vertices,
        "triangles": skin.triangles,
        "midpoints": skin.midpoints,
    } | changes
    return at.Scene(AIR, [at.sound_hard(at.Surface(**given))])


def nudged(points: np.ndarray) -> np.ndarray:
    """Move one point by a nanometre."""
    moved = points.copy()
    moved.reshape(-1, 3)[0, 2] *= 1 + 1e-9 / 3e-3
    return moved


def bent() -> np.ndarray:
    """Move the middle of one edge, which two triangles share."""
    midpoints = np.array(SCENE.obstacles[0].surface.midpoints)
    midpoints[np.all(midpoints == midpoints[0, 0], axis=2)] *= 1 + 1e-6
    return midpoints


FARTHER = at.Monopoles(AWAY * (1 + 1e-12), np.ones(1))


def others() -> dict[str, tuple]:
    """Solver, scene and sources: each differs from all others in one thing."""
    skin, stronger = SCENE.obstacles[0].surface, at.Monopoles(AWAY, np.full(1, 1.0 + 1e-15))
    return {
        "moved vertex": (SOLVER, with_surface(vertices=nudged(skin.vertices)), SOURCE),
        "moved mid-edge point": (SOLVER, with_surface(midpoints=bent()), SOURCE),
        "no mid-edge points": (SOLVER, with_surface(midpoints=None), SOURCE),
        "other triangles": (
            SOLVER,
            with_surface(triangles=skin.triangles[::-1], midpoints=None),
            SOURCE,
        ),
        "closed form": (SOLVER, SCENE, SOURCE),
        "larger": (SOLVER, ball(radius=3e-3 + 1e-9), SOURCE),
        "other density": (SOLVER, ball(medium=at.Medium(343.1, 1.3)), SOURCE),
        "other speed": (SOLVER, ball(medium=at.Medium(343.2, 1.293)), SOURCE),
        "absorption": (SOLVER, ball(medium=at.Medium(343.1, 1.293, 0.1)), SOURCE),
        "frequency": (SOLVER, ball(frequency=40e3 + 1e-6), SOURCE),
        "impedance": (SOLVER, at.Scene(AIR, [at.impedance(skin, 50.0)]), SOURCE),
        "other impedance": (SOLVER, at.Scene(AIR, [at.impedance(skin, 50.0 + 1e-9j)]), SOURCE),
        "filled": (SOLVER, at.Scene(AIR, [at.filled(skin, at.Medium(1481.0, 999.7))]), SOURCE),
        "two bodies": (
            SOLVER,
            at.Scene(
                AIR, [at.sound_hard(skin), at.sound_hard(at.sphere(3e-3, 2e-3, (0.02, 0, 0)))]
            ),
            SOURCE,
        ),
        "strength": (SOLVER, SCENE, stronger),
        "place": (SOLVER, SCENE, FARTHER),
        "two sounds": (SOLVER, SCENE, at.Monopoles(np.tile(AWAY, (2, 1)), np.eye(2))),
        "beacons": (SOLVER, SCENE, at.Target(AWAY).beacons()),
        "accuracy": (at.BoundaryElement(accuracy=0.29), SCENE, SOURCE),
        "precision": (at.BoundaryElement(accuracy=0.3, precision="float64"), SCENE, SOURCE),
        "solver": (at.SphereSeries(), SCENE, SOURCE),
        "order": (at.FiniteElement(order=3), SCENE, SOURCE),
    }


def test_whatever_determines_a_field_gives_it_another_name() -> None:
    names = {name: name_of(*parts) for name, parts in others().items()}
    mesh = with_surface()
    names["mesh"] = name_of(SOLVER, mesh, SOURCE)
    SOLVER.radiate(mesh, SOURCE)  # which finds out more about the shape, such as its panels
    assert name_of(SOLVER, mesh, SOURCE) == names["mesh"]
    assert len(set(names.values())) == len(names)
    assert name_of(SOLVER, ball(), at.Monopoles(AWAY.copy(), np.ones(1))) == names["closed form"]
    telling = at.FiniteElement(order=3, progress=print)  # progress determines nothing
    assert name_of(telling, SCENE, SOURCE) == names["order"]


def test_a_damaged_entry_is_solved_again(tmp_path: Path) -> None:
    true = at.Stored(SOLVER, tmp_path).radiate(SCENE, SOURCE).at(POINTS)
    (path,) = entries(tmp_path)
    whole = path.read_bytes()
    key = name_of(SOLVER, SCENE, SOURCE)
    assert unpacked(whole, key, SCENE, SOURCE) is not None
    assert unpacked(whole, name_of(SOLVER, SCENE, FARTHER), SCENE, SOURCE) is None
    damaged = [whole[:length] for length in (0, 100, len(whole) // 2, len(whole) - 1)]
    for place in range(0, len(whole), 997):
        flipped = bytearray(whole)
        flipped[place] ^= 16
        damaged.append(bytes(flipped))
    assert not any(unpacked(attempt, key, SCENE, SOURCE) for attempt in (*damaged, whole + b"0"))
    path.write_bytes(damaged[2])
    found = at.Stored(SOLVER, tmp_path).radiate(SCENE, SOURCE)
    assert not was_read(found)
    assert np.array_equal(found.at(POINTS), true)
    assert was_read(at.Stored(SOLVER, tmp_path).radiate(SCENE, SOURCE))


def test_the_oldest_used_entries_go(tmp_path: Path) -> None:
    """What killed writers left goes first."""
    at.Stored(SOLVER, tmp_path).radiate(SCENE, SOURCE)
    size = entries(tmp_path)[0].stat().st_size
    left = tmp_path / f".killed{SUFFIX}.partial"
    left.write_bytes(bytes(size))
    places = [at.Monopoles(AWAY + 1e-3 * step, np.ones(1)) for step in range(4)]
    stored = at.Stored(SOLVER, tmp_path, most_bytes=int(3.9 * size))
    for index, source in enumerate(places[:3]):
        stored.radiate(SCENE, source)
        for path in tmp_path.iterdir():
            os.utime(path, (path.stat().st_atime, path.stat().st_mtime - 10 * (3 - index)))
    assert not left.exists()
    assert was_read(stored.radiate(SCENE, places[0]))  # so the second is the oldest now
    stored.radiate(SCENE, places[3])
    assert len(entries(tmp_path)) == 3
    kept = [was_read(stored.radiate(SCENE, places[index])) for index in (0, 2, 3, 1)]
    assert kept == [True, True, True, False]


class Wrapped(at.acoustics.Solver):
    """A solver that is no dataclass, so that nothing says how it differs from another."""

    def __init__(self, solver: at.acoustics.Solver) -> None:
        self.solver = solver

    def radiate(self, scene: at.Scene, sources: at.Monopoles) -> at.acoustics.RadiatedField:
        return self.solver.radiate(scene, sources)


@pytest.mark.parametrize(
    ("solver", "folder", "most_bytes"),
    [
        (SOLVER, "/proc/airtact", 10**9),  # nobody makes a folder there
        (SOLVER, "kept", 1000),
        (at.FiniteElement(order=1, elements_per_wavelength=1.0), "kept", 10**9),
        (Wrapped(SOLVER), "kept", 10**9),
    ],
    ids=["no folder", "too large", "objects of a library", "no settings to compare"],
)
def test_what_cannot_be_stored_is_solved_and_said(tmp_path, solver, folder, most_bytes) -> None:
    found = at.Stored(solver, tmp_path / folder, most_bytes).radiate(SCENE, SOURCE)
    assert found.report.warnings
    assert entries(tmp_path / "kept") == []
    if solver is SOLVER:
        assert np.array_equal(found.at(POINTS), SOLVER.radiate(SCENE, SOURCE).at(POINTS))


@pytest.mark.usefixtures("as_outside_the_tests")
@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        ((SOLVER, "kept", 0), "out_of_range"),
        ((SOLVER, "kept", float("nan")), "out_of_range"),
        ((SOLVER, 3), "wrong_kind"),
        ((at.BoundaryElement, "kept"), "wrong_kind"),
    ],
)
def test_what_a_store_refuses(arguments: tuple, code: str) -> None:
    with raises_code(code):
        at.Stored(*arguments)
