"""Foci from frame to frame: hysteresis, ramps and identity."""

import numpy as np
import pytest

import airtact as at
from airtact.touch import TouchState, skin_of

FRAME = 5e-3


@pytest.fixture
def skin():
    return skin_of(at.sphere(8e-3, 2e-3))


def ball_at(depth: float) -> at.VirtualObject:
    pose = at.Pose.shift((0.0, 0.0, 20e-3 - depth))
    return at.VirtualObject(at.sphere(12e-3, 3e-3), pose, name="ball")


def play(state: TouchState, skin, depths) -> list[at.touch.TouchFoci]:
    results = []
    for depth in depths:
        state.objects = ball_at(depth)
        results.append(state.update(skin, play.time))
        play.time += FRAME
    return results


play.time = 0.0


def test_a_contact_begins_inside_and_ends_a_millimetre_outside(skin) -> None:
    state = TouchState(ball_at(0.0))
    depths = [-0.5e-3] * 3 + [0.5e-3] * 8 + [-0.8e-3] * 8 + [-1.2e-3] * 8
    frames = play(state, skin, depths)
    counts = [len(frame.points) for frame in frames]
    assert counts[:3] == [0, 0, 0]
    assert counts[3:19] == [1] * 16
    assert frames[18].strengths[0] == pytest.approx(0.2)  # that of the first touch
    assert counts[-3:] == [0, 0, 0]


def test_levels_rise_and_fall_within_the_ramp(skin) -> None:
    state = TouchState(ball_at(3e-3))
    frames = play(state, skin, [3e-3] * 8 + [-5e-3] * 6)
    levels = [float(frame.strengths[0]) if len(frame.points) else 0.0 for frame in frames]
    assert levels[:4] == pytest.approx([0.0, 0.25, 0.5, 0.75])
    assert levels[4:8] == pytest.approx([1.0] * 4)
    assert levels[8:] == pytest.approx([0.75, 0.5, 0.25, 0.0, 0.0, 0.0])
    assert frames[8].contacts.tolist() == [-1]


def test_a_focus_keeps_its_number_while_it_moves(skin) -> None:
    state = TouchState(ball_at(2e-3))
    numbers = set()
    for step in range(20):
        angle = 0.05 * step
        pose = at.Pose.shift((18e-3 * np.sin(angle), 0.0, 18e-3 * np.cos(angle)))
        state.objects = at.VirtualObject(at.sphere(12e-3, 3e-3), pose, name="ball")
        foci = state.update(skin, step * FRAME)
        numbers |= set(state.numbers.tolist())
        way = pose.translation / np.linalg.norm(pose.translation)
        np.testing.assert_allclose(foci.points, [8.5e-3 * way], atol=0.1e-3)
    assert numbers == {1}


def test_new_foci_wait_until_others_have_faded(skin) -> None:
    def at_angle(angle: float) -> at.VirtualObject:
        pose = at.Pose.shift((18e-3 * np.sin(angle), 0.0, 18e-3 * np.cos(angle)))
        return at.VirtualObject(at.sphere(12e-3, 3e-3), pose, name="ball")

    state = TouchState(at_angle(0.0), most=1)
    counts = []
    for step in range(20):
        state.objects = at_angle(0.0 if step < 8 else np.pi)
        counts.append(len(state.update(skin, step * FRAME).points))
    assert max(counts) == 1
    assert state.numbers.tolist() == [2]
