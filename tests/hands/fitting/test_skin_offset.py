"""The skin of a fitted hand moves to the points where there are any, and nowhere else."""

import numpy as np
import pytest
from scipy.spatial import KDTree

from airtact.hands.body import Hulls
from airtact.hands.fitting import fit
from airtact.hands.fitting.fit import FittedHand, fit_hand, with_offset
from airtact.hands.hand import hand_from_joints
from geometry.mesh.meshes import flat_mesh
from references.hand_poses import example
from references.rigged_hand import Rigged, posed, rough, seen, turned_to_camera


@pytest.fixture(scope="module")
def true_hand() -> Rigged:
    return turned_to_camera(posed("pinch", build="stout"), 2)


@pytest.fixture(scope="module")
def fitted(true_hand: Rigged) -> FittedHand:
    return fit_hand(seen(true_hand, 2), rough(true_hand.joints, 2), "right", np.zeros(3))


@pytest.fixture(scope="module")
def hulls() -> Hulls:
    joints, radii = example("relaxed")
    return hand_from_joints(joints, radii).shape.hulls


def shown(hulls: Hulls, out: float) -> np.ndarray:
    """Points off the skin of a body [m], on one side of it."""
    joints, radii = example("relaxed")
    places = hand_from_joints(joints, radii).shape.skin(2.5e-3).vertices
    normals = hulls.look(places).gradient
    return (places + out * normals)[normals[:, 1] > 0.3]


def test_skin_that_is_seen_is_nearer_to_the_true_one(true_hand: Rigged, fitted: FittedHand) -> None:
    true, sight = flat_mesh(true_hand.vertices, true_hand.triangles), np.array([0.0, 0.0, -1.0])
    medians = []
    for places in (fitted.hand.shape.skin(3.5e-3).vertices, fitted.surface.vertices):
        faces = fitted.hand.shape.hulls.look(places).gradient @ sight > 0.3
        medians.append(np.median(np.abs(true.depth(places[faces]))))

    assert medians[1] < 0.8 * medians[0]
    assert medians[1] < 0.5e-3
    assert len(fitted.surface.crossings) == 0
    assert fitted.surface.primitive is None


def test_skin_moves_as_far_as_points_are_off_and_stays_where_there_are_none(hulls: Hulls) -> None:
    points = shown(hulls, 0.8e-3)

    skin = with_offset(hulls, points)

    assert skin is not None
    look = hulls.look(skin.vertices)
    facing = look.gradient[:, 1]
    free = (look.facing > 8e-3) & (np.abs(look.bend) > 5e-3)
    assert np.median(look.distance[(facing > 0.8) & free]) == pytest.approx(0.8e-3, rel=0.1)
    away = KDTree(points).query(skin.vertices)[0] > 2.5 * 5e-3
    assert away.any()
    assert np.abs(look.distance[away]).max() < 1e-6


def test_points_far_off_are_not_followed(hulls: Hulls) -> None:
    points = shown(hulls, 4e-3)
    points = points[
        hulls.look(points).distance > 1.05 * 3e-3
    ]  # in creases they are near other parts
    far, some = with_offset(hulls, points), with_offset(hulls, shown(hulls, 2.5e-3))

    assert far is not None
    assert some is not None
    assert np.abs(hulls.look(far.vertices).distance).max() < 1e-6
    assert np.abs(hulls.look(some.vertices).distance).max() < 1.01 * 1.5e-3


def test_where_the_moved_skin_would_cross_itself_it_stays(
    hulls: Hulls, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Every vertex stays within the limit, but its normal is turned so that triangles cross.
    monkeypatch.setattr(fit, "_unit_rows", lambda vectors: 6.0 * vectors)
    wide = with_offset(hulls, shown(hulls, 0.0))

    assert wide is None or len(wide.crossings) == 0


def test_places_are_on_the_moved_skin(fitted: FittedHand) -> None:
    point, normal = fitted.place("index.pad")

    assert abs(fitted.surface.depth(point[None])[0]) < 1e-6
    assert np.linalg.norm(point - fitted.hand.place("index.pad")[0]) < 1.2 * 1.5e-3
    assert np.linalg.norm(normal) == pytest.approx(1.0)
