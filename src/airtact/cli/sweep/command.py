"""``airtact sweep``: what the foci of a scene get while keys of its file vary."""

from pathlib import Path

import click

from airtact.cli.console import open_page, plain_table, show
from airtact.cli.options import INPUT, as_json, open_result, pictures, quiet, results, scene
from airtact.cli.sweep.counting import counting


@click.command(
    short_help="Make the drive of a scene at many points of its keys.",
    epilog='Example: airtact sweep pinch --vary "pinch.gap=0.008:0.016:5" --out out/gaps',
)
@scene
@results
@click.option(
    "--vary",
    "varied",
    multiple=True,
    metavar="PATH=LOW:HIGH:COUNT",
    help="A key and its values, such as foci[0].offset=0.0005:0.003:6; several make a grid.",
)
@click.option(
    "--recording", type=INPUT, help="Recording whose frames take the place of the scene's hand."
)
@click.option(
    "--processes",
    type=click.IntRange(min=1),
    help="How many; by default as processors and memory allow.",
)
@click.option(
    "--dask", metavar="ADDRESS", help="Dask scheduler, such as tcp://10.0.0.1:8786, or local."
)
@click.option("--parquet", is_flag=True, help="Write sweep.parquet too.")
@pictures
@open_result
@as_json
@quiet
def sweep(
    scene: Path,
    folder: Path,
    varied: tuple[str, ...],
    recording: Path | None,
    processes: int | None,
    dask: str | None,
    parquet: bool,
    pictures: bool,
    opened: bool,
) -> None:
    """Make the drive of SCENE at every point and write sweep.csv and sweep.html.

    PATH is a key of the scene file: foci[0].offset, medium.celsius,
    obstacles[0].pose.translation[2], or short for the only body of a kind: hand.gap, pinch.gap,
    sphere.radius. The result of each point is kept in the folder: the same command goes on where it
    was stopped. A point that fails is a row with its sentence.
    """
    with counting() as count:
        from airtact.workflows.sweep import sweep as workflow

        settings = {"number": processes, "dask": dask, "parquet": parquet, "pictures": pictures}
        try:
            found = workflow.sweep(scene, varied, folder, count, recording, **settings)
        except KeyboardInterrupt:
            kept = len(list((folder / workflow.STORE).glob("*.point.json")))
            sentence = f"{kept} points in {folder / workflow.STORE} kept; the same command goes on from there"
            raise KeyboardInterrupt(sentence) from None
    written = [name for name in workflow.FILES if (folder / name).exists()]
    page = folder / workflow.FILES[1]
    table = plain_table("points", "failed", "weakest focus, median", "least", "most")
    known = len(found.failed) < len(found.rows)
    if known:
        import numpy as np

        weakest = found.numbers("weakest_Pa")
        figures = [f"{f(weakest):,.0f} Pa" for f in (np.nanmedian, np.nanmin, np.nanmax)]
        table.add_row(f"{len(found.rows):,}", f"{len(found.failed):,}", *figures)
    first = found.failed[:1]
    show(
        *([table] if known else []),
        warnings=[
            f"{len(found.failed)} of {len(found.rows)} points failed; the first: {one['sentence']}"
            for one in first
        ],
        lines=[f"Report: {page}" if pictures else f"Table: {folder / workflow.FILES[0]}"],
        record={
            "points": len(found.rows),
            "failed": len(found.failed),
            "varied": list(found.varied),
            "files": {name: str(folder / name) for name in written},
        },
    )
    if opened:
        open_page(page)
