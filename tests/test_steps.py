"""The solver that verifies a drive is the next more accurate one that fits."""

from dataclasses import replace

import numpy as np
import pytest

from airtact.scene.sources import Monopoles
from airtact.scene_file.building import read_scene
from airtact.solvers.bem.solver import BoundaryElement
from airtact.solvers.fem.solver import FiniteElement
from airtact.solvers.free_field import FreeField
from airtact.steps import FINEST, MOST_UNKNOWNS, REFINEMENT, verification_solver
from paths import EXAMPLES, SCENES

PINCH = read_scene(EXAMPLES / "pinch.toml")


def first_accuracy_that_refines(setup) -> float:
    """Try one accuracy after the other, a factor of 1.2 apart."""
    emitting = Monopoles(setup.array.positions, np.ones(len(setup.array)))

    def unknowns(accuracy: float) -> int:
        return BoundaryElement(accuracy=accuracy).unknowns(setup.scene, emitting)

    accuracy = setup.accuracy / 1.2
    while unknowns(accuracy) < REFINEMENT * unknowns(setup.accuracy) and accuracy / 1.2 > FINEST:
        accuracy /= 1.2
    assert unknowns(accuracy) <= MOST_UNKNOWNS
    return accuracy


@pytest.mark.parametrize("setup", [PINCH, replace(PINCH, accuracy=0.2), read_scene(SCENES / "ball.toml")])
def test_verification_has_the_first_accuracy_that_refines_enough(setup) -> None:
    assert verification_solver(setup) == BoundaryElement(accuracy=first_accuracy_that_refines(setup))


def test_few_accuracies_are_tried(monkeypatch) -> None:
    tried = []
    unknowns = BoundaryElement.unknowns
    monkeypatch.setattr(BoundaryElement, "unknowns", lambda self, *args: tried.append(self) or unknowns(self, *args))
    verification_solver(PINCH)
    assert len(tried) <= 3  # its own, the first that refines enough and the one before; six when tried in turn


def test_verification_of_the_best_accuracy_stays_there() -> None:
    assert verification_solver(replace(PINCH, accuracy=FINEST)) == BoundaryElement(accuracy=FINEST)


def test_open_air_and_filled_bodies_have_solvers_of_their_own() -> None:
    scene = replace(PINCH.scene, obstacles=())
    assert verification_solver(replace(PINCH, scene=scene)) == FreeField()
    filled = replace(
        PINCH.scene,
        obstacles=tuple(replace(one, boundary="impedance", ratio=2.0) for one in PINCH.scene.obstacles),
    )
    setup = replace(PINCH, scene=filled, solver=FiniteElement(order=4))
    assert verification_solver(setup) == FiniteElement(order=5)
