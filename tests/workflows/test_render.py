"""A run writes what it computed, and another method agrees with it."""

import csv
import re
from base64 import b64decode

import h5py
import numpy as np
import pytest
from scipy.special import j1

from airtact.acoustics.solvers.spherical.sphere_series import SphereSeries
from airtact.drives.bounds import upper_bound
from airtact.drives.default_method import best
from airtact.drives.sequence import Sequence
from airtact.drives.transfer import Drive, TransferMatrix
from airtact.evaluation.field import drive_sources
from airtact.setup.saved_drives import load_drive
from airtact.transducers.drive_file import read_drive_file
from airtact.transducers.levels import Levels
from airtact.transducers.modulation import AmplitudeModulation
from airtact.workflows.render import FILES, render
from faults import raises_code
from paths import SCENES

BALL = SCENES / "ball.toml"


@pytest.fixture(scope="module")
def rendered(tmp_path_factory):
    """One run of the small scene: its folder, what it returned and the steps it reported."""
    folder, steps = tmp_path_factory.mktemp("run") / "new", []
    run = render(BALL, folder, steps.append)
    return folder, run, steps


@pytest.fixture(scope="module")
def exact(rendered):
    """Pressure of the drive anywhere, by the series for a sphere."""
    run = rendered[1]
    field = SphereSeries().radiate(run.scene, drive_sources(run.array, [run.drive]))
    return lambda points: field.at(points)[:, 0]


def test_a_run_writes_its_files_and_nothing_else(rendered):
    folder, _, steps = rendered
    assert sorted(entry.name for entry in folder.iterdir()) == sorted(FILES)
    assert [step.split()[0] for step in steps] == [
        "reading",
        "solving",
        "evaluating",
        "making",
        "verifying",
        "computing",
        "computing",
        "computing",
        "drawing",
    ]


def test_the_worst_focus_gets_what_it_asked_by_the_series(rendered, exact):
    run = rendered[1]
    got = np.abs(exact(run.target.points))
    better = (
        0.05 / 3
    )  # than the scene's 5 %: the error of the verification solve, by which the drive is scaled
    np.testing.assert_allclose(np.min(got / run.target.pressures), 1.0, atol=better)
    np.testing.assert_allclose(np.min(run.reached / run.target.pressures), 1.0, rtol=1e-9)
    np.testing.assert_allclose(run.reached, got, rtol=better)


def test_the_picture_of_the_plane_says_how_far_off_its_pressures_are(rendered):
    folder, run, _ = rendered
    assert (
        f"estimated to be {100 * run.plane.error:.1g} % off" in (folder / "report.html").read_text()
    )


@pytest.mark.slow
def test_the_estimated_error_of_a_picture_is_that_against_the_series(rendered, exact):
    run = rendered[1]
    found = next(iter(run.plane.pressures.values()))
    outside = np.isfinite(found)
    true = exact(run.plane.window.points[outside])
    error = np.linalg.norm(found[outside] - true) / np.linalg.norm(true)
    assert 0.3 < run.plane.error / error < 10.0


def control_in_closed_form(run) -> Drive:
    """The control: the best drive on the matrix of baffled pistons in open air, 2 J1(x)/x with x = k a sin(angle)."""
    away = run.target.points[:, None] - run.array.positions[None]
    distance = np.linalg.norm(away, axis=-1)
    wavenumber = 2.0 * np.pi * run.scene.frequency / run.scene.medium.sound_speed
    cosine = np.einsum("fec,ec->fe", away, run.array.normals) / distance
    argument = wavenumber * run.array.element.radius * np.sqrt(1.0 - cosine**2)
    pattern = np.where(cosine > 0.0, 2.0 * j1(argument) / argument, 0.0)
    wave = pattern * np.exp(1j * wavenumber * distance) / distance
    return best(TransferMatrix(run.array.element.sensitivity * wave, 0.0), run.target)


def test_the_comparison_is_that_of_the_series(rendered):
    run = rendered[1]
    assert run.comparison.names == ("object-aware", "without the object")
    control = control_in_closed_form(run)
    sources = drive_sources(run.array, [run.drive, control])
    ours, theirs = np.abs(SphereSeries().radiate(run.scene, sources).at(run.target.points)).T
    energy = [np.sum(np.abs(drive.amplitudes) ** 2) for drive in (run.drive, control)]
    ratio = theirs / ours * np.sqrt(energy[0] / energy[1])
    np.testing.assert_allclose(run.comparison.ratios("equal energy")[1], ratio, rtol=0.03)


def test_the_verification_is_more_accurate_than_the_drive(rendered):
    run = rendered[1]
    assert (
        run.comparison.report.settings["accuracy"] < 0.05 / 2.95
    )  # steps of 1.2: six of them are 2.986
    assert run.comparison.report.nodes > run.beacons.nodes


