"""Traps of scene files: their drive, verdicts and limits."""

import re

import numpy as np
import pytest

import airtact as at
from faults import raises_code

TINYLEV = """
[array]
layout = "tinylev"
"""
TRAP = """
[[traps]]
point = [0.0, {}, 0.0]
"""
BALL = """
[[obstacles]]
sphere = { centre = [0.0, 0.0, 0.0], radius = 8e-3 }
"""
FOCUS = """
[[foci]]
point = [0.01, 0.0, 0.0]
"""


@pytest.fixture(scope="module")
def levitator():
    return at.render(at.read_scene("tinylev"))


def test_the_example_holds_two_beads_as_strongly_as_the_signature(levitator) -> None:
    setup = levitator.setup
    assert setup.foci[2] == "trap 2 lobe 1"
    opposed = at.traps.signature(setup.array, at.Drive(np.ones(72) + 0j))
    for trap, height in zip(levitator.traps, (0.0, 4.7e-3), strict=True):
        assert trap.is_trap
        np.testing.assert_allclose(trap.point, (0.0, height, 0.0), atol=0.05e-3)
        best = at.traps.stiffness(setup.scene, setup.array, opposed, trap.point[None])[0]
        np.testing.assert_allclose(np.diag(trap.stiffness), np.diag(best), rtol=0.03)


def test_the_verdict_is_of_the_emitted_drive(levitator) -> None:
    setup = levitator.setup
    places = np.array([trap.point for trap in levitator.traps])
    verdicts = at.traps.verdict(setup.scene, setup.array, levitator.drive, places)
    for trap, other in zip(levitator.traps, verdicts, strict=True):
        np.testing.assert_allclose(trap.stiffness, other.stiffness, rtol=0, atol=1e-6)
        assert trap.holds == pytest.approx(other.holds, rel=1e-6)


def test_a_heavier_bead_falls(read) -> None:
    heavy = TRAP.format(0.0) + "density = 1000.0\nsound_speed = 1480.0\n"
    assert not at.render(read(TINYLEV, heavy)).traps[0].is_trap


def test_a_focus_beside_a_trap_has_its_share(read) -> None:
    result = at.render(read(TINYLEV, TRAP.format(0.0), FOCUS, "share = 0.5\n"))
    assert result.traps[0].is_trap
    lobes, focus = result.pressures[:2].mean(), result.pressures[2]
    assert focus == pytest.approx(0.5 * lobes, rel=0.1)


def test_functions_for_foci_alone_reject_traps(levitator) -> None:
    with raises_code("not_supported"):
        at.setup.why(levitator)
    with raises_code("not_supported"):
        at.place(levitator.setup)


def test_every_method_makes_traps(read) -> None:
    setup = read(TINYLEV, TRAP.format(0.0), FOCUS)
    contenders = at.compare(setup).contenders
    assert len(contenders) == 8
    # Foci at both lobes without opposed phases would leave the bead in an antinode.
    for contender in contenders:
        place = np.zeros((1, 3))
        assert at.traps.verdict(setup.scene, setup.array, contender.emitted, place)[0].stable


def test_the_page_lists_stiffness_and_verdict(levitator, tmp_path) -> None:
    at.write_report(levitator, tmp_path)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    row = re.search(r"trap 2</\w+>(.*?)</tr>", page, re.DOTALL)
    stiffness = levitator.traps[1].stiffness[1, 1]
    assert f"{stiffness:.3g}" in row[1]
    assert "yes" in row[1]
    # Three planes and the force for each of two beads
    assert page.count("Map of the potential along") == 6
    assert page.count("Curves of the force") == 2
    assert page.count(str(levitator.traps[1])[1:]) >= 2


def test_impossible_settings_beside_traps_are_rejected(read) -> None:
    trap = TRAP.format(0.0)
    with raises_code("options_clash"):
        read(TINYLEV, trap, FOCUS, "pressure = 500.0\n")
    with raises_code("options_clash"):
        read(TINYLEV, trap, '[drive.modulation]\nkind = "am"\n')
    with raises_code("options_clash"):
        read(TINYLEV, trap, "[uncertainty]\nposition = 1e-3\n")
    with raises_code("all_zero", "traps[0]"):
        read(TINYLEV, trap, "axis = [0.0, 0.0, 0.0]\n")
    with raises_code("inside_body", "trap 0 at (0.00, 0.00, 0.00) mm is 8 mm inside a body"):
        read(TINYLEV, trap, BALL)
    with raises_code("out_of_range", "body_force"):
        at.render(read(TINYLEV, trap, "radius = 5e-3\n"))
