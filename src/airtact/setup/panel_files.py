"""Panels as files: curved ones for ParaView, flat triangles for everything else."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Real

from airtact.checks import within
from airtact.errors import InvalidInput
from airtact.files.atomic import whole_file
from airtact.geometry.mesh.arrays import QuadraticTriangles
from airtact.geometry.mesh.topology import edge_twins
from airtact.geometry.panels import Panels
from airtact.setup.flat_triangles import flat_triangles
from airtact.setup.vtkhdf import write_panels_vtkhdf

CURVED = ".vtkhdf"
FLAT = (".stl", ".ply", ".glb")
"""File name endings that are written, in metres."""

EDGE = 4e-3
"""Edge of the triangles of a hand's skin unless given [m]."""

FINEST, COARSEST = 0.8e-3, 20e-3
"""Edges that are taken [m]."""


def checked_edge(edge: float) -> float:
    """Return the edge of the triangles of a hand's skin [m] if it is 0.8 to 20 mm."""
    return within(edge, FINEST, COARSEST, "edge", "m", "is it in millimetres? Give metres.")


def check_ending(path: Path) -> None:
    """Check that the ending of a file's name is a format that is written."""
    if path.suffix.lower() not in (CURVED, *FLAT):
        raise InvalidInput(
            f"{path.name} ends in {path.suffix!r}, but panels are written to {', '.join((CURVED, *FLAT))}.",
            code="unknown_format",
        )


def write_panels(path: Path, panels: Panels) -> int:
    """Write the panels of bodies as ``write_triangles`` does; a .vtkhdf also holds body and deviation of each."""
    return write_triangles(
        path, panels.quadratic_triangles, {"deviation": panels.deviation, "body": panels.body}
    )


def write_triangles(
    path: Path,
    quadratic_triangles: QuadraticTriangles,
    cells: Mapping[str, Real[np.ndarray, "panels"]] | None = None,
) -> int:
    """Write quadratic triangles [m] in the format of the file's ending; .vtkhdf also holds further numbers by name.

    Return how many edges of the flat triangles have no neighbour; 0 for curved panels, which need
    not meet.
    """
    check_ending(path)
    if path.suffix.lower() == CURVED:
        write_panels_vtkhdf(path, quadratic_triangles, cells or {})
        return 0
    import trimesh  # takes as long to import as all the rest of airtact

    vertices, triangles = flat_triangles(quadratic_triangles)
    content = trimesh.Trimesh(vertices, triangles, process=False).export(
        file_type=path.suffix.lower()[1:]
    )
    with whole_file(path) as partial:
        partial.write_bytes(content if isinstance(content, bytes) else str(content).encode())
    return int((edge_twins(triangles) < 0).sum())
