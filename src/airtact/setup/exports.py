"""Export of fields, bodies and panels as VTKHDF 2.2 for ParaView or as flat triangles.

See https://docs.vtk.org/en/latest/vtk_file_formats/vtkhdf_file_format.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import h5py
import numpy as np
from jaxtyping import Complex, Real

from airtact.errors import InvalidInput
from airtact.evaluation.windows import Box
from airtact.files.atomic import whole_file, whole_hdf5
from airtact.geometry.mesh.triangles import (
    QuadraticTriangles,
    Triangles,
    Vertices,
    components,
    edge_lengths,
    edge_twins,
    panel_areas,
    smallest_angles,
)
from airtact.geometry.surface import Surface

CURVED = ".vtkhdf"
# File name endings for flat triangles, whose coordinates are in metres
FLAT = (".stl", ".ply", ".glb")


def write_field(
    path: Path, box: Box, pressure: Complex[np.ndarray, "points"], bodies: Sequence[Surface]
) -> None:
    """Write the pressure [Pa] in a box as VTK image data, and the bodies as polygons.

    The point data are pressure_real and pressure_imag; both are NaN inside bodies. The cell data
    ``body`` contain the index of the body of each polygon.
    """
    with whole_hdf5(path) as file:
        root = _group(file, "VTKHDF", "PartitionedDataSetCollection")
        image = _group(root, "field", "ImageData")
        # The axes of the arrays are z, y, x, and the extent includes both ends.
        across, along, deep = box.counts
        image.attrs["Index"] = 0
        image.attrs["WholeExtent"] = np.array([0, across - 1, 0, along - 1, 0, deep - 1])
        image.attrs["Origin"] = box.origin
        image.attrs["Spacing"] = box.step
        image.attrs["Direction"] = np.eye(3).ravel()
        data = image.create_group("PointData")
        for name, part in (
            ("pressure_real", np.real(pressure)),
            ("pressure_imag", np.imag(pressure)),
        ):
            data.create_dataset(
                name, data=part.reshape(deep, along, across), compression="gzip", compression_opts=1
            )
        names = ["field"]
        if bodies:
            _write_polygons(_group(root, "bodies", "PolyData"), bodies)
            names.append("bodies")
        assembly = root.create_group("Assembly", track_order=True)
        # ParaView displays the assembly as a tree, whose leaves must be links to the blocks.
        for name in names:
            assembly.create_group(name, track_order=True)[name] = h5py.SoftLink(f"/VTKHDF/{name}")


def check_output(path: Path, *sources: Path) -> None:
    """Raise ``InvalidInput`` if a file's ending is not supported or the file is an input file."""
    if path.suffix.lower() not in (CURVED, *FLAT):
        raise InvalidInput(
            f"{path.name} ends in {path.suffix!r}, but panels can only be written to "
            f"{', '.join((CURVED, *FLAT))}.",
            code="unknown_format",
        )
    for source in sources:
        if path.resolve() == source.resolve():
            raise InvalidInput(
                f"the output would overwrite the input {source.name}: choose another file name.",
                code="would_overwrite",
            )


def write_triangles(
    path: Path,
    quadratic_triangles: QuadraticTriangles,
    cells: Mapping[str, Real[np.ndarray, "panels"]] | None = None,
) -> int:
    """Write quadratic triangles [m] in the format given by the file name's ending.

    ``cells`` contains additional values for each panel, which only a .vtkhdf file can store. The
    function returns the number of open edges of the flat triangles, which occur between panels of
    different sizes; it is 0 for curved panels.
    """
    check_output(path)
    if path.suffix.lower() == CURVED:
        _write_vtkhdf(path, quadratic_triangles, cells or {})
        return 0
    import trimesh  # imported here because the import takes as long as that of airtact

    vertices, triangles = flat_triangles(quadratic_triangles)
    content = trimesh.Trimesh(vertices, triangles, process=False).export(
        file_type=path.suffix.lower()[1:]
    )
    with whole_file(path) as partial:
        partial.write_bytes(content if isinstance(content, bytes) else str(content).encode())
    return int((edge_twins(triangles) < 0).sum())


