"""A scene file that names finite elements."""

import pytest

import airtact as at
from airtact.scene_file.building import read_setup

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
    assert read_setup(path).solver == at.FiniteElement(order=order)


def test_more_than_finite_elements_reach_is_refused(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(TEXT.replace("ACCURACY", "0.0001"))
    with pytest.raises(at.InvalidInput, match=r"accuracy is 0\.0001, but finite elements reach 0\.001 to 0\.3"):
        read_setup(path)
