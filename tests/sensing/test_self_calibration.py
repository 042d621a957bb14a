"""Boards, gains and sound speed from transmissions that monopoles, summed one by one, make; what is not determined."""

from functools import partial

import numpy as np
import pytest

import airtact as at
from airtact.sensing.transmission import boards_of, transmission
from faults import raises_code

BELIEVED_AIR = at.Medium(343.1, 1.2)
TRUE_AIR = at.Medium(344.4, 1.2)
calibrate = partial(at.calibrate, boards=2)
simulate_transmissions = partial(at.sensing.simulate_transmissions, boards=2)
FACING = at.Pose.turn((1, 0, 0), np.pi, (0, 0.03, 0.06))
CODES = at.sensing.hadamard_codes(24)
OFF = at.Pose.turn((1, 2, -1), 0.012, (4e-4, -3e-4, 2e-4))


def pair(
    off: at.Pose | None = None, element: at.transducers.Element | None = None
) -> at.PhasedArray:
    facing = FACING if off is None else off @ FACING
    return at.transducers.board_array("nano16", [at.Pose.identity(), facing], element)


def gains(seed: int, count: int = 24) -> np.ndarray:
    random = np.random.default_rng(seed)
    return np.exp(0.1 * random.normal(size=count) + 0.3j * random.normal(size=count))


def by_hand(
    array: at.PhasedArray, reception: np.ndarray, codes: np.ndarray, noise: float
) -> at.Echoes:
    """Add up s e^{ikR}/R over the points of both faces, pair by pair of elements."""
    wavenumber = TRUE_AIR.wavenumber(40e3).real
    faces = array.face_points
    weights = array.element.weights
    pairs = np.zeros((len(array), len(array)), dtype=complex)
    for receiver, points in enumerate(faces):
        for emitter in range(12, 24) if receiver < 12 else range(12):
            distance = np.linalg.norm(points[:, None] - faces[emitter], axis=2)
            mean = weights @ (np.exp(1j * wavenumber * distance) / distance) @ weights
            pairs[receiver, emitter] = array.element.sensitivity * mean
    pressures = reception[:, None] * (pairs @ (array.gains[:, None] * codes))
    deviation = noise * float(np.sqrt(np.mean(np.abs(pressures) ** 2)))
    random = np.random.default_rng(3)
    rest = random.normal(size=pressures.shape) + 1j * random.normal(size=pressures.shape)
    return at.Echoes(codes, pressures + deviation / np.sqrt(2) * rest, noise=deviation or None)


@pytest.fixture(scope="module")
def found() -> at.sensing.Calibrated:
    heard = by_hand(pair(OFF).calibrated(gains(0)), gains(1), at.sensing.hadamard_codes(24), 1e-4)
    return calibrate(heard, pair(), BELIEVED_AIR)


def test_boards_gains_and_sound_speed_are_found_from_sums_by_hand(
    found: at.sensing.Calibrated,
) -> None:
    assert found.converged, found
    middle = pair().positions[12:].mean(axis=0)
    assert np.linalg.norm(found.motions[1].apply(middle) - OFF.apply(middle)) < 2e-5
    assert np.linalg.norm(found.motions[1].rotation - OFF.rotation) < 1e-3
    assert np.allclose(found.motions[0].rotation, np.eye(3), rtol=0, atol=1e-12)
    assert found.sound_speed == pytest.approx(344.4, abs=0.3)
    assert np.allclose(found.array.positions, pair(OFF).positions, rtol=0, atol=3e-5)
    for one, true in ((found.emission, gains(0)), (found.reception, gains(1))):
        ratio = (one / true).reshape(2, 12)  # two boards alone do not compare with each other
        assert np.abs(ratio / ratio.mean(axis=1, keepdims=True) - 1).max() < 0.002
    product = found.reception[:12, None] * found.emission[12:]
    assert np.allclose(product, gains(1)[:12, None] * gains(0)[12:], rtol=0, atol=0.01)


def test_errors_are_as_large_as_the_covariance_says() -> None:
    off = []
    true = pair(OFF, at.monopole())
    for seed in range(12):
        heard = simulate_transmissions(
            true, TRUE_AIR, at.sensing.hadamard_codes(24), noise=50.0, seed=seed
        )
        found = calibrate(heard, pair(OFF, at.monopole()), TRUE_AIR)
        move = found.shifts[1]
        turn = found.motions[1].rotation
        twist = (
            np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
            / 2
        )
        error = np.concatenate([move, twist, [found.sound_speed - 344.4]])
        off.append(error @ np.linalg.solve(found.covariance, error))
    assert 4.0 < np.mean(off) < 11.0  # chi squared with 7 degrees of freedom: 7 ± 1.1


def test_derivatives_are_those_of_the_transmission() -> None:
    one, other = boards_of(pair(OFF), 2)
    wavenumber = TRUE_AIR.wavenumber(40e3)
    step = 1e-7
    _, slopes = transmission(one, other, wavenumber)
    for index in range(13):
        values = []
        for sign in (1, -1):
            boards = [one, other]
            size = wavenumber
            if index == 12:
                size = wavenumber + sign * 1e-3
            else:
                board, axis = divmod(index, 6)
                along = np.eye(3)[axis % 3]
                turn = at.Pose.turn(along, sign * step if axis > 2 else 0.0).rotation
                middle = boards[board].positions.mean(axis=0)
                shift = sign * step * along if axis < 3 else 0.0
                boards[board] = boards[board].moved(at.Pose(turn, middle - turn @ middle + shift))
            values.append(transmission(boards[0], boards[1], size)[0])
        numeric = (values[0] - values[1]) / (2e-3 if index == 12 else 2 * step)
        assert np.linalg.norm(numeric - slopes[index]) < 1e-6 * np.linalg.norm(slopes[index])


