"""Drives of other programs: each format as its own program writes it, and files that are damaged."""

import gzip
import zlib

import numpy as np
import pytest

import airtact as at
from airtact.drives.frame import Frame
from airtact.emission.codecs import codec_of
from airtact.emission.frame_file import drive_for
from emission.test_codecs import random_frame
from faults import raises_code

PHASES = np.random.default_rng(5).uniform(-np.pi, np.pi, 512)


def openmpd_order() -> np.ndarray:
    """Elements of two opposed boards by AcousTools' positions, matched with OpenMPD's boards."""
    grid = 10.5e-3 * (np.arange(16) - 7.5)
    x, y = (part.ravel() for part in np.meshgrid(grid, grid, indexing="ij"))
    acoustools = np.concatenate(
        [np.stack([x, y, np.full(256, z)], axis=1) for z in (0.11825, -0.11825)]
    )
    turned = at.Pose(np.diag([-1.0, 1.0, -1.0]), np.array([0.0, 0.0, 0.11825]))
    boards = at.transducers.board_array("openmpd", [turned, at.Pose.shift((0.0, 0.0, -0.11825))])
    away = np.linalg.norm(boards.positions[:, None] - acoustools, axis=2)
    assert away.min(axis=1).max() < 1e-9
    return away.argmin(axis=1)


def test_tables_of_acoustools_are_in_the_order_of_openmpd(tmp_path) -> None:
    order = openmpd_order()
    table = tmp_path / "acoustools.csv"
    rows = [",".join(str(phase) for phase in PHASES[order] + shift) for shift in (0.0, 0.1)]
    table.write_text("\n".join(["2,512", *rows]) + "\n")
    sequence = at.load_drive(table, rate=1000.0)
    assert isinstance(sequence, at.drives.Sequence)
    np.testing.assert_allclose(sequence.drives[1], np.exp(1j * (PHASES[order] + 0.1)), atol=1e-12)
    # The same drive as a hologram, which AcousTools writes in its own order and rounds
    levels = np.rint(PHASES / (2 * 3.1415 / 32) + 16).astype(int)
    numbers = [*levels, 63, *[32] * 512, 63]
    holo = tmp_path / "acoustools.holo"
    holo.write_bytes(zlib.compress(b"".join(int(n).to_bytes(5, "big") for n in numbers)))
    drive = at.load_drive(holo)
    assert isinstance(drive, at.Drive)
    turns = np.angle(drive.amplitudes / sequence.drives[0]) / (2 * np.pi)
    assert np.abs(turns).max() < 0.51 / 32
    np.testing.assert_allclose(drive.magnitudes, 1.0)


@pytest.mark.parametrize(
    ("text", "factor"),
    [
        ("phase_degrees\n" + "\n".join(f"{np.degrees(p):.9f}" for p in PHASES), 1.0),
        ("\n".join(f"{np.degrees(p) % 360:.9f}" for p in PHASES), 1.0),
        (" ".join(f"{p:.12f}" for p in PHASES), 1.0),
        ("amplitude;phase\n" + "\n".join(f"0.5;{p:.12f}" for p in PHASES), 0.5),
        (
            "element,phase\n" + "\n".join(f"{512 - i},{PHASES[511 - i]:.12f}" for i in range(512)),
            1.0,
        ),
        ("# from a simulation\n" + ",".join(f"{p % (2 * np.pi):.12f}" for p in PHASES), 1.0),
    ],
)
def test_degrees_and_radians_are_recognised(tmp_path, text: str, factor: float) -> None:
    file = tmp_path / "phases.csv"
    file.write_text(text)
    drive = at.load_drive(file)
    assert isinstance(drive, at.Drive)
    np.testing.assert_allclose(drive.amplitudes, factor * np.exp(1j * PHASES), atol=1e-8)


def test_levels_of_256_are_named_or_suspected(tmp_path) -> None:
    levels = np.arange(249) % 256
    file = tmp_path / "levels.csv"
    file.write_text("phase_level\n" + "\n".join(map(str, levels)))
    drive = at.load_drive(file)
    np.testing.assert_allclose(drive.amplitudes, np.exp(2j * np.pi * levels / 256), atol=1e-12)
    file.write_text("\n".join(map(str, levels)))
    with pytest.warns(UserWarning, match="phase_level"):
        at.load_drive(file)


@pytest.mark.parametrize("name", ["autd3", "sonicsurface", "nano16", "openmpd"])
def test_messages_of_boards_come_back(tmp_path, name: str) -> None:
    codec = codec_of(name)
    boards = 1 if name == "nano16" else 2
    frames = [random_frame(name, boards, seed) for seed in (1, 2)]
    file = tmp_path / "frames.bin"
    file.write_bytes(b"".join(codec.encode(frame) for frame in frames))
    elements = boards * len(codec.board)
    back = at.load_drive(file, board=name, elements=elements, rate=10.0)
    assert isinstance(back, at.drives.Sequence)
    for frame, drive in zip(frames, back.drives, strict=True):
        np.testing.assert_allclose(drive, frame.drive().amplitudes, atol=1e-12)
    for damaged in (file.read_bytes()[:-1], b"", b"\x7f" * len(file.read_bytes())):
        file.write_bytes(damaged)
        if name == "autd3" and len(damaged) > 1000 and len(damaged) % 2 == 0:
            continue  # any bytes are phases and intensities
        with raises_code("file_unreadable"):
            at.load_drive(file, board=name, elements=elements)
    with raises_code("key_missing"):
        at.load_drive(file)


