"""Suppression zones, measured by another solver on the whole zone and not only in the points that were asked."""

import numpy as np

import airtact as at
from airtact.acoustics.solvers.bem.quadrature import place_nodes
from airtact.geometry.panels import panels_of
from worlds import hard

ARRAY = at.surrounding_box()


def test_the_back_of_a_ball_falls_silent_by_the_measure_of_another_solver() -> None:
    ball = at.sphere(8e-3, edge=3e-3)
    scene = hard(ball)
    zone = at.acoustics.surface_points(
        ball, 0.3 * scene.wavelength, facing=(-1.0, 0.0, 0.0), within=60.0
    )
    target = at.Target(np.array([[8.5e-3, 0.0, 0.0]]), suppression_points=zone)
    beacons = at.SphereSeries().radiate(scene, target.beacons(suppression=True))
    transfer = at.transfer_matrix(beacons, ARRAY)
    # the strongest drive that knows no suppression zone, and the one that does, at full scale
    foci = at.TransferMatrix(transfer.matrix[:1], 0.0, target.points)
    loud = at.max_min(foci, at.Target(target.points))
    quiet = at.drives.gradient(transfer, target, loss=0.09)
    sources = at.evaluation.drive_sources(ARRAY, [loud, quiet])
    field = at.BoundaryElement(0.02).radiate(scene, sources)
    edge = scene.wavelength / 3
    panels = panels_of([ball.shape], edge, np.empty((0, 3)), edge)
    nodes = place_nodes(panels.quadratic_triangles, panels.body, panels.deviation)
    back = -nodes.normals[:, 0] > np.cos(np.radians(60.0))
    squares = np.abs(field.at(nodes.points[back])) ** 2
    mean = np.average(squares, axis=0, weights=nodes.weights[back])
    focus = np.abs(field.at(target.points))[0]
    assert 10.0 * np.log10(mean[1] / mean[0]) < -10.0
    assert focus[1] > 0.9 * focus[0]