def test_a_scene_reads_what_was_found(found: at.sensing.Calibrated, tmp_path) -> None:
    path = tmp_path / "calibration.csv"
    found.save(path)
    (tmp_path / "scene.toml").write_text(
        '[medium]\nsound_speed = 344.4\ndensity = 1.2\n[array]\nlayout = "boards"\nboard = "nano16"\n'
        f'calibration = "{path.name}"\npose = {{ translation = [0.0, 0.0, -0.03] }}\n[[array.poses]]\n'
        "[[array.poses]]\naxis = [1, 0, 0]\ndegrees = 180\ntranslation = [0.0, 0.03, 0.06]\n"
        '[[foci]]\npoint = [0.01, 0.01, 0.0]\n[solver]\nname = "free_field"\n'
    )
    array = at.read_scene(tmp_path / "scene.toml").array
    assert np.allclose(array.positions, found.array.positions - [0, 0, 0.03], rtol=0, atol=1e-9)
    assert np.allclose(array.normals, found.array.normals, rtol=0, atol=1e-8)
    assert np.allclose(array.gains, found.emission, rtol=1e-7)
    text = path.read_text().replace("0,0,0,0,0,0\n", "0.3,0,0,0,0,0\n", 1)
    path.write_text(text)
    with raises_code("out_of_range"):
        at.read_scene(tmp_path / "scene.toml")
    with raises_code("unknown_format"):
        found.save(tmp_path / "calibration.h5")


def test_dead_elements_and_few_receivers() -> None:
    emission = gains(0)
    reception = gains(1)
    emission[3] = reception[20] = 0.0
    heard = by_hand(pair(OFF).calibrated(emission), reception, np.eye(24), 1e-3)
    some = np.setdiff1d(np.arange(24), [5, 18])
    few = at.Echoes(heard.codes, np.asarray(heard.pressures)[some], some, noise=heard.noise)
    found = calibrate(few, pair(), BELIEVED_AIR)
    assert found.converged
    assert found.dead.tolist() == [3, 20]
    assert found.emission[3] == found.reception[20] == 0.0
    assert found.reception[5] == 1.0
    echoes = at.Echoes(np.eye(24), np.ones((2, 24)), np.array([0, 1]))
    expected = found.emission[[0, 1]] / found.reception[[0, 1]]
    assert np.allclose(found.as_emitted(echoes).pressures, expected[:, None])
    with raises_code("data_missing"):
        found.as_emitted(at.Echoes(np.eye(24), np.ones((1, 24)), np.array([20])))


def test_something_between_the_boards_is_not_believed(heard) -> None:
    random = np.random.default_rng(0)
    pressures = np.asarray(heard.pressures)
    spoilt = pressures + 0.3 * np.abs(pressures).mean() * random.normal(size=pressures.shape)
    found = calibrate(at.Echoes(CODES, spoilt, noise=heard.noise), pair(), BELIEVED_AIR)
    assert not found.converged
    assert "NOT converged" in repr(found)


@pytest.fixture(scope="module")
def heard() -> at.Echoes:
    return by_hand(pair(OFF), np.ones(24), CODES, 1e-3)


FEW = np.array([0, 1, 12, 13])
FLAT = at.transducers.board_array("nano16", [at.Pose.identity(), at.Pose.shift((0.1, 0, 0))])


@pytest.mark.parametrize(
    ("code", "changed", "array", "boards"),
    [
        ("sizes_differ", lambda p: {}, at.transducers.board_array("nano16"), 2),
        ("too_few", lambda p: {"codes": CODES[:, :8], "pressures": p[:, :8]}, pair(), 2),
        ("signal_unusable", lambda p: {"pressures": 0 * p}, pair(), 2),
        ("misplaced", lambda p: {}, FLAT, 2),
        ("unknown_name", lambda p: {}, pair(), None),
        ("unknown_name", lambda p: {}, pair(), 5),
        (  # clipped
            "signal_unusable",
            lambda p: {"pressures": p * np.minimum(1, 0.5 * abs(p).max() / abs(p))},
            pair(),
            2,
        ),
        ("pose_not_found", lambda p: {"pressures": p[FEW], "receivers": FEW}, pair(), 2),
    ],
)
def test_transmissions_that_tell_too_little_are_rejected(
    heard, code, changed, array, boards
) -> None:
    fields = {"codes": CODES, "pressures": heard.pressures, "noise": heard.noise}
    with raises_code(code):
        at.calibrate(
            at.Echoes(**fields | changed(heard.pressures)),
            array,
            BELIEVED_AIR,
            **({"boards": boards} if boards else {}),
        )
    with raises_code("sizes_differ"):
        simulate_transmissions(pair(), TRUE_AIR, np.eye(8))
