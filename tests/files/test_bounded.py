"""Files of numbers that would hurt are rejected before they are unpacked, and nothing but files is opened."""

import os

import h5py
import numpy as np
import pytest

import airtact as at
from airtact.errors import LARGEST_DATA
from airtact.files.bounded import bytes_of, datasets_of, text_of
from airtact.files.text_table import read_text_table
from faults import raises_code


def no_datasets(path):
    return datasets_of(path, {}, newest=1)


@pytest.mark.parametrize("read", [bytes_of, text_of, no_datasets, read_text_table])
def test_a_pipe_a_folder_and_a_missing_file_are_named(read, tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with raises_code("file_unreadable"):
        read(tmp_path / "pipe")
    with raises_code("file_unreadable"):
        read(tmp_path)
    with raises_code("file_missing"):
        read(tmp_path / "absent")
    with raises_code("file_missing"):
        read(tmp_path / "a\0b")


@pytest.mark.parametrize("read", [bytes_of, text_of, no_datasets, read_text_table])
def test_a_file_that_is_too_large_is_rejected_unread(read, tmp_path):
    with (tmp_path / "large").open("wb") as file:
        file.truncate(LARGEST_DATA + 1)
    with raises_code("file_too_large"):
        read(tmp_path / "large")


def test_a_dataset_of_zeros_without_end_is_rejected(tmp_path):
    with h5py.File(tmp_path / "zeros.h5", "w") as file:
        file.create_dataset("amplitude", (10**6, 10**6), dtype="f8", chunks=(100, 100))
    with raises_code("file_too_large", "8,000,000,000,000"):
        at.load_drive(tmp_path / "zeros.h5")


def test_links_data_of_other_files_and_large_chunks_are_rejected(tmp_path):
    np.zeros(3).tofile(tmp_path / "outside.bin")
    with h5py.File(tmp_path / "one.h5", "w") as file:
        file["own"] = np.ones(2)
        file["group/circle"] = h5py.SoftLink("/group/circle")
        file["link"] = h5py.ExternalLink("outside.h5", "/x")
        file.create_dataset(
            "outside", (3,), "f8", external=[(str(tmp_path / "outside.bin"), 0, 24)]
        )
        file.create_dataset("packed", (3,), "f8", chunks=(2**28,), maxshape=(None,))
    assert one_file(tmp_path, {"own": "real *"})["own"].tolist() == [1.0, 1.0]
    for name in ("group/circle", "link", "outside"):
        with raises_code("file_unreadable", name):
            one_file(tmp_path, {name: "optional real *"})
    with raises_code("file_too_large"):
        one_file(tmp_path, {"packed": "real *"})


def one_file(folder, layout):
    return datasets_of(folder / "one.h5", layout, newest=1)


def test_kinds_and_axes_are_those_of_the_layout(tmp_path):
    with h5py.File(tmp_path / "one.h5", "w") as file:
        file["points"] = np.arange(6).reshape(2, 3)
        file["gains"] = np.ones(2)
        file["rate"] = [[5.0]]
        file["name"] = "é"
        file.attrs["places"] = ["thumb", "index"]
    layout = {"points": "real points 3", "gains": "complex (frames) points", "rate": "real"}
    read = one_file(tmp_path, {**layout, "name": "text", "@places": "text points"})
    assert (read["points"].dtype, read["gains"].dtype, read["rate"]) == ("f8", "c16", 5.0)
    assert (read["name"], read["places"]) == ("é", ["thumb", "index"])
    for name, form, code in [
        ("points", "real points", "wrong_shape"),
        ("points", "real 4 3", "wrong_shape"),
        ("points", "text 2 3", "not_a_number"),
        ("gains", "whole *", "not_a_number"),
        ("gains", "real 3", "wrong_shape"),
        ("name", "real", "not_a_number"),
        ("@places", "text", "wrong_shape"),
        ("@places", "real *", "not_a_number"),
        ("gone", "real", "data_missing"),
        ("name/gone", "real", "data_missing"),
    ]:
        with raises_code(code, name.lstrip("@")):
            one_file(tmp_path, {name: form})


@pytest.mark.parametrize(
    ("words", "code"),
    [
        ("x,y\n1," + "9" * 200_000, "file_unreadable"),
        ("x,y\n1," + "9" * 400, "file_unreadable"),
        ("x,y\n1,1e13", "file_unreadable"),
        (",".join(["x"] * 100_000), "given_twice"),
        (",".join(["%x"] * 100_000) + "\n1,2", "given_twice"),
    ],
    ids=[
        "a long cell",
        "many digits",
        "a large number",
        "many columns",
        "many columns in a comment",
    ],
)
def test_a_table_that_hurts_is_rejected(words, code, tmp_path):
    (tmp_path / "table.csv").write_text(words)
    with raises_code(code):
        read_text_table(tmp_path / "table.csv").numbers("y")


@pytest.mark.parametrize(
    ("ending", "words"),
    [
        ("xyz", "1 2 3\n4 5\n"),
        ("xyz", "0,1 0,2 0,3\n"),
        ("xyz", "0_1 2 3\n"),
        ("xyz", ""),
        ("ply", "ply\n"),
    ],
)
def test_a_cloud_that_is_cut_is_rejected(ending, words, tmp_path):
    path = tmp_path / f"cloud.{ending}"
    path.write_text(words)
    with raises_code("empty" if not words else "file_unreadable"):
        at.hands.load_cloud(path)


def test_commas_and_comments_of_a_cloud_are_passed_over(tmp_path):
    (tmp_path / "cloud.xyz").write_text("# x y z\n1,2,3,9\n4 5 6 9\n")
    assert at.hands.load_cloud(tmp_path / "cloud.xyz").tolist() == [[1, 2, 3], [4, 5, 6]]
