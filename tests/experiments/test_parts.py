"""Parts of the experiment by themselves, against closed forms."""

import dataclasses
import subprocess
import sys

import numpy as np
import pytest
from scipy.spatial import KDTree

import airtact as at
from airtact.evaluation.windows import AXES, Window
from airtact.experiments.dummies import dummies
from airtact.experiments.measurement import peak_ratios, readings
from airtact.experiments.mesh_run import Combination, Ran, run_apart
from airtact.experiments.mesh_sizes import how_many, study
from airtact.experiments.part import write_columns
from airtact.experiments.rigid_motion import Nodes, nodes_beside, random_poses
from airtact.experiments.settings import FULL
from airtact.reports.field_figure import past_the_surface
from airtact.timing import Clock
from faults import raises_code

K = 2 * np.pi * 40e3 / 343.1


def test_dummies_are_those_of_the_pinch() -> None:
    made, known = dummies(gap=0.014), at.pinch(gap=0.014)
    assert np.allclose(made.foci, known.pads)
    probes = np.random.default_rng(1).uniform(-0.06, 0.06, (200, 3))
    scene = at.Scene(
        at.Medium(343.1, 1.293), [at.sound_hard(one) for one in known.surfaces], frequency=40e3
    )
    assert np.allclose(made.scene.depth(probes), scene.depth(probes), atol=1e-9)


@pytest.mark.parametrize("entering", ["from below", "from above", "from the side"])
@pytest.mark.parametrize("tilt", [0.0, 30.0, 90.0])
def test_foci_are_where_the_fingers_are_nearest(entering, tilt) -> None:
    fingers = dummies(gap=0.01, radius=7e-3, tilt=tilt, entering=entering)
    assert np.allclose(fingers.scene.depth(fingers.foci), 0.0, atol=1e-9)
    for surface in fingers.surfaces:
        assert np.abs(surface.vertices[:, 0]).min() >= 0.005 - 1e-9


@pytest.mark.parametrize(
    ("settings", "code", "number"),
    [({"tilt": 120.0}, "out_of_range", "120"), ({"gap": 0.0}, "out_of_range", "0 mm")],
)
def test_impossible_fingers_raise(settings, code, number) -> None:
    with raises_code(code, number):
        dummies(**settings)


def cloud(pressure) -> Nodes:
    points = np.random.default_rng(2).uniform(-0.01, 0.01, (4000, 3)) + [0.05, 0.0, 0.0]

    def carrier(at_points):
        distance = np.linalg.norm(at_points, axis=1)
        return np.exp(1j * K * distance) / distance

    return Nodes(points, pressure(points), carrier, KDTree(points))


def test_four_nodes_are_exact_for_what_is_linear() -> None:
    nodes = cloud(lambda x: (x @ [1.0, 2.0, -3.0] + 0.5).astype(np.complex128))
    asked = np.random.default_rng(3).uniform(-0.009, 0.009, (500, 3)) + [0.05, 0.0, 0.0]
    pressure, outside = nodes.literal(asked)
    assert np.allclose(pressure, asked @ [1.0, 2.0, -3.0] + 0.5, atol=1e-6)
    assert 0.2 < outside.mean() < 1.0  # the 4 nearest rarely surround a point


def test_four_nodes_without_the_carrier_are_exact_for_a_monopole() -> None:
    nodes = cloud(lambda x: np.exp(1j * K * np.linalg.norm(x, axis=1)) / np.linalg.norm(x, axis=1))
    asked = np.random.default_rng(3).uniform(-0.009, 0.009, (500, 3)) + [0.05, 0.0, 0.0]
    distance = np.linalg.norm(asked, axis=1)
    true = np.exp(1j * K * distance) / distance
    assert np.allclose(nodes.carrier_free(asked)[0], true, rtol=1e-6)
    assert np.linalg.norm(nodes.literal(asked)[0] - true) > 0.01 * np.linalg.norm(true)


def test_nodes_surround_the_points_and_leave_the_bodies_out() -> None:
    scene = dummies().scene
    points = np.array([[0.0, 0.0, 0.0], [0.0, 0.05, 0.0]])
    nodes = nodes_beside(points, 2e-3, scene)
    assert (scene.depth(nodes) < 0).all()
    assert len(nodes) > 27
    assert (
        np.linalg.norm(nodes[:, None] - points, axis=2).min(axis=1).max() < 2e-3 * np.sqrt(3) * 2.4
    )


def test_poses_are_the_same_every_time() -> None:
    one, other = random_poses(3), random_poses(3)
    assert all(np.array_equal(a.rotation, b.rotation) for a, b in zip(one, other, strict=True))
    assert max(np.abs(pose.translation).max() for pose in one) <= 5e-3


