"""``airtact register``: determine the pose of the tracker from touched transducers."""

from contextlib import ExitStack
from pathlib import Path

import click

import airtact as at
from airtact.cli.console import plain_table, progress, say, show, status_line
from airtact.cli.options import FILE, INPUT, as_json, page_address, quiet, scene_here


@click.command(
    short_help="Determine the pose of the tracker by touching transducers.",
    epilog="Example: airtact register scene.toml --from websocket --write",
)
@click.argument("scene", type=INPUT, default="scene.toml", callback=scene_here)
@click.option(
    "--from",
    "source",
    default="websocket",
    show_default=True,
    metavar="websocket|FILE.jsonl",
    help="Source of the hand: trackers (websocket or websocket:PORT), or a recording of touches.",
)
@click.option(
    "--touches",
    type=click.IntRange(min=3),
    default=6,
    show_default=True,
    help="Number of touches, at transducers that are far apart.",
)
@click.option(
    "--element",
    "elements",
    type=int,
    multiple=True,
    help="Index of a transducer to touch; repeat the option for each touch, in order.",
)
@click.option(
    "--offset",
    type=float,
    help="Distance of the fingertip joint from the touched face in metres; by default the radius "
    "of the joint.",
)
@click.option("--fit-offset", is_flag=True, help="Also estimate the distance --offset.")
@click.option(
    "--fit-scale", is_flag=True, help="Also estimate a scale factor for the tracker's lengths."
)
@click.option("--write", is_flag=True, help="Write [tracker] to SCENE and keep its comments.")
@click.option("--out", "file", type=FILE, help="Write a copy of SCENE with [tracker].")
@click.option("--page", is_flag=True, help="Also show the touches on a page.")
@page_address
@as_json
@quiet
def register(
    scene: Path,
    source: str,
    touches: int,
    elements: tuple[int, ...],
    offset: float | None,
    fit_offset: bool,
    fit_scale: bool,
    write: bool,
    file: Path | None,
    page: bool,
    page_port: int,
    host: str,
) -> None:
    """Print the table [tracker] for SCENE: the pose of the hand tracker in the frame of the scene.

    With the tip of an index finger, touch each transducer that the command names, hold still for a
    second, and move the finger away. Nothing is emitted. A touch that contradicts the others must
    be repeated, at most twice. The command also prints how far each touch is from its transducer
    after the fit, and the standard deviations of the pose. Add the table to the scene file with
    --write.
    """
    with progress(f"reading {scene.name}"):
        from airtact.live.registering import elements_to_touch, register_tracker, with_tracker

        setup = at.read_scene(scene)
        if write and at.example("live_pinch").parent in scene.resolve().parents:
            raise at.InvalidInput(
                f"{scene.name} is an example: use --out to write a copy with [tracker].",
                code="not_writable",
            )
        # Find out now whether the file can be changed, before the user touches anything.
        with_tracker(setup.text, setup.tracker)
        chosen = elements or elements_to_touch(setup.array, touches)
    with ExitStack() as closing:
        shown = None
        if page:
            from airtact.errors import extra

            with extra("live", "to serve the page, airtact needs websockets"):
                from airtact.live.page.touches import TouchPage

            shown = closing.enter_context(TouchPage(setup, chosen, page_port, host))
            say(f"Page: {shown.address}")
        report = closing.enter_context(status_line())

        def report_touch(step: at.live.TouchStep) -> None:
            report(step)
            if shown is not None:
                shown.show(step)

        found = register_tracker(
            setup,
            source,
            chosen,
            offset=offset,
            fit_offset=fit_offset,
            fit_scale=fit_scale,
            report=report_touch,
        )
        if shown is not None:
            shown.finish(found)
    fit = found.fit
    table = plain_table("touch", "transducer", "residual")
    for number, words in enumerate(found.words):
        mark = ", ignored" if number == fit.repeat else ""
        table.add_row(f"{number + 1}", words, f"{1e3 * fit.residuals[number]:.2f} mm{mark}")
    import numpy as np

    lines = [
        f"Standard deviation: {1e3 * fit.position_error:.2g} mm and "
        f"{np.degrees(fit.angle_error):.2g} degrees."
    ]
    if fit_offset:
        lines.append(f"The fingertip joint is {1e3 * fit.offset:.1f} mm from a touched face.")
    if fit_scale:
        lines.append(f"Multiply the tracker's lengths by {fit.scale:.4f} before sending them.")
    written = file or (scene if write else None)
    if written is not None:
        at.live.write_tracker(scene, fit.tracker, written)
    warnings = []
    if fit.repeat is not None:
        warnings.append(f"touch {fit.repeat + 1} contradicts the others and is ignored.")
    if fit.likely_scale is not None:
        warnings.append(
            "the touches fit much better if the tracker's lengths are multiplied by "
            f"{fit.likely_scale:.3f}. Use --fit-scale, and send lengths multiplied by that factor."
        )
    show(
        table,
        warnings=warnings,
        lines=[*lines, "", found.table(), *([] if written is None else [f"Scene: {written}"])],
        record={
            "rotation": fit.tracker.rotation.tolist(),
            "translation": fit.tracker.translation.tolist(),
            "scale": fit.scale,
            "offset": fit.offset,
            "position_error": fit.position_error,
            "angle_error": fit.angle_error,
            "touches": [
                {"element": element, "residual": residual}
                for element, residual in zip(found.elements, fit.residuals.tolist(), strict=True)
            ],
            "repeat": fit.repeat,
            "files": {} if written is None else {"scene": str(written)},
        },
    )
