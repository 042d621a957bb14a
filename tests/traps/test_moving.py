"""A bead carried along a path between the caps of TinyLev."""

import numpy as np
import pytest

import airtact as at
from airtact.emission.codecs import codec_of
from faults import raises_code

SCENE = at.Scene(at.Medium(sound_speed=343.1, density=1.2))
ARRAY = at.transducers.known_array("tinylev")
UP = np.array([[0.0, 0.0, 0.0], [0.0, 2e-3, 0.0]])


def followed(sequence: at.drives.Sequence, start: np.ndarray) -> np.ndarray:
    """Equilibria of a bead that is at rest in every frame."""
    places = [start[None]]
    for index in range(len(sequence)):
        places.append(at.traps.find(SCENE, ARRAY, sequence.drive(index), places[-1]))
    return np.concatenate(places[1:])


def test_the_bead_follows_every_frame_and_returns() -> None:
    corners = np.array([[0.0, 0.0, 0.0], [0.0, 2e-3, 0.0], [1e-3, 2e-3, 0.0]])
    sequence = at.traps.path(SCENE, ARRAY, corners, speed=0.05)
    places = followed(sequence, corners[0])
    for corner in corners:
        assert np.linalg.norm(places - corner, axis=1).min() < 0.1e-3
    again = followed(sequence, places[-1])
    np.testing.assert_allclose(again, places, atol=1e-6)
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    assert steps.max() * sequence.rate == pytest.approx(0.05, rel=0.2)


def test_steps_are_a_share_of_an_eighth_of_a_wavelength_along_the_axis() -> None:
    # The force of a standing wave peaks there.
    for share in (0.1, 0.4):
        sequence = at.traps.path(SCENE, ARRAY, UP, share=share)
        step = 2 * 2e-3 / len(sequence)
        assert step == pytest.approx(share * SCENE.wavelength / 8, rel=0.15)


def test_steps_beyond_the_peak_lose_the_bead() -> None:
    sequence = at.traps.path(SCENE, ARRAY, 1.5 * UP)
    jumped = at.traps.find(SCENE, ARRAY, sequence.drive(len(sequence) // 2), UP[:1])
    # The bead goes to the next trap, half a wavelength below.
    assert jumped[0, 1] == pytest.approx(3e-3 - SCENE.wavelength / 2, abs=0.6e-3)


def test_a_path_is_exported(tmp_path) -> None:
    closed = np.concatenate([UP, UP[:1]])
    sequence = at.traps.path(SCENE, ARRAY, closed)
    np.testing.assert_array_equal(sequence.drives, at.traps.path(SCENE, ARRAY, UP).drives)
    sequence.save(tmp_path / "path.h5", ARRAY, SCENE)
    loaded = at.load_drive(tmp_path / "path.h5")
    assert len(loaded) == len(sequence)


@pytest.mark.parametrize("name", ["autd3", "openmpd", "sonicsurface"])
def test_the_messages_of_boards_carry_the_bead(name, tmp_path) -> None:
    board = codec_of(name).board
    places = board.positions - board.positions.mean(axis=0)
    lower = at.PhasedArray(places, np.tile([0.0, 0.0, 1.0], (len(places), 1)))
    pair = at.transducers.join(
        [lower, lower.moved(at.Pose.turn((1, 0, 0), np.pi, (0.0, 0.0, 0.2)))]
    )
    corners = np.array([[0.0, 0.0, 0.1], [0.5e-3, 0.0, 0.101]])
    sequence = at.traps.path(SCENE, pair, corners, axis=(0, 0, 1), speed=0.015)
    file = tmp_path / "path.bin"
    count, rate = at.emission.write_frames(file, sequence, name)
    assert count == len(sequence)
    loaded = at.load_drive(file, board=name, elements=len(pair), rate=rate)
    place = corners[:1]
    for index in range(len(sequence)):
        played = at.traps.find(SCENE, pair, loaded.drive(index), place)
        place = at.traps.find(SCENE, pair, sequence.drive(index), place)
        # The levels of the boards shift the bead.
        np.testing.assert_allclose(played, place, atol=0.03e-3)


def test_impossible_paths_are_rejected() -> None:
    # One board alone is too weak against the weight.
    with raises_code("misplaced", "(0.00, 0.00, 100.00)"):
        at.traps.path(SCENE, at.flat_boards(1, 1), np.array([[0.0, 0.0, 0.1], [0.0, 2e-3, 0.1]]))
    with raises_code("out_of_range"):
        at.traps.path(SCENE, ARRAY, UP, share=1.5)
    with raises_code("too_few"):
        at.traps.path(SCENE, ARRAY, UP[:1])
