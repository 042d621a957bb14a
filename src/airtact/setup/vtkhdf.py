"""Fields, bodies and panels for ParaView: the VTKHDF format, version 2.2.

See https://docs.vtk.org/en/latest/vtk_file_formats/vtkhdf_file_format.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Complex, Real

from airtact.errors import InvalidInput
from airtact.evaluation.windows import Box
from airtact.files.atomic import whole_file
from airtact.geometry.mesh.arrays import QuadraticTriangles
from airtact.geometry.mesh.quadratic_triangles import panel_areas, smallest_angles
from airtact.geometry.surface import Surface

if TYPE_CHECKING:
    import h5py

# VTK's number for a triangle of six nodes: the corners, then the middles of edges 01, 12, 20
QUADRATIC_TRIANGLE = 22


def write_field(
    path: Path, box: Box, pressure: Complex[np.ndarray, "points"], bodies: Sequence[Surface]
) -> None:
    """Write the pressure [Pa] at a box's points as image data, and the bodies as polygons.

    The data are pressure_real and pressure_imag, NaN where there is no field; cell data ``body``
    numbers the bodies.
    """
    import h5py

    if len(pressure) != np.prod(box.counts):
        raise InvalidInput(
            f"{len(pressure)} pressures do not fit a box of {np.prod(box.counts)} points.",
            code="sizes_differ",
        )
    with whole_file(path) as partial, h5py.File(partial, "w") as file:
        root = _group(file, "VTKHDF", "PartitionedDataSetCollection")
        _write_image(_block(root, "field", 0, "ImageData"), box, pressure)
        names = ["field"]
        if bodies:
            _write_polygons(_block(root, "bodies", 1, "PolyData"), bodies)
            names.append("bodies")
        assembly = root.create_group("Assembly", track_order=True)
        # ParaView shows the tree of the assembly; its leaves are links to the blocks.
        for name in names:
            assembly.create_group(name, track_order=True)[name] = h5py.SoftLink(f"/VTKHDF/{name}")


def write_panels_vtkhdf(
    path: Path,
    quadratic_triangles: QuadraticTriangles,
    cells: Mapping[str, Real[np.ndarray, "panels"]],
) -> None:
    """Write curved panels as an unstructured grid of quadratic triangles.

    Each keeps its own six points, because neighbours need not share them. Cell data:
    ``smallest_angle`` [degrees], ``area`` [m²], and what is given.
    """
    import h5py

    count = len(quadratic_triangles)
    numbers = {
        "smallest_angle": smallest_angles(quadratic_triangles),
        "area": panel_areas(quadratic_triangles),
    }
    with whole_file(path) as partial, h5py.File(partial, "w") as file:
        root = _group(file, "VTKHDF", "UnstructuredGrid")
        for name, number in (
            ("Points", 6 * count),
            ("Cells", count),
            ("ConnectivityIds", 6 * count),
        ):
            root.create_dataset(f"NumberOf{name}", data=np.array([number]))
        root.create_dataset("Points", data=quadratic_triangles.reshape(-1, 3))
        root.create_dataset("Connectivity", data=np.arange(6 * count))
        root.create_dataset("Offsets", data=6 * np.arange(count + 1))
        root.create_dataset("Types", data=np.full(count, QUADRATIC_TRIANGLE, dtype=np.uint8))
        data = root.create_group("CellData")
        for name, values in (numbers | dict(cells)).items():
            data.create_dataset(name, data=values)


def _group(parent: "h5py.Group", name: str, kind: str) -> "h5py.Group":
    group = parent.create_group(name, track_order=True)
    group.attrs["Version"] = np.array([2, 2])
    # The reader wants a fixed-length ASCII string; h5py writes a Python str as variable-length
    # UTF-8.
    group.attrs["Type"] = np.bytes_(kind)
    return group


def _block(root: "h5py.Group", name: str, index: int, kind: str) -> "h5py.Group":
    group = _group(root, name, kind)
    group.attrs["Index"] = index
    return group


def _write_image(group: "h5py.Group", box: Box, pressure: Complex[np.ndarray, "points"]) -> None:
    # The format counts along z first, and an extent includes both ends.
    across, along, deep = box.counts
    group.attrs["WholeExtent"] = np.array([0, across - 1, 0, along - 1, 0, deep - 1])
    group.attrs["Origin"] = box.origin
    group.attrs["Spacing"] = np.full(3, box.step)
    group.attrs["Direction"] = np.eye(3).ravel()
    data = group.create_group("PointData")
    for name, part in (("pressure_real", np.real(pressure)), ("pressure_imag", np.imag(pressure))):
        data.create_dataset(
            name, data=part.reshape(deep, along, across), compression="gzip", compression_opts=1
        )


def _write_polygons(group: "h5py.Group", bodies: Sequence[Surface]) -> None:
    starts = np.cumsum([0] + [len(body.vertices) for body in bodies])
    vertices = np.concatenate([body.vertices for body in bodies])
    triangles = np.concatenate(
        [body.triangles + start for body, start in zip(bodies, starts, strict=False)]
    )
    numbers = np.concatenate(
        [np.full(len(body.triangles), index) for index, body in enumerate(bodies)]
    )
    group.create_dataset("NumberOfPoints", data=np.array([len(vertices)]))
    group.create_dataset("Points", data=vertices)
    # The reader asks for all four kinds of cells, empty ones too.
    for name in ("Vertices", "Lines", "Polygons", "Strips"):
        cells = triangles if name == "Polygons" else np.empty((0, 3), dtype=np.int64)
        part = group.create_group(name)
        part.create_dataset("NumberOfCells", data=np.array([len(cells)]))
        part.create_dataset("NumberOfConnectivityIds", data=np.array([cells.size]))
        part.create_dataset("Offsets", data=3 * np.arange(len(cells) + 1))
        part.create_dataset("Connectivity", data=cells.ravel().astype(np.int64))
    group.create_group("CellData").create_dataset("body", data=numbers)
