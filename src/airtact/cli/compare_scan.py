"""``airtact compare-scan``: a measured scan beside the prediction."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from airtact.cli.console import plain_table, progress, show
from airtact.cli.options import INPUT, as_json, given, pictures, quiet, results

if TYPE_CHECKING:
    from rich.table import Table

    from airtact.workflows.compare_scan import Compared


@click.command(
    name="compare-scan",
    short_help="Compare a measured scan with the prediction for a scene.",
    epilog="Example: airtact compare-scan pinch_scan.csv pinch --out out/scan",
)
@click.argument("scan", type=INPUT)
@click.argument("scene", type=INPUT)
@results
@click.option(
    "--diameter",
    type=float,
    help="Of the microphone's face in metres; 6.35e-3, a quarter inch, by default.",
)
@click.option(
    "--axis",
    type=float,
    nargs=3,
    metavar="X Y Z",
    help="Direction of its face; 0 0 -1 by default, down.",
)
@click.option(
    "--housing",
    type=float,
    help="Length of its housing behind the face in metres; 0.05 by default.",
)
@pictures
@as_json
@quiet
def compare_scan(scan: Path, scene: Path, folder: Path, pictures: bool, **microphone: Any) -> None:
    """Predict what a microphone reads in SCENE and compare SCAN, a measured one, with it.

    SCAN is a .csv file with the columns x, y, z (metres, in the obstacles' frame), pressure (any
    unit) and, if it was measured, phase (radians). Writes overlay.csv and overlay.png.
    """
    with progress() as report_step:
        report_step("starting")
        from airtact.evaluation.microphone import Microphone
        from airtact.workflows import compare_scan as workflow

        compared = workflow.compare_scan(
            scan, scene, folder, Microphone(**given(**microphone)), report_step, pictures
        )
    warnings = [*compared.notes, *compared.overlay.warnings, *compared.report.warnings]
    written = {
        name: str(folder / name) for name in (workflow.FILES if pictures else workflow.FILES[:1])
    }
    lines = [f"Overlay: {folder / list(written)[-1]}"]
    show(
        _table(compared),
        warnings=warnings,
        lines=lines,
        record={**_record(compared), "files": written},
    )


def _record(compared: "Compared") -> dict[str, Any]:
    """List how well a scan and its prediction agree, for ``--json``."""
    found = compared.overlay
    return {
        "error": found.error,
        "positions": len(found.used),
        "compared": int(found.used.sum()),
        "scale": [found.scale.real, found.scale.imag],
        "phased": found.scan.phased,
        "estimated_error": compared.report.estimated_error,
    }


def _table(compared: "Compared") -> "Table":
    """Tabulate how well a scan and its prediction agree."""
    import numpy as np

    found, report = compared.overlay, compared.report
    facts = plain_table()
    quantity = (
        "pressures with their phases"
        if found.scan.phased
        else "magnitudes, as no phase was measured"
    )
    facts.add_row("relative error", f"{found.error:.1%}, after one scale, of {quantity}")
    facts.add_row("positions", f"{int(found.used.sum())} of {len(found.used)} compared")
    turn = f" at {np.degrees(np.angle(found.scale)):.1f}°" if found.scan.phased else ""
    facts.add_row("scale", f"{abs(found.scale):.4g} of the scan's unit for 1 Pa predicted{turn}")
    facts.add_row("predicted by", f"{report.solver}, estimated error {report.estimated_error:.2%}")
    return facts