def test_the_field_file_is_the_field_of_the_series(rendered, exact):
    with h5py.File(rendered[0] / "field.vtkhdf") as file:
        image = file["VTKHDF/field"]
        pressure = image["PointData/pressure_real"][:] + 1j * image["PointData/pressure_imag"][:]
        origin, step = image.attrs["Origin"], image.attrs["Spacing"]
    random = np.random.default_rng(0)
    index = np.stack([random.integers(0, count, 300) for count in pressure.shape], axis=1)
    points = origin + step * index[:, ::-1]
    drawn = pressure[tuple(index.T)]
    outside = np.linalg.norm(points, axis=1) > 5e-3
    np.testing.assert_array_equal(np.isnan(drawn), ~outside)
    expected = exact(points[outside])
    assert np.linalg.norm(drawn[outside] - expected) < 0.02 * np.linalg.norm(expected)


def test_the_pictures_show_the_drive_as_it_is_and_the_control_at_its_energy(rendered, exact):
    run = rendered[1]
    cut = run.plane
    outside = np.linalg.norm(cut.window.points, axis=1) > 5.1e-3
    chosen = np.flatnonzero(outside)[::200]
    control = control_in_closed_form(run).amplitudes
    expected = exact(cut.window.points[chosen])
    drawn = cut.pressures[run.comparison.names[0]][chosen]
    assert np.linalg.norm(drawn - expected) < 0.02 * np.linalg.norm(expected)
    energies = [np.sum(np.abs(amplitudes) ** 2) for amplitudes in (run.drive.amplitudes, control)]
    emitted = Drive(np.sqrt(energies[0] / energies[1]) * control)
    field = SphereSeries().radiate(run.scene, drive_sources(run.array, [emitted]))
    expected = field.at(cut.window.points[chosen])[:, 0]
    drawn = cut.pressures[run.comparison.names[1]][chosen]
    common = np.vdot(expected, drawn)  # the phase that all elements of a drive share is free
    expected *= common / abs(common)
    assert np.linalg.norm(drawn - expected) < 0.02 * np.linalg.norm(expected)
    assert tuple(cut.pressures) == run.comparison.names


