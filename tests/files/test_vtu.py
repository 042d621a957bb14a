"""VTU files whose arrays are larger unpacked, or shorter, than they say."""

import lzma
import os
import zlib

import meshio
import numpy as np
import pytest

from airtact.files import vtu
from faults import raises_code

POINTS = np.random.default_rng(0).normal(size=(50, 3))
MESH = meshio.Mesh(
    POINTS, [("tetra", np.arange(8).reshape(2, 4))], point_data={"Pressure": np.arange(50.0)}
)


@pytest.mark.parametrize("compression", ["zlib", "lzma", None])
def test_nodes_of_tetrahedra_are_read_and_the_other_ones_left_out(compression, tmp_path):
    meshio.vtu.write(tmp_path / "a.vtu", MESH, compression=compression)
    points, columns, cells = vtu.nodes_of_vtu(tmp_path / "a.vtu")
    assert np.array_equal(points, POINTS[:8])
    assert np.array_equal(columns["pressure"], np.arange(8.0))
    assert cells.tolist() == [[0, 1, 2, 3], [4, 5, 6, 7]]


@pytest.mark.parametrize("compression", ["zlib", "lzma"])
def test_no_more_is_unpacked_than_the_limit(compression, tmp_path, monkeypatch):
    meshio.vtu.write(tmp_path / "a.vtu", MESH, compression=compression)
    monkeypatch.setattr(vtu, "LARGEST_DATA", 1000)  # the points alone are 1,200 bytes
    with raises_code("file_too_large", "a.vtu", "1,000 bytes"):
        vtu.nodes_of_vtu(tmp_path / "a.vtu")
    assert meshio.vtu._vtu.zlib is zlib
    assert meshio.vtu._vtu.lzma is lzma


def test_cells_of_nodes_that_are_not_there_are_rejected(tmp_path):
    mesh = meshio.Mesh(POINTS, [("tetra", np.arange(48, 52)[None])])
    meshio.vtu.write(tmp_path / "a.vtu", mesh)
    with raises_code("file_unreadable", "a.vtu", "50 nodes"):
        vtu.nodes_of_vtu(tmp_path / "a.vtu")


def test_pipes_are_not_opened(tmp_path):
    os.mkfifo(tmp_path / "a.vtu")
    with raises_code("file_unreadable", "device or pipe"):
        vtu.nodes_of_vtu(tmp_path / "a.vtu")
