"""Wrong hands are wrong by what was asked; their drives are evaluated on the right hand."""

import numpy as np
import pytest

from airtact.geometry.mesh.topology import edge_twins
from airtact.hands.hand import Hand
from airtact.hands.joints import BONES, CHAINS
from airtact.transducers.layout import PhasedArray
from benchmarks.hand_mesh_figure import COLUMNS, answers, draw_quality, side_lobes_of, spreads
from benchmarks.hand_mesh_quality import Outcome, Study, beacons, cases, studies
from benchmarks.wrong_hands import (
    bent,
    hand_of_triangles,
    random_direction,
    random_radii,
    scaled_radii,
)
from paths import HANDS

TIPS = [chain[-1] for chain in CHAINS]


@pytest.fixture(scope="module")
def study(tmp_path_factory) -> Study:
    """One focus before the palm, all solutions coarse."""
    whole = studies(HANDS, tmp_path_factory.mktemp("kept"))[1]
    some = PhasedArray(whole.array.positions[::5], whole.array.normals[::5], whole.array.element)
    return Study(whole.name, whole.hand, some, ("palm",), whole.folder, 0.3, 0.3, 0.3, 60e-3)


@pytest.mark.parametrize("size", [0.5e-3, 5e-3])
def test_bent_fingers_keep_their_bones_and_are_elsewhere_by_what_was_asked(study, size):
    wrong = bent(study.hand, size, 3)
    away = np.linalg.norm(wrong.joints - study.hand.joints, axis=1)
    assert np.sqrt(np.mean(away[TIPS] ** 2)) == pytest.approx(size, rel=1e-3)
    assert np.all(away[[0, 1, 5, 6, 10, 11, 15, 16, 20, 21]] == 0)
    for one, other in BONES:
        before, after = (
            np.linalg.norm(hand.joints[one] - hand.joints[other]) for hand in (study.hand, wrong)
        )
        assert after == pytest.approx(before, rel=1e-9)


def test_radii_are_wrong_by_what_was_asked(study):
    errors = np.log(random_radii(study.hand, 0.1, 5).radii / study.hand.radii)
    assert np.sqrt(np.mean(errors**2)) == pytest.approx(0.1)
    assert scaled_radii(study.hand, -0.2).radii == pytest.approx(0.8 * study.hand.radii)


def test_triangles_of_a_hand_touch_it_with_their_corners_alone(study):
    flat = hand_of_triangles(study.hand, 8e-3)
    assert edge_twins(flat.triangles).min() >= 0
    off = study.hand.shape.hulls.look(flat.vertices).distance
    assert np.abs(off).max() < 1e-6
    centres = flat.vertices[flat.triangles].mean(axis=1)
    assert np.median(study.hand.shape.hulls.look(centres).distance) < -0.1e-3


def test_directions_are_of_length_1_and_all_around():
    directions = np.array([random_direction(seed) for seed in range(400)])
    assert np.linalg.norm(directions, axis=1) == pytest.approx(1.0)
    assert np.abs(directions.mean(axis=0)).max() < 0.12


def test_a_hand_believed_elsewhere_has_the_drive_of_a_hand_that_is_there(study):
    shift = np.array([2e-3, -1e-3, 3e-3])
    there = Hand(study.hand.joints + shift, study.hand.radii, study.hand.side)
    solved = study.drive(beacons(there, study.pads, study.driving))
    believed = study.drive(study.believed, shift)
    assert abs(np.vdot(solved, believed)) > 0.999
    assert abs(np.vdot(solved, study.drive(study.believed))) < 0.9


def test_no_drive_of_the_same_energy_passes_that_of_the_right_hand(study):
    found = {case.error: case for case in cases(study, 1)}
    blind = study.outcome(found["no hand at all"])
    assert 0.3 < blind.focus < 1.0
    right = np.vdot(
        study.drive(study.believed), study.reference[0].conj() / np.linalg.norm(study.reference[0])
    )
    assert abs(right) == pytest.approx(1.0, abs=1e-3)
    assert len(study.reference) == 1 + len(study.side_lobe_points) > 10


def test_the_reference_is_read_again_from_its_file(study):
    first = study.reference
    again = Study(
        study.name, study.hand, study.array, study.pads, study.folder, spacing=study.spacing
    )
    assert np.array_equal(again.reference, first)  # of an accuracy that would give other numbers


def outcome(error: str, size: float, focus: float, seed: int = 0) -> Outcome:
    return Outcome("pinch", error, size, seed, focus, focus, 0.5, 0.2)


def test_outcomes_are_summed_up_by_least_median_and_most():
    ones = [outcome("radii", 5.0, focus, seed) for seed, focus in enumerate((0.9, 0.5, 0.8))]
    sizes, table = spreads([*ones, outcome("radii", 2.0, 1.0)], lambda one: one.focus)
    assert sizes.tolist() == [2.0, 5.0]
    assert table.tolist() == [[1.0, 1.0, 1.0], [0.5, 0.8, 0.9]]
    assert side_lobes_of(ones[1]) == pytest.approx(0.0)
    assert answers([*ones, outcome("radii", 2.0, 1.0)])[2:] == [
        "| radii | 2 | 1.00 | -6.0 |",
        "| radii | 5 | 0.80 (0.50 to 0.90) | -4.1 (-5.1 to +0.0) |",
    ]


def test_every_error_has_its_line():
    errors = [error for column in COLUMNS for error in column.errors]
    ones = [outcome(error, size, 1.0 - 0.1 * size) for error in errors for size in (1.0, 2.0)]
    figure = draw_quality([*ones, outcome("no hand at all", 0.0, 0.4)])
    assert len(figure.axes) == 2 * len(COLUMNS)
    drawn = [line.get_ydata() for line in figure.axes[0].lines]
    assert any(np.allclose(values, [1.0, 0.9, 0.8]) for values in drawn if len(values) == 3)
