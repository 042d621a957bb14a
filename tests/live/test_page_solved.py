"""The sound that the page shows with the hand in its place, against a finer solution and the rules of reciprocity."""

import time
from dataclasses import replace

import numpy as np
import pytest

import airtact as at
from airtact.live.drives.bending import BendingHand
from airtact.live.drives.factors import OpenAir, PartSolver, part_of
from airtact.live.page.process import Shown
from airtact.live.page.sound import (
    SLICE_POINTS,
    SLICE_SIZE,
    Section,
    SoundRequest,
    solved_sound,
)
from airtact.live.page.view import MovingSkin, View
from airtact.live.scene import LiveScene, pose_hand
from live.live_scenes import direct_sound, one_board, playing


def asked(scene: LiveScene, moment: at.live.Moment, section: Section | None = None) -> SoundRequest:
    vertices = MovingSkin(scene.radii).at(moment.joints)
    section = section or Section(moment.foci.mean(axis=0), "y", 0.0)
    return SoundRequest(
        time.monotonic(), moment.joints, moment.foci, moment.amplitudes, vertices, section
    )


@pytest.mark.parametrize(
    ("across", "along", "up", "normal"),
    [
        ("x", (0, 1, 0), (0, 0, 1), (1, 0, 0)),
        ("y", (1, 0, 0), (0, 0, 1), (0, 1, 0)),
        ("z", (1, 0, 0), (0, 1, 0), (0, 0, 1)),
    ],
)
def test_a_slice_begins_at_the_upper_left(across, along, up, normal) -> None:
    middle, half = np.array([0.01, 0.02, 0.03]), 0.5 * SLICE_SIZE
    section = Section(middle, across, 5e-3)
    points = section.points()
    centre = middle + 5e-3 * np.array(normal)
    np.testing.assert_allclose(section.middle, centre, atol=1e-12)
    np.testing.assert_allclose(
        points[0], centre - half * np.array(along) + half * np.array(up), atol=1e-12
    )
    np.testing.assert_allclose(
        points[SLICE_POINTS - 1], centre + half * np.array(along) + half * np.array(up), atol=1e-12
    )
    assert np.linalg.det(section.axes) == pytest.approx(1.0)


def test_a_focus_gets_what_a_beacon_there_sends_to_the_array() -> None:
    """The direct equation here and the transposed one, which drives are made with, agree by reciprocity."""
    scene, moment = one_board(), playing(one_board(), 0.2)
    scene = replace(scene, places=("middle.pad", "ring.pad"), offsets=np.full(2, 5e-3))
    foci = pose_hand(scene, moment.joints).foci
    rows = OpenAir(scene).rows(foci)
    amplitudes = rows.conj().sum(axis=0) / np.abs(rows.sum(axis=0)).max()
    sent = np.abs(
        (rows * PartSolver(scene).meshed(moment.joints, "hand", 0.0).factors) @ amplitudes
    )
    hand, skin = BendingHand(scene, accuracy=0.1, min_seen=0.0), np.zeros((1, 3))
    for focus, expected in zip(foci, sent, strict=True):
        section = Section(
            focus + 0.5 * SLICE_SIZE / (SLICE_POINTS - 1) * np.array([1.0, 0.0, 1.0]), "y", 0.0
        )
        request = SoundRequest(0.0, moment.joints, foci, amplitudes, skin, section)
        sound = solved_sound(scene, hand, request)
        nearest = np.argmin(np.linalg.norm(section.points() - focus, axis=1))
        np.testing.assert_allclose(section.points()[nearest], focus, atol=1e-9)
        assert np.abs(sound.field[nearest]) == pytest.approx(expected, rel=0.1)


@pytest.mark.slow
def test_skin_and_slice_are_those_of_a_finer_solution() -> None:
    scene = one_board()
    first, moment = playing(scene, 0.0), playing(scene, 0.26)
    solver = BendingHand(scene, accuracy=0.1, min_seen=0.0)
    solved_sound(scene, solver, asked(scene, first))
    what = asked(scene, moment)
    sound, points = solved_sound(scene, solver, what), what.section.points()
    fine = at.BoundaryElement(accuracy=0.03)
    hand = at.hand_from_joints(moment.joints, scene.radii, side="left")
    body = part_of(hand, "hand", scene.places, fine.panel_edge(scene.medium.wavelength(40e3)))
    air = at.Scene(scene.medium, [at.sound_hard(body)], frequency=40e3)
    every = np.vstack([points, what.skin])
    truth = np.abs(at.field_map(air, scene.array, at.Drive(moment.amplitudes), every, solver=fine))
    direct = np.abs(direct_sound(scene, points, moment.amplitudes))
    for found, true, least in (
        (np.abs(sound.field), truth[: len(points)], 2000),
        (sound.skin, truth[len(points) :], 500),
    ):
        known = np.isfinite(true)
        error = np.linalg.norm((found - true)[known]) / np.linalg.norm(true[known])
        assert known.sum() > least
        assert error < 0.25
    known = np.isfinite(truth[: len(points)])
    assert np.linalg.norm((direct - truth[: len(points)])[known]) > 0.4 * np.linalg.norm(
        truth[: len(points)][known]
    )


def test_a_solver_that_has_died_leaves_the_page_without_sound() -> None:
    scene = one_board()
    view = View(scene)
    view._solver.process.kill()
    view._solver.process.wait()
    for _ in range(3):
        picture = view.picture(Shown(playing(scene)), "y", 0.0, None)
    assert "sound" not in picture.facts
    view._solver.close()
