"""A file is whole or not there."""

import pytest

from airtact.files.atomic import whole_file, writable_folder
from faults import raises_code


def test_a_finished_file_replaces_the_old_one(tmp_path):
    path = tmp_path / "result.txt"
    path.write_text("old")
    with whole_file(path) as partial:
        partial.write_text("new")
        assert path.read_text() == "old"
    assert [entry.name for entry in tmp_path.iterdir()] == ["result.txt"]
    assert path.read_text() == "new"


@pytest.mark.parametrize("stop", [KeyboardInterrupt, ValueError])
def test_a_file_broken_off_leaves_the_old_one_and_nothing_else(tmp_path, stop):
    path = tmp_path / "result.txt"
    path.write_text("old")
    with pytest.raises(stop):
        _write_and_stop(path, stop)
    assert [entry.name for entry in tmp_path.iterdir()] == ["result.txt"]
    assert path.read_text() == "old"


def _write_and_stop(path, stop):
    with whole_file(path) as partial:
        partial.write_text("ne")
        raise stop


def test_a_folder_is_made_with_those_above_it_and_left_empty(tmp_path):
    folder = writable_folder(tmp_path / "a" / "b")
    assert folder.is_dir()
    assert list(folder.iterdir()) == []


def test_a_folder_that_cannot_be_is_refused(tmp_path):
    (tmp_path / "file").touch()
    with raises_code("not_writable"):
        writable_folder(tmp_path / "file" / "out")


def test_a_folder_keeps_all_of_its_files(tmp_path):
    """Files with any name, such as that of a trial, stay."""
    (tmp_path / "probe").write_text("mine")
    writable_folder(tmp_path)
    assert (tmp_path / "probe").read_text() == "mine"
