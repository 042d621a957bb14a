"""Surfaces from STL, PLY, OBJ and GLB files, read by trimesh within size limits."""

from pathlib import Path

import numpy as np

from airtact.errors import InvalidInput, about, counted, fixed, of_kind, positive
from airtact.files.meshes import read_mesh
from airtact.geometry.checks import check_not_crossed
from airtact.geometry.mesh.gridded import united_parts, without_details
from airtact.geometry.mesh.repair import repaired
from airtact.geometry.mesh.triangles import SHARP_DEGREES
from airtact.geometry.mesh_shape import MeshShape, QuadraticMesh
from airtact.geometry.pose import Pose
from airtact.geometry.surface import Surface
from airtact.timing import Progress, no_progress


def load_surface(
    path: str | Path,
    scale: float | None = None,
    largest_hole: float = 2e-3,
    sharp_degrees: float = SHARP_DEGREES,
    *,
    union: bool = False,
    smallest: float | None = None,
    progress: Progress | None = None,
) -> Surface:
    """Read a closed surface from a file, and repair it if it is damaged.

    If the file contains a scene graph, its nodes are placed by their transforms and joined.
    Vertices at the same position are merged, even if their textures or normals differ. Materials
    and images are not read. The attribute ``repairs`` of the surface lists the repairs (see
    ``airtact.geometry.mesh.repair.repaired``). A file may have up to 100 MB and 250,000 triangles;
    reading it then takes about 10 s and 1 GB of memory.

    Parameters
    ----------
    path : an STL, PLY, OBJ or GLB file.
    scale : metres per unit of the file, above 0, such as 1e-3 for a file in millimetres; by default
        1. A body wider than 0.5 m needs an explicit ``scale=1.0``.
    largest_hole : width of the widest hole that is filled [m], 0 to 0.1; 2 mm by default, 0 fills
        none. Wider holes raise an error.
    sharp_degrees : angle by which the surface turns at an edge, above which the edge remains sharp
        [degrees]; 75 by default. The surface is smooth across all other edges.
    union : whether to replace overlapping parts, such as those of a CAD export, with a single
        surface around all of them. This surface is computed on a grid with a spacing of 1/256 of
        the body's length. Edges are rounded on the scale of the grid, but edges that turn by more
        than 30 degrees are still treated as sharp.
    smallest : width below which bores and gaps are filled, and walls and ribs are removed [m]; at
        least 1/64 of the body's length. The new surface deviates by at most about half of this
        width and has as few triangles as possible. Edges that turn by more than 25 degrees stay
        sharp. ``repairs`` states this deviation, and the volumes of the original and of the new
        surface. This option includes the effect of ``union``.
    progress : function that is called with a description of each step when the step begins.

    Returns
    -------
    The closed ``Surface`` in the frame of the file, scaled to metres, with outward normals.

    Raises
    ------
    InvalidInput
        If the file is missing, unreadable, too large or without triangles, if the surface has
        self-intersections or damage that cannot be repaired, if a width of over 0.5 m suggests
        another unit, if the scaled body is over 2 m or under 0.5 mm wide, or if a parameter is
        outside its range.
    """
    of_kind(path, str | Path, "the path of a surface", "the name of a file")
    path = Path(path)
    unit = 1.0 if scale is None else positive(scale, "scale", "m per unit of the file")
    report_step = progress or no_progress
    report_step(f"reading {path.name}")
    vertices, triangles = read_mesh(path)
    with about(path.name):
        if scale is None:
            _check_unit(float(np.ptp(vertices, axis=0).max()))
        report_step(f"repairing {counted(len(triangles), 'triangle', 'triangles')}")
        with np.errstate(over="ignore"):  # infinite vertices are rejected by the repair
            scaled = vertices * unit
        united = ()
        if smallest is not None:
            smallest = positive(smallest, "smallest", "m")
            report_step("removing details")
            (scaled, triangles), note = without_details(scaled, triangles, smallest)
            united = (note,)
            # Its large triangles meet at larger angles on round parts than on true edges.
            sharp_degrees = min(sharp_degrees, 25.0)
        elif union:
            scaled, triangles, note = united_parts(scaled, triangles)
            united = (note,)
            # The grid cuts an edge off by chamfers of about 45°, which must not be curved.
            sharp_degrees = min(sharp_degrees, 30.0)
        sound = repaired(scaled, triangles, largest_hole)
        report_step("curving the surface")
        mesh = QuadraticMesh(fixed(sound.vertices), sound.triangles, sharp_degrees=sharp_degrees)
        surface = Surface(
            mesh.vertices,
            mesh.triangles,
            sharp_degrees=sharp_degrees,
            repairs=(*united, *sound.notes),
            _known_shape=MeshShape(mesh, Pose.identity()),
        )
        report_step("checking for self-intersections")
        check_not_crossed(surface)
        return surface


def _check_unit(extent: float) -> None:
    if not 0.5 < extent < np.inf:
        return
    units = {"millimetres": 1e-3, "centimetres": 1e-2, "inches": 0.0254}
    sizes = {name: 1e3 * unit * extent for name, unit in units.items()}
    listed = ", ".join(f"{size:.3g} mm in {name}" for name, size in sizes.items())
    # The body is probably a finger, a hand or a board.
    likely = [f"{units[name]:g} for {name}" for name, size in sizes.items() if 5 <= size <= 300]
    advice = f"such as {' or '.join(likely)}, " if likely else ""
    raise InvalidInput(
        f"the body is {extent:.3g} wide in the units of the file: {listed}. Set scale "
        f"(--scale), {advice}or 1.0 if it really is in metres.",
        code="not_in_metres",
    )
