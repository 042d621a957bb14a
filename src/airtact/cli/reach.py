"""``airtact reach``: map the largest pressure that the array can produce on the skin."""

from pathlib import Path

import click

import airtact as at
from airtact.cli.console import open_page, plain_table, progress, show
from airtact.cli.options import as_json, open_result, pictures, quiet, results, scene, setup_for


@click.command(
    short_help="Map the largest pressure that the array can produce on the skin.",
    epilog="Example: airtact reach pinch --out out/reach",
)
@scene
@results
@click.option(
    "--points",
    type=click.IntRange(min=1, max=5000),
    default=500,
    help="Number of points on the skin; by default 500.",
)
@click.option(
    "--accuracy",
    type=float,
    default=0.03,
    help="Largest relative error of the boundary elements; by default 0.03.",
)
@pictures
@open_result
@as_json
@quiet
def reach(
    scene: Path, folder: Path, points: int, accuracy: float, pictures: bool, opened: bool
) -> None:
    """Map the largest pressure that the array of SCENE can produce on the skin.

    The command writes reach.csv and the page reach.html to the folder given by --out. The
    pressure at each point of the skin is produced by all transducers at full scale and in phase at
    this point, and includes scattering by the bodies. No drive produces more pressure there.
    """
    with progress(f"reading {scene.name}") as report_step:
        result = at.reach(setup_for(folder, scene), points, accuracy, report_step)
        written = [folder / "reach.csv"]
        result.save(written[0])
        if pictures:
            from airtact.reports.reach_page import write_reach_page

            report_step("drawing the page")
            written.append(folder / "reach.html")
            write_reach_page(written[1], result)
        else:
            (folder / "reach.html").unlink(missing_ok=True)  # left from an older run
    table = plain_table("part", "points", "weakest", "strongest", "x", "y", "z")
    table.title = f"Largest pressure at {len(result.bounds):,} points of the skin"
    table.caption = "x, y and z are the coordinates of the strongest point of each part."
    for name, weakest, strongest in result.extremes:
        table.add_row(
            name,
            str(result.places.count(name)),
            f"{1e-3 * result.bounds[weakest]:.2f} kPa",
            f"{1e-3 * result.bounds[strongest]:.2f} kPa",
            *(f"{1e3 * number:z.1f} mm" for number in result.points[strongest]),
        )
    show(
        table,
        lines=[f"{'Page' if pictures else 'Table'}: {written[-1]}"],
        record={
            "points": result.table(),
            "unknowns": result.report.nodes,
            "files": {file.name: str(file) for file in written},
        },
    )
    if opened:
        open_page(written[-1])
