"""Surfaces from files: STL, PLY, OBJ and GLB, read by trimesh after what they hold was counted."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float64, Int64

from airtact.checks import counted, fixed, of_kind, positive
from airtact.errors import about
from airtact.files.mesh_reading import arrays_of, mesh_arrays, node_arrays, vertex_arrays
from airtact.geometry.checks import check_not_crossed
from airtact.geometry.mesh.curving import SHARP_DEGREES
from airtact.geometry.mesh.repair.pipeline import repaired
from airtact.geometry.mesh_shape import MeshShape
from airtact.geometry.pose import Pose
from airtact.geometry.quadratic_mesh import QuadraticMesh
from airtact.geometry.surface import Surface
from airtact.timing import Progress, no_progress


def load_surface(
    path: str | Path,
    scale: float = 1.0,
    largest_hole: float = 2e-3,
    sharp_degrees: float = SHARP_DEGREES,
    *,
    progress: Progress | None = None,
) -> Surface:
    """Read a closed surface from a file, and repair what is damaged.

    The nodes of a scene graph are put where their transforms place them and joined; vertices at the
    same position are merged, whatever their texture or normal. ``repairs`` of the surface lists
    what was repaired, a sentence each; see ``airtact.geometry.mesh.repair.pipeline.repaired`` for
    what can be. Files of up to 100 MB and 250,000 triangles are read, which takes up to some 10 s
    and 1 GB. Files that are not plain (over 4 MB, or glTF with many nodes, extensions or other
    files, or PLY with other elements; never an STL in binary) are read by a process of its own,
    which may take 60 s of processor time and 4 GB; on Windows by this one. What a file names is
    read from its own folder only; materials and pictures never are.

    Parameters
    ----------
    path : an STL, PLY, OBJ or GLB file.
    scale : metres per unit of the file: 1e-3 for a file in millimetres.
    largest_hole : widest hole that is filled [m], 0 for none.
    sharp_degrees : edges whose triangles turn by more than this stay sharp; the rest of the surface
        is curved.
    progress : called with the words of each step as it begins.

    Raises
    ------
    InvalidInput
        When there is no such file, it cannot be read, is beyond those limits, holds no triangles, or the surface
        crosses itself or is at fault in another way that cannot be repaired.
    """
    of_kind(path, str | Path, "the path of a surface", "the name of a file")
    path, scale = Path(path), positive(scale, "scale", "m per unit of the file")
    report_step = progress or no_progress
    report_step(f"reading {path.name}")
    vertices, triangles = bare_mesh(path)
    with about(path.name):
        report_step(f"repairing {counted(len(triangles), 'triangle', 'triangles')}")
        with np.errstate(over="ignore"):  # infinite vertices are named below
            scaled = vertices * scale
        whole = repaired(scaled, triangles, largest_hole)
        report_step("curving the surface")
        mesh = QuadraticMesh(fixed(whole.vertices), whole.triangles, sharp_degrees=sharp_degrees)
        shape = MeshShape(mesh, Pose.identity())
        surface = Surface(
            mesh.vertices,
            mesh.triangles,
            None,
            None,
            sharp_degrees,
            whole.notes,
            _known_shape=shape,
        )
        report_step("looking for crossings")
        check_not_crossed(surface)
        return surface


def node_positions(path: Path) -> Mapping[str, Float64[np.ndarray, "3"]]:
    """Read where the named nodes of a file are, such as the joints of a rig: (3,) each, in units of the file.

    Raises
    ------
    InvalidInput
        When there is no such file, or it cannot be read.
    """
    found = arrays_of(path, node_arrays)
    return {
        str(name): fixed(position)
        for name, position in zip(found["names"], found["positions"], strict=True)
    }


def bare_mesh(
    path: Path,
) -> tuple[Float64[np.ndarray, "vertices 3"], Int64[np.ndarray, "triangles 3"]]:
    """Read the vertices and triangles of a file as they are, in units of the file.

    Raises
    ------
    InvalidInput
        When there is no such file, it cannot be read, is beyond the limits, or holds no triangles.
    """
    found = arrays_of(path, mesh_arrays)
    return found["vertices"], found["triangles"]


def bare_vertices(path: Path) -> Float64[np.ndarray, "vertices 3"]:
    """Read the vertices of a file or the points of a cloud in PLY, in units of the file; errors as of ``bare_mesh``."""
    return arrays_of(path, vertex_arrays)["vertices"]