def test_arrays_of_numpy(tmp_path) -> None:
    file = tmp_path / "drive.npy"
    drive = 0.5 * np.exp(1j * PHASES)
    for saved, read in ((drive, drive), (PHASES, 2.0 * drive)):
        np.save(file, saved)
        np.testing.assert_allclose(at.load_drive(file).amplitudes, read, atol=1e-12)
    frame = random_frame("autd3", 1, 4)
    np.save(file, np.stack([frame.phase, frame.amplitude], axis=1))
    levels = Frame(frame.amplitude, frame.phase).drive().amplitudes
    np.testing.assert_allclose(at.load_drive(file).amplitudes, levels, atol=1e-12)
    np.save(file, np.array([{}], dtype=object), allow_pickle=True)
    with raises_code("file_unreadable"):
        at.load_drive(file)


BEAN = """ <object class="acousticfield3d.simulation.Transducer" id="T{index}">
  <void class="acousticfield3d.simulation.Transducer" method="getField"><string>phase</string>
   <void method="set"><object idref="T{index}"/><float>{phase}</float></void></void>
  <void property="transform">
   <void property="rot"><void property="w"><float>0.7071068</float></void>
    <void property="x"><float>0.7071068</float></void></void>
   <void id="V{index}" property="translation">
    <void method="getField"><string>x</string>
     <void method="set"><object idref="V{index}"/><float>{x}</float></void></void></void>
  </void>
 </object>
"""


def ultraino(phases: np.ndarray) -> bytes:
    beans = [BEAN.format(index=i, phase=p / np.pi, x=0.01 * i) for i, p in enumerate(phases)]
    return ("<java class='java.beans.XMLDecoder'>\n" + "".join(beans) + "</java>").encode()


def test_simulations_of_ultraino(tmp_path) -> None:
    file = tmp_path / "simulation.xml.gz"
    file.write_bytes(gzip.compress(ultraino(PHASES[:8])))
    # Turned by 90° about x, the y axis points along z.
    row = at.PhasedArray(np.arange(8)[:, None] * [0.01, 0, 0], np.tile([0.0, 0, 1], (8, 1)))
    moved = row.moved(at.Pose.shift((0.0, 0.1, 0.0)))
    drive = drive_for(moved, file)
    np.testing.assert_allclose(drive.amplitudes, np.exp(1j * PHASES[:8]), atol=1e-6)
    backwards = at.PhasedArray(row.positions[::-1], row.normals)
    drive = drive_for(backwards, file)
    np.testing.assert_allclose(drive.amplitudes, np.exp(1j * PHASES[7::-1]), atol=1e-6)
    other = at.PhasedArray(row.positions[::-1] * [2, 1, 1], row.normals)
    with raises_code("does_not_match"):
        drive_for(other, file)
    with raises_code("sizes_differ"):
        drive_for(at.autd3_board(), file)


@pytest.mark.parametrize(
    ("name", "contents", "code"),
    [
        ("a.csv", b"", "file_unreadable"),
        ("a.csv", b"phase\n1\nx\n", "file_unreadable"),
        ("a.csv", b"phase\n1\nnan\n", "not_finite"),
        ("a.csv", b"0.1,0.2\n0.3,0.4\n0.5,0.6\n", "data_missing"),
        ("a.csv", b"angles\n1e6\n", "out_of_range"),
        ("a.csv", b"amplitude,phase\n1.5,0\n", "out_of_range"),
        ("a.csv", b"element,phase\n1,0\n1,0\n", "out_of_range"),
        ("a.csv", b"frame,element,phase\n0,0,1\n1,0,1\n", "not_supported"),
        ("a.csv", b"1,2,3\n4,5\n", "wrong_shape"),
        ("a.holo", b"no zlib", "file_unreadable"),
        ("a.holo", zlib.compress(b"\x00" * 7), "file_unreadable"),
        ("a.xml", b"<java><object/>", "file_unreadable"),
        ("a.xml", b"<!DOCTYPE a [<!ENTITY b 'c'>]><java/>", "file_unreadable"),
        ("a.xml", b"<java></java>", "file_unreadable"),
        ("a.xml.gz", b"not gzip", "file_unreadable"),
        ("a.npy", b"not numpy", "file_unreadable"),
        ("a.docx", b"", "unknown_format"),
    ],
)
def test_damaged_files_are_named(tmp_path, name: str, contents: bytes, code: str) -> None:
    (tmp_path / name).write_bytes(contents)
    with raises_code(code) as fault:
        at.load_drive(tmp_path / name)
    assert name in str(fault.value)


def test_a_file_that_unpacks_to_too_much_is_named(tmp_path) -> None:
    (tmp_path / "a.holo").write_bytes(zlib.compress(bytes(2**28 + 10), level=1))
    with raises_code("file_too_large", "a.holo"):
        at.load_drive(tmp_path / "a.holo")
