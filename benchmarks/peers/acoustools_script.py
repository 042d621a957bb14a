"""Run one case with AcousTools, in its own environment: ``python acoustools_script.py case.npz answer.npz``.

Monopoles stand for the transducers (a piston of radius 0 at half its reference pressure), CHIEF
points inside the bodies keep the equation solvable at interior resonances. No part of airtact is
imported.
"""

# pyright: reportMissingImports=false, reportAttributeAccessIssue=false

import sys
import time
from importlib.metadata import version

import numpy as np


def main(case_file: str, answer_file: str) -> None:
    """Time H and E on a mesh, as many times as the case asks, after one run on a small mesh to warm up."""
    import torch
    from acoustools.BEM import compute_E, compute_H
    from peak_memory import write_answer
    from vedo import Mesh

    case = np.load(case_file)
    wavenumber = float(case["wavenumber"])

    def tensor(points):
        return torch.tensor(points.T[None], dtype=torch.complex64)

    board = torch.tensor(case["elements"], dtype=torch.complex64)
    same = {
        "p_ref": 1.0,
        "k": wavenumber,
        "transducer_radius": 0.0,
        "norms": torch.ones_like(board),
    }

    def solve(vertices, triangles):
        scatterer = Mesh([vertices, triangles])
        scatterer.compute_cell_size()
        scatterer.compute_normals()
        inside = tensor(case["inside"]) if len(case["inside"]) else None
        began = time.perf_counter()
        density = compute_H(scatterer, board, internal_points=inside, **same)
        pressure = compute_E(
            scatterer, tensor(case["foci"]), board, H=density, internal_points=inside, **same
        )
        return (
            pressure[0].numpy().astype(np.complex128),
            time.perf_counter() - began,
            len(triangles),
        )

    solve(case["warm_vertices"], case["warm_triangles"])
    write_answer(answer_file, case, solve, "AcousTools " + version("acoustools"))


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2])