def flat_triangles(quadratic_triangles: QuadraticTriangles) -> tuple[Vertices, Triangles]:
    """Divide each panel into four flat triangles, and merge the nodes of neighbouring panels.

    Each panel is projected onto the surface separately, so the nodes of neighbours
    differ by micrometres. Where panels of two sizes meet, the smaller ones have
    additional nodes.
    """
    from scipy.spatial import KDTree  # importing it takes 0.2 s

    nodes = quadratic_triangles.reshape(-1, 3)
    shortest = np.repeat(edge_lengths(quadratic_triangles).min(axis=1), 6)
    pairs = KDTree(nodes).query_pairs(0.1 * shortest.max(), output_type="ndarray")
    apart = np.linalg.norm(nodes[pairs[:, 0]] - nodes[pairs[:, 1]], axis=1)
    # The nodes of a single panel are half an edge apart, so they are never merged.
    pairs = pairs[apart <= 0.1 * shortest[pairs].min(axis=1)]
    vertex = components(pairs[:, 0], pairs[:, 1], len(nodes))
    vertices = np.stack([np.bincount(vertex, weights=axis) for axis in nodes.T], axis=1)
    vertices /= np.bincount(vertex)[:, None]
    corners = np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]])
    return vertices, vertex.reshape(-1, 6)[:, corners].reshape(-1, 3)


def _write_vtkhdf(
    path: Path,
    quadratic_triangles: QuadraticTriangles,
    cells: Mapping[str, Real[np.ndarray, "panels"]],
) -> None:
    """Write curved panels as an unstructured grid of quadratic triangles.

    The panels share no points. The cell data are ``smallest_angle`` [degrees], ``area`` [m²] and
    ``cells``.
    """
    count = len(quadratic_triangles)
    with whole_hdf5(path) as file:
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
        # Type 22 is a triangle with six nodes: the corners, then the midpoints of 01, 12 and 20.
        root.create_dataset("Types", data=np.full(count, 22, dtype=np.uint8))
        data = root.create_group("CellData")
        data["smallest_angle"] = smallest_angles(quadratic_triangles)
        data["area"] = panel_areas(quadratic_triangles)
        for name, values in cells.items():
            data[name] = values


def _group(parent: h5py.Group, name: str, kind: str) -> h5py.Group:
    group = parent.create_group(name, track_order=True)
    group.attrs["Version"] = np.array([2, 2])
    # The reader requires a fixed-length ASCII string, but h5py writes variable-length UTF-8.
    group.attrs["Type"] = np.bytes_(kind)
    return group


def _write_polygons(group: h5py.Group, bodies: Sequence[Surface]) -> None:
    starts = np.cumsum([0] + [len(body.vertices) for body in bodies])
    vertices = np.concatenate([body.vertices for body in bodies])
    triangles = np.concatenate(
        [body.triangles + start for body, start in zip(bodies, starts, strict=False)]
    )
    numbers = np.concatenate(
        [np.full(len(body.triangles), index) for index, body in enumerate(bodies)]
    )
    group.attrs["Index"] = 1
    group["NumberOfPoints"] = np.array([len(vertices)])
    group["Points"] = vertices
    # The reader requires all four kinds of cells, even if they are empty.
    for name in ("Vertices", "Lines", "Polygons", "Strips"):
        cells = triangles if name == "Polygons" else np.empty((0, 3), dtype=np.int64)
        part = group.create_group(name)
        part.create_dataset("NumberOfCells", data=np.array([len(cells)]))
        part.create_dataset("NumberOfConnectivityIds", data=np.array([cells.size]))
        part.create_dataset("Offsets", data=3 * np.arange(len(cells) + 1))
        part.create_dataset("Connectivity", data=cells.ravel().astype(np.int64))
    group.create_group("CellData").create_dataset("body", data=numbers)
