"""``airtact compare``: compare drives from all methods or from other programs for a scene."""

from pathlib import Path

import click
from rich.table import Table

import airtact as at
from airtact.cli.console import open_page, plain_table, progress, show
from airtact.cli.options import (
    INPUT,
    as_json,
    open_result,
    pictures,
    quiet,
    results,
    scene,
    setup_for,
    store,
)


@click.command(
    short_help="Compute the drive of a scene by all methods and compare them.",
    epilog="Example: airtact compare pinch --out out/methods",
)
@scene
@click.option(
    "--drive",
    "files",
    type=INPUT,
    multiple=True,
    metavar="FILE",
    help="Compare this drive from any program instead of the methods; can be repeated.",
)
@click.option("--board", metavar="NAME", help="Kind of board for a .bin file.")
@results
@store
@pictures
@open_result
@as_json
@quiet
def compare(
    scene: Path,
    files: tuple[Path, ...],
    board: str | None,
    folder: Path,
    store: Path | None,
    pictures: bool,
    opened: bool,
) -> None:
    """Compute the drive of SCENE by every method; write methods.csv, methods.html, drives/*.h5.

    The files are written to the folder given by --out. All drives are computed from the same
    transfer matrix and verified by a second solve.

    With --drive, evaluate a drive from another program. It is compared with the best drive, and
    with a corrected drive: the most similar drive whose weakest focus reaches 95 % of the upper
    bound on its pressure. Supported files: .h5; .csv or .txt with phases; .csv and .holo from
    AcousTools; .xml from Ultraino; .npy; .bin with messages to boards.
    """
    with progress(f"reading {scene.name}") as report_step:
        from airtact.emission.frame_file import drive_for

        setup = setup_for(folder, scene)
        drives = {file.name: drive_for(setup.array, file, board) for file in files}
        result = at.compare(setup, drives=drives, store=store, progress=report_step)
        written = [result.save(folder)]
        if pictures:
            written += at.write_report(result, folder, progress=report_step)
        else:
            (folder / "methods.html").unlink(missing_ok=True)  # left from an older run
    show(
        _table(result),
        warnings=result.warnings,
        lines=[f"{'Report' if pictures else 'Methods'}: {written[-1]}"],
        record={
            "foci": list(result.setup.foci),
            "default": result.default,
            "methods": [
                {
                    "name": contender.name,
                    "pressures": contender.pressures.tolist(),
                    "of_the_bound": float(result.of_the_bound(contender)),
                    "seconds": contender.seconds,
                    "kept": contender.kept,
                    "suppression_level": contender.suppression_level,
                }
                for contender in result.ranked
            ],
            "bound": result.bound,
            "estimated_error": result.report.estimated_error,
            "files": {file.name: str(file) for file in written},
        },
    )
    if opened:
        open_page(written[-1])


def _table(result: "at.MethodComparison") -> Table:
    from airtact.timing import duration

    uncertain = result.contenders[0].kept is not None
    suppressed = len(result.setup.target.suppression_points) > 0
    columns = ["method", "weakest focus", "of the bound", "mean", "time"]
    if uncertain:
        columns.insert(2, "in 9 of 10 samples")
    if suppressed:
        columns.append("suppression points")
    table = plain_table(*columns)
    # The drives differ in energy, so compare shares of the bound at full scale.
    table.title = "Pressure at the foci, and fraction of the upper bound reached at full scale"
    equal = len(result.equally_good)
    if equal > 1:
        table.caption = (
            f"The first {equal} reach the same fraction of the bound, "
            f"to within {result.tolerance:.1%}."
        )
    target = result.setup.target
    for contender in result.ranked:
        row = [
            result.label(contender),
            f"{contender.pressures[target.weakest(contender.pressures)]:,.0f} Pa",
            f"{result.of_the_bound(contender):.0%}",
            f"{contender.pressures[target.weights > 0.0].mean():,.0f} Pa",
            duration(contender.seconds),
        ]
        if uncertain:
            row.insert(2, f"{contender.kept:,.0f} Pa")
        if suppressed:
            row.append(f"{contender.suppression_level:+z.1f} dB")
        table.add_row(*row)
    return table
