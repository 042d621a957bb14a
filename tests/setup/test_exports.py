"""Files for other programs: fields and panels that vtk reads back, and flat triangles that are closed."""

import h5py
import numpy as np
import pytest
import trimesh

import airtact as at
from airtact.evaluation.windows import Box
from airtact.geometry.mesh.triangles import cone_volumes, edge_twins, enclosed_volume, panel_areas
from airtact.geometry.panels import panels_of
from airtact.geometry.primitives import sphere
from airtact.setup.exports import FLAT, flat_triangles, write_field, write_triangles
from geometry.mesh.meshes import box_mesh, torus_mesh

BALL = at.sphere(0.01, 3e-3, (0.03, 0.0, 0.0))
ROD = at.capsule((0, 0, 0), (0, 0, 0.02), 5e-3, 2e-3)
PANELS = panels_of([BALL.shape, ROD.shape], 4e-3, np.empty((0, 3)), 2e-3)
WRITTEN = (PANELS.quadratic_triangles, {"deviation": PANELS.deviation, "body": PANELS.body})


@pytest.fixture(scope="module")
def vtk():
    """The module of that name, which every worker would import with this file."""
    import vtk.util.numpy_support

    return vtk


@pytest.mark.parametrize("ending", FLAT)
def test_flat_triangles_are_read_back_in_metres(tmp_path, ending):
    path = tmp_path / f"panels{ending}"
    assert write_triangles(path, *WRITTEN) == 0
    surface = at.load_surface(path)
    np.testing.assert_allclose(np.ptp(surface.vertices, axis=0), [0.045, 0.02, 0.035], rtol=0.01)
    mesh = trimesh.Trimesh(surface.vertices, surface.triangles, process=False)
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(enclosed_volume(PANELS.quadratic_triangles), rel=0.05)
    assert list(tmp_path.iterdir()) == [path]


def test_vtk_reads_the_panels_back(vtk, tmp_path):
    path = tmp_path / "panels.vtkhdf"
    write_triangles(path, *WRITTEN)
    reader = vtk.vtkHDFReader()
    reader.SetFileName(str(path))
    reader.Update()
    grid = reader.GetOutputDataObject(0)
    assert grid.GetNumberOfCells() == len(PANELS.quadratic_triangles)
    assert {grid.GetCell(index).GetClassName() for index in range(grid.GetNumberOfCells())} == {
        "vtkQuadraticTriangle"
    }
    np.testing.assert_array_equal(
        vtk.util.numpy_support.vtk_to_numpy(grid.GetPoints().GetData()),
        PANELS.quadratic_triangles.reshape(-1, 3),
    )
    areas = vtk.util.numpy_support.vtk_to_numpy(grid.GetCellData().GetArray("area"))
    np.testing.assert_array_equal(areas, panel_areas(PANELS.quadratic_triangles))
    skin = vtk.vtkDataSetSurfaceFilter()
    skin.SetNonlinearSubdivisionLevel(
        3
    )  # the curved panels, as VTK's own shape functions have them
    skin.SetInputData(grid)
    skin.Update()
    mass = vtk.vtkMassProperties()
    mass.SetInputData(skin.GetOutput())
    mass.Update()
    assert mass.GetSurfaceArea() == pytest.approx(float(areas.sum()), rel=2e-3)
    assert mass.GetVolume() == pytest.approx(enclosed_volume(PANELS.quadratic_triangles), rel=2e-3)


BODIES = {
    "ball": at.sphere(0.01, 3e-3),
    "rod": at.capsule((0, 0, 0), (0, 0, 0.02), 5e-3, 2e-3),
    "box": at.Surface(*box_mesh()),
    "ring": at.Surface(*torus_mesh(0.02, 0.006, around=48, across=24)),
}
EXACT = {  # volumes in closed form
    "ball": 4 / 3 * np.pi * 0.01**3,
    "rod": np.pi * 5e-3**2 * 0.02 + 4 / 3 * np.pi * 5e-3**3,
    "box": 0.02 * 0.03 * 0.04,
    "ring": 2 * np.pi**2 * 0.02 * 0.006**2,
}


@pytest.mark.parametrize("name", BODIES)
def test_triangles_of_panels_of_one_size_are_closed_and_right(name):
    panels = BODIES[name].panelled(4e-3).quadratic_triangles
    vertices, triangles = flat_triangles(panels)
    assert len(triangles) == 4 * len(panels)
    assert np.all(edge_twins(triangles) >= 0)
    assert len(vertices) == len(triangles) // 2 + (0 if name == "ring" else 2)  # Euler
    assert cone_volumes(vertices[triangles]).sum() == pytest.approx(EXACT[name], rel=0.04)


BOX = Box(np.array([-0.01, 0.0, 0.02]), np.array([1e-3, 1e-3, 2e-3]), (4, 3, 2))


def plane_wave(points):
    return 5.0 * np.exp(1j * points @ np.array([700.0, 200.0, -50.0]))


@pytest.fixture
def written(tmp_path):
    path = tmp_path / "field.vtkhdf"
    pressure = plane_wave(BOX.points)
    pressure[5] = np.nan
    bodies = [sphere(5e-3, 3e-3), sphere(4e-3, 3e-3, (0.02, 0.0, 0.0))]
    write_field(path, BOX, pressure, bodies)
    return path, pressure, bodies


def test_the_tree_of_the_file_links_to_image_and_bodies(written):
    """As ParaView asks for; the reader of the other test does without."""
    path, _, bodies = written
    with h5py.File(path) as file:
        root = file["VTKHDF"]
        assert root.attrs["Version"].tolist() == [2, 2]
        assert isinstance(root["Assembly/field"].get("field", getlink=True), h5py.SoftLink)
        polygons = root["bodies"]
        corners = polygons["Points"][:][polygons["Polygons/Connectivity"][:].reshape(-1, 3)]
        np.testing.assert_array_equal(
            corners, np.concatenate([body.vertices[body.triangles] for body in bodies])
        )


def test_vtk_reads_it_back(vtk, written):
    path, pressure, bodies = written
    reader = vtk.vtkHDFReader()
    reader.SetFileName(str(path))
    reader.Update()
    collection = reader.GetOutputDataObject(0)
    image, polygons = (collection.GetPartition(index, 0) for index in range(2))
    parts = [
        vtk.util.numpy_support.vtk_to_numpy(image.GetPointData().GetArray(name))
        for name in ("pressure_real", "pressure_imag")
    ]
    np.testing.assert_array_equal(parts[0] + 1j * parts[1], pressure)
    places = np.array([image.GetPoint(index) for index in range(image.GetNumberOfPoints())])
    np.testing.assert_allclose(places, BOX.points, atol=1e-15)
    assert polygons.GetNumberOfPolys() == sum(len(body.triangles) for body in bodies)
    numbers = vtk.util.numpy_support.vtk_to_numpy(polygons.GetCellData().GetArray("body"))
    assert np.bincount(numbers).tolist() == [len(body.triangles) for body in bodies]
