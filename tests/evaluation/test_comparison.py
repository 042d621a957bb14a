"""Normalisations against what they say they hold equal."""

import numpy as np
import pytest

import airtact as at
from airtact.evaluation.comparison import HELD_EQUAL, compare, held_out
from faults import raises_code

SCENE = at.Scene(at.Medium(343.1, 1.293), [])
ARRAY = at.flat_boards(1, 1)
TARGET = at.Target(np.array([[0.02, 0.0, 0.06], [-0.03, 0.01, 0.08]]))
TRANSFER = at.transfer_matrix(at.FreeField().radiate(SCENE, TARGET.beacons()), ARRAY)

DRIVES = {
    "time reversal": at.Drive(0.3 * at.time_reversal(TRANSFER, TARGET).amplitudes),
    "phases": at.drives.phase_conjugate(TRANSFER, TARGET),
    "control": at.focus_by_distance(ARRAY, TARGET, SCENE.medium, SCENE.frequency),
}


@pytest.fixture(scope="module")
def result() -> at.evaluation.Comparison:
    return compare(SCENE, ARRAY, DRIVES, TARGET, solver=at.FreeField())


def test_every_normalisation_holds_equal_what_it_says(result) -> None:
    energies = [
        np.sum(np.abs(drive.amplitudes / np.abs(drive.amplitudes).max()) ** 2)
        for drive in DRIVES.values()
    ]
    for row, (name, drive) in enumerate(DRIVES.items()):
        largest = drive.amplitudes / np.abs(drive.amplitudes).max()
        alike = {
            "equal peak": largest,
            "equal energy": largest * np.sqrt(min(energies) / energies[row]),
            "phase only": drive.amplitudes / np.abs(drive.amplitudes),
        }
        assert name == result.names[row]
        for held_equal in HELD_EQUAL:
            expected = np.abs(
                at.field_map(
                    SCENE, ARRAY, at.Drive(alike[held_equal]), TARGET.points, solver=at.FreeField()
                )
            )
            np.testing.assert_allclose(result.pressures[held_equal][row], expected, rtol=1e-10)


def test_the_field_of_each_drive_is_found_by_its_name(result) -> None:
    points = np.array([[0.0, 0.0, 0.1], [0.01, -0.02, 0.09]])
    computed = result.at(points)
    assert list(computed) == list(DRIVES)
    for name, drive in DRIVES.items():
        largest = at.Drive(drive.amplitudes / np.abs(drive.amplitudes).max())
        expected = at.field_map(SCENE, ARRAY, largest, points, solver=at.FreeField())
        np.testing.assert_allclose(computed[name], expected, rtol=1e-10)
        phases = at.field_map(SCENE, ARRAY, drive.phase_only(), points, solver=at.FreeField())
        column = result.field.at(points)[:, result.column(name, phase_only=True)]
        np.testing.assert_allclose(column, phases, rtol=1e-10)
    with raises_code("unknown_name"):
        result.column("no drive")


def test_a_comparison_reads_as_a_table_that_says_what_is_held_equal(result) -> None:
    text = str(result)
    for held_equal, meaning in HELD_EQUAL.items():
        assert f"{held_equal}: {meaning}" in text
    rows = [line for line in text.splitlines() if line.startswith("control")]
    assert len(rows) == 1
    weakest = [result.pressures[held_equal].min(axis=1) for held_equal in HELD_EQUAL]
    reference = [number for column in weakest for number in (column[2], column[2] / column[0])]
    numbers = [float(word.strip("()")) for word in rows[0].split()[1:]]
    np.testing.assert_allclose(numbers, reference, rtol=1e-2)
    assert "do not reflect" in text
    assert "steepening" in text.splitlines()[-1]
    best = result.names[int(np.argmax(weakest[0]))]
    assert f"{best!r} is the strongest drive, with {weakest[0].max():.0f} Pa" in text


def test_a_comparison_lists_every_focus_of_every_drive(result) -> None:
    rows = result.table()
    assert len(rows) == 3 * 3 * len(TARGET.points)
    row = next(
        row
        for row in rows
        if (row["held_equal"], row["drive"], row["focus"]) == ("equal energy", "control", 1)
    )
    assert row["pressure"] == result.pressures["equal energy"][2, 1]
    assert row["ratio"] == pytest.approx(result.ratios("equal energy")[2, 1], rel=1e-12)
    assert [row["x"], row["y"], row["z"]] == TARGET.points[1].tolist()
    with raises_code("unknown_name"):
        result.weakest("equal power")


def test_the_weakest_focus_is_relative_to_the_shares() -> None:
    target = at.Target(TARGET.points, shares=np.array([1.0, 0.2]))
    # The drive for equal shares gives the focus of share 1 too little, although it is not lower.
    drive = at.max_min(TRANSFER, TARGET)
    result = compare(SCENE, ARRAY, {"equal": drive}, target, solver=at.FreeField())
    first, second = result.pressures["equal peak"][0]
    assert second < 1.01 * first
    assert result.weakest("equal peak").tolist() == [first]
    samples = at.drives.TransferEnsemble(TRANSFER.matrix, 0.0, geometry=TRANSFER.matrix[None])
    held = held_out(samples, target, {"equal": drive})
    assert held.expected[0] == pytest.approx(first, rel=1e-6)
    assert held.lowest_tenth[0] == pytest.approx(first, rel=1e-6)


@pytest.mark.parametrize(
    ("code", "drives"),
    [
        ("all_zero", {"silence": at.Drive(np.zeros(249, dtype=np.complex128))}),
        ("too_few", {}),
        ("sizes_differ", {"short": at.Drive(np.ones(3, dtype=np.complex128))}),
    ],
)
def test_drives_that_cannot_be_compared_raise(code, drives) -> None:
    with raises_code(code):
        compare(SCENE, ARRAY, drives, TARGET, solver=at.FreeField())
