"""``airtact mesh``: curved panels on a surface."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

from airtact.cli.console import plain_table, progress, repairs_table, sharp_edges_in_words, show
from airtact.cli.options import FILE, INPUT, given, quiet, surface_settings

if TYPE_CHECKING:
    from rich.table import Table

    from airtact.workflows.mesh import Meshed


@click.command(
    short_help="Cover a surface with curved panels and report how good they are.",
    epilog="Example: airtact mesh generic-hand-right.glb --out out.vtkhdf",
)
@click.argument("surface", type=INPUT)
@click.option(
    "--edge", type=float, help="Edge of the panels in metres; by default what 1 % takes at 40 kHz."
)
@click.option("--out", "file", required=True, type=FILE, help="File for the panels.")
@surface_settings
@quiet
def mesh(surface: Path, edge: float | None, file: Path, **settings: float | None) -> None:
    """Cover SURFACE (STL, PLY, OBJ, GLB) with curved panels, as the solvers do, and report how good they are.

    The panels are written to a .vtkhdf file for ParaView, or as flat triangles in metres to .stl,
    .ply or .glb; a picture of them, .png, stands beside it.
    """
    with progress() as report_step:
        from airtact.workflows import mesh as workflow

        meshed = workflow.mesh(surface, file, edge, report_step, **given(**settings))
    lines = [f"Panels: {meshed.file}", f"Picture: {meshed.picture}"]
    show(*_tables(meshed), warnings=[meshed.warning] if meshed.warning else [], lines=lines)


def _tables(meshed: "Meshed") -> "Iterator[Table]":
    """Tabulate panels beside the triangles that they were made from."""
    sizes = plain_table("", "given", "panels")
    given, made = meshed.surface.triangles, meshed.panels.quadratic_triangles
    sizes.add_row("triangles, panels", f"{len(given):,}", f"{len(made):,}")
    (area, volume), (given_area, given_volume) = meshed.size, meshed.given_size
    sizes.add_row("area", f"{1e4 * given_area:.4g} cm²", f"{1e4 * area:.4g} cm²")
    sizes.add_row("volume", f"{1e6 * given_volume:.4g} cm³", f"{1e6 * volume:.4g} cm³")
    yield sizes
    worst, first = meshed.angles
    facts, panels = plain_table(), meshed.panels
    facts.add_row("smallest angle", f"{worst:.1f}°, 1 of 100 panels below {first:.1f}°")
    facts.add_row(
        "edge",
        f"{1e3 * meshed.edge:.3g} mm asked, the longest has {1e3 * meshed.longest_edge:.3g} mm",
    )
    farthest, mean = _gap(panels.farthest.max()), _gap(panels.mean_distance.max())
    facts.add_row("off the triangles given", f"{farthest} at most, {mean} in the mean")
    facts.add_row("off the curved surface", f"{_gap(panels.deviation.max())} at most")
    facts.add_row("sharp edges", sharp_edges_in_words(meshed.surface))
    if meshed.open_edges:
        facts.add_row(
            "open edges",
            f"{meshed.open_edges} in {meshed.file.name}: its triangles are not quite closed",
        )
    yield facts
    yield repairs_table(meshed.surface)


def _gap(distance: float) -> str:
    return f"{1e3 * distance:.2g} mm" if distance >= 1e-7 else "under 0.1 µm"
