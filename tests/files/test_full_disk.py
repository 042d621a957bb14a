"""On a full disk no command crashes, the sentence names the file, and the earlier file stays."""

import os
import subprocess
import sys

import numpy as np
import pytest

from airtact.drives.drive_file import DriveFile, write_drive_file
from airtact.files.atomic import whole_file, whole_hdf5
from airtact.reports.page import write_picture
from airtact.transducers.levels import EIGHT_BITS
from faults import full_disk, raises_code
from paths import SCENES


def _drive(path):
    write_drive_file(path, DriveFile(np.ones((1, 996), np.complex128), levels=EIGHT_BITS))


def _picture(path):
    from matplotlib.figure import Figure

    figure = Figure()
    figure.text(0.5, 0.5, "focus")
    write_picture(path, figure)


@pytest.mark.parametrize("write", [_drive, _picture], ids=["drive.h5", "picture.png"])
@pytest.mark.parametrize("room", [0, 1000])
def test_a_full_disk_is_one_sentence_and_keeps_the_file_of_before(write, room, tmp_path):
    path = tmp_path / ("drive.h5" if write is _drive else "picture.png")
    path.write_text("before")
    with full_disk(room), raises_code("not_writable", str(path)):
        write(path)
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]
    assert path.read_text() == "before"


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only root mounts")
@pytest.mark.parametrize("size", ["40k", "200k"])
def test_render_on_a_full_disk_ends_with_a_sentence(size, tmp_path):
    folder = tmp_path / "out"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(folder)]
    if subprocess.run(mount, capture_output=True, check=False).returncode:
        pytest.skip("no tmpfs can be mounted here")
    try:
        (folder / "report.html").write_text("before")
        (folder / "probe").write_text("of the user")
        command = [sys.executable, "-m", "airtact", "render", str(SCENES / "ball.toml")]
        command += ["--out", str(folder)]
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
        assert done.returncode == 2, done.stderr
        assert "No space left on device" in done.stderr
        assert str(folder) in done.stderr
        assert (folder / "report.html").read_text() == "before"
        assert (folder / "probe").read_text() == "of the user"
        assert not list(folder.glob(".*"))
    finally:
        subprocess.run(["umount", str(folder)], check=True)


def test_several_processes_write_one_file(tmp_path):
    """Each writes to its own partial file; the last one stays."""
    path = tmp_path / "field.h5"
    with whole_hdf5(path) as first, whole_hdf5(path) as second:
        first["number"] = 1
        second["number"] = 2
    with whole_file(path) as one, whole_file(path) as two:
        one.write_text("1")
        two.write_text("2")
    assert path.read_text() == "1"
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]
