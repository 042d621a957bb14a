"""The skin of a hand is meshed once, for its file, its picture and its notes."""

from pathlib import Path

from airtact.cli.hand import _table
from airtact.workflows.hand import pose
from paths import HANDS


def test_the_notes_take_no_second_mesh(tmp_path: Path) -> None:
    done = pose(HANDS / "pinch.json", tmp_path / "hand.vtkhdf", edge=6e-3)

    assert _table(done).row_count == 9
    notes = [touch.note for touch in done.hand.touches]
    assert list(done.hand.shape.meshes) == [6e-3]
    assert "surface" not in vars(done.hand)

    assert notes[0].endswith("14 mm in each other")
    assert tuple(notes) == done.hand.surface.repairs


def test_the_file_of_a_skin_holds_no_made_up_numbers(tmp_path: Path) -> None:
    import h5py

    done = pose(HANDS / "pinch.json", tmp_path / "hand.vtkhdf", edge=6e-3)

    with h5py.File(done.file) as file:
        assert set(file["VTKHDF/CellData"]) == {"smallest_angle", "area"}  # pyright: ignore[reportArgumentType]
