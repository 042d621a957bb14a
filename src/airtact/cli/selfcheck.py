"""``airtact selfcheck``: measure the errors of the solver on this machine."""

import click

from airtact.cli.console import facts_table, plain_table, progress, show
from airtact.cli.options import as_json, quiet


@click.command(
    short_help="Compare solves on this machine with known fields.",
    epilog="Example: airtact selfcheck",
)
@as_json
@quiet
def selfcheck() -> None:
    """Solve for the scattering by one and by two spheres, and compare with reference pressures.

    This takes about 10 s. The exit code is 1 if an error exceeds 1 %.
    """
    with progress("starting") as report_step:
        from airtact.evaluation.self_check import self_check

        checked = self_check(report_step)
    threads = f"{checked.threads} {'thread' if checked.threads == 1 else 'threads'}"
    table = plain_table("field", "error", "reference", "error of the reference")
    for field in checked.fields:
        table.add_row(
            field.name,
            f"{100 * field.error:.2f} %",
            field.truth,
            f"{100 * field.reference_error:.1g} %",
        )
    show(
        facts_table(
            [
                ("compiled loops", f"{checked.instructions}, {threads}"),
                ("requested error", f"{100 * checked.asked:g} %"),
            ]
        ),
        table,
        warnings=[
            f"{field.name}: the error is {100 * field.error:.2g} %, above the limit of "
            f"{100 * checked.asked:g} %. Do not trust solutions on this machine. Reinstall "
            "airtact, and report the instruction set if that does not help."
            for field in checked.failed
        ],
        record={
            "instructions": checked.instructions,
            "threads": checked.threads,
            "asked": checked.asked,
            "fields": [
                {
                    "name": field.name,
                    "truth": field.truth,
                    "error": field.error,
                    "own": field.reference_error,
                }
                for field in checked.fields
            ],
        },
    )
    if checked.failed:
        click.get_current_context().exit(1)