def test_the_drive_files_hold_the_drive(rendered):
    folder, run, _ = rendered
    with (folder / "drive.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    amplitudes = [float(row["amplitude"]) * np.exp(1j * float(row["phase"])) for row in rows]
    np.testing.assert_allclose(amplitudes, run.drive.amplitudes, atol=1e-8)
    with h5py.File(folder / "drive.h5") as file:
        pressure = file["transfer_matrix"][:] @ (
            file["amplitude"][:] * np.exp(1j * file["phase"][:])
        )
        assert file["scene"].asstr()[()] == BALL.read_text()
        assert '"solver":"BoundaryElement"' in file["report"].asstr()[()]
    np.testing.assert_allclose(pressure, run.transfer.pressure(run.drive), rtol=1e-9)


def test_the_page_needs_nothing_from_elsewhere(rendered):
    page = (rendered[0] / "report.html").read_text(encoding="utf-8")
    sources = re.findall(r'(?:src|href)="([^"]*)"', page)
    assert len(sources) == 5
    for source in sources:
        kind, data = source.split(",", 1)
        assert kind == "data:image/webp;base64"
        assert b64decode(data).startswith(b"RIFF")
    assert not re.search(r"https?://|@import|url\((?!#)|<script src|<link", page)


def test_the_page_says_what_was_computed_and_what_was_not(rendered):
    folder, run, _ = rendered
    page = (folder / "report.html").read_text(encoding="utf-8")
    for words in (
        "do not reflect",
        "uncalibrated",
        "Equal peak",
        "Equal energy",
        "Phase only",
        "343.1 m/s",
        "estimated error",
        "dual-surface equation",
        "south pole",
        f"{run.reached[0]:,.0f}",
        f"<td>{1.0 / run.comparison.ratios('equal energy')[1, 0]:.3f}</td>",
        f"{run.beacons.nodes:,}",
    ):
        assert words in page


def test_below_full_scale_the_run_says_what_is_left(rendered):
    run = rendered[1]
    bound = upper_bound(run.transfer, run.target)
    times = 1.0 / bound.reached(run.transfer, run.target, run.drive)
    assert run.remarks[-1].startswith(
        f"At full scale no drive exceeds {times:.1f} times that; rounded to 256 levels"
    )


def test_the_first_sentence_has_both_drives_and_what_is_missing(tmp_path):
    greedy = tmp_path / "greedy.toml"
    greedy.write_text(BALL.read_text(encoding="utf-8").replace("00.0\n", "0000.0\n"))
    run = render(greedy, tmp_path / "out", pictures=False)
    weakest = (run.comparison.pressures["equal peak"] / run.target.pressures).min(axis=1)
    gain = f"{weakest[0] / weakest[1] - 1.0:+.0%}".replace("%", " %").replace("-", "−")
    words = f"Object-aware: {weakest[0]:.0%} of what was asked at the weakest focus. ".replace(
        "%", " %"
    )
    assert run.headline.startswith(f"{words}Without the object: ")
    assert run.headline.endswith(f"Same hardware: {gain}.") or "does not matter" in run.headline
    missing = run.remarks[0]
    assert missing.startswith("Asked and not reached: south pole ")
    assert "of 90.0 kPa" in missing
    assert "of 60.0 kPa" in missing
    assert missing.endswith("the transducers are at full scale.")
    assert "of the upper bound for any drive" in run.remarks[-1]


def test_in_open_air_there_is_nothing_to_compare_with(tmp_path):
    scene = tmp_path / "air.toml"
    text = BALL.read_text(encoding="utf-8").replace(
        "[[obstacles]]\nsphere = { radius = 5e-3 }\n", ""
    )
    scene.write_text(text.replace("[solver]\naccuracy = 0.05\n", ""))
    run = render(scene, tmp_path / "out")
    assert run.comparison.names == ("drive",)
    assert run.headline == "Drive: 100 % of what was asked at the weakest focus."
    assert "Without" not in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")


def test_markup_in_names_stays_words(tmp_path):
    path = tmp_path / "a<b>.toml"
    path.write_text(BALL.read_text().replace("south pole", "<i>&"))
    render(path, tmp_path / "out")
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "<i>" not in page
    assert "<b>" not in page.replace('<div class="number"><b>', "")
    assert "&lt;i&gt;&amp;" in page


def test_a_folder_that_cannot_be_written_is_rejected_before_anything_is_solved(tmp_path):
    (tmp_path / "file").touch()
    steps = []
    with raises_code("not_writable", "out"):
        render(BALL, tmp_path / "file" / "out", steps.append)
    assert steps == ["reading ball.toml"]


def test_a_drive_is_rounded_to_the_levels_of_its_scene(tmp_path):
    scene = tmp_path / "levels.toml"
    strong = BALL.read_text(encoding="utf-8").replace("00.0\n", "000.0\n")
    scene.write_text(strong + "\n[drive]\nlevels = { amplitude = 5, phase = 16 }\n")
    run = render(scene, tmp_path / "out")
    stored = read_drive_file(tmp_path / "out" / "drive.h5")
    assert stored.levels is not None
    assert stored.levels.same_as(Levels.even(amplitudes=5, phases=16))
    np.testing.assert_array_equal(stored.amplitude_level[0], run.frame.amplitude)
    assert set(run.frame.amplitude) <= set(range(5))
    assert 4 < len(set(run.frame.phase)) <= 16
    assert run.frame.phase.max() < 16
    assert (
        "Rounded to 5 levels of amplitude and 16 of phase"
        in (tmp_path / "out" / "report.html").read_text()
    )


def test_moving_foci_are_written_as_a_sequence_and_an_older_one_goes(tmp_path):
    """Each frame is the field of its drive: by the series of the sphere the foci are where the circle leads."""
    scene = tmp_path / "ball.toml"
    scene.write_text(
        BALL.read_text()
        + '\n[drive.modulation]\nkind = "lm"\nframes = 4\nradius = 1e-3\nfrequency = 100\n'
    )
    run = render(scene, tmp_path / "out")
    sequence = load_drive(tmp_path / "out" / "sequence.h5")
    stored = read_drive_file(tmp_path / "out" / "sequence.h5")
    assert isinstance(sequence, Sequence)
    assert (len(sequence), sequence.rate) == (4, 400.0)
    assert "The foci move: 4 frames" in run.sensation[0]
    assert "spatiotemporal" in run.sensation[1]
    field = SphereSeries().radiate(
        run.scene, drive_sources(run.array, [sequence.drive(i) for i in range(4)])
    )
    foci = stored.foci.reshape(4, len(run.foci), 3)
    np.testing.assert_array_equal(run.view.paths, foci.swapaxes(0, 1))
    assert "Foci run along the dashed lines" in (tmp_path / "out" / "report.html").read_text(
        encoding="utf-8"
    )
    np.testing.assert_allclose(np.linalg.norm(foci - run.target.points, axis=2), 1e-3, rtol=0.1)
    for frame in range(4):
        got = np.abs(field.at(foci[frame])[:, frame])
        assert np.min(got / run.target.pressures) == pytest.approx(1.0, abs=0.06)
    scene.write_text(BALL.read_text() + '\n[drive.modulation]\nkind = "am"\n')
    run = render(scene, tmp_path / "out")
    assert not (tmp_path / "out" / "sequence.h5").exists()
    assert read_drive_file(tmp_path / "out" / "drive.h5").modulation == AmplitudeModulation()
    assert "with amplitude modulation, 557 Pa" in run.sensation[0]
    assert "with amplitude modulation, 557 Pa" in (tmp_path / "out" / "report.html").read_text(
        encoding="utf-8"
    )


def test_a_constant_drive_is_said_to_be_hardly_felt(rendered):
    assert "Skin hardly feels a constant force" in rendered[1].sensation[0]
