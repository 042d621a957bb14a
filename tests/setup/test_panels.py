"""Panels are written so that others read the same shape back."""

import h5py
import numpy as np
import pytest
import trimesh
import vtk
from vtk.util import numpy_support

import airtact as at
from airtact.geometry.mesh.quadratic_triangles import enclosed_volume, panel_areas, smallest_angles
from airtact.geometry.panels import panels_of
from airtact.setup.panel_files import FLAT, write_panels
from faults import raises_code

BALL = at.sphere(0.01, 3e-3, (0.03, 0.0, 0.0))
ROD = at.capsule((0, 0, 0), (0, 0, 0.02), 5e-3, 2e-3)
PANELS = panels_of([BALL.shape, ROD.shape], 4e-3, np.empty((0, 3)), 2e-3)


def test_the_file_has_the_quality_of_each_panel(tmp_path):
    path = tmp_path / "panels.vtkhdf"
    assert write_panels(path, PANELS) == 0
    with h5py.File(path) as file:
        data = {name: values[:] for name, values in file["VTKHDF/CellData"].items()}
    assert sorted(data) == ["area", "body", "deviation", "smallest_angle"]
    np.testing.assert_array_equal(
        data["smallest_angle"], smallest_angles(PANELS.quadratic_triangles)
    )
    # 4π r², and 2π r l + 4π r²
    areas = [data["area"][data["body"] == body].sum() for body in (0, 1)]
    np.testing.assert_allclose(
        areas, [4 * np.pi * 1e-4, 2 * np.pi * (5e-3 * 0.02 + 2 * 25e-6)], rtol=2e-3
    )
    np.testing.assert_array_equal(data["deviation"], PANELS.deviation)


@pytest.mark.parametrize("ending", FLAT)
def test_flat_triangles_are_read_back_in_metres(tmp_path, ending):
    path = tmp_path / f"panels{ending}"
    assert write_panels(path, PANELS) == 0
    surface = at.load_surface(path)
    np.testing.assert_allclose(np.ptp(surface.vertices, axis=0), [0.045, 0.02, 0.035], rtol=0.01)
    mesh = trimesh.Trimesh(surface.vertices, surface.triangles, process=False)
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(enclosed_volume(PANELS.quadratic_triangles), rel=0.05)
    assert list(tmp_path.iterdir()) == [path]


def test_an_ending_that_is_not_written_is_rejected(tmp_path):
    with raises_code("unknown_format", "panels.obj"):
        write_panels(tmp_path / "panels.obj", PANELS)
    assert list(tmp_path.iterdir()) == []


def test_vtk_reads_the_panels_back(tmp_path):
    path = tmp_path / "panels.vtkhdf"
    write_panels(path, PANELS)
    reader = vtk.vtkHDFReader()
    reader.SetFileName(str(path))
    reader.Update()
    grid = reader.GetOutputDataObject(0)
    assert grid.GetNumberOfCells() == len(PANELS.quadratic_triangles)
    assert {grid.GetCell(index).GetClassName() for index in range(grid.GetNumberOfCells())} == {
        "vtkQuadraticTriangle"
    }
    np.testing.assert_array_equal(
        numpy_support.vtk_to_numpy(grid.GetPoints().GetData()),
        PANELS.quadratic_triangles.reshape(-1, 3),
    )
    areas = numpy_support.vtk_to_numpy(grid.GetCellData().GetArray("area"))
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
