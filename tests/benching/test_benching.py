"""The parts of the bench: scenes, references, meshes for other packages, scripts of other packages, and the page."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

import airtact as at
from airtact.acoustics.solvers.spherical.sphere_series import SphereSeries
from airtact.benching import bench, contest, growth
from airtact.benching.contest import (
    Solved,
    faster,
    flat_triangles,
    ours,
    points_inside,
    run_case,
    theirs,
)
from airtact.benching.machine import memory_over_matrix
from airtact.benching.performance_page import Bench
from airtact.benching.phalanges import Phalanges
from airtact.benching.real_time import RealTime, Row, to_drive
from airtact.benching.references import reference_pressure
from airtact.benching.scenes import (
    Bodies,
    deformed,
    moved_each,
    moved_foci,
    two_fingers,
    whole_motion,
)
from airtact.benching.timing import Timed, correlation, relative_error, timed
from airtact.geometry.mesh.topology import cone_volumes, edge_twins
from faults import raises_code
from paths import HANDS

BALL = Bodies((at.sphere(4e-3, 2e-3),), np.array([[0.0, 0.0, 6e-3], [0.0, 7e-3, 0.0]]))
FAR = at.flat_boards(1, 1).seen_from(at.Pose(np.eye(3), np.array([0.0, 0.0, 0.15]))).positions[::8]


def by_series(bodies: Bodies) -> np.ndarray:
    return SphereSeries().radiate(bodies.scene, bodies.target.beacons()).at(FAR).T


# --- scenes ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("frame", range(10))
def test_every_frame_is_a_scene_whose_foci_stand_before_their_pads(frame: int) -> None:
    rest = two_fingers()
    for bodies in (deformed(frame), moved_each(rest, frame), moved_foci(rest, frame)):
        depth = np.array([capsule.depth(bodies.foci) for capsule in bodies.capsules])
        assert bodies.scene.obstacles  # the constructor rejects bodies that touch
        assert np.all(depth.max(axis=0) < -0.4e-3)
        assert np.all(depth.max(axis=0) > -4e-3)
    for capsule, moved in zip(rest.capsules, moved_each(rest, frame).capsules, strict=True):
        assert (moved.radius, moved.length) == (capsule.radius, capsule.length)
    array = at.surrounding_box().seen_from(whole_motion(frame))
    assert rest.scene.depth(array.positions).max() < -5e-3


def test_the_issues_two_fingers() -> None:
    bodies = two_fingers()
    assert [capsule.extent for capsule in bodies.capsules] == pytest.approx([60e-3, 60e-3])
    assert -bodies.capsules[0].depth(bodies.capsules[1].project(bodies.foci[[1]]))[
        0
    ] == pytest.approx(12e-3)
    assert all(
        deformed(1).capsules[0].radius != deformed(frame).capsules[0].radius
        for frame in range(2, 8)
    )


# --- references, meshes, times ----------------------------------------------------------------------------------------


def test_the_reference_is_that_of_the_series_and_is_cached(tmp_path: Path) -> None:
    reference = reference_pressure(BALL, FAR, BALL.foci, tmp_path)
    assert relative_error(reference.pressure, by_series(BALL)) < 3e-3
    files = list(tmp_path.iterdir())
    assert np.array_equal(
        reference_pressure(BALL, FAR, BALL.foci, tmp_path).pressure, reference.pressure
    )
    assert list(tmp_path.iterdir()) == files


def test_flat_triangles_are_closed_even_and_hold_the_volume() -> None:
    bodies = two_fingers()
    vertices, triangles = flat_triangles(bodies, 3e-3)
    assert edge_twins(triangles).min() >= 0
    volume = sum(capsule.volume for capsule in bodies.capsules)
    assert cone_volumes(vertices[triangles]).sum() == pytest.approx(volume, rel=1e-6)
    sides = np.linalg.norm(np.roll(vertices[triangles], 1, axis=1) - vertices[triangles], axis=2)
    assert sides.max() < 2.5 * sides.min()
    inside = points_inside(bodies, 20)
    assert np.bincount(np.argmax([c.depth(inside) for c in bodies.capsules], axis=0)).tolist() == [
        20,
        20,
    ]
    assert bodies.scene.depth(inside).min() > 1.5e-3


def test_times_are_written_with_their_spread() -> None:
    assert str(Timed((0.020, 0.0301, 0.0222))) == "22.2 ms (20.0 to 30.1)"
    assert (
        str(Timed((0.020, 0.0301, 0.0222), (0.03, 0.031, 0.04)))
        == "22.2 ms (20.0 to 30.1; processor 31.0)"
    )
    assert str(Timed((2.0, 3.0, 1.5))) == "2.00 s (1.50 to 3.00)"
    seen: list[int] = []
    took, results = timed([lambda step=step: seen.append(step) or step for step in range(4)])
    assert (results, len(took.seconds), len(took.processor), seen[-3:]) == (
        [1, 2, 3],
        3,
        3,
        [1, 2, 3],
    )
    assert set(seen[:-3]) == {0}


def test_errors_and_likeness() -> None:
    true = np.array([[1.0 + 1j, 2.0], [3.0, 4.0j]])
    assert relative_error(true * np.array([[1.01], [1.03]]), true) == pytest.approx(0.03)
    assert correlation(true[0] * 2j, true[0]) == pytest.approx(1.0)
    assert correlation(np.array([1.0 + 0j, 0]), np.array([1.0 + 0j, 1.0])) == pytest.approx(
        np.sqrt(0.5)
    )


# --- the contest -----------------------------------------------------------------------------------------------------

ANOTHER = """
import sys
import numpy as np
case = np.load(sys.argv[1])
corners = case["vertices"][case["triangles"]]
offset = np.linalg.norm(case["elements"][None] - case["foci"][:, None], axis=2)
matrix = np.exp(1j * case["wavenumber"] * offset) / offset  # as if no body were there
np.savez(
    sys.argv[2], matrix=matrix, seconds=[1.0] * int(case["runs"]), peak=10**6, unknowns=len(corners), version="None 0"
)
"""


def test_ours_runs_in_a_process_of_its_own_and_is_accurate() -> None:
    found = ours(BALL, FAR, by_series(BALL), 2, accuracies=(0.05,))
    assert [one.package for one in found] == [
        f"airtact {at.__version__}",
        f"airtact {at.__version__}, no estimate",
    ]
    for one in found:
        assert one.error < 0.05
        assert one.unknowns > 100
        assert len(one.timed.seconds) == 2


def test_others_get_triangles_and_are_compared_alike(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "bempp_script.py").write_text(ANOTHER)
    monkeypatch.setattr(contest, "SCRIPTS", tmp_path)
    found = theirs("bempp-cl", sys.executable, BALL, FAR, by_series(BALL), 3, (2e-3,))
    assert found[0].unknowns > 20
    assert found[0].error > 0.2  # open air is no answer
    assert found[0].timed.seconds == (1.0, 1.0, 1.0)


def test_an_interpreter_that_is_missing_or_fails_raises() -> None:
    with raises_code("not_supported", "/no/python"):
        run_case("acoustools", "/no/python", {})
    with raises_code("child_failed", "code 1", "ModuleNotFoundError"):
        run_case("acoustools", sys.executable, {"foci": np.zeros((1, 3))})
    with raises_code("file_too_large", "acoustools_script.py", "0 s"):
        run_case("acoustools", sys.executable, {}, limit=0.01)


def solved(package: str, seconds: float, error: float) -> Solved:
    return Solved(package, "", 1000, Timed((seconds,) * 7), error, 10**7)


def test_the_ratio_is_to_the_fastest_of_ours_that_is_as_accurate() -> None:
    mine = [
        solved("airtact", 0.01, 0.05),
        solved("airtact", 0.02, 0.02),
        solved("airtact", 0.05, 0.01),
    ]
    times, best = faster(mine, solved("other", 3.0, 0.03)) or (0.0, mine[0])
    assert (times, best) == (pytest.approx(150.0), mine[1])
    assert faster(mine, solved("other", 3.0, 0.001)) is None


# --- rows, growth and the page ---------------------------------------------------------------------------------------


def test_a_row_has_time_error_and_profile(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fingers = RealTime(tmp_path, runs=1, accuracy=0.1)
    array = at.PhasedArray(FAR, np.tile([0.0, 0.0, 1.0], (len(FAR), 1)))
    monkeypatch.setitem(fingers.__dict__, "array", array)
    frames = [BALL, Bodies((at.sphere(4.2e-3, 2e-3),), BALL.foci)]
    row = fingers._frames("a ball", "1 ms", at.BoundaryElement(accuracy=0.1), frames)
    assert 0 < row.numbers["error"] < 0.1
    assert row.numbers["correlation"] > 0.99
    assert "reference itself" in row.error
    assert "gmres" in row.profile
    made = to_drive(at.BoundaryElement(accuracy=0.1), frames[1], array)
    assert relative_error(
        made.transfer.matrix, array.element.sensitivity * by_series(frames[1])
    ) == pytest.approx(row.numbers["error"], abs=5e-3)


def test_last_phalanges_are_timed_and_compared_with_exacter_ones() -> None:
    rows = Phalanges(1)  # its pose is the one of the smallest gap
    for row in (rows.rigid(), rows.meshed_anew()):
        assert len(row.numbers["seconds"]) == 1
        assert 0.98 < row.numbers["correlation"] < 1.0


def test_codes_are_timed_beside_two_foci(tmp_path: Path) -> None:
    fingers, solved = RealTime(tmp_path, runs=1, accuracy=0.1), []

    def radiate(self: at.BoundaryElement, scene: at.Scene, sources: at.Monopoles) -> None:
        solved.append(sources.strengths.shape)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(at.BoundaryElement, "radiate", radiate)
        row = fingers.coded()
    assert set(solved) == {(2, 2), (996, 16)}
    assert solved.index((2, 2)) < solved.index((996, 16))
    assert "two foci" in row.profile


def test_the_cost_of_more_unknowns_and_elements_is_measured() -> None:
    grown = growth.by_unknowns(1, most=1000)
    assert 500 < grown[0].size < 1200
    assert [one.size for one in growth.by_elements(1, (1, 2))] == [249, 996]
    squared = [growth.Grown(size, Timed((1e-6 * size**2,))) for size in (1000, 2000, 4000, 8000)]
    assert growth.power(squared) == pytest.approx(2.0)


def test_memory_is_measured_in_a_process_of_its_own() -> None:
    row = memory_over_matrix(accuracy=0.03)
    assert row.numbers["unknowns"] > 500
    assert 0.05 < row.numbers["share"] < 5.0


def test_rows_of_the_hand_need_its_pose(tmp_path: Path) -> None:
    names = set(bench.row_jobs(tmp_path, None, 1))
    assert set(bench.row_jobs(tmp_path, HANDS / "relaxed.json", 1)) - names == {
        "hand",
        "hand-drive",
    }


def test_the_folder_holds_tables_figures_and_the_page(tmp_path: Path) -> None:
    found = Bench(
        machine="x86_64, 2 cores, avx2",
        contest=(
            solved("airtact 1", 0.02, 0.02),
            solved("other 2", 2.0, 0.03),
            solved("third 1", 1.0, 0.001),
        ),
        own_error=0.001,
        rows=(
            Row(
                "two fingers",
                "25 ms",
                "21.0 ms (20.0 to 22.0)",
                "2 %",
                "gmres",
                {"seconds": (0.02, 0.022)},
            ),
        ),
        unknowns=tuple(growth.Grown(size, Timed((1e-7 * size**2,))) for size in (1000, 2000)),
        elements=tuple(growth.Grown(size, Timed((1e-6 * size,))) for size in (249, 996)),
        notes=("AcousTools is left out: no --acoustools PYTHON was given.",),
    )
    bench.write(tmp_path, found)
    assert sorted(file.name for file in tmp_path.iterdir()) == sorted([*bench.FILES, "growth.svg"])
    page = (tmp_path / "performance.md").read_text(encoding="utf-8")
    assert "100 times faster (20.0 ms (20.0 to 20.0), 2.00%)" in page
    assert "none of these runs is as accurate" in page
    assert "no --acoustools PYTHON was given" in page
    kept = json.loads((tmp_path / "bench.json").read_text(encoding="utf-8"))
    assert kept["contest"][1]["timed"]["seconds"] == [2.0] * 7
    table = (tmp_path / "bench.csv").read_text(encoding="utf-8").splitlines()
    assert table[0].split(",")[:4] == ["what", "setting", "unknowns", "median_s"]
    assert len(table) == 5
