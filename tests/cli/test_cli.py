"""The command line: what it prints, what it rejects, and what Ctrl-C leaves."""

import re
import signal
import subprocess
import sys

import numpy as np
import pytest
import trimesh

import airtact as at
from airtact import cli
from airtact.setup import rendering
from cli.running import done, output, rejected
from geometry.mesh.meshes import box_mesh
from paths import EXAMPLES, ROOT

BALL = ROOT / "tests" / "scenes" / "ball.toml"


def only_steps(errors):
    return all(re.fullmatch(r" +\d+\.\d s  \w.*", step) for step in errors.splitlines())


def test_names_reach_a_terminal_without_what_it_would_obey(capsys, tmp_path):
    text = BALL.read_text(encoding="utf-8")
    (tmp_path / "s.toml").write_text(
        text.replace('"south pole"', '"\\u001b[31mend\\u202e\\u0085"'), encoding="utf-8"
    )
    for arguments in (["check"], ["check", "--json"]):
        code, printed, errors = output(capsys, *arguments, tmp_path / "s.toml")
        assert code == 0, errors
        assert "[31mend" in printed
        assert all(line.isprintable() for line in [*printed.split("\n"), *errors.split("\n")])


def test_a_folder_is_not_taken_for_the_name_of_an_example(capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "keep").mkdir()
    assert rejected(capsys, "check", "keep").endswith(": Is a directory. [file_unreadable]")


