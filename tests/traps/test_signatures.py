"""Signatures of traps: phases around the focus, and which elements they shift."""

import numpy as np
import pytest

import airtact as at
from faults import raises_code

SCENE = at.Scene(at.Medium(sound_speed=343.1, density=1.2))
BOARD = at.flat_boards(1, 1)
HEIGHT = 0.1
FOCUSED = at.focus_by_distance(BOARD, at.Target((0.0, 0.0, HEIGHT)), SCENE.medium, SCENE.frequency)


def pressure(drive: at.Drive, *points: tuple[float, float]) -> np.ndarray:
    """Pressure in the plane of the focus, relative to that of the focus alone."""
    places = np.array([[0.0, 0.0, HEIGHT]] + [[x, y, HEIGHT] for x, y in points])
    focus = at.field_map(SCENE, BOARD, FOCUSED, places[:1], solver=at.FreeField())
    return at.field_map(SCENE, BOARD, drive, places, solver=at.FreeField()) / np.abs(focus)


@pytest.mark.parametrize("kind", ["twin", "vortex", "bottle"])
def test_a_signature_keeps_magnitudes_and_weakens_the_focus(kind) -> None:
    drive = at.traps.signature(BOARD, FOCUSED, kind)
    np.testing.assert_allclose(drive.magnitudes, FOCUSED.magnitudes)
    # The board has three gaps, and a bottle divides amplitudes, not pressures.
    assert np.abs(pressure(drive)[0]) < (0.35 if kind == "bottle" else 0.03)


def test_twin_has_two_opposed_lobes_along_its_axis() -> None:
    for axis, lobe in (((0, 1, 0), (0.0, 3e-3)), ((2, 0, 0), (3e-3, 0.0))):
        drive = at.traps.signature(BOARD, FOCUSED, "twin", axis)
        _, first, second = pressure(drive, lobe, (-lobe[0], -lobe[1]))
        assert abs(first) > 0.4
        assert abs(first + second) < 0.1 * abs(first)


def test_the_phase_of_a_vortex_turns_once_around_the_focus() -> None:
    drive = at.traps.signature(BOARD, FOCUSED, "vortex")
    turn = np.linspace(0, 2 * np.pi, 13)
    ring = pressure(drive, *zip(2e-3 * np.cos(turn), 2e-3 * np.sin(turn), strict=True))[1:]
    steps = np.angle(ring[1:] / ring[:-1])
    assert steps.sum() == pytest.approx(2 * np.pi)
    assert steps.min() > 0.0


def test_an_array_without_a_front_is_turned_about_the_axis() -> None:
    y = np.array([-0.1, 0.1] * 4)
    angle = 2 * np.pi * np.arange(8) / 8
    places = np.stack([0.05 * np.sin(angle), y, 0.05 * np.cos(angle)], axis=1)
    normals = np.stack([0 * y, -np.sign(y), 0 * y], axis=1)
    caps = at.PhasedArray(places, normals)
    drive = at.traps.signature(caps, at.Drive(np.ones(8) + 0j), "vortex", (0, 1, 0))
    np.testing.assert_allclose(np.exp(1j * np.diff(drive.phases)), np.exp(0.25j * np.pi))


def test_impossible_signatures_are_rejected(as_outside_the_tests) -> None:
    with raises_code("unknown_name", "'quad'"):
        at.traps.signature(BOARD, FOCUSED, "quad")
    with raises_code("misplaced"):
        at.traps.signature(BOARD, FOCUSED, "twin", (0, 0, 1))
    with raises_code("all_zero"):
        at.traps.signature(BOARD, FOCUSED, "twin", (0, 0, 0))
    with raises_code("sizes_differ", "2"):
        at.traps.signature(BOARD, at.Drive(np.ones(2) + 0j))
    line = at.PhasedArray(0.02 * np.eye(3)[:2] * [0, 1, 0], np.eye(3)[[1, 1]])
    with raises_code("misplaced"):
        at.traps.signature(line, at.Drive(np.ones(2) + 0j), "bottle")
