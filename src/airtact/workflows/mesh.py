"""From a surface file to curved panels, their file, their picture and their quality. Prints nothing."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from airtact.acoustics.medium import air
from airtact.acoustics.solvers.bem.solver import BoundaryElement
from airtact.checks import positive
from airtact.errors import InvalidInput, about
from airtact.files.atomic import writable_folder
from airtact.geometry.checks import check_surface
from airtact.geometry.files import load_surface
from airtact.geometry.mesh.quadratic_triangles import (
    enclosed_volume,
    longest_edges,
    panel_areas,
    smallest_angles,
    with_middles,
)
from airtact.geometry.mesh.topology import cone_volumes
from airtact.geometry.panels import Panels
from airtact.geometry.surface import Surface
from airtact.reports.body_figure import draw_panels
from airtact.reports.page import write_picture
from airtact.setup.panel_files import check_ending, write_panels
from airtact.timing import Progress, no_progress

WAVELENGTH = air(celsius=20.0).wavelength(40e3)
"""Of the sound that panels are made for unless their edge is given [m]."""

FAR = 1.0 / 20.0
"""Distance over the wavelength from which panels lie too far from the triangles given."""

MOST_PANELS = 300_000
"""More are rejected: they take minutes to make, and no solver takes a tenth of them."""


@dataclass(frozen=True, eq=False)
class Meshed:
    """Panels that were made and written.

    Attributes
    ----------
    edge : of the equilateral triangle as large as the panels wanted [m].
    open_edges : edges of flat triangles that have no neighbour in the file.
    """

    surface: Surface
    edge: float
    panels: Panels
    file: Path
    picture: Path
    open_edges: int

    @property
    def size(self) -> tuple[float, float]:
        """Area of the panels [m²], and the volume inside them [m³]."""
        triangles = self.panels.quadratic_triangles
        return float(panel_areas(triangles).sum()), enclosed_volume(triangles)

    @property
    def given_size(self) -> tuple[float, float]:
        """Area of the triangles given [m²], and the volume inside them [m³]."""
        corners = self.surface.corners
        return float(panel_areas(with_middles(corners)).sum()), float(cone_volumes(corners).sum())

    @property
    def angles(self) -> tuple[float, float]:
        """Smallest angle of the worst panel and of the first percentile [degrees]."""
        angles = smallest_angles(self.panels.quadratic_triangles)
        return float(angles.min()), float(np.percentile(angles, 1))

    @property
    def longest_edge(self) -> float:
        """Longest edge of a panel, from corner to corner [m]."""
        return float(longest_edges(self.panels.quadratic_triangles).max())

    @property
    def warning(self) -> str | None:
        """Warning that panels lie far from the triangles given, or None."""
        farthest = float(self.panels.farthest.max())
        if farthest <= FAR * WAVELENGTH:
            return None
        return (
            f"the panels lie up to {1e3 * farthest:.2g} mm off the triangles given, more than 1/20 of the wavelength "
            f"of {1e3 * WAVELENGTH:.3g} mm: these are coarse for a curved surface; give smaller triangles, or "
            "--sharp 0 if it is faceted."
        )


def usual_edge() -> float:
    """Edge of the panels that a solve of 1 % takes at 40 kHz in air of 20 °C [m].

    >>> f"{1e3 * usual_edge():.2f} mm"
    '5.49 mm'
    """
    return WAVELENGTH * math.sqrt(
        6.0 / BoundaryElement(accuracy=0.01).nodes_per_square_wavelength * 4.0 / math.sqrt(3)
    )


def mesh(
    path: Path,
    file: Path,
    edge: float | None = None,
    report_step: Progress = no_progress,
    **settings: float,
) -> Meshed:
    """Read a surface, cover it with curved panels and write them with a picture of the same name beside them.

    The panels are as large as the equilateral triangle of ``edge`` [m], ``usual_edge`` unless
    given; ``settings`` are those of ``load_surface``.

    Raises
    ------
    InvalidInput
        The surface or a number is at fault, or the panels cannot be written there.
    """
    check_ending(file)
    if path.resolve() == file.resolve():
        raise InvalidInput(
            f"the panels would overwrite {path.name}, the 1 file that they are made from.",
            code="would_overwrite",
        )
    surface = load_surface(path, **settings, progress=report_step)
    with about(path.name):
        check_surface(surface)
    edge = usual_edge() if edge is None else _checked_edge(edge, surface)
    writable_folder(file.parent)
    report_step(f"making panels of {1e3 * edge:.3g} mm")
    panels = surface.panelled(edge)
    report_step(f"writing {file.name}")
    open_edges = write_panels(file, panels)
    picture = file.with_suffix(".png")
    report_step(f"drawing {picture.name}")
    write_picture(picture, draw_panels(panels.quadratic_triangles))
    return Meshed(surface, edge, panels, file, picture, open_edges)


def _checked_edge(edge: float, surface: Surface) -> float:
    edge, extent = positive(edge, "edge", "m"), surface.extent
    if edge > extent:
        raise InvalidInput(
            f"edge is {edge:g} m, but the surface spans {1e3 * extent:.3g} mm: is it in millimetres? Give metres.",
            code="does_not_match",
        )
    count = surface.area / (math.sqrt(3) / 4 * edge**2)
    if count > MOST_PANELS:
        raise InvalidInput(
            f"edge is {edge:g} m, which makes {count:.2g} panels of this surface, more than {MOST_PANELS:g}; give a "
            "larger one.",
            code="too_many",
        )
    return edge
