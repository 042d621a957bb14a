"""``airtact calibrate``: calibrate boards, gains and sound speed, or the sensitivity from scans."""

from pathlib import Path
from typing import Any

import click

import airtact as at
from airtact.cli.console import facts_table, progress, show
from airtact.cli.options import FILE, INPUT, as_json, given, microphone_face, quiet, setup_for


@click.command(
    short_help="Calibrate an array from its own transmissions or from scans.",
    epilog="Example: airtact calibrate --simulate --scene pinch --out out/calibration.csv",
)
@click.argument("echoes", type=FILE, required=False, metavar="[ECHOES | SCENE]")
@click.option(
    "--scene",
    type=INPUT,
    default="scene.toml",
    show_default=True,
    help="Scene file with the array.",
)
@click.option(
    "--simulate", is_flag=True, help="Simulate transmissions of an array with small errors."
)
@click.option(
    "--noise",
    type=float,
    default=30.0,
    show_default=True,
    help="Signal-to-noise ratio of the simulation [dB].",
)
@click.option(
    "--seed",
    type=click.IntRange(0),
    default=0,
    show_default=True,
    help="Seed of the simulated noise and array.",
)
@click.option(
    "--scan",
    "scans",
    type=FILE,
    multiple=True,
    help="File with a scan of the array's field without bodies; can be repeated.",
)
@click.option(
    "--element",
    "elements",
    type=int,
    multiple=True,
    help="Index (from 0) of the only element that emits; one per scan.",
)
@click.option(
    "--drive",
    "drives",
    type=FILE,
    multiple=True,
    help="Drive file for each scan or for all scans; by default the drive of the scene.",
)
@microphone_face
@click.option(
    "--out",
    type=FILE,
    default="calibration.csv",
    show_default=True,
    help="File for the calibration table.",
)
@as_json
@quiet
def calibrate(
    echoes: Path | None,
    scene: Path,
    simulate: bool,
    noise: float,
    seed: int,
    scans: tuple[Path, ...],
    elements: tuple[int, ...],
    drives: tuple[Path, ...],
    out: Path,
    **microphone: Any,
) -> None:
    """Estimate the poses of a scene's boards, the gains of the elements and the sound speed.

    ECHOES is an .h5 file with the pressures that the elements receive from each other, including
    the direct sound. The pressures must be measured without bodies in the array. The boards must
    face each other, and the codes that the elements emit must be linearly independent. The poses in
    the scene file (--scene) may be wrong by up to 2 mm and 1 degree.

    With --scan, the only argument is the scene file. The command then estimates the sensitivity
    that all elements share, the rotation and shift of the scanned positions relative to the
    obstacles' frame, and the gains of the elements that the scans determine. A scan is a .csv file
    with the columns x, y, z (metres, in the obstacles' frame), pressure (pascals, peak) and, if
    measured, phase (radians).

    The gains are written to --out. To use this table in a scene, set calibration =
    "calibration.csv" in [array].
    """
    if scans:
        if simulate:
            raise at.InvalidInput(
                "--scan and --simulate cannot be combined: omit one.", code="options_clash"
            )
        scene = scene if echoes is None else INPUT.convert(str(echoes), None, None)
        _from_scans(scene, scans, elements, drives, given(**microphone), out)
        return
    if elements or drives or given(**microphone):
        raise at.InvalidInput(
            "--element, --drive, --diameter and --axis only apply to scans: set --scan.",
            code="options_clash",
        )
    with progress(f"reading {scene.name}") as report_step:
        from airtact.setup.sensing import calibrate_array

        setup = setup_for(out.parent, scene)
        calibrated, error = calibrate_array(
            setup, echoes, noise if simulate else None, seed, report_step
        )
        calibrated.save(out)
    show(
        facts_table(_facts(calibrated, error)),
        lines=[
            f"Calibration: {out}",
            f"In the scene file: sound_speed = {calibrated.sound_speed:.2f} in [medium], "
            f'calibration = "{out.name}" in [array].',
        ],
        record={
            "sound_speed": calibrated.sound_speed,
            "boards": [
                {"rotation": pose.rotation.tolist(), "translation": pose.translation.tolist()}
                for pose in calibrated.motions
            ],
            "covariance": calibrated.covariance.tolist(),
            "gain_deviation": calibrated.gain_deviation,
            "residual": calibrated.residual,
            "misfit": calibrated.misfit,
            "dead": calibrated.dead.tolist(),
            "error": None if error is None else list(error),
            "files": {"calibration.csv": str(out)},
        },
    )


