"""Bodies before and after are cut where they are, and the foci stand beside them."""

import numpy as np
import pytest

import airtact as at
from airtact.evaluation.windows import plane_across
from airtact.reports.sense_page import draw_moved


def test_cuts_of_a_ball_are_circles_about_where_it_was_and_where_it_is():
    ball = at.sphere(4e-3, 0.5e-3)
    moved = ball.moved(at.Pose(np.eye(3), np.array([2e-3, 1e-3, 0.0])))
    foci = np.array([[[0.0, 0.0, 5e-3]], [[2e-3, 1e-3, 5e-3]]])
    window = plane_across(foci[0] * [1, 1, 0], "xz", 8e-3)
    scenes = tuple(at.Scene(at.air(), [at.sound_hard(body)]) for body in (ball, moved))
    figure = draw_moved(window, scenes, foci)
    for axes, name in zip(figure.axes, "zy", strict=True):
        assert axes.get_ylabel() == f"{name} [mm]"
        was, now = (np.column_stack(line.get_data()) for line in axes.lines)
        _, computed, start = (part.get_paths()[0].vertices for part in axes.collections)
        np.testing.assert_allclose(np.linalg.norm(start, axis=1), 4.0, atol=0.05)
        middle = np.array([2.0, 0.0 if name == "z" else 1.0])
        radius = np.sqrt(15.0) if name == "z" else 4.0
        np.testing.assert_allclose(np.linalg.norm(computed - middle, axis=1), radius, atol=0.05)
        height = [5.0, 5.0] if name == "z" else [0.0, 1.0]
        assert [was[0, 0], now[0, 0]] == pytest.approx([0.0, 2.0])
        assert [was[0, 1], now[0, 1]] == pytest.approx(height)
