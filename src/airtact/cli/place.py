"""``airtact place``: search for board positions that maximise the pressure at the weakest focus."""

from pathlib import Path
from typing import Literal

import click
from rich.table import Table

import airtact as at
from airtact.cli.console import plain_table, progress, show
from airtact.cli.options import INPUT, Names, as_json, quiet, results, scene

# Two opposite corners of a box
BOX = (float,) * 6


@click.command(
    short_help="Search for the best positions of boards around a hand.",
    epilog="Example: airtact place pinch --boards 2 --out out/places",
)
@scene
@results
@click.option(
    "--boards", type=click.IntRange(min=1), default=1, help="Number of boards; by default 1."
)
@click.option(
    "--board",
    type=Names("airtact.transducers.boards:BOARDS"),
    default="autd3",
    help="Kind of board; by default autd3.",
)
@click.option(
    "--distance",
    type=(float, float),
    default=(0.15, 0.25),
    help="Smallest distance from bodies and foci, and largest distance of a board's centre from "
    "the centre of the foci, in metres; by default 0.15 0.25.",
)
@click.option(
    "--region",
    type=BOX,
    metavar="X Y Z X Y Z",
    help="Opposite corners of the box that must contain the boards, in metres.",
)
@click.option(
    "--keep-out",
    "kept_out",
    type=BOX,
    multiple=True,
    metavar="X Y Z X Y Z",
    help="Opposite corners of a box that boards must avoid, such as a screen; can be repeated.",
)
@click.option(
    "--fixed",
    type=click.IntRange(min=0),
    multiple=True,
    help="Index (from 0) of a board of the scene that stays in place; can be repeated.",
)
@click.option(
    "--symmetric",
    type=click.Choice(["x", "y", "z"]),
    help="Axis along which boards are placed in mirrored pairs.",
)
@click.option(
    "--no-tilt",
    "tilted",
    is_flag=True,
    flag_value=False,
    default=True,
    help="Make every board face the middle of the foci.",
)
@click.option(
    "--objective",
    type=click.Choice(["weakest", "lowest_tenth"]),
    default="weakest",
    help="Maximise the pressure that the weakest focus reaches for all hands (weakest) or for "
    "nine hands out of ten (lowest_tenth).",
)
@click.option("--recording", type=INPUT, help="Recording with poses of the hand in the scene.")
@click.option(
    "--hands",
    "count",
    type=click.IntRange(min=1),
    default=5,
    help="Number of poses from the recording, evenly spaced in time; by default 5.",
)
@click.option(
    "--tries",
    type=click.IntRange(min=1),
    default=2000,
    help="Number of layouts to try; by default 2000.",
)
@click.option(
    "--seed", type=click.IntRange(min=0), default=0, help="Seed of the random search; by default 0."
)
@as_json
@quiet
def place(
    scene: Path,
    folder: Path,
    boards: int,
    board: str,
    distance: tuple[float, float],
    region: tuple[float, ...] | None,
    kept_out: tuple[tuple[float, ...], ...],
    fixed: tuple[int, ...],
    symmetric: Literal["x", "y", "z"] | None,
    tilted: bool,
    objective: Literal["weakest", "lowest_tenth"],
    recording: Path | None,
    count: int,
    tries: int,
    seed: int,
) -> None:
    """Search for the layouts that maximise the pressure at the weakest focus; write layout_*.toml.

    The three best layouts are written as scene files to the folder given by --out.

    --fixed keeps a board of SCENE in place. --symmetric places the other boards in mirrored pairs.
    The mirror plane is in the middle of the region or, without --region, of the foci.

    The first table compares the best layouts with the present array of SCENE. The second table
    lists the change of the pressure if a board of the best layout is moved by 1 cm or turned by 5
    degrees.
    """
    with progress(f"reading {scene.name}") as report_step:
        import numpy as np

        from airtact.setup.placing import hands_of
        from airtact.setup.sentences import all_at_once

        setup = at.read_scene(scene)
        result = at.place(
            setup,
            boards,
            board,
            distance,
            None if region is None else np.reshape(region, (2, 3)),
            None if recording is None else hands_of(setup, recording, count),
            tries,
            seed,
            progress=report_step,
            keep_out=[np.reshape(box, (2, 3)) for box in kept_out],
            fixed=fixed,
            symmetric=symmetric,
            tilted=tilted,
            objective=objective,
        )
        files = result.save(folder)
    warnings = list(all_at_once(setup))
    best = result.layouts[0].weakest
    if abs(result.verified / best - 1.0) > 0.1:
        warnings.append(
            f"according to a finer solve, the best layout reaches {result.verified:,.0f} Pa, not "
            f"{best:,.0f} Pa, so another layout may be better: compare them by airtact render."
        )
    moves = plain_table("board", "1 cm in x", "y", "z", "5° about x", "y", "z")
    moves.title = "Change in pressure if one board of layout 1 is moved or turned"
    for index, changes in enumerate(result.moves):
        moves.add_row(str(index), *(f"{100 * change:+z.1f} %" for change in changes))
    show(
        _layouts_table(result, files),
        moves,
        warnings=warnings,
        lines=[f"According to a finer solve, the best layout reaches {result.verified:,.0f} Pa."],
        record={
            "layouts": [
                {
                    "weakest": layout.weakest,
                    "poses": [
                        {
                            "rotation": pose.rotation.tolist(),
                            "translation": pose.translation.tolist(),
                        }
                        for pose in layout.poses
                    ],
                }
                for layout in result.layouts[: len(files)]
            ],
            "tried": len(result.layouts),
            "median": result.median,
            "present": result.present,
            "verified": result.verified,
            "moves": result.moves.tolist(),
            "files": {file.name: str(file) for file in files},
        },
    )


def _layouts_table(result: "at.setup.Placement", files: tuple[Path, ...]) -> Table:
    table = plain_table("layout", "transducers", "weakest focus", "relative to the present array")
    table.title = "Pressure at the weakest focus at full scale, over all poses of the hand"
    layouts = result.layouts
    rows = [
        *(
            (file.stem, len(layout.array), layout.weakest)
            for file, layout in zip(files, layouts, strict=False)
        ),
        (f"median of {len(layouts):,}", len(layouts[0].array), result.median),
        ("present", len(result.setup.array), result.present),
    ]
    for name, transducers, weakest in rows:
        share = weakest / result.present
        # The present array may leave no room for some poses of the hand.
        words = ("-", "-") if weakest != weakest else (f"{weakest:,.0f} Pa", f"{share:.2f}")
        table.add_row(name, str(transducers), words[0], words[1] if share == share else "-")
    return table
