"""A scene file that names finite elements."""

import msgspec
import numpy as np
import pytest

import airtact as at
from faults import raises_code

TEXT = """
frequency = 40e3
[medium]
sound_speed = 343.1
density = 1.293
[array]
layout = "surrounding_box"
[[obstacles]]
sphere = { radius = 0.004 }
boundary = "filled"
medium = { sound_speed = 1481.0, density = 999.7 }
[[foci]]
point = [0.0, 0.0, 0.006]
[solver]
name = "finite_element"
accuracy = ACCURACY
"""


@pytest.mark.parametrize(("accuracy", "order"), [("0.03", 4), ("0.01", 5), ("0.002", 6)])
def test_finite_elements_are_taken_for_a_filled_body(tmp_path, accuracy, order):
    path = tmp_path / "scene.toml"
    path.write_text(TEXT.replace("ACCURACY", accuracy))
    assert at.read_scene(path).solver == at.FiniteElement(order=order)


def test_more_than_finite_elements_reach_is_rejected(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(TEXT.replace("ACCURACY", "0.0001"))
    with raises_code("out_of_range", "accuracy is 0.0001", "0.001 and 0.3"):
        at.read_scene(path)


@pytest.mark.slow
def test_a_filled_body_is_verified_by_the_next_order(tmp_path):
    path = tmp_path / "scene.toml"
    small = TEXT.replace("radius = 0.004", "radius = 0.0015").replace("0.006", "0.003")
    path.write_text(small.replace("ACCURACY", "0.3"))
    setup = at.read_scene(path)
    field = setup.solver.radiate(setup.scene, setup.target.beacons())
    verified = at.setup.verification_solver(setup).radiate(setup.scene, setup.target.beacons())
    assert verified.report.settings["order"] == int(field.report.settings["order"]) + 1


def test_the_report_goes_into_the_files_of_a_run():
    ball = at.Scene(at.Medium(343.1, 1.293), [at.sound_hard(at.sphere(1.5e-3, edge=1e-3))])
    source = at.Monopoles(np.array([[0.0, 0.0, 0.01]]), np.ones(1, dtype=complex))
    report = at.FiniteElement(order=2).radiate(ball, source).report
    assert msgspec.json.decode(msgspec.json.encode(report))["solver"] == "FiniteElement"
