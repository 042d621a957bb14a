"""Field files have the structure that VTKHDF asks for, and vtk reads them back."""

import h5py
import numpy as np
import pytest
import vtk
from vtk.util import numpy_support

from airtact.evaluation.windows import Box
from airtact.geometry.primitives import sphere
from airtact.setup.vtkhdf import write_field
from faults import raises_code

BOX = Box(np.array([-0.01, 0.0, 0.02]), 1e-3, (4, 3, 2))


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


def test_a_field_that_does_not_fit_is_rejected(tmp_path):
    with raises_code("sizes_differ", "24 points"):
        write_field(tmp_path / "field.vtkhdf", BOX, np.zeros(23, complex), [])
    assert list(tmp_path.iterdir()) == []


def test_vtk_reads_it_back(written):
    path, pressure, bodies = written
    reader = vtk.vtkHDFReader()
    reader.SetFileName(str(path))
    reader.Update()
    collection = reader.GetOutputDataObject(0)
    image, polygons = (collection.GetPartition(index, 0) for index in range(2))
    parts = [
        numpy_support.vtk_to_numpy(image.GetPointData().GetArray(name))
        for name in ("pressure_real", "pressure_imag")
    ]
    np.testing.assert_array_equal(parts[0] + 1j * parts[1], pressure)
    places = np.array([image.GetPoint(index) for index in range(image.GetNumberOfPoints())])
    np.testing.assert_allclose(places, BOX.points, atol=1e-15)
    assert polygons.GetNumberOfPolys() == sum(len(body.triangles) for body in bodies)
    numbers = numpy_support.vtk_to_numpy(polygons.GetCellData().GetArray("body"))
    assert np.bincount(numbers).tolist() == [len(body.triangles) for body in bodies]
