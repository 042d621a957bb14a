"""What a refusal is about stands in front, and the place of the fault stays."""

import numpy as np
import pytest

from airtact.conventions import InvalidInput, about


def test_the_place_is_kept_through_all_that_it_is_about():
    place = np.array([0.01, 0.02, 0.03])
    with pytest.raises(InvalidInput) as caught, about("scene.toml"), about("obstacles[1]"):
        raise InvalidInput("1 edge is open.", place)
    assert str(caught.value) == "scene.toml: obstacles[1]: 1 edge is open."
    assert caught.value.place is place


def test_a_refusal_without_a_place_stays_without_one():
    with pytest.raises(InvalidInput) as caught, about("scene.toml"):
        raise InvalidInput("0 foci.")
    assert caught.value.place is None
