"""``airtact sense``: locate the hand from echoes of the array's own transmissions."""

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

import airtact as at
from airtact.cli.console import facts_table, open_page, progress, show
from airtact.cli.options import (
    FILE,
    as_json,
    open_result,
    pictures,
    quiet,
    results,
    scene,
    setup_for,
    store,
)

if TYPE_CHECKING:
    from airtact.setup.sensing import Sensed


@click.command(
    short_help="Locate the hand from echoes.",
    epilog="Example: airtact sense pinch --simulate --noise 20 --out out/sensed",
)
@scene
@click.option(
    "--echoes",
    type=FILE,
    help="File with measured echoes (.h5) without the direct sound.",
)
@click.option("--simulate", is_flag=True, help="Simulate the echoes of a displaced hand.")
@click.option(
    "--noise",
    type=float,
    default=20.0,
    show_default=True,
    help="Signal-to-noise ratio of the simulation [dB].",
)
@click.option(
    "--offset",
    type=click.FloatRange(0.0, 0.05),
    default=2e-3,
    show_default=True,
    help="Offset of the simulated hand [m].",
)
@click.option(
    "--turn",
    type=click.FloatRange(0.0, 45.0),
    default=3.0,
    show_default=True,
    help="Rotation of the simulated hand [degrees].",
)
@click.option(
    "--opened",
    "wider",
    type=click.FloatRange(-2e-3, 2e-3),
    default=5e-4,
    show_default=True,
    help="Change of the gap of the simulated pinch [m].",
)
@click.option(
    "--seed",
    type=click.IntRange(0),
    default=0,
    show_default=True,
    help="Seed of the simulated noise and directions.",
)
@results
@store
@pictures
@open_result
@as_json
@quiet
def sense(
    scene: Path,
    echoes: Path | None,
    simulate: bool,
    noise: float,
    offset: float,
    turn: float,
    wider: float,
    seed: int,
    folder: Path,
    store: Path | None,
    pictures: bool,
    opened: bool,
) -> None:
    """Estimate the pose of the hand in SCENE, and the gap of a pinch, from echoes.

    The supported boards cannot receive, so --echoes reads measurements from other
    receivers. The command writes pose.json and report.html, as well as echoes.h5 if it
    simulates the echoes.
    """
    with progress(f"reading {scene.name}") as report_step:
        from airtact.files.atomic import whole_file
        from airtact.reports.sense_page import write_sense_page
        from airtact.setup import sensing

        if (echoes is None) != simulate:
            raise at.InvalidInput(
                "use either a file of echoes (--echoes FILE) or --simulate.", code="data_missing"
            )
        setup = setup_for(folder, scene)
        pose = folder / "pose.json"
        page = folder / "report.html"
        source = (
            sensing.Simulation(noise, offset, turn, seed, wider)
            if echoes is None
            else at.sensing.load_echoes(echoes)
        )
        sensed = sensing.sense(setup, source, report_step, store)
        files = [pose]
        record = {"format_version": 1, **sensed.record()}
        with whole_file(pose) as partial:
            partial.write_text(json.dumps(record, indent=1), encoding="utf-8")
        if pictures:
            report_step("drawing the report")
            write_sense_page(page, sensed)
            files.append(page)
        else:
            page.unlink(missing_ok=True)  # left from an older run
        if simulate:
            files.append(folder / "echoes.h5")
            sensed.echoes.save(files[-1])
    show(
        facts_table(_facts(sensed)),
        lines=[f"Report: {page}" if pictures else f"Pose: {pose}"],
        record={**record, "files": {file.name: str(file) for file in files}},
    )
    if opened and pictures:
        open_page(page)


def _facts(sensed: "Sensed") -> list[tuple[str, str]]:
    import numpy as np

    def motion(distance: float, angle: float) -> str:
        return f"{1e3 * distance:.3f} mm and {np.degrees(angle):.3f}°"

    located = sensed.located
    before = sensed.before.min()
    after = sensed.after.min()
    facts = [
        ("displacement from the pose in the scene", motion(*sensed.sizes[0])),
        ("standard deviation", motion(*located.deviation)),
    ]
    if sensed.gap is not None and located.opening is not None:
        facts += [
            ("gap", f"{1e3 * located.opening:.3f} mm ({1e3 * sensed.gap:.3f} mm in the scene)"),
            ("standard deviation of the gap", f"{1e3 * located.opening_deviation:.3f} mm"),
        ]
        if sensed.true_gap is not None:
            error = 1e3 * abs(located.opening - sensed.true_gap)
            facts.append(("error of the gap", f"{error:.3f} mm"))
    facts += [
        (
            "unexplained",
            f"{located.residual:.1%} of the echoes, {located.misfit:.1%} beyond noise",
        ),
        ("weakest focus, drive for the pose in the scene", f"{before:,.0f} Pa"),
        (
            "weakest focus, drive for the estimated pose",
            f"{after:,.0f} Pa, {after / before:.2f} times",
        ),
    ]
    if len(located.left_out):
        facts.append(
            ("ignored receivers", ", ".join(str(receiver) for receiver in located.left_out[:20]))
        )
    if len(sensed.sizes) > 1:
        facts.append(("error of the pose", motion(*sensed.sizes[1])))
    return facts
