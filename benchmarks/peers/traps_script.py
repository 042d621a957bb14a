"""Run one case of traps with another package: ``python traps_script.py case.npz answer.npz``.

Package 0 is AcousTools, 1 levitate. The elements are monopoles (in AcousTools pistons
of radius 0). Each row of the answer is the pressure at a point, Gor'kov's potential of the bead and
the three components of the force. No part of airtact is imported.
"""

# pyright: reportMissingImports=false, reportAttributeAccessIssue=false

import sys
import time
from importlib.metadata import version

import numpy as np


def acoustools(case):
    """Return functions that compute pressure, potential and force."""
    import torch
    from acoustools.Force import compute_force
    from acoustools.Gorkov import gorkov_analytical
    from acoustools.Utilities import propagate

    def tensor(values):
        return torch.tensor(values, dtype=torch.complex64)

    board = tensor(case["elements"])
    drive = tensor(case["drive"])[None, :, None]
    points = tensor(case["points"].T[None])
    element = {"p_ref": float(case["strength"]), "k": float(case["wavenumber"])}
    element["transducer_radius"] = 0.0
    norms = tensor(case["normals"])
    bead = {
        "V": 4.0 / 3.0 * np.pi * float(case["radius"]) ** 3,
        "medium_density": float(case["density"]),
        "medium_speed": float(case["sound_speed"]),
        "particle_density": float(case["bead_density"]),
        "particle_speed": float(case["bead_speed"]),
    }

    settings = {"transducer_norms": norms, **element, **bead}
    return (
        lambda: propagate(drive, points, board, norms=norms, **element).reshape(-1, 1).numpy(),
        lambda: gorkov_analytical(drive, points, board, **settings).reshape(-1, 1).numpy(),
        lambda: compute_force(drive, points, board, **settings)[0].numpy(),
    )


def levitate(case):
    """Return functions that compute pressure, potential and force."""
    from scipy import special

    # levitate 3.0 imports a name that SciPy 1.17 has removed; the case does not use it.
    if not hasattr(special, "sph_harm"):
        special.sph_harm = None
    from levitate import arrays, fields, materials, transducers

    materials.air.c = float(case["sound_speed"])
    materials.air.rho = float(case["density"])
    materials.styrofoam.c = float(case["bead_speed"])
    materials.styrofoam.rho = float(case["bead_density"])
    array = arrays.TransducerArray(
        case["elements"].T,
        case["normals"].T,
        transducer=transducers.PointSource,
        freq=float(case["frequency"]),
        p0=float(case["strength"]),
    )
    radius = float(case["radius"])
    pressure = fields.Pressure(array)
    potential = fields.GorkovPotential(array, radius=radius)
    gradient = fields.GorkovGradient(array, radius=radius)
    drive = case["drive"]
    points = case["points"].T
    return (
        lambda: pressure(drive, points)[:, None],
        lambda: potential(drive, points)[:, None],
        lambda: -gradient(drive, points).T,
    )


def main(case_file: str, answer_file: str) -> None:
    """Time the force as many times as the case asks, after a run to warm up."""
    case = np.load(case_file)
    package = ("AcousTools", "levitate")[int(case["package"])]
    pressure, potential, force = (acoustools, levitate)[int(case["package"])](case)
    matrix = np.hstack([pressure(), potential(), force()])
    seconds = []
    for _ in range(int(case["runs"])):
        began = time.perf_counter()
        force()
        seconds.append(time.perf_counter() - began)
    np.savez(
        answer_file,
        matrix=matrix.astype(np.complex128),
        seconds=seconds,
        peak=0,
        unknowns=0,
        version=f"{package} {version(package.lower())}",
    )


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2])
