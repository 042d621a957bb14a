"""Curved tetrahedra of Netgen's volume mesh, bent to the bodies' surfaces."""

from typing import Any

import numpy as np
from scipy.spatial import KDTree

from airtact.solvers.fem.meshing.netgen import NetgenMesh
from airtact.solvers.fem.meshing.skin import SkinMesh
from airtact.solvers.tetrahedra import EDGES, Tetrahedra


def curved_tetrahedra(mesh: NetgenMesh, skin: SkinMesh, wavelength: float) -> Tetrahedra:
    """Take the tetrahedra out of a mesh of Netgen's, and bend those beside the bodies.

    Parameters
    ----------
    mesh : Netgen's mesh.
    skin : the bodies' triangles, which its faces are.
    wavelength : [m].
    """
    vertices = np.array(mesh.Coordinates(), dtype=np.float64)
    elements: Any = mesh.Elements3D().NumPy()
    corners = elements["nodes"][:, :4].astype(np.int64) - 1
    own = np.asarray(KDTree(vertices).query(skin.vertices / wavelength)[1])
    triangles = own[skin.triangles]
    ends = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    keys, first = np.unique(ends[:, 0] * len(vertices) + ends[:, 1], return_index=True)
    straight = 0.5 * (vertices[ends[first, 0]] + vertices[ends[first, 1]])
    bend = skin.middles.reshape(-1, 3)[first] / wavelength - straight
    wanted = np.sort(corners[:, EDGES], axis=2) @ [len(vertices), 1]
    found = np.minimum(np.searchsorted(keys, wanted.ravel()), len(keys) - 1).reshape(wanted.shape)
    bends = np.where((keys[found] == wanted)[:, :, None], bend[found], 0.0)
    return Tetrahedra(vertices[corners], bends)
