"""Phases that maximise the stiffness of the weakest trap."""

from typing import Literal

import numpy as np
from jaxtyping import Float64, Real
from scipy.optimize import minimize

from airtact.acoustics.scene import Scene, check_outside
from airtact.acoustics.solvers.problem import Solver
from airtact.acoustics.target import Target
from airtact.drives.drive import Drive
from airtact.drives.transfer import transfer_matrix
from airtact.errors import Vector, points_of
from airtact.transducers.layout import PhasedArray
from airtact.traps.gorkov import (
    DIRECTIONS,
    Derivatives,
    bead_of,
    default_solver,
    derivatives_inside,
    force_of,
    stiffness_of,
)
from airtact.traps.holding import hold


def stiffest(
    scene: Scene,
    array: PhasedArray,
    points: Real[np.ndarray, "traps 3"],
    kind: Literal["twin", "vortex"] = "twin",
    axis: Vector = (0, 1, 0),
    radius: float = 0.65e-3,
    density: float = 29.36,
    sound_speed: float = 900.0,
    solver: Solver | None = None,
) -> Drive:
    """Return a drive that maximises the stiffness of the weakest trap in its weakest direction.

    All elements are at full scale. Starting from the drive of ``hold``, L-BFGS improves the phases
    to a local maximum. The optimisation also keeps the force at the points small, so that the beads
    rest there.

    Parameters
    ----------
    scene, array, points, kind, axis, solver : as for ``hold``.
    radius, density, sound_speed : properties of the beads, as for ``force``.

    Raises
    ------
    InvalidInput
        If a point is within a sixth of a wavelength of a body, or for the reasons listed in
        ``hold`` and ``force``.

    Examples
    --------
    >>> import airtact as at
    >>> caps = at.transducers.known_array("tinylev")
    >>> air = Scene(at.air())
    >>> traps = np.array([[-6e-3, 0, 0], [6e-3, 0, 0]])
    >>> drives = hold(air, caps, traps), stiffest(air, caps, traps)
    >>> shifts = [np.abs(at.traps.find(air, caps, drive, traps) - traps).max() for drive in drives]
    >>> np.round(1e3 * np.array(shifts), 2).tolist()
    [0.3, 0.0]
    """
    bead = bead_of(scene, radius, density, sound_speed)
    points = points_of(points, "trap points")
    start = hold(scene, array, points, kind, axis, solver=solver)
    solver = solver or default_solver(scene)
    wavenumber = scene.wavenumber
    # Compute derivatives at the traps for every element, from beacons on spheres around the traps.
    size = 1.0 / wavenumber.real
    target = Target((points[:, None] + size * DIRECTIONS).reshape(-1, 3))
    check_outside(scene, target.points, "point around a trap")
    transfer = transfer_matrix(solver.radiate(scene, target.beacons()), array)
    traps = len(points)
    elements = len(array)
    pressure = transfer.matrix.reshape(traps, -1, elements).transpose(0, 2, 1)
    pressure = pressure.reshape(traps * elements, -1)
    waves = derivatives_inside(pressure, np.full(len(pressure), size), wavenumber)
    # Stack one row per derivative: 1 pressure, 3 first, 9 second and 27 third derivatives.
    parts = (waves.pressure, waves.first, waves.second, waves.third)
    rows = np.concatenate([part.reshape(traps, elements, -1) for part in parts], axis=2)
    a, b = bead.factors(scene)

    def sound_of(amplitudes: np.ndarray) -> Derivatives:
        values = np.einsum("ted,e->td", rows, amplitudes)
        return Derivatives(
            values[:, 0],
            values[:, 1:4],
            values[:, 4:13].reshape(-1, 3, 3),
            values[:, 13:].reshape(-1, 3, 3, 3),
        )

    sound = sound_of(start.at_full_scale().amplitudes)
    values, ways = np.linalg.eigh(stiffness_of(sound, bead, scene))
    scale = np.abs(values).min()
    # A shift of λ/30 costs as much as the stiffness at the start.
    sizes = np.maximum(np.abs(values), 1e-3 * np.abs(values).max())
    shifts = np.einsum("tik,tk,tjk->tij", ways, 30.0 / (scene.wavelength * sizes), ways)

    def loss(phases: Float64[np.ndarray, "elements"]) -> tuple[float, np.ndarray]:
        """Return a smooth maximum of the negative stiffnesses, and its gradient by the phases."""
        amplitudes = np.exp(1j * phases)
        sound = sound_of(amplitudes)
        values, ways = np.linalg.eigh(stiffness_of(sound, bead, scene))
        push = np.einsum("tij,tj->ti", shifts, force_of(sound, bead, scene))
        sharpness = 20.0
        least = values.min()
        shares = np.exp(-sharpness * (values - least) / scale)
        total = shares.sum()
        cost = np.log(total) / sharpness - least / scale + np.sum(push**2)
        # Derivatives of the cost by the stiffness matrices and forces.
        weight = -np.einsum("tik,tk,tjk->tij", ways, shares / total, ways) / scale
        pull = 2.0 * np.einsum("tij,tj->ti", shifts, push)
        # Derivatives by the conjugates of the values in ``sound``, from both formulas.
        p = sound.pressure
        g = sound.first
        h = sound.second
        along = np.einsum("ti,ti->t", pull, g)
        by_p = 2.0 * a * (np.einsum("tij,tij->t", weight, h) - along)
        by_g = 4.0 * a * np.einsum("tij,tj->ti", weight, g) - 2.0 * a * p[:, None] * pull
        by_g -= 2.0 * b * np.einsum("tij,tijk->tk", weight, sound.third)
        by_g += 2.0 * b * np.einsum("ti,tij->tj", pull, h)
        by_h = 2.0 * a * p[:, None, None] * weight - 4.0 * b * weight @ h
        by_h += 2.0 * b * np.einsum("ti,tj->tij", pull, g)
        by_third = -2.0 * b * np.einsum("tij,tk->tijk", weight, g)
        by_parts = [part.reshape(traps, -1) for part in (by_p, by_g, by_h, by_third)]
        by_values = np.concatenate(by_parts, axis=1).conj()
        by_amplitude = np.einsum("td,ted->e", by_values, rows)
        return cost, (by_amplitude * 1j * amplitudes).real

    best = minimize(loss, start.phases, jac=True, method="L-BFGS-B", options={"maxiter": 1000})
    return Drive(np.exp(1j * best.x))
