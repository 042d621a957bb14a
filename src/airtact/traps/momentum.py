"""Force and torque on a body of any size and shape, from the flux of momentum towards it.

Source: P. J. Westervelt, "Acoustic radiation pressure", J. Acoust. Soc. Am. 29, 26 (1957).
"""

import re

import numpy as np
from jaxtyping import Float64
from scipy.integrate import lebedev_rule

from airtact.acoustics.scene import Obstacle, Scene
from airtact.acoustics.solvers.bem.solver import BoundaryElement
from airtact.acoustics.solvers.fem.solver import FiniteElement
from airtact.acoustics.solvers.problem import Solver
from airtact.acoustics.solvers.spherical.sphere_series import SphereSeries
from airtact.drives.drive import Drive
from airtact.errors import InvalidInput, Vector, in_mm, millimetres, of_kind, point_of
from airtact.evaluation.metrics import radiate_drives
from airtact.evaluation.verification import radiation_pressure
from airtact.geometry.primitives import Capsule
from airtact.transducers.layout import PhasedArray


def body_force(
    scene: Scene,
    array: PhasedArray,
    drive: Drive,
    body: Obstacle,
    about: Vector | None = None,
    solver: Solver | None = None,
) -> tuple[Float64[np.ndarray, "3"], Float64[np.ndarray, "3"]]:
    """Return the radiation force and torque on a body of any size and shape.

    The body is added to the scene, and the field that it scatters is computed, including
    reflections from the other bodies. The force and the torque are the mean fluxes of momentum and
    angular momentum through a sphere around the body. They do not include streaming, viscosity or
    weight.

    Parameters
    ----------
    scene : the air and the other bodies, without ``body``.
    array : transducers in the frame of the scene; see ``PhasedArray.seen_from``.
    drive : drive of the array, one complex amplitude per element.
    body : the body at its position in the scene, such as ``sound_hard(sphere(2e-3, 1e-3))``. A
        sphere filled with a fluid can also represent a light solid, such as expanded polystyrene.
    about : (3,) reference point of the torque in the scene [m]; by default, the centre of the
        body's bounding box.
    solver : solver that computes the field; by default, ``BoundaryElement(accuracy=0.01)``. If this
        or another body is filled with a fluid, the default is ``SphereSeries`` for a single sphere
        in open air, and ``FiniteElement`` otherwise.

    Returns
    -------
    Two arrays along the axes of the scene: the time-averaged force (3,) [N] and torque (3,) [N·m].

    Raises
    ------
    InvalidInput
        If another body, a plane or an element is inside the smallest sphere around the body, or
        within 1/50 of a wavelength of this sphere. The error is also raised if this sphere's
        diameter exceeds about 17 wavelengths, if a body is behind the face of a directional
        element, if elements overlap, if the solver does not support the bodies, or if the drive is
        silent or does not have as many elements as the array.
    NotConverged
        If the solver stops before it converges.

    Examples
    --------
    >>> import airtact as at
    >>> places = np.array([[0, -0.1, 0], [0, 0.1, 0]])
    >>> pair = PhasedArray(places, element=at.monopole())
    >>> ball = at.sound_hard(at.sphere(2e-3, 1e-3, (0, 1e-3, 0)))
    >>> force, torque = body_force(Scene(at.air()), pair, Drive(np.array([1, -1 + 0j])), ball)
    >>> np.round(force / np.linalg.norm(force), 2).tolist()[1], torque.shape
    (-1.0, (3,))
    """
    of_kind(scene, Scene, "the scene", "Scene(medium, obstacles, frequency)")
    of_kind(body, Obstacle, "the body", "sound_hard(surface) or filled(surface, medium)")
    index = len(scene.obstacles)
    try:
        return _force_on(scene, array, drive, body, about, solver)
    except InvalidInput as fault:
        # Solvers number the bodies, and this one is the last.
        words = re.sub(rf"\bbody {index}\b", "the body", str(fault))
        raise InvalidInput(words, fault.position, code=fault.code) from fault


def _force_on(
    scene: Scene,
    array: PhasedArray,
    drive: Drive,
    body: Obstacle,
    about: Vector | None,
    solver: Solver | None,
) -> tuple[Float64[np.ndarray, "3"], Float64[np.ndarray, "3"]]:
    shape = body.surface.shape
    whole = Scene(scene.medium, [*scene.obstacles, body], scene.frequency, scene.planes)
    if solver is None:
        solver = BoundaryElement(accuracy=0.01)
        if any(obstacle.boundary == "filled" for obstacle in whole.obstacles):
            alone = len(whole.obstacles) == 1 and not scene.planes
            ball = isinstance(shape, Capsule) and shape.length == 0.0
            solver = SphereSeries() if alone and ball else FiniteElement()

    # Find the smallest sphere around the centre of the body, from its extent in many directions.
    ends = np.array([shape.farthest(way) for way in np.concatenate([np.eye(3), -np.eye(3)])])
    centre = 0.5 * (ends.min(axis=0) + ends.max(axis=0))
    tips = np.array([shape.farthest(way) for way in lebedev_rule(17)[0].T])
    smallest = np.linalg.norm(tips - centre, axis=1).max()

    # The flux of the incident sound cancels in the sum, so the sphere should be small. However, it
    # must keep away from other bodies, because the field is least accurate at surfaces.
    middle = centre[None]
    heights = [plane.height(middle)[0] for plane in scene.planes]
    nearest = np.linalg.norm(array.face_points.reshape(-1, 3) - centre, axis=1).min()
    free = min(nearest, -scene.depth(middle)[0], *heights, np.inf) - smallest
    if free < scene.wavelength / 50.0:
        raise InvalidInput(
            f"the smallest sphere around the body at {in_mm(centre)} has a radius of "
            f"{millimetres(smallest, 3)} and touches another body, a plane or an element. Move the "
            "body away from it.",
            centre,
            code="bodies_overlap",
        )
    radius = smallest + min(0.5 * free, smallest, scene.wavelength / 8.0)

    # The flux is quadratic in the field, so it has twice the order. Waves above order kr + 10 are
    # below 1e-6. With fewer points, errors of the panels would cause aliasing.
    needed = 2.0 * (scene.wavenumber.real * radius + 10.0)
    orders = [order for order in (17, 23, 29, 41, 53, 65, 83, 101, 131) if order >= needed]
    if not orders:
        raise InvalidInput(
            "the force is computed on a sphere around the body, which would have a radius of "
            f"{millimetres(radius, 3)}, more than 8 wavelengths. Use a smaller body.",
            centre,
            code="out_of_range",
        )
    columns, weights = lebedev_rule(orders[0])
    normals = columns.T
    field = radiate_drives(whole, array, [drive], solver)
    points = centre + radius * normals
    pressure = field.at(points)[:, 0]
    velocity = field.velocity(points)[:, :, 0]
    through = np.sum(velocity * normals, axis=1)
    carried = 0.5 * scene.medium.density * (velocity.conj() * through[:, None]).real
    push = radiation_pressure(pressure, velocity, scene.medium)[:, None] * normals + carried
    force = -(radius**2) * weights @ push
    torque = -(radius**3) * weights @ np.cross(normals, push)
    if about is not None:
        torque = torque + np.cross(centre - point_of(about, "the point of the torque"), force)
    return force, torque
