"""Sequences of drives that carry a bead along a path."""

from itertools import pairwise
from typing import Literal

import numpy as np
from jaxtyping import Float64, Real

from airtact.acoustics.scene import Scene
from airtact.acoustics.solvers.problem import RadiatedField, Solver
from airtact.acoustics.target import Target
from airtact.drives.drive import Drive
from airtact.drives.methods import best
from airtact.drives.sequence import Sequence
from airtact.drives.transfer import transfer_matrix
from airtact.errors import InvalidInput, Vector, in_mm, points_of, within
from airtact.evaluation.field import radiate_drives
from airtact.transducers.layout import PhasedArray
from airtact.traps.gorkov import (
    Bead,
    bead_of,
    default_solver,
    derivatives,
    force_of,
    stiffness_of,
)
from airtact.traps.holding import Trap, holding


def path(
    scene: Scene,
    array: PhasedArray,
    corners: Real[np.ndarray, "corners 3"],
    kind: Literal["twin", "vortex"] = "twin",
    axis: Vector = (0, 1, 0),
    speed: float = 0.02,
    share: float = 0.3,
    radius: float = 0.65e-3,
    density: float = 29.36,
    sound_speed: float = 900.0,
    solver: Solver | None = None,
) -> Sequence:
    """Return a sequence of drives that carries a bead along straight lines and back.

    A bead follows if the next trap is closer than the distance at which the trap's restoring force
    peaks. In a standing wave, this distance is an eighth of a wavelength. For each frame, the
    function checks that the trap can hold more than the bead's weight, and that the bead's previous
    resting position is nearer to the trap than the peak of the restoring force. Inertia and drag
    are not included.

    Parameters
    ----------
    scene, array, kind, axis, solver : as for ``hold``.
    corners : (C, 3) corners of the path [m]. The sequence repeats, so the bead returns the same way
        unless the last corner equals the first.
    speed : largest mean speed of the bead [m/s].
    share : largest step between frames, as a fraction of the distance at which the restoring force
        peaks; at most 0.9.
    radius, density, sound_speed : properties of the bead, as for ``force``.

    Raises
    ------
    InvalidInput
        If the bead would be lost between two frames, if there are fewer than two corners, or if a
        number is out of range. Also for the reasons listed in ``hold``.

    Examples
    --------
    >>> import airtact as at
    >>> caps = at.transducers.known_array("tinylev")
    >>> len(path(Scene(at.air()), caps, np.array([[0, 0, 0], [0, 2e-3, 0]])))
    12
    """
    bead = bead_of(scene, radius, density, sound_speed)
    speed = within(speed, 0.0, 10.0, "the speed of a bead", "m/s", "use metres per second.")
    share = within(share, 0.0, 0.9, "the share of a step", "", "smaller steps are safer.")
    corners = points_of(corners, "the corners of a path")
    if np.ptp(corners, axis=0).max() < 1e-6:
        raise InvalidInput("a path needs at least two different corners.", code="too_few")
    solver = solver or default_solver(scene)
    if np.linalg.norm(corners[-1] - corners[0]) > 1e-6:
        corners = np.concatenate([corners, corners[-2::-1]])

    def field_of(points: Float64[np.ndarray, "points 3"]) -> tuple[list[Drive], RadiatedField]:
        """Solve for a trap at each point; each trap is a separate excitation."""
        traps = [Trap(tuple(point), kind, axis) for point in points]
        lobes = np.array([trap.lobes(scene.wavelength) for trap in traps])
        target = Target(lobes.reshape(-1, 3))
        transfer = transfer_matrix(solver.radiate(scene, target.beacons()), array)
        rows = np.arange(len(target.points)).reshape(len(points), -1)
        drives = [
            holding(best, [trap])(transfer.of_rows(own), Target(lobes[index]))
            for index, (trap, own) in enumerate(zip(traps, rows, strict=True))
        ]
        return drives, radiate_drives(scene, array, drives, solver, foci=points)

    # Divide each line between two corners into points, without the last one.
    _, field = field_of(corners)
    points = []
    for index, (start, end) in enumerate(pairwise(corners)):
        way = end - start
        first = _reach(field, bead, start, way, index)
        reach = min(first, _reach(field, bead, end, way, index + 1))
        steps = int(np.ceil(np.linalg.norm(way) / max(share * reach, 1e-6)))
        points.append(start + way * np.arange(steps)[:, None] / max(steps, 1))
    points = np.concatenate(points)
    drives, field = field_of(points)
    _check_followed(field, bead, points)
    longest = np.linalg.norm(np.diff(points, axis=0, append=points[:1]), axis=1).max()
    return Sequence(np.array([drive.amplitudes for drive in drives]), speed / longest)


def _reach(
    field: RadiatedField,
    bead: Bead,
    point: Float64[np.ndarray, "3"],
    way: Float64[np.ndarray, "3"],
    excitation: int,
) -> float:
    """Return the distance [m] behind a trap at which the force along the path first peaks."""
    way = way / max(np.linalg.norm(way), 1e-12)
    distances = field.scene.wavelength / 4.0 * np.linspace(0.05, 1.0, 20)
    behind = point - distances[:, None] * way
    sound = derivatives(field, behind, bead, np.full(20, excitation))
    pull = force_of(sound, bead, field.scene) @ way
    rising = np.append(np.diff(pull) > 0.0, False)
    return float(distances[rising.argmin()])


def _check_followed(
    field: RadiatedField, bead: Bead, points: Float64[np.ndarray, "points 3"]
) -> None:
    """Raise ``InvalidInput`` unless the bead follows from each equilibrium to the next."""
    excitations = np.arange(len(points))
    sound = derivatives(field, points, bead, excitations)
    matrices = stiffness_of(sound, bead, field.scene)
    pulls = force_of(sound, bead, field.scene)
    rests = points + np.einsum("pij,pj->pi", np.linalg.pinv(matrices, rcond=1e-6), pulls)
    before = np.roll(rests, 1, axis=0)
    ways = rests - before
    sound = derivatives(field, before, bead, excitations)
    restoring = np.einsum("pi,pi->p", force_of(sound, bead, field.scene), ways)
    linear = np.einsum("pi,pij,pj->p", ways, matrices, ways)
    # In a standing wave, the force sin(2kx) K/(2k) peaks at K λ/(4π), 2/π of the linear force.
    holds = np.linalg.eigvalsh(matrices)[:, 0] * field.scene.wavelength / (4.0 * np.pi)
    lost = (holds <= 9.80665 * bead.mass) | (restoring < 2.0 / np.pi * linear)
    if lost.any():
        index = int(lost.argmax())
        raise InvalidInput(
            f"the bead would be lost on its way to {in_mm(points[index])}. Move the path, choose "
            "another axis, or set a smaller share.",
            points[index],
            code="misplaced",
        )
