"""Water against rigid fingers, and boundary against finite elements."""

from pathlib import Path

import numpy as np
from jaxtyping import Complex128

from airtact.acoustics.scene import Scene
from airtact.acoustics.solvers.bem.solver import BoundaryElement
from airtact.acoustics.solvers.fem.solver import FiniteElement
from airtact.acoustics.solvers.problem import Solver
from airtact.benching.timing import correlation
from airtact.evaluation.windows import plane_through
from airtact.experiments.mesh_sizes import relative_error
from airtact.experiments.part import Part, write_columns
from airtact.experiments.settings import Settings
from airtact.experiments.solved import Solved
from airtact.reports.page import paragraph, table
from airtact.timing import Clock

OFF_SKIN = 0.5
"""Points of the plane nearer to a finger than so many wavelengths are left out."""


def differences(made: Solved, settings: Settings, folder: Path, clock: Clock) -> Part:
    """Solve for the beacons in several ways and compare each pair."""
    fingers, elements = made.dummies, made.array.positions
    vertices = np.concatenate([surface.vertices for surface in fingers.surfaces])
    plane = plane_through(fingers.foci, vertices, made.scene.wavelength).points[::7]
    plane = plane[made.scene.depth(plane) < -OFF_SKIN * made.scene.wavelength]
    points = np.concatenate([elements, plane])
    finite = f"finite elements of order {settings.order}"
    ways: dict[str, tuple[Scene, Solver]] = {
        "boundary elements, rigid": (made.scene, BoundaryElement(accuracy=settings.reference)),
        f"{finite}, water": (
            fingers.watery,
            FiniteElement(settings.order, settings.elements_per_wavelength),
        ),
    }
    received = {f"{finite}, rigid": made.field.at(points)[:, 0]}
    for name, (scene, solver) in ways.items():
        with clock.step(name, f"solving for the beacons by {name}"):
            received[name] = solver.radiate(scene, fingers.beacon).at(points)[:, 0]
    count = len(elements)
    pairs = [
        (one, other) for index, one in enumerate(received) for other in list(received)[index + 1 :]
    ]
    rows = [(one, other, *_apart(received[one], received[other], count)) for one, other in pairs]
    names = "one", "other", "at_the_transducers", "in_the_plane", "correlation_of_the_drives"
    columns = {name: ("", [row[index] for row in rows]) for index, name in enumerate(names)}
    write_columns(folder, "differences", columns)
    pieces = (
        paragraph(
            "The paper fills its fingers with water (Table 1), which reflects 0.9994 of the pressure; everything above "
            "has them rigid. How far the field of both beacons in step is apart between solvers and fillings:"
        ),
        table(
            ["", "against", "at the transducers", "in the plane of the fingers", "drives alike"],
            [[a, b, f"{100 * c:.2f} %", f"{100 * d:.2f} %", f"{e:.5f}"] for a, b, c, d, e in rows],
            f"Relative differences ‖a − b‖ / ‖b‖; in the plane, points {OFF_SKIN:g} λ and more off the fingers. The "
            "last column is the correlation of the two drives, 1 for equal ones.",
        ),
    )
    return Part("Water against rigid, boundary against finite elements", pieces)


def _apart(
    one: Complex128[np.ndarray, "points"], other: Complex128[np.ndarray, "points"], elements: int
) -> tuple[float, float, float]:
    first, second = one[:elements], other[:elements]
    apart = relative_error(first, second), relative_error(one[elements:], other[elements:])
    return *apart, correlation(first, second)