def _from_scans(
    scene: Path,
    scans: tuple[Path, ...],
    elements: tuple[int, ...],
    drives: tuple[Path, ...],
    microphone: dict[str, Any],
    out: Path,
) -> None:
    with progress(f"reading {scene.name}") as report_step:
        import numpy as np

        from airtact.setup.parsing import parse_scene
        from airtact.setup.sensing import calibrate_from_files

        setup = setup_for(out.parent, scene)
        calibrated = calibrate_from_files(
            setup, scans, elements, drives, at.evaluation.Microphone(**microphone), report_step
        )
        determined = np.flatnonzero(calibrated.determined)
        gains = f"{len(determined)} of {len(calibrated.array)}"
        settings = f"sensitivity = {calibrated.sensitivity:.5g}"
        files = {}
        if kept := parse_scene(setup.text).array.calibration:
            # Another table would lose the positions in this one.
            gains += f", not written, because the scene already uses {kept}"
        elif len(determined):
            calibrated.save(out)
            levels = np.abs(calibrated.array.gains[determined])
            gains += f", {levels.min():.2f} to {levels.max():.2f}"
            settings += f', calibration = "{out.name}"'
            files = {"calibration.csv": str(out)}
    turn, shift = np.split(calibrated.misalignment, 2)
    turn_doubt, shift_doubt = np.linalg.norm(
        calibrated.misalignment_deviation.reshape(2, 3), axis=1
    )
    facts = [
        (
            "sensitivity",
            f"{calibrated.sensitivity:.4g} Pa·m, standard deviation {calibrated.deviation:.2g} "
            f"Pa·m ({calibrated.deviation / calibrated.sensitivity:.1%})",
        ),
        (
            "rotation of the scan",
            f"{np.degrees(np.linalg.norm(turn)):.2f}°, standard deviation "
            f"{np.degrees(turn_doubt):.2g}°",
        ),
        (
            "shift of the scan",
            f"({1e3 * shift[0]:z.2f}, {1e3 * shift[1]:z.2f}, {1e3 * shift[2]:z.2f}) mm, standard "
            f"deviation {1e3 * shift_doubt:.2g} mm",
        ),
        ("gains determined", gains),
        ("unexplained", ", ".join(f"{error:.1%}" for error in calibrated.errors)),
    ]
    show(
        facts_table(facts),
        lines=[f"In the scene file: {settings} in [array]."],
        record={
            "sensitivity": calibrated.sensitivity,
            "deviation": calibrated.deviation,
            "determined": determined.tolist(),
            "rotation": calibrated.pose.rotation.tolist(),
            "translation": calibrated.pose.translation.tolist(),
            "misalignment_deviation": calibrated.misalignment_deviation.tolist(),
            "errors": list(calibrated.errors),
            "files": files,
        },
    )


def _facts(
    calibrated: "at.sensing.Calibrated", error: tuple[float, float] | None
) -> list[tuple[str, str]]:
    import numpy as np

    position, turn, speed = calibrated.deviation
    facts = [("sound speed", f"{calibrated.sound_speed:.3f} m/s, standard deviation {speed:.1g}")]
    for board, motion in enumerate(calibrated.motions[1:], 1):
        # Relative to the first board, which defines the frame
        x, y, z = 1e3 * calibrated.shifts[board]
        # The distance of a small rotation from the identity is √2 times its angle.
        angle = np.degrees(np.linalg.norm(motion.rotation - np.eye(3)) / np.sqrt(2.0))
        facts.append(
            (
                f"misalignment of board {board}",
                f"({x:z.3f}, {y:z.3f}, {z:z.3f}) mm, rotated by {angle:.3f}°",
            )
        )
    gains = np.abs(calibrated.emission[calibrated.emission != 0.0])
    facts += [
        ("standard deviation of a board", f"{1e3 * position:.2g} mm and {np.degrees(turn):.2g}°"),
        (
            "gains",
            f"{gains.min():.2f} to {gains.max():.2f}, standard deviation "
            f"{calibrated.gain_deviation:.1%}",
        ),
        (
            "unexplained",
            f"{calibrated.residual:.1%} of the direct sound, {calibrated.misfit:.1%} beyond noise",
        ),
    ]
    if len(calibrated.dead):
        facts.append(("dead elements", ", ".join(str(element) for element in calibrated.dead[:20])))
    if error is not None:
        facts.append(
            (
                "errors of the worst board and the sound speed",
                f"{1e3 * error[0]:.4f} mm and {error[1]:.4f} m/s",
            )
        )
    return facts
