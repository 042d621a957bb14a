"""Shapes as points: on the shape, no farther apart than asked, and rejected with a number."""

import numpy as np
import pytest
from scipy.spatial import KDTree

import airtact as at
from airtact.acoustics.target_points import (
    circle,
    frame_of,
    onto_surface,
    polyline,
    segment,
    sphere_shell,
    surface_points,
)
from faults import raises_code

TILTED = np.array([1.0, -2.0, 2.0]) / 3.0


def test_a_segment_has_both_ends_and_even_steps():
    points = segment((0.0, 0.01, 0.0), (0.03, 0.01, 0.04), spacing=0.011)
    np.testing.assert_allclose(points[[0, -1]], [[0, 0.01, 0], [0.03, 0.01, 0.04]], atol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(np.diff(points, axis=0), axis=1), 0.01)
    # a spacing that fits is kept
    assert len(segment((0, 0, 0), (0.03, 0, 0), spacing=0.01)) == 4
    assert len(circle((0, 0, 0), radius=0.01, spacing=2 * np.pi * 0.01 / 8)) == 8


def test_a_polyline_has_all_its_corners_once():
    corners = np.array([[0.0, 0, 0], [0.01, 0, 0], [0.01, 0.02, 0]])
    line, ring = polyline(corners, 4e-3), polyline(corners, 4e-3, closed=True)
    for points in (line, ring):
        assert KDTree(points).query(points, k=2)[0][:, 1].min() > 1e-3
        assert KDTree(points).query(corners)[0].max() < 1e-12
    assert (len(line), len(ring)) == (3 + 5 + 1, 3 + 5 + 6)


def test_a_circle_lies_in_its_plane_at_its_radius_and_turns_anticlockwise():
    centre = np.array([0.01, 0.02, -0.03])
    points = circle(tuple(centre), radius=0.02, spacing=3e-3, normal=tuple(TILTED))
    np.testing.assert_allclose((points - centre) @ TILTED, 0.0, atol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(points - centre, axis=1), 0.02)
    steps = np.linalg.norm(points - np.roll(points, 1, axis=0), axis=1)
    assert np.ptp(steps) < 1e-12
    assert steps[0] <= 3e-3
    assert np.all(np.cross(points - centre, np.roll(points, -1, axis=0) - centre) @ TILTED > 0)


def test_a_shell_is_even():
    points = sphere_shell((0.0, 0.0, 0.1), radius=0.02, spacing=4e-3)
    np.testing.assert_allclose(np.linalg.norm(points - [0, 0, 0.1], axis=1), 0.02)
    nearest = KDTree(points).query(points, k=2)[0][:, 1]
    assert 0.75 * 4e-3 < nearest.min() <= nearest.max() < 1.25 * 4e-3
    np.testing.assert_allclose(points.mean(axis=0), [0, 0, 0.1], atol=2e-4)


def test_surface_points_lie_on_the_side_that_faces_there():
    finger = at.pinch().surfaces[1]
    everywhere, back = (
        surface_points(finger, 3e-3),
        surface_points(finger, 3e-3, facing=(1.0, 0.0, 0.0)),
    )
    np.testing.assert_allclose(finger.depth(everywhere), 0.0, atol=1e-9)
    axis = np.array([np.sin(np.radians(20.0)), 0.0, -np.cos(np.radians(20.0))])
    tip = np.array([0.014, 0.0, 0.0])
    foot = tip + np.clip((back - tip) @ axis, 0.0, 44e-3)[:, None] * axis
    assert np.all((back - foot)[:, 0] / 8e-3 > -0.05)  # a panel's normal against the true one
    assert 0.35 < len(back) / len(everywhere) < 0.65
    narrow = surface_points(finger, 3e-3, facing=(1.0, 0.0, 0.0), within=30.0)
    assert 0 < len(narrow) < 0.5 * len(back)


def test_surface_points_are_neither_dense_nor_sparse():
    points = surface_points(at.sphere(0.01, edge=3e-3), 2.5e-3)
    assert KDTree(points).query(points, k=2)[0][:, 1].min() > 0.8 * 2.5e-3
    assert KDTree(points).query(sphere_shell((0, 0, 0), 0.01, 0.7e-3))[0].max() < 1.2 * 2.5e-3