def test_an_example_is_taken_where_no_file_has_its_name(capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    printed, errors = done(capsys, "check", "pinch")
    taken, _, steps = errors.partition("\n")
    assert taken == f"There is no file pinch here: using the example {at.example('pinch')}"
    assert only_steps(steps)
    assert "thumb" in printed


def test_a_file_here_goes_before_an_example_of_its_name(capsys, monkeypatch, tmp_path):
    (tmp_path / "pinch").write_text(BALL.read_text(encoding="utf-8"), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    printed, errors = done(capsys, "check", "pinch")
    assert only_steps(errors)
    assert "south pole" in printed


def test_a_name_of_no_file_and_no_example_lists_the_examples(capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    errors = rejected(capsys, "render", "pinhc", "--out", "out")
    assert "there is no file pinhc here, and 'pinhc'" in errors
    assert "did you mean pinch?" in errors
    assert "palm_circle, pinch, " in errors
    assert errors.endswith("[unknown_name]")


def test_help_of_render_names_all_scenes_that_come_with_airtact(capsys):
    printed, _ = done(capsys, "render", "--help")
    assert (
        f"an example: {', '.join(sorted(path.stem for path in EXAMPLES.glob('*.toml')))}."
        in printed
    )


def test_version(capsys):
    assert output(capsys, "--version")[:2] == (0, f"airtact {at.__version__}\n")


def test_check_reports_what_is_in_a_scene(capsys):
    printed, _ = done(capsys, "check", BALL)
    # 4π · 25 mm² is 3.1 cm², and the foci are 0.5 and 3 mm off a ball of 5 mm.
    for words in (
        "sphere",
        "sound-hard",
        "3.1 cm²",
        "south pole",
        "0.5 mm",
        "3 mm",
        "900 Pa",
        "249",
        "unknowns",
        "MB",
    ):
        assert words in printed


def box_file(folder, change=lambda vertices, triangles: (vertices, triangles), name="box.stl"):
    vertices, triangles = change(*box_mesh())
    trimesh.Trimesh(1e3 * vertices, triangles, process=False).export(folder / name)
    return folder / name


def test_check_reports_what_is_in_a_surface(capsys, tmp_path):
    printed, errors = done(
        capsys, "check", box_file(tmp_path), "--scale", "1e-3", "--out", tmp_path / "out"
    )
    assert only_steps(errors)
    # 2 (2·3 + 2·4 + 3·4) cm², 2·3·4 cm³, 4 (20 + 30 + 40) mm of edges
    for words in (
        "accepted box.stl: 12 triangles, 1 closed piece",
        "20 x 30 x 40 mm",
        "52 cm²",
        "24 cm³",
        "12 with a total length of 360 mm",
        "unknowns, about",
        "repaired nothing",
    ):
        assert words in printed
    assert [entry.name for entry in (tmp_path / "out").iterdir()] == ["bodies.png"]


def test_check_lists_repairs_and_how_sharp_edges_were_asked(capsys, tmp_path):
    path = box_file(tmp_path, lambda v, t: (v, np.vstack([t[:1, ::-1], t[1:]])))
    printed, _ = done(capsys, "check", path, "--scale", "1e-3", "--sharp", "120")
    assert "repaired 1 triangle was reversed" in printed
    assert "none with an angle above 120°" in printed
    assert list(tmp_path.iterdir()) == [path]


def test_the_widest_hole_that_is_filled_can_be_asked_for(capsys, tmp_path):
    ball = trimesh.creation.icosphere(subdivisions=3, radius=10.0)
    rim = np.linalg.norm(ball.triangles_center - ball.vertices[0], axis=1) > 2.0
    trimesh.Trimesh(ball.vertices, ball.faces[rim], process=False).export(tmp_path / "ball.ply")
    errors = rejected(capsys, "check", tmp_path / "ball.ply", "--scale", "1e-3")
    assert errors.endswith("[mesh_faulty]")
    options = ["--scale", "1e-3", "--largest-hole", "6e-3", "--out", tmp_path / "panels.ply"]
    printed, _ = done(capsys, "mesh", tmp_path / "ball.ply", *options)
    assert re.search(r"1 hole of up to [0-9.]+ mm was filled", printed)


def test_mesh_reports_how_good_panels_are(capsys, tmp_path):
    out = tmp_path / "out" / "panels.vtkhdf"
    printed, errors = done(
        capsys, "mesh", box_file(tmp_path), "--scale", "1e-3", "--edge", "0.008", "--out", out
    )
    assert only_steps(errors)
    for words in (
        "triangles, panels 12",
        "area 52 cm² 52 cm²",
        "volume 24 cm³ 24 cm³",
        "8 mm requested",
        "repaired nothing",
    ):
        assert words in printed
    assert "under 0.1 µm at most, under 0.1 µm on average" in printed
    assert float(re.search(r"smallest angle (\d+\.\d)°", printed)[1]) > 15
    assert "Warning" not in printed
    assert sorted(entry.name for entry in out.parent.iterdir()) == ["panels.png", "panels.vtkhdf"]


def test_mesh_warns_of_triangles_too_coarse_for_a_curved_surface(capsys, tmp_path):
    trimesh.creation.icosphere(subdivisions=1, radius=0.02).export(tmp_path / "ball.ply")
    printed, _ = done(capsys, "mesh", tmp_path / "ball.ply", "--out", tmp_path / "panels.stl")
    # 80 triangles of a sphere: it stands 1.4 mm over them
    assert re.search(r"Warning: the panels lie up to \d\.\d mm from the triangles", printed)
    assert "--sharp 0" in printed


@pytest.mark.parametrize(
    ("options", "numbers", "fault"),
    [
        (["--edge", "3"], ("3 m", "40 mm"), "not_in_metres"),
        (["--edge", "-0.003"], ("-0.003 m",), "out_of_range"),
        (["--edge", "1e-6"], ("1e-06 m", "1.2e+10 panels", "300"), "too_many"),
        (["--sharp", "200"], ("sharp_degrees is 200", "180"), "out_of_range"),
        (["--scale", "1.0"], ("box.stl", "40 m", "2 m"), "not_in_metres"),
    ],
)
def test_mesh_rejects_in_one_sentence(capsys, tmp_path, options, numbers, fault):
    scale = [] if "--scale" in options else ["--scale", "1e-3"]
    out = tmp_path / "out" / "panels.vtkhdf"
    code, printed, errors = output(
        capsys, "mesh", box_file(tmp_path), *scale, *options, "--out", out
    )
    assert (code, printed) == (2, "")
    last = errors.splitlines()[-1]
    assert last.endswith(f" [{fault}]")
    assert [number for number in numbers if number not in last] == []
    assert not out.parent.exists()


def test_mesh_rejects_files_that_it_cannot_write(capsys, tmp_path):
    path = box_file(tmp_path)
    before = path.read_bytes()
    for file, fault in (
        (path, "would_overwrite"),
        (tmp_path / "panels.obj", "unknown_format"),
        (path / "panels.stl", "not_writable"),
    ):
        errors = rejected(capsys, "mesh", path, "--scale", "1e-3", "--out", file)
        assert errors.endswith(f" [{fault}]")
    assert path.read_bytes() == before


def test_render_reports_its_steps_and_what_the_foci_get(capsys, tmp_path):
    printed, errors = done(capsys, "render", BALL, "--out", tmp_path / "out")
    assert str(tmp_path / "out" / "report.html") in printed
    got = re.search(r"focus 2\s+(\d+) Pa", printed)
    assert got
    assert float(got[1]) == pytest.approx(600.0, rel=0.05)  # the accuracy that the scene asks for
    assert only_steps(errors)
    assert sum("solving" in step for step in errors.splitlines()) == 1


def test_a_missing_scene_and_a_wrong_option_are_exit_code_2(capsys, tmp_path):
    errors = rejected(capsys, "check", tmp_path / "no.toml")
    assert errors.endswith("no.toml does not exist. [file_missing]")
    assert output(capsys, "check", BALL, "--unreadable")[0] == 2
    assert output(capsys, "export", BALL)[0] == 2


def test_a_checkout_without_kernels_says_so_in_one_sentence(capsys, monkeypatch):
    def unbuilt(**_: object) -> None:
        raise ImportError("cannot import name '_kernels' from 'airtact'")

    monkeypatch.setattr(cli.commands, "main", unbuilt)
    errors = rejected(capsys, "emit", "--help")
    assert "pip install ." in errors
    assert errors.endswith("[extra_missing]")


@pytest.mark.parametrize("folder", ["file", "file/out"])
def test_a_folder_that_cannot_be_made_is_rejected_before_anything_is_solved(
    capsys, tmp_path, folder
):
    (tmp_path / "file").touch()
    code, _, errors = output(capsys, "render", BALL, "--out", tmp_path / folder)
    assert code == 2
    assert f"{tmp_path / 'file'} is a file." in errors
    assert errors.endswith(" [not_writable]\n")
    assert "solving" not in errors


@pytest.mark.skipif(sys.platform == "win32", reason="signals are sent another way there")
def test_ctrl_c_during_the_verification_leaves_the_drive(tmp_path):
    """The drive is written before its verification; files of an older run do not stay beside it."""
    folder = tmp_path / "out"
    folder.mkdir()
    (folder / "report.html").write_text("older")
    command = [sys.executable, "-m", "airtact", "render", "pinch", "--out", str(folder)]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stderr is not None
        for line in process.stderr:
            if "verifying" in line:
                break
        process.send_signal(signal.SIGINT)
        errors = process.stderr.read()
        assert process.wait() == 130
    assert errors.splitlines()[-1].endswith("[interrupted]")
    assert "Traceback" not in errors
    assert f"The drive in {folder} is not verified" in errors
    assert sorted(entry.name for entry in folder.iterdir()) == ["drive.csv", "drive.h5"]
    assert at.load_drive(folder / "drive.h5").peak == pytest.approx(1.0)


def test_a_drive_is_on_disk_before_its_verification_which_keeps_it(capsys, monkeypatch, tmp_path):
    scene = tmp_path / "air.toml"
    text = BALL.read_text(encoding="utf-8")
    for line in ("[[obstacles]]\nsphere = { radius = 5e-3 }\n", "[solver]\naccuracy = 0.05\n"):
        text = text.replace(line, "")
    at_full_scale = text.replace("pressure = ", "#")
    compare = rendering.compare_drives
    files = [tmp_path / "out" / name for name in ("drive.csv", "drive.h5")]
    written = []

    def observed(*arguments, **options):
        written[:] = [(file.read_bytes(), file.stat().st_mtime_ns) for file in files]
        return compare(*arguments, **options)

    monkeypatch.setattr(rendering, "compare_drives", observed)
    command = ["render", scene, "--no-pictures", "--out", tmp_path / "out"]
    scene.write_text(at_full_scale, encoding="utf-8")
    done(capsys, *command)
    assert [(file.read_bytes(), file.stat().st_mtime_ns) for file in files] == written
    # Requested pressures are scaled to the verified ones.
    scene.write_text(text, encoding="utf-8")
    done(capsys, *command)
    assert at.load_drive(files[1]).amplitudes.shape == (249,)
    assert files[1].stat().st_mtime_ns > written[1][1]

    def failing(*arguments, **options):
        raise at.NotConverged("the residual is 0.1.", code="not_converged")

    monkeypatch.setattr(rendering, "compare_drives", failing)
    files[1].unlink()
    errors = rejected(capsys, *command)
    assert f"The drive in {tmp_path / 'out'} is not verified." in errors
    assert at.load_drive(files[1]).amplitudes.shape == (249,)
