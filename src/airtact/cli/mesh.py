"""``airtact mesh``: cover a surface with curved panels."""

import math
from pathlib import Path
from typing import Any

import click

import airtact as at
from airtact.cli.console import (
    facts_table,
    plain_table,
    progress,
    repairs_table,
    sharp_edges_in_words,
    show,
)
from airtact.cli.options import FILE, INPUT, given, quiet, surface_settings


@click.command(
    short_help="Cover a surface with curved panels and report their quality.",
    epilog="Example: airtact mesh generic-hand-right.glb --out out.vtkhdf",
)
@click.argument("surface", type=INPUT)
@click.option(
    "--edge",
    type=float,
    help="Edge length of the panels in metres; by default the length for 1 % accuracy at 40 kHz.",
)
@click.option(
    "--out", "file", required=True, type=FILE, help="File to which the panels are written."
)
@surface_settings
@quiet
def mesh(surface: Path, edge: float | None, file: Path, **settings: Any) -> None:
    """Cover SURFACE (STL, PLY, OBJ, GLB) with curved panels and report their quality.

    The panels are written to a .vtkhdf file for ParaView, or as flat triangles in metres to a .stl,
    .ply or .glb file. A picture (.png) is written next to it.
    """
    with progress() as report_step:
        import numpy as np

        from airtact.errors import about
        from airtact.files.atomic import writable_folder
        from airtact.geometry.checks import check_surface
        from airtact.geometry.mesh.triangles import (
            cone_volumes,
            enclosed_volume,
            longest_edges,
            panel_areas,
            smallest_angles,
            with_middles,
        )
        from airtact.reports.body_figure import draw_panels
        from airtact.reports.page import write_picture
        from airtact.setup.exports import check_output, write_triangles

        check_output(file, surface)
        loaded = at.load_surface(surface, **given(**settings), progress=report_step)
        with about(surface.name):
            check_surface(loaded)
        wavelength = at.air(celsius=20.0).wavelength(40e3)
        edge = usual_edge(wavelength) if edge is None else _checked_edge(edge, loaded)
        writable_folder(file.parent)
        report_step(f"meshing the surface with panels of {1e3 * edge:.3g} mm")
        panels = loaded.panelled(edge)
        report_step(f"writing {file.name}")
        triangles = panels.quadratic_triangles
        open_edges = write_triangles(
            file, triangles, {"deviation": panels.deviation, "body": panels.body}
        )
        picture = file.with_suffix(".png")
        report_step(f"drawing {picture.name}")
        write_picture(picture, draw_panels(triangles))

    # Turn flat triangles into quadratic ones, with nodes at the midpoints of the edges.
    corners = loaded.corners
    sizes = plain_table("", "given", "panels")
    sizes.add_row("triangles, panels", f"{len(loaded.triangles):,}", f"{len(triangles):,}")
    sizes.add_row(
        "area",
        f"{1e4 * panel_areas(with_middles(corners)).sum():.4g} cm²",
        f"{1e4 * panel_areas(triangles).sum():.4g} cm²",
    )
    sizes.add_row(
        "volume",
        f"{1e6 * cone_volumes(corners).sum():.4g} cm³",
        f"{1e6 * enclosed_volume(triangles):.4g} cm³",
    )
    angles = smallest_angles(triangles)
    longest = 1e3 * longest_edges(triangles).max()
    # Larger deviations than λ/20 change the phase of the reflected sound.
    farthest = float(panels.farthest.max())
    facts = [
        (
            "smallest angle",
            f"{angles.min():.1f}°; 1 % of the panels are below {np.percentile(angles, 1):.1f}°",
        ),
        ("edge", f"{1e3 * edge:.3g} mm requested, longest {longest:.3g} mm"),
        (
            "distance from the triangles",
            f"{_gap(farthest)} at most, {_gap(panels.mean_distance.max())} on average",
        ),
        ("distance from the curved surface", f"{_gap(panels.deviation.max())} at most"),
        ("sharp edges", sharp_edges_in_words(loaded)),
    ]
    if open_edges:
        facts.append(("open edges", f"{open_edges}: the triangles in {file.name} are not closed"))
    warnings = []
    if farthest > wavelength / 20.0:
        warnings.append(
            f"the panels lie up to {1e3 * farthest:.2g} mm from the triangles, which is more than "
            f"1/20 of the wavelength of {1e3 * wavelength:.3g} mm. The triangles are too coarse "
            "for a curved surface: use smaller ones, or --sharp 0 if the body is faceted."
        )
    show(
        sizes,
        facts_table(facts),
        repairs_table(loaded),
        warnings=warnings,
        lines=[f"Panels: {file}", f"Picture: {picture}"],
    )


def usual_edge(wavelength: float) -> float:
    """Return the edge length [m] of panels for a solve with an error of 1 %.

    >>> import airtact as at
    >>> f"{1e3 * usual_edge(at.air(celsius=20.0).wavelength(40e3)):.2f} mm"
    '5.49 mm'
    """
    # A panel has 6 nodes, and an equilateral triangle with edge length a has the area √3/4 a².
    density = at.BoundaryElement(accuracy=0.01).nodes_per_square_wavelength
    return wavelength * math.sqrt(6.0 / density * 4.0 / math.sqrt(3))


def _checked_edge(edge: float, surface: "at.Surface") -> float:
    from airtact.errors import positive

    edge = positive(edge, "edge", "m")
    if edge > surface.extent:
        raise at.InvalidInput(
            f"edge is {edge:g} m, but the surface only spans {1e3 * surface.extent:.3g} mm: use a "
            "smaller edge, in metres.",
            code="not_in_metres",
        )
    count = surface.area / (math.sqrt(3) / 4 * edge**2)
    # More panels would take minutes to compute, and solvers cannot use even a tenth of them.
    if count > 300_000:
        raise at.InvalidInput(
            f"edge is {edge:g} m, which would create {count:.2g} panels, but at most 300,000 "
            "are allowed: use a larger edge.",
            code="too_many",
        )
    return edge


def _gap(distance: float) -> str:
    return f"{1e3 * distance:.2g} mm" if distance >= 1e-7 else "under 0.1 µm"
