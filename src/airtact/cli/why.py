"""``airtact why``: explain which causes reduce the pressure at each focus of a scene."""

from pathlib import Path

import click
from rich.markup import escape

import airtact as at
from airtact.cli.console import plain_table, progress, show
from airtact.cli.options import FILE, as_json, quiet, scene, store


@click.command(
    short_help="Explain the causes of low pressure at each focus of a scene.",
    epilog="Example: airtact why pinch --page why.html",
)
@scene
@click.option(
    "--session", type=FILE, help="Session (session.h5) whose tracking errors are included."
)
@click.option("--out", "file", type=FILE, help="Table to write (.csv).")
@click.option("--page", type=FILE, help="Page to write (.html), with a waterfall for each focus.")
@store
@as_json
@quiet
def why(
    scene: Path, session: Path | None, file: Path | None, page: Path | None, store: Path | None
) -> None:
    """List the causes that reduce the pressure at each focus of SCENE, and the effect of each.

    SCENE is a scene file or the name of an example. The command computes its drive and prints a
    table with a column for each focus. The first row is the largest pressure [Pa] that the array
    can produce anywhere in open air. Each further row adds the effect of one cause, such as the
    distance of the focus, the shadow of the hand, the other foci, or rounding, and shows the
    pressure that remains and its change. The line below the table names the change to the scene
    that would most increase the pressure at the weakest focus. Scenes with traps are not supported.
    """
    with progress(f"reading {scene.name}") as report_step:
        setup = at.read_scene(scene)
        setup.check_no_traps("why")
        kept = None
        if session is not None:
            from airtact.live.session import read_session
            from airtact.live.verification import differing_tables, verify_session

            recorded = read_session(session)
            different = differing_tables(recorded, setup)
            if different:
                raise at.InvalidInput(
                    f"{session} was recorded for another scene, which differs from {scene.name} "
                    f"in: {', '.join(different)}. Use the scene of the session.",
                    code="does_not_match",
                )
            verified = verify_session(recorded, report_step=report_step)
            kept = float(sorted(verified.kept)[len(verified.kept) // 2])
        explained = at.setup.why(at.render(setup, store=store, progress=report_step), kept)
        if file is not None:
            explained.save(file)
        if page is not None:
            from airtact.reports.why_page import write_why_page

            write_why_page(page, explained, setup.title, setup.text)
    table = plain_table("after", *(escape(name) for name in explained.foci))
    table.title = "Pressure at each focus, cause by cause"
    for index, cause in enumerate(explained.causes):
        cells = (
            f"{pressure:,.0f} Pa  {explained.change_in_words(index, focus)}".rstrip()
            for focus, pressure in enumerate(cause.pressures)
        )
        table.add_row(cause.name, *cells)
    show(
        table,
        lines=[explained.advice, *(f"Written: {path}" for path in (file, page) if path)],
        record={
            "foci": list(explained.foci),
            "causes": [
                {"name": cause.name, "pressures": cause.pressures.tolist(), "remedy": cause.remedy}
                for cause in explained.causes
            ],
            "advice": explained.advice,
        },
    )
