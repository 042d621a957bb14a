"""Scene files with a rigid plane."""

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
layout = "flat_boards"
[[planes]]
point = [0.0, 0.0, 0.0]
normal = [0.0, 0.0, 1.0]
[[obstacles]]
sphere = { radius = 0.004, centre = [0.08, 0.06, 0.1] }
[[foci]]
point = [0.08, 0.06, 0.095]
"""


def written(folder, old="", new=""):
    path = folder / "scene.toml"
    path.write_text(TEXT.replace(old, new) if old else TEXT)
    return path


def test_a_plane_is_read_from_a_file(tmp_path):
    setup = at.read_scene(written(tmp_path))
    (plane,) = setup.scene.planes
    assert np.array_equal(plane.normal, [0, 0, 1])
    assert isinstance(setup.solver, at.BoundaryElement)


@pytest.mark.parametrize(
    ("code", "words", "old", "new"),
    [
        ("behind_plane", "foci: ", "0.095]", "-0.005]"),
        ("bodies_overlap", "body 0 reaches 104 mm behind", "0.0, 1.0]", "0.0, -1.0]"),
        ("behind_plane", "array: ", "point = [0.0, 0.0, 0.0]", "point = [0.0, 0.0, 0.001]"),
        ("out_of_range", "planes[0]: ", "normal = [0.0, 0.0, 1.0]", "normal = [0.0, 0.0, 0.0]"),
        ("not_supported", "solver: ", "[[foci]]", '[solver]\nname = "finite_element"\n[[foci]]'),
    ],
)
def test_what_does_not_go_with_a_plane_is_rejected_by_its_table(tmp_path, code, words, old, new):
    with raises_code(code, words):
        at.read_scene(written(tmp_path, old, new))
