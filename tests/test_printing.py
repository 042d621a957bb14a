"""What objects print: one line each."""

import re

import numpy as np
import pytest

import airtact as at
from airtact.errors import in_short, one_line, span
from paths import HANDS

# Characters of a line of a public object
LONGEST = 130


@pytest.fixture(scope="module")
def objects() -> dict[str, object]:
    ball = at.sphere(5e-3, edge=2e-3)
    small, spot = at.Scene(at.air(), [at.sound_hard(ball)]), at.Target(np.array([[0, 0, 8e-3]]))
    board = at.autd3_board().facing((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 0.1)
    few = at.Drive(np.ones(249, dtype=complex))
    pinch = at.pinch(gap=0.012)
    scene = at.Scene(at.air(celsius=22), [at.sound_hard(surface) for surface in pinch.surfaces])
    target = at.Target(pinch.foci(offset=0.5e-3), pressures=1500.0)
    array, solver = at.surrounding_box(), at.BoundaryElement(accuracy=0.1)
    beacons = solver.radiate(small, spot.beacons())
    transfer = at.open_air_matrix(at.Scene(scene.medium, []), array, target)
    drive = at.max_min(transfer, target)
    made = {
        "pinch": pinch,
        "surface": pinch.surfaces[0],
        "scene": scene,
        "obstacle": scene.obstacles[0],
        "medium": scene.medium,
        "target": target,
        "sources": target.beacons(),
        "array": array,
        "element": at.piston(4e-3),
        "solver": solver,
        "field": beacons,
        "report": beacons.report,
        "transfer": transfer,
        "drive": drive,
        "frame": at.quantise(drive),
        "sequence": at.drives.Sequence(np.stack([drive.amplitudes] * 4), 800.0),
        "bound": at.upper_bound(transfer, target),
        "evaluation": at.evaluate(small, board, few, spot, solver=solver),
        "comparison": at.compare(small, board, {"one": few, "two": few}, spot, solver=solver),
        "verification": at.evaluation.verify(small, board, few, spot, solver=solver),
        "hand": at.load_hand(HANDS / "relaxed.json"),
        "expansion": at.multipole_expansion(beacons),
        "free field": at.FreeField().radiate(at.Scene(scene.medium, []), target.beacons()),
    }
    return made | {"skin": made["verification"].skin, "on surface": beacons.on_surface}


def test_every_object_prints_in_one_short_line(objects) -> None:
    lines = {name: repr(value) for name, value in objects.items()}
    assert {name: line for name, line in lines.items() if len(line) > LONGEST or "\n" in line} == {}


@pytest.mark.parametrize(
    ("name", "numbers"),
    [
        ("transfer", "2 996"),
        ("target", "2 1500"),
        ("array", "996 4 140 172.7"),
        ("scene", "2 40"),
    ],
)
def test_a_line_has_the_numbers_that_matter(objects, name, numbers) -> None:
    assert set(numbers.split()) <= set(re.findall(r"[\d.]+", repr(objects[name])))


def test_parts_that_are_long_stand_as_their_type() -> None:
    pair = at.hands.Pinch(at.pinch().surfaces, np.zeros((2, 3)), np.zeros((2, 3)), 0.01)
    assert "surfaces=2 in a tuple" in in_short(pair)
    assert one_line(pair, "a", "", "b") == "Pinch(a, b)"
    assert span([1.0, 1.0], "Pa") == "1 Pa"
