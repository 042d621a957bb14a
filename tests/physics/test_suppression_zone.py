"""Suppression zones, measured by another solver on the whole zone and not only in the points that were asked."""

import numpy as np

import airtact as at
from airtact.acoustics.solvers.bem.quadrature import place_nodes
from airtact.geometry.panels import panels_of

AIR = at.Medium(343.1, 1.293)
ARRAY = at.surrounding_box()


def drives_for(transfer: at.TransferMatrix, target: at.Target) -> tuple[at.Drive, at.Drive]:
    """The strongest drive that knows no suppression zone, and the one that does, at full scale."""
    foci = at.TransferMatrix(transfer.matrix[: len(target.points)], 0.0, target.points)
    loud, quiet = (
        at.max_min(foci, at.Target(target.points)),
        at.drives.gradient(transfer, target, loss=0.09),
    )
    return loud, quiet


def measured(
    scene: at.Scene,
    target: at.Target,
    drives: tuple[at.Drive, at.Drive],
    facing: np.ndarray,
    within: float,
    solver: at.acoustics.Solver,
) -> tuple[float, float]:
    """Fall of the mean p² over the skin that looks to its body's side [dB], and the loss of the weakest focus."""
    field = solver.radiate(scene, at.evaluation.drive_sources(ARRAY, list(drives)))
    edge = scene.wavelength / 3
    panels = panels_of(
        [obstacle.surface.shape for obstacle in scene.obstacles], edge, np.empty((0, 3)), edge
    )
    nodes = place_nodes(panels.quadratic_triangles, panels.body, panels.deviation)
    chosen = np.einsum("qd,qd->q", nodes.normals, facing[nodes.body]) > np.cos(np.radians(within))
    loud, quiet = np.average(
        np.abs(field.at(nodes.points[chosen])) ** 2, axis=0, weights=nodes.weights[chosen]
    )
    weakest = np.abs(field.at(target.points)).min(axis=0)
    return 10.0 * float(np.log10(quiet / loud)), 1.0 - float(weakest[1] / weakest[0])


def test_the_back_of_a_ball_falls_silent_by_the_measure_of_another_solver() -> None:
    ball = at.sphere(8e-3, edge=3e-3)
    scene = at.Scene(AIR, [at.sound_hard(ball)])
    back = np.array([[-1.0, 0.0, 0.0]])
    zone = at.acoustics.surface_points(
        ball, 0.3 * scene.wavelength, facing=(-1.0, 0.0, 0.0), within=60.0
    )
    target = at.Target(np.array([[8.5e-3, 0.0, 0.0]]), suppression_points=zone)
    transfer = at.transfer_matrix(
        at.SphereSeries().radiate(scene, target.beacons(suppression=True)), ARRAY
    )
    fall, loss = measured(
        scene, target, drives_for(transfer, target), back, 60.0, at.BoundaryElement(0.02)
    )
    assert fall < -10.0
    assert loss < 0.10
