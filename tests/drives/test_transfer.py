"""The transfer matrix: reciprocity against forward solves, and bad input."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import airtact as at
from faults import raises_code

AIR = at.Medium(343.1, 1.293)
FOCI = np.array([[0.0115, 0.0, 0.0], [-0.004, 0.01, 0.006], [0.0, 0.03, -0.02]])
BALL = at.sphere(0.010, edge=4e-3)


def random_drive(elements: int, seed: int = 1) -> at.Drive:
    random = np.random.default_rng(seed)
    return at.Drive(
        random.uniform(0.0, 1.0, elements) * np.exp(2j * np.pi * random.uniform(size=elements))
    )


@pytest.mark.parametrize("element", [at.monopole(), at.piston(4.5e-3)], ids=["monopole", "piston"])
@pytest.mark.parametrize("medium", [AIR, at.air(20.0, 0.5)], ids=["lossless", "absorbing"])
def test_in_open_air_the_matrix_is_the_closed_form_and_the_forward_field(
    medium: at.Medium, element: at.transducers.Element
) -> None:
    scene = at.Scene(medium, [])
    box = at.surrounding_box(element)
    target = at.Target(FOCI)
    transfer = at.transfer_matrix(at.FreeField().radiate(scene, target.beacons()), box)
    distance = np.linalg.norm(box.face_points[None] - FOCI[:, None, None], axis=-1)
    waves = np.exp(1j * scene.wavenumber * distance) / distance
    np.testing.assert_allclose(
        transfer.matrix, element.sensitivity * (waves @ element.weights), rtol=1e-12
    )
    drive = random_drive(len(box))
    forward = at.field_map(scene, box, drive, FOCI, solver=at.FreeField())
    assert np.abs(transfer.pressure(drive) - forward).max() < 1e-12 * np.abs(forward).max()
    assert transfer.estimated_error == 0.0


@pytest.mark.parametrize("element", [at.monopole(), at.piston(4.5e-3)], ids=["monopole", "piston"])
@pytest.mark.parametrize(
    "body",
    [
        at.sound_hard(BALL),
        at.impedance(BALL, 3.0 + 1.0j),
        at.filled(BALL, at.Medium(1481.0, 999.7)),
    ],
    ids=["sound_hard", "impedance", "filled"],
)
def test_around_a_sphere_beacons_at_the_foci_predict_what_the_elements_make(
    body, element: at.transducers.Element
) -> None:
    scene = at.Scene(AIR, [body])
    target = at.Target(FOCI)
    pose = at.Pose.turn((1, 2, -1), 0.4, (0.003, -0.005, 0.01))
    array = at.PhasedArray(
        *(at.surrounding_box().positions[::40], at.surrounding_box().normals[::40]), element
    ).seen_from(pose)
    drive = random_drive(len(array))
    transfer = at.transfer_matrix(at.SphereSeries().radiate(scene, target.beacons()), array)
    forward = at.field_map(scene, array, drive, FOCI, solver=at.SphereSeries())
    assert np.abs(transfer.pressure(drive) - forward).max() < 1e-6 * np.abs(forward).max()


def test_the_estimated_error_is_asked_for_at_the_elements() -> None:
    scene = at.Scene(AIR, [at.sound_hard(BALL)])
    target = at.Target(FOCI)
    array = at.autd3_board(at.Pose.turn((1, 0, 0), np.pi, (-0.08, 0.06, 0.1)))
    beacons = at.BoundaryElement().radiate(scene, target.beacons())
    transfer = at.transfer_matrix(beacons, array)
    assert transfer.estimated_error == np.max(beacons.error_at(array.positions))
    exact = at.transfer_matrix(at.SphereSeries().radiate(scene, target.beacons()), array).matrix
    true_error = np.max(
        np.linalg.norm(transfer.matrix - exact, axis=1) / np.linalg.norm(exact, axis=1)
    )
    assert true_error < 0.02
    assert 0.3 * true_error < transfer.estimated_error < 0.05


@given(st.integers(0, 2**32 - 1), st.integers(1, 4))
@settings(max_examples=20, deadline=None)
def test_focus_by_distance_sums_the_reversed_delays(seed: int, foci: int) -> None:
    points = np.random.default_rng(seed).uniform(-0.03, 0.03, (foci, 3))
    box = at.surrounding_box()
    drive = at.focus_by_distance(box, at.Target(points, 1500.0), at.air(), 40e3)
    k = 2.0 * np.pi * 40e3 / at.air().sound_speed
    expected = sum(
        np.exp(-1j * k * np.linalg.norm(box.positions - point, axis=1)) for point in points
    )
    np.testing.assert_allclose(drive.amplitudes, expected / np.abs(expected).max(), atol=1e-9)
    assert np.abs(drive.amplitudes).max() == pytest.approx(1.0, rel=1e-12)
    twin = at.focus_by_distance(box, at.Target(points), at.air(), 40e3).phase_only()
    np.testing.assert_allclose(np.abs(twin.amplitudes), 1.0, rtol=1e-12)
    np.testing.assert_allclose(twin.amplitudes * np.abs(expected), expected, atol=1e-9)


def unit_beacons(scene: at.Scene, points: np.ndarray):
    return at.SphereSeries().radiate(scene, at.Target(points).beacons())


def test_sources_that_are_not_unit_beacons_raise() -> None:
    scene = at.Scene(AIR, [])
    for strengths in (np.ones((3, 1)), 2.0 * np.eye(3), np.ones((3, 3))):
        field = at.FreeField().radiate(scene, at.Monopoles(FOCI, strengths + 0j))
        with raises_code("wrong_kind"):
            at.transfer_matrix(field, at.autd3_board())


def test_an_element_inside_a_body_raises_with_its_depth() -> None:
    scene = at.Scene(AIR, [at.sound_hard(BALL)])
    array = at.PhasedArray(np.array([[0.1, 0.0, 0.0], [0.0, 0.006, 0.0]]))
    with raises_code("inside_body"):
        at.transfer_matrix(unit_beacons(scene, FOCI), array)
    with raises_code("inside_body"):
        at.field_map(scene, array, random_drive(2), FOCI, solver=at.SphereSeries())


def test_a_face_that_reaches_into_a_body_raises_though_its_centre_is_outside() -> None:
    scene = at.Scene(AIR, [at.sound_hard(BALL)])
    face = at.transducers.Element(np.array([[-4e-3, 0.0, 0.0], [4e-3, 0.0, 0.0]]), np.ones(2) / 2)
    normals = np.array([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    tangents = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 1.0]])
    array = at.PhasedArray(np.array([[0.1, 0.0, 0.0], [0.0, 0.0, 0.013]]), normals, face, tangents)
    with raises_code("bodies_overlap"):
        at.transfer_matrix(unit_beacons(scene, FOCI), array)


def test_an_element_on_the_skin_is_allowed() -> None:
    scene = at.Scene(AIR, [at.sound_hard(BALL)])
    array = at.PhasedArray(np.array([[0.0, 0.0, 0.010]]))
    transfer = at.transfer_matrix(unit_beacons(scene, FOCI[2:]), array)
    assert np.abs(transfer.matrix).item() > 0.0


def test_what_stands_behind_a_directional_face_raises_with_how_far() -> None:
    array = at.flat_boards(1, 1, at.piston(4.5e-3))
    scene = at.Scene(AIR, [])
    target = at.Target(np.array([[0.0, 0.0, 0.1], [0.0, 0.0, -0.025]]))
    with raises_code("behind_faces"):
        at.transfer_matrix(at.FreeField().radiate(scene, target.beacons()), array)
    with raises_code("behind_faces"):
        at.focus_by_distance(array, target, AIR, 40e3)
    monopoles = at.flat_boards(1, 1, at.monopole())
    assert np.isfinite(
        at.transfer_matrix(at.FreeField().radiate(scene, target.beacons()), monopoles).matrix
    ).all()
    assert len(at.focus_by_distance(monopoles, target, AIR, 40e3)) == 249


def test_a_body_behind_a_directional_face_raises_with_how_far() -> None:
    array = at.flat_boards(1, 1, at.piston(4.5e-3))
    low = at.Scene(AIR, [at.sound_hard(at.sphere(0.010, edge=4e-3, centre=(0.0, 0.2, 0.004)))])
    with raises_code("behind_faces"):
        at.transfer_matrix(unit_beacons(low, np.array([[0.0, 0.0, 0.1]])), array)


def test_a_piston_too_large_for_the_frequency_raises() -> None:
    scene = at.Scene(AIR, [], frequency=80e3)
    array = at.autd3_board(element=at.piston(4.5e-3))
    beacons = at.FreeField().radiate(scene, at.Target(np.array([[0.0, 0.0, 0.1]])).beacons())
    with raises_code("out_of_range"):
        at.transfer_matrix(beacons, array)


ONES = np.ones((2, 3), dtype=np.complex128)


@pytest.mark.usefixtures("as_outside_the_tests")
@pytest.mark.parametrize(
    ("make", "code"),
    [
        (lambda: at.TransferMatrix(0.0 * ONES, 0.0), "all_zero"),
        (lambda: at.TransferMatrix(ONES[0], 0.0), "wrong_shape"),
        (lambda: at.TransferMatrix(ONES[:0], 0.0), "wrong_shape"),
        (lambda: at.TransferMatrix(ONES, 0.0).pressure(at.Drive(np.ones(4) + 0j)), "sizes_differ"),
        (lambda: at.TransferMatrix(np.where(np.eye(2, 3) > 0, np.nan, ONES), 0.0), "not_finite"),
        (lambda: at.Drive((1.0 + 1e-8) * ONES[0]), "over_full_scale"),
        (lambda: at.Drive(np.nan * ONES[0]), "not_finite"),
        (lambda: at.Drive(ONES), "wrong_shape"),
        (lambda: at.Drive(ONES[0, :0]), "wrong_shape"),
    ],
)
def test_bad_matrices_and_drives_raise(make, code: str) -> None:
    with raises_code(code):
        make()
