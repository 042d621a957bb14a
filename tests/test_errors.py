"""The name of a file or a table stands in front of a fault's sentence; its position and code stay."""

import numpy as np
import pytest

from airtact.errors import InvalidInput, about


def test_the_position_and_the_code_are_kept_through_all_that_the_fault_is_about():
    position = np.array([0.01, 0.02, 0.03])
    with pytest.raises(InvalidInput) as caught, about("scene.toml"), about("obstacles[1]"):
        raise InvalidInput("1 edge is open.", position, code="mesh_open")
    assert str(caught.value) == "scene.toml: obstacles[1]: 1 edge is open."
    assert caught.value.position is position
    assert caught.value.code == "mesh_open"


def test_a_fault_without_a_position_stays_without_one():
    with pytest.raises(InvalidInput) as caught, about("scene.toml"):
        raise InvalidInput("0 foci.", code="empty")
    assert caught.value.position is None
