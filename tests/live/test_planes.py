"""The live loop over a table: rows against other solvers, what drives keep there, sessions, hands through the table."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import airtact as at
from airtact.live.drives.factors import OpenAir, PartSolver
from airtact.live.safety import Workspace
from airtact.live.scene import LiveScene, foci_on
from live.live_scenes import Ready, direct_sound, one_board, open_pinch
from references.motions import pinch_pose

JOINTS = open_pinch(0.02)


@cache
def hand() -> at.Hand:
    return at.hand_from_joints(JOINTS, pinch_pose()[1], side="left")


@cache
def before() -> LiveScene:
    """A board that stands upright beside the hand."""
    low = hand().surface.corners.reshape(-1, 3).min(axis=0)
    place = (hand().pads[0, 0] / 2 + hand().pads[1, 0] / 2 - 0.09, low[1] - 0.1, low[2] + 0.1)
    upright = at.Pose.turn((1, 0, 0), -np.pi / 2, place)
    return replace(one_board(), array=at.autd3_board(upright))


@cache
def over() -> LiveScene:
    """The same over a table, 40 mm below the hand."""
    lowest = hand().surface.corners[..., 2].min()
    return replace(before(), planes=(at.plane((0, 0, lowest - 0.04), (0, 0, 1)),))


@pytest.fixture(scope="module")
def exact() -> at.TransferMatrix:
    """The hand and the table, solved together."""
    scene = at.Scene(
        over().medium, [at.sound_hard(hand().surface)], frequency=40e3, planes=over().planes
    )
    foci = at.Target(foci_on(hand(), over()))
    return at.transfer_matrix(
        at.BoundaryElement(accuracy=0.03, estimate=False).radiate(scene, foci.beacons()),
        over().array,
    )


@cache
def solution(table: bool, part: str):
    return PartSolver(over() if table else before()).meshed(JOINTS, part, 0.0)


def drive_of(scene: LiveScene, part="hand", method: str | None = None) -> np.ndarray:
    found = [Ready(solution(scene is over(), part))] if part else []
    maker = at.live.HandAware(scene, noise=1e-4, solvers=found)
    maker.take(at.hands.HandFrame(0.0, "left", 0, JOINTS))
    return maker.make(0.01, at.live.Controls(method=method)).amplitudes


def kept(exact: at.TransferMatrix, amplitudes: np.ndarray) -> float:
    best = at.best(exact, at.Target(exact.foci)).amplitudes
    weakest = [np.abs(exact.matrix @ one).min() / np.linalg.norm(one) for one in (amplitudes, best)]
    return weakest[0] / weakest[1]


@pytest.mark.parametrize("let_in", [False, True])
def test_open_air_over_a_table_is_that_of_images(let_in) -> None:
    array = at.autd3_board(at.Pose(np.eye(3), over().planes[0].point)) if let_in else over().array
    scene = replace(over(), array=array)
    foci = foci_on(hand(), scene)
    found = scene.with_images.folded(OpenAir(scene).rows(foci))
    empty = at.Scene(scene.medium, [], frequency=40e3, planes=over().planes)
    rows = at.transfer_matrix(
        at.FreeField().radiate(empty, at.Target(foci).beacons()), array
    ).matrix
    assert np.linalg.norm(found - rows) < 1e-3 * np.linalg.norm(rows)
    amplitudes = rows[0].conj() / np.abs(rows).max()
    sound = direct_sound(scene, foci, amplitudes)
    np.testing.assert_allclose(sound[0], rows[0] @ amplitudes, rtol=0.06)


def test_a_drive_that_knows_the_table_keeps_more(exact) -> None:
    """What goes to and fro between hand and table is left out of both."""
    knowing, not_knowing = (kept(exact, drive_of(scene)) for scene in (over(), before()))
    assert knowing > 0.9
    assert knowing > not_knowing + 0.1
    assert (
        kept(exact, drive_of(over(), "phalanges"))
        > kept(exact, drive_of(before(), "phalanges")) + 0.05
    )
    assert kept(exact, drive_of(over(), None)) > kept(exact, drive_of(before(), None))


def test_another_method_knows_the_table(exact) -> None:
    assert kept(exact, drive_of(over(), method="max_min")) > 0.7


def test_foci_that_move_know_the_table() -> None:
    (places,) = np.tile(np.arange(2), (1, 4, 1))
    moving = at.live.MovingFoci(places, np.zeros((4, 2, 3)), 400.0, "still")
    scene = replace(over(), moving=moving)
    maker = at.live.HandAware(
        scene, noise=1e-4, solvers=[Ready(PartSolver(scene).meshed(JOINTS, "phalanges", 0.0))]
    )
    maker.take(at.hands.HandFrame(0.0, "left", 0, JOINTS))
    frames = maker.make(0.01, at.live.Controls()).frames
    assert frames is not None
    assert frames.shape == (4, len(over().array))


def test_a_session_keeps_its_table(tmp_path) -> None:
    for scene, version in ((over(), 2), (before(), 1)):
        writer = at.live.SessionWriter(tmp_path / "session.h5", scene)
        writer.begin()
        writer.close()
        read = at.live.read_session(tmp_path / "session.h5").scene
        assert len(read.planes) == len(scene.planes)
        for one, other in zip(read.planes, scene.planes, strict=True):
            np.testing.assert_allclose([one.point, one.normal], [other.point, other.normal])
        import h5py

        with h5py.File(tmp_path / "session.h5") as file:
            assert file.attrs["format_version"] == version


@pytest.mark.slow
def test_a_session_is_verified_with_its_table(exact) -> None:
    """The drive made for hand and table gets all of the best; one from distances far less."""
    drives = np.stack([at.best(exact, at.Target(exact.foci)).amplitudes, drive_of(before(), None)])
    nan = np.full(2, np.nan)
    session = at.live.Session(
        over(),
        "",
        drives.astype(np.complex64),
        np.array([0.01, 0.02]),
        np.array([0.01, 0.02]),
        ("hand", "distances"),
        ("playing", "playing"),
        nan,
        nan,
        np.stack([foci_on(hand(), over())] * 2),
        np.stack([JOINTS] * 2),
        np.array([0.0, 0.1]),
        np.stack([JOINTS] * 2),
        (over().side,) * 2,
        np.ones((2, len(over().places))),
        np.zeros((2, 0, 3)),
        np.zeros((2, 0)),
        np.full((2, 25, 3), np.nan),
    )
    shares = at.live.verify_session(session, drives=2).kept
    assert shares[0] == pytest.approx(1.0, abs=0.03)
    assert shares[1] == pytest.approx(kept(exact, drives[1]), abs=0.03)


def test_a_hand_through_the_table_gets_no_sound() -> None:
    workspace, foci = Workspace(over()), foci_on(hand(), over())
    assert workspace.fault(JOINTS, foci) is None
    deeper = JOINTS - [0.0, 0.0, 0.06]
    assert "through the plane: " in str(workspace.fault(deeper, foci))
