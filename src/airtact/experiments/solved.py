"""The drive as the paper makes it: one solution by finite elements, its conjugate at the transducers."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex128

from airtact.acoustics.scene import Scene
from airtact.acoustics.solvers.bem.solver import BoundaryElement
from airtact.acoustics.solvers.fem.field import FiniteField
from airtact.acoustics.solvers.fem.solver import FiniteElement
from airtact.drives.rounding import quantise
from airtact.drives.transfer import Drive, focus_by_distance
from airtact.evaluation.comparison import Comparison, compare
from airtact.experiments.dummies import Dummies, dummies
from airtact.experiments.settings import Settings
from airtact.printing import in_short
from airtact.timing import Clock
from airtact.transducers.element import monopole
from airtact.transducers.layout import PhasedArray, surrounding_box

CONSIDERED, IGNORED = "fingers considered", "fingers ignored"
"""The paper's two drives."""

DRAWN = 1.2e-3
"""Longest edge of the fingers' outlines in pictures [m]."""


@dataclass(frozen=True, eq=False)
class Solved:
    """The paper's experiment up to the verified drives: sound-hard fingers and the 996 transducers.

    ``field`` is that of both beacons in step by finite elements, ``received`` its pressure at the
    transducers [Pa]; the drives, by name, have 256 levels, and ``compared`` is what each gives at
    the foci by boundary elements.
    """

    dummies: Dummies
    scene: Scene
    array: PhasedArray
    field: FiniteField
    received: Complex128[np.ndarray, "elements"]
    drives: dict[str, Drive]
    compared: Comparison

    __repr__ = in_short


def solved(settings: Settings, clock: Clock) -> Solved:
    """Solve for the beacons by finite elements, make both drives, and verify them by boundary elements."""
    fingers, array = dummies(edge=DRAWN), surrounding_box(monopole())
    scene = fingers.scene
    solver = FiniteElement(settings.order, settings.elements_per_wavelength)
    with clock.step(
        "finite elements", f"solving for the beacons by finite elements of order {settings.order}"
    ):
        field = solver.radiate(scene, fingers.beacon)
        received = field.at(array.positions)[:, 0]
    drives = {
        CONSIDERED: Drive(received.conj() / np.abs(received).max()),
        IGNORED: focus_by_distance(array, fingers.target, scene.medium, scene.frequency),
    }
    drives = {name: quantise(drive).drive() for name, drive in drives.items()}
    verifier = BoundaryElement(accuracy=settings.verifying)
    with clock.step(
        "verification", "verifying both drives by boundary elements, all transducers emitting"
    ):
        compared = compare(scene, array, drives, fingers.target, solver=verifier)
    return Solved(fingers, scene, array, field, received, drives, compared)
