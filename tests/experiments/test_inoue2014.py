"""The paper's experiment from end to end: small, and as ``--quick`` does it."""

import csv
import dataclasses
import re

import h5py
import numpy as np
import pytest

import airtact as at
from airtact.experiments.dummies import dummies
from airtact.experiments.inoue2014 import reproduce
from airtact.experiments.settings import QUICK

TINY = dataclasses.replace(
    QUICK,
    name="tiny",
    order=3,
    elements_per_wavelength=1.0,
    plane_step=2e-3,  # a grid that holds the beacons, where the pressure is infinite
    verifying=0.1,
    reference=0.1,
    sweep_drive=0.1,
    sweep_verify=0.1,
    gaps=(6e-3, 12e-3),
    radii=(8e-3, 10e-3),
    tilts=(20.0,),
    ways=("from below",),
    tilt_gaps=(12e-3,),
    scan_step=2e-3,
    study_orders=(1, 2),
    study_sizes=(1.0, 10.0),
    study_seconds=0.5,
    study_budget=1.0,
    poses=2,
    node_spacings=(1.0,),
)

TABLES = {
    "beacon_field",
    "differences",
    "foci",
    "mesh_cut",
    "mesh_sizes",
    "mesh_surfaces",
    "microphone",
    "pressures",
    "rigid_motion",
    "rigid_motion_readings",
    "sweep",
    "transducers",
}


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    steps = []
    folder = tmp_path_factory.mktemp("inoue2014")
    return folder, reproduce(folder, report_step=steps.append, settings=TINY), steps


def rows_of(folder, name):
    with (folder / "data" / f"{name}.csv").open(encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def numbers(rows, column):
    return np.array([float(row[column]) for row in rows])


def test_page_is_self_contained_and_says_what_was_left_out(small) -> None:
    _, done, steps = small
    page = done.page.read_text(encoding="utf-8")
    assert page.count("data:image/webp;base64,") == 10
    assert re.findall(r'(?:src|href)="(?!data:)', page) == []
    assert "This is the tiny run" in page
    assert len(steps) == len(set(steps)) > 10
    assert not done.failed
    for name in re.findall(r"data/(\w+)", page):
        assert name in TABLES


def test_what_was_done_before_a_failure_and_before_ctrl_c_is_kept(tmp_path) -> None:
    def broken_off(step: str) -> None:
        if step.startswith("moving the hand"):
            raise KeyboardInterrupt

    settings = dataclasses.replace(TINY, gaps=(6e-3, 0.0), radii=(8e-3,))
    with pytest.raises(KeyboardInterrupt):
        reproduce(tmp_path, report_step=broken_off, settings=settings)
    page = (tmp_path / "index.html").read_text(encoding="utf-8")
    assert "Unfinished: 2 parts are still to come (Rigid motion, Mesh and order)" in page
    assert (
        "This part failed, and the others were done without it: a gap of 0 mm leaves no room"
        in page
    )
    assert page.count("data:image/webp;base64,") == 6
    assert len(rows_of(tmp_path, "sweep")) == 1  # the fingers before the ones that cannot be
    unfinished = {"mesh_sizes", "rigid_motion", "rigid_motion_readings"}
    assert {path.stem for path in (tmp_path / "data").iterdir()} == TABLES - unfinished


def test_numbers_behind_each_figure_are_in_both_kinds_of_file(small) -> None:
    folder, _, _ = small
    assert {path.stem for path in (folder / "data").iterdir()} == TABLES
    for name in TABLES:
        rows = rows_of(folder, name)
        with h5py.File(folder / "data" / f"{name}.h5") as file:
            units = {key: file[key].attrs["unit"] for key in file}
            assert {f"{key}_{unit}" if unit else key for key, unit in units.items()} == set(rows[0])
            assert {len(file[key]) for key in file} == {len(rows)}


def test_drive_is_the_one_that_boundary_elements_make(small) -> None:
    rows, fingers, array = rows_of(small[0], "transducers"), dummies(), at.surrounding_box()
    made = numbers(rows, "amplitude") * np.exp(1j * numbers(rows, "phase_rad"))
    received = (
        at.BoundaryElement(accuracy=0.05)
        .radiate(fingers.scene, fingers.beacon)
        .at(array.positions)[:, 0]
    )
    assert abs(np.vdot(made, received.conj())) > 0.9 * np.linalg.norm(made) * np.linalg.norm(
        received
    )
    assert np.allclose(
        np.stack([numbers(rows, axis) for axis in ("x_m", "y_m", "z_m")], axis=1), array.positions
    )
    levels = (
        numbers(rows, "amplitude_level")
        / 255
        * np.exp(2j * np.pi * numbers(rows, "phase_level") / 256)
    )
    assert np.abs(levels - made).max() < 1e-6  # the verified drive has 256 levels


def test_microphone_is_blank_where_a_finger_is_in_its_way(small) -> None:
    rows = rows_of(small[0], "microphone")
    places = np.stack([numbers(rows, axis) for axis in ("x_m", "y_m", "z_m")], axis=1)
    blank = np.isnan(numbers(rows, "considered_Pa"))
    deep = dummies().scene.depth(places)
    assert blank[deep > 0].all()
    assert 0 < blank.sum() < len(rows)


def test_what_was_not_run_has_no_error_and_says_why(small) -> None:
    rows = rows_of(small[0], "mesh_sizes")
    assert len(rows) == 8
    for row in rows:
        assert (row["notes"] == "run") == np.isfinite(float(row["error"]))
    assert sum(row["notes"] == "run" for row in rows) >= 1
    assert sum("limit" in row["notes"] for row in rows) >= 1


@pytest.mark.slow
def test_quick_run_shows_what_the_issue_asks(tmp_path) -> None:
    done = reproduce(tmp_path, quick=True)
    between = next(
        float(number.split()[0]) for number, what in done.facts if what == "between solvers"
    )
    assert between <= 2.0
    assert len(rows_of(tmp_path, "sweep")) == 12 + 5
    motion = rows_of(tmp_path, "rigid_motion")
    integral, literal = (
        numbers(motion, "surface_integral"),
        numbers(motion, "4_nearest_nodes_lambda_6"),
    )
    assert np.median(integral) < 0.02 < np.median(literal)
