"""``airtact sense``: where the hand is, from echoes of the array's own transmissions."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import airtact as at
from airtact.cli.console import facts_table, open_page, progress, show
from airtact.cli.options import FILE, as_json, open_result, pictures, quiet, results, scene, store

if TYPE_CHECKING:
    from airtact.setup.sensing import Sensed


@click.command(
    short_help="Find where the hand is from echoes.",
    epilog="Example: airtact sense pinch --simulate --noise 20 --out out/sensed",
)
@scene
@click.option(
    "--echoes", type=FILE, help="File of measured echoes (.h5), less what the empty array receives."
)
@click.option(
    "--simulate", is_flag=True, help="Simulate echoes of a hand that is off the scene's pose."
)
@click.option(
    "--noise",
    type=float,
    default=20.0,
    show_default=True,
    help="Echoes over noise in dB, if simulated.",
)
@click.option(
    "--offset",
    type=click.FloatRange(0.0, 0.05),
    default=2e-3,
    show_default=True,
    help="Of the simulated hand in metres.",
)
@click.option(
    "--turn",
    type=click.FloatRange(0.0, 45.0),
    default=3.0,
    show_default=True,
    help="Of the simulated hand in degrees.",
)
@click.option(
    "--opened",
    "wider",
    type=click.FloatRange(-2e-3, 2e-3),
    default=5e-4,
    show_default=True,
    help="Of the simulated pinch in metres.",
)
@click.option(
    "--seed",
    type=click.IntRange(0),
    default=0,
    show_default=True,
    help="Of the simulated noise and directions.",
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
    """Find the pose of the hand of SCENE, and the gap of a pinch, from echoes.

    No board that airtact drives today can receive: --echoes reads what a laboratory's own receivers
    measured. Writes pose.json, report.html, and echoes.h5 where they were simulated.
    """
    with progress() as report_step:
        report_step(f"reading {scene.name}")
        from airtact.files.atomic import writable_folder
        from airtact.reports.sense_page import write_sense_page
        from airtact.setup.sensing import Simulation, write_pose
        from airtact.setup.sensing import sense as sense_hand

        if (echoes is None) != simulate:
            raise at.InvalidInput(
                "give either a file of echoes (--echoes FILE) or --simulate.", code="data_missing"
            )
        setup = at.read_scene(scene)
        writable_folder(folder)
        pose = folder / "pose.json"
        page = folder / "report.html"
        # An older run's must not be beside this run's echoes.
        for file in (pose, page):
            file.unlink(missing_ok=True)
        if echoes is None:
            source = Simulation(noise, offset, turn, seed, wider)
        else:
            source = at.sensing.load_echoes(echoes)
        sensed = sense_hand(setup, source, report_step, store)
        files = [pose]
        write_pose(pose, sensed.located)
        if pictures:
            report_step("drawing the report")
            write_sense_page(page, sensed)
            files.append(page)
        if simulate:
            files.append(folder / "echoes.h5")
            sensed.echoes.save(files[-1])
    show(
        facts_table(_facts(sensed)),
        lines=[f"Report: {page}" if pictures else f"Pose: {pose}"],
        record={**_record(sensed), "files": {file.name: str(file) for file in files}},
    )
    if opened and pictures:
        open_page(page)


def _facts(sensed: "Sensed") -> list[tuple[str, str]]:
    import numpy as np

    located = sensed.located
    deviation, deviation_turn = located.deviation
    off, turn = sensed.off
    share = sensed.uncorrected / sensed.corrected
    facts = [
        ("the hand is off the scene's pose by", f"{1e3 * off:.3f} mm and {np.degrees(turn):.3f}°"),
        (
            "standard deviation",
            f"{1e3 * deviation:.3f} mm and {np.degrees(deviation_turn):.3f}°",
        ),
        *_gap_facts(sensed),
        (
            "not explained",
            f"{located.residual:.1%} of the echoes, {located.misfit:.1%} beyond noise",
        ),
        (
            "weakest focus, drive for the scene's pose",
            f"{sensed.uncorrected:,.0f} Pa, {share:.0%} of the next",
        ),
        ("weakest focus, drive for the pose found", f"{sensed.corrected:,.0f} Pa"),
    ]
    if len(located.left_out):
        facts.append(
            ("receivers left out", ", ".join(str(receiver) for receiver in located.left_out[:20]))
        )
    if sensed.error is not None:
        error, wrong_turn = sensed.error
        facts.append(
            (
                "off the simulated truth by",
                f"{1e3 * error:.3f} mm and {np.degrees(wrong_turn):.3f}°",
            )
        )
    return facts


def _gap_facts(sensed: "Sensed") -> list[tuple[str, str]]:
    located = sensed.located
    gap = sensed.gap
    true = sensed.true_gap
    if gap is None or located.opening is None:
        return []
    facts = [
        (
            "gap",
            f"{1e3 * located.opening:.3f} mm, standard deviation "
            f"{1e3 * located.opening_deviation:.3f} mm",
        ),
        ("gap in the scene", f"{1e3 * gap:.3f} mm"),
    ]
    if true is not None:
        facts.append(
            ("gap off the simulated truth by", f"{1e3 * abs(located.opening - true):.3f} mm")
        )
    return facts


def _record(sensed: "Sensed") -> dict[str, Any]:
    located = sensed.located
    return {
        "rotation": located.pose.rotation.tolist(),
        "translation": located.pose.translation.tolist(),
        "covariance": located.covariance.tolist(),
        "off": list(sensed.off),
        "error": None if sensed.error is None else list(sensed.error),
        "opening": located.opening,
        "true_gap": sensed.true_gap,
        "residual": located.residual,
        "misfit": located.misfit,
        "left_out": located.left_out.tolist(),
        "uncorrected": sensed.uncorrected,
        "corrected": sensed.corrected,
    }
