"""Growth of the cost with the unknowns of the bodies and with the elements of the array."""

from dataclasses import dataclass
from functools import partial

import numpy as np

from airtact.acoustics.scene import Scene
from airtact.acoustics.solvers.bem.solver import BoundaryElement
from airtact.acoustics.target import Target
from airtact.benching.scenes import Bodies, two_fingers
from airtact.benching.timing import Timed, timed
from airtact.drives.linear_methods import time_reversal
from airtact.drives.transfer import transfer_matrix
from airtact.geometry.pose import Pose
from airtact.geometry.surface import Surface
from airtact.hands.body import Hulls
from airtact.hands.shape import HandShape
from airtact.hands.skin_mesh import midpoints
from airtact.timing import Progress, no_progress
from airtact.transducers.element import monopole
from airtact.transducers.layout import flat_boards

UNKNOWNS = (1000, 2000, 4000, 8000, 16000)
BOARDS = (1, 2, 4, 8)
"""Boards along each side of the array: 249, 996, 3984 and 15936 elements."""

AFAR = np.array([[0.0, 0.0, 0.03], [5e-3, 0.0, 0.035]])
"""Foci so far above the fingertips that the panels need no refinement there [m]."""


@dataclass(frozen=True)
class Grown:
    """Times of one size: of a solve by its unknowns, or of transfer matrix and drive by the elements."""

    size: int
    timed: Timed


def by_unknowns(runs: int, most: int, report_step: Progress = no_progress) -> list[Grown]:
    """Time solves of two fingers with increasing unknowns, a third of the runs from 8000 unknowns on."""
    scene, beacons, found = evenly_covered(two_fingers()).scene, Target(AFAR).beacons(), []
    for wanted in (one for one in UNKNOWNS if one <= most):
        report_step(f"solving {wanted} unknowns")
        solver = BoundaryElement(accuracy=_accuracy_for(wanted, scene))
        count = runs if wanted < 8000 else max(1, runs // 3)
        took, fields = timed([partial(solver.radiate, scene, beacons)] * (count + 1))
        found.append(Grown(fields[0].report.nodes, took))
    return found


def by_elements(runs: int, boards: tuple[int, ...] = BOARDS) -> list[Grown]:
    """Time transfer matrix and drive of a solved shape for increasing arrays, ``boards`` along each side."""
    bodies = two_fingers()
    beacons = BoundaryElement(accuracy=0.03).radiate(bodies.scene, bodies.target.beacons())
    found = []
    for side in boards:
        array = flat_boards(side, side, monopole()).seen_from(
            Pose(np.eye(3), np.array([0.0, 0.0, 0.2]))
        )
        jobs = [
            lambda array=array: time_reversal(transfer_matrix(beacons, array), bodies.target)
        ] * (runs + 1)
        found.append(Grown(len(array), timed(jobs)[0]))
    return found


def power(grown: list[Grown]) -> float:
    """Exponent of the time as a power of the size, over the upper half of the sizes."""
    upper = grown[len(grown) // 2 - 1 :]
    sizes, seconds = [one.size for one in upper], [one.timed.median for one in upper]
    return float(np.polyfit(np.log(sizes), np.log(seconds), 1)[0])


def evenly_covered(bodies: Bodies) -> Bodies:
    """Replace capsules by sphere meshes, which take panels of any size: those of capsules come in few sizes."""
    surfaces = []
    for one in bodies.capsules:
        balls = np.array([[*end, one.radius] for end in one.axis])
        shape = HandShape(
            Hulls(balls, np.array([[0, 1, -1]]), np.zeros((1, 1)), np.zeros((1, 1))),
            Pose.identity(),
        )
        skin = shape.skin(3e-3)
        surfaces.append(
            Surface(skin.vertices, skin.triangles, midpoints(shape.hulls, skin), primitive=shape)
        )
    return Bodies(tuple(surfaces), bodies.foci)


def _accuracy_for(unknowns: int, scene: Scene) -> float:
    """Choose the accuracy that gives bodies about so many unknowns."""
    beacons, low, high = Target(AFAR).beacons(), 2e-4, 0.3
    for _ in range(10):
        middle = float(np.sqrt(low * high))
        if BoundaryElement(accuracy=middle).unknowns(scene, beacons) > unknowns:
            low = middle
        else:
            high = middle
    return high