def costs_of(one: Combination) -> tuple[float, float, float]:
    """Tetrahedra, seconds and bytes of a mesh by a law of its own, other powers than the prediction's among it."""
    cells = {"tight": 1300, "box": 8600}[one.domain] * (0.3 + 0.7 * one.elements_per_wavelength**3)
    local, shared = (
        (one.order + 1) * (one.order + 2) * (one.order + 3) / 6,
        cells * one.order**3 / 6,
    )
    return (
        cells,
        0.5 + 3e-4 * cells + 4e-7 * cells * local**2 + 2e-7 * shared**1.6,
        3e8 + 40 * cells * local**2,
    )


def imitated(one: Combination, _limit: float) -> Ran:
    cells, seconds, most = costs_of(one)
    return Ran(
        int(cells),
        int(cells * one.order**3 / 6),
        seconds,
        int(most),
        np.ones(4, dtype=np.complex128),
    )


def test_study_runs_what_is_within_its_limits_and_nothing_else() -> None:
    settings, kept = FULL, []
    rows = study(
        settings, np.ones(4, dtype=np.complex128), Clock(lambda _: None), imitated, kept.append
    )
    assert len(rows) == 96
    assert len({row.combination for row in rows}) == 96
    for row in rows:
        _, seconds, most = costs_of(row.combination)
        share = max(seconds / settings.study_seconds, most / settings.study_bytes)
        if not 0.7 < share < 1.4:  # a prediction is no more exact than that
            assert (row.notes == "") == (share < 1)
    ran = [row for row in rows if not row.notes]
    assert len(ran) > 30
    assert all(row.error == 0.0 for row in ran)
    assert [sum(not row.notes for row in some) for some in kept] == list(
        range(len(ran) + 1)
    )  # each run was kept


def test_study_stops_when_its_time_is_spent_and_says_so() -> None:
    settings = dataclasses.replace(FULL, study_budget=1.0)
    rows = study(settings, np.ones(4, dtype=np.complex128), Clock(lambda _: None), imitated)
    cut = [row for row in rows if row.notes == "no time left for it"]
    assert cut
    assert any(not row.notes for row in rows)
    assert (
        f"{len(cut)} within those limits were not run because the study as a whole is given 1 s"
        in how_many(rows, settings)
    )


def test_study_in_which_nothing_ends_well_stops_too() -> None:
    settings = dataclasses.replace(FULL, study_budget=0.0)
    rows = study(
        settings,
        np.ones(4, dtype=np.complex128),
        Clock(lambda _: None),
        lambda one, limit: "it broke",
    )
    assert sum(row.notes == "it broke" for row in rows) == 1
    assert all(np.isnan(row.error) for row in rows)
    assert "1 begun did not end well" in how_many(rows, settings)


def test_memory_of_a_process_is_its_own() -> None:
    """The largest memory that Linux counts for a child would hold what its parent had."""
    ballast = np.ones(2**26)  # half a gigabyte
    command = [
        sys.executable,
        "-c",
        "from airtact.benching.peers.peak_memory import peak; print(peak())",
    ]
    most = int(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    assert 2**24 < most < ballast.nbytes


def test_a_run_that_takes_too_long_is_ended_with_its_reason() -> None:
    assert run_apart(Combination(1, 1.0, "tight"), 0.05) == "ended after 0 s"


def test_a_run_that_fails_has_its_reason() -> None:
    assert "order" in str(run_apart(Combination(11, 1.0, "tight"), 600.0))


def test_readings_keep_the_blanks_and_ratios_ignore_them() -> None:
    pressure = np.full((50, 4), 2.0 + 0j) * np.array([1.0, 0.5, 3.0, 1.5])
    pressure[7] = np.nan
    read = readings(pressure)
    assert np.isnan(read[7]).all()
    assert np.isfinite(np.delete(read, 7, axis=0)).all()
    ratios = peak_ratios(read, np.array([1.0, 0.5, 1.0, 1.0]))
    assert ratios["equal energy"] == pytest.approx(0.5, rel=0.1)
    assert ratios["equal peak"] == pytest.approx(2 * ratios["equal energy"])
    assert ratios["phase only"] == pytest.approx(0.5, rel=0.1)


def test_values_are_carried_two_points_past_the_skin() -> None:
    window = Window(np.zeros(3), AXES["x"], AXES["z"], 9e-3, 1e-3, 1e-3)
    values = np.tile([1.0, 2, 3, 4, *[np.nan] * 6], 2)
    assert np.array_equal(
        past_the_surface(window, values, 2)[:7], [1, 2, 3, 4, 4, 4, np.nan], equal_nan=True
    )


def test_columns_of_unequal_length_raise(tmp_path) -> None:
    with pytest.raises(ValueError, match="shorter"):
        write_columns(tmp_path, "uneven", {"a": ("m", np.zeros(2)), "b": ("", ["one"])})
    assert not list(tmp_path.iterdir())