def test_a_plane_is_seen_upright():
    right, up, normal = frame_of((0.0, 0.0, 2.0))
    np.testing.assert_allclose([right, up, normal], np.eye(3), atol=1e-15)
    # From +x with z up, y is to the right.
    np.testing.assert_allclose(
        frame_of((1.0, 0.0, 0.0), up=(0.3, 0.0, 1.0))[0], [0, 1, 0], atol=1e-15
    )
    np.testing.assert_allclose(frame_of((0.0, 1.0, 0.0))[1], [0, 0, 1], atol=1e-15)


@pytest.mark.parametrize(
    ("make", "code"),
    [
        (lambda: segment((0, 0, 0), (0, 0, 0), 1e-3), "all_zero"),
        (lambda: segment((0, 0, 0), (0, 0, np.nan), 1e-3), "not_finite"),
        (lambda: segment((0, 0, 0), (5, 0, 0), 1e-3), "too_many"),
        (lambda: polyline(np.zeros((1, 3)), 1e-3), "too_few"),
        (lambda: polyline(np.eye(3)[:2], 1e-3, closed=True), "too_few"),
        (lambda: circle((0, 0, 0), 0.0, 1e-3), "out_of_range"),
        (lambda: circle((0, 0, 0), 50.0, 3e-3), "too_many"),
        (lambda: circle((0, 0, 0), 0.01, -1e-3), "out_of_range"),
        (lambda: circle((0, 0, 0), 0.01, 1e-3, normal=(0, 0, 0)), "all_zero"),
        (lambda: sphere_shell((0, 0, 0), 0.1, 1e-3), "too_many"),
        (lambda: frame_of((0, 0, 1), up=(0, 0, -3)), "all_zero"),
        (lambda: surface_points(at.sphere(0.01, edge=4e-3), 1e-4), "too_many"),
        (
            lambda: surface_points(at.sphere(0.01, edge=4e-3), 3e-3, facing=(0, 0, 0)),
            "out_of_range",
        ),
        (
            lambda: surface_points(at.sphere(0.01, edge=4e-3), 3e-3, facing=(0, 0, 1), within=0.01),
            "empty",
        ),
    ],
)
def test_faults_are_rejected(make, code):
    with raises_code(code):
        make()


def test_a_circle_is_brought_onto_a_ball():
    drawn = circle((0.0, 0.0, 0.02), 5e-3, 2e-3)
    brought = onto_surface(
        drawn, at.sphere(0.01, edge=1e-3, centre=(0.0, 0.0, 0.002)), offset=0.7e-3
    )
    way = drawn - [0.0, 0.0, 0.002]
    expected = [0.0, 0.0, 0.002] + 10.7e-3 * way / np.linalg.norm(way, axis=1, keepdims=True)
    np.testing.assert_allclose(brought, expected, atol=1e-7)


def test_an_offset_in_millimetres_and_a_crevice_are_rejected(hand_file):
    with raises_code("out_of_range"):
        onto_surface(np.array([[0.0, 0.0, 0.02]]), at.sphere(0.01, edge=2e-3), offset=0.5)
    hand = at.load_surface(hand_file)
    between = hand.vertices[hand.vertices[:, 1].argmin()] + [0.0, 0.02, 0.012]
    crowd = between + np.random.default_rng(0).normal(scale=4e-3, size=(300, 3))
    with raises_code("misplaced"):
        onto_surface(crowd, hand, offset=0.015)


def test_points_far_from_a_hand_are_brought_onto_it():
    hand = at.load_hand(at.example("relaxed.json"))
    palm = hand.place("palm")[0]
    points = palm + np.random.default_rng(0).normal(size=(30, 3)) * 0.08
    points = points[hand.surface.depth(points) < 0.0]
    brought = onto_surface(points, hand.surface, 1e-3)
    np.testing.assert_allclose(hand.surface.depth(brought), -1e-3, atol=1e-6)
    # the way is not longer than to the nearest skin
    way = np.linalg.norm(points - brought, axis=1)
    np.testing.assert_allclose(way, -hand.surface.depth(points) - 1e-3, atol=1e-3)
