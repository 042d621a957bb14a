"""Drives that hold several beads at once and can also create foci.

Source: A. Marzo and B. W. Drinkwater, "Holographic acoustic tweezers", PNAS 116, 84 (2019).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Complex128, Float64, Real
from scipy.linalg import block_diag

from airtact.acoustics.scene import Scene, check_outside
from airtact.acoustics.solvers.problem import Solver
from airtact.acoustics.target import Target
from airtact.drives.drive import Drive
from airtact.drives.methods import best
from airtact.drives.transfer import TransferMatrix, transfer_matrix
from airtact.errors import InvalidInput, Vector, check_choice, in_mm, point_of, points_of
from airtact.transducers.layout import PhasedArray
from airtact.traps.gorkov import Bead, bead_of, default_solver


@dataclass(frozen=True)
class Trap:
    """A requested trap with its bead.

    Attributes
    ----------
    point : (3,) position of the centre of the bead [m].
    kind : "twin" for two lobes of opposite phase, one on each side of the bead along ``axis``;
        "vortex" for a ring of high pressure around ``axis`` whose phase increases by 2π.
    axis : (3,) direction of the axis, of any length.
    radius, density, sound_speed : radius [m], density [kg/m³] and speed of sound [m/s] of the
        bead; by default, a bead of expanded polystyrene with a radius of 0.65 mm.
    """

    point: Vector
    kind: Literal["twin", "vortex"] = "twin"
    axis: Vector = (0, 1, 0)
    radius: float = 0.65e-3
    density: float = 29.36
    sound_speed: float = 900.0

    def lobes(self, wavelength: float) -> Float64[np.ndarray, "lobes 3"]:
        """Return points (L, 3) on the lobes of pressure next to the bead [m]; 2 for a twin trap."""
        check_choice(self.kind, "the kind of trap", ("twin", "vortex"))
        axis = point_of(self.axis, "the axis of a trap")
        if not np.linalg.norm(axis) > 0.0:
            raise InvalidInput(
                "the axis of a trap has length 0; use a nonzero vector.", code="all_zero"
            )
        axis = axis / np.linalg.norm(axis)
        ways = np.stack([axis, -axis])
        if self.kind == "vortex":
            # The phase can start in any direction perpendicular to the axis.
            start = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
            start = start / np.linalg.norm(start)
            across = np.cross(axis, start)
            ways = np.stack([start, across, -start, -across])
        # Between opposed boards, the lobes are a quarter of a wavelength from the bead. At that
        # distance, however, lobes of beads half a wavelength apart would coincide.
        return point_of(self.point, "a trap") + wavelength / 6.0 * ways

    def bead(self, scene: Scene) -> Bead:
        """Return the bead, or raise ``InvalidInput`` if a number is out of range."""
        return bead_of(scene, self.radius, self.density, self.sound_speed)

    @property
    def phasing(self) -> Complex128[np.ndarray, "lobes"]:
        """Weights (L,) with which the lobe pressures of an ideal trap add up in phase."""
        count = 2 if self.kind == "twin" else 4
        return np.exp(-2j * np.pi * np.arange(count) / count) / count


def target_of(
    traps: Sequence[Trap],
    wavelength: float,
    foci: Real[np.ndarray, "foci 3"] | None = None,
    focus_share: float = 1.0,
) -> Target:
    """Return a target for ``holding``: the lobes of all traps, followed by the foci."""
    points = np.concatenate([trap.lobes(wavelength) for trap in traps])
    if foci is None:
        return Target(points)
    foci = points_of(foci, "the foci beside traps")
    shares = np.concatenate([np.ones(len(points)), np.full(len(foci), focus_share)])
    return Target(np.concatenate([points, foci]), shares=shares)


def check_free(traps: Sequence[Trap], scene: Scene) -> None:
    """Raise ``InvalidInput`` if a trap or one of its lobes is in a body or behind a plane."""
    if not traps:
        return
    points = np.array([point_of(trap.point, "a trap") for trap in traps])
    check_outside(scene, points, "trap")
    for index, trap in enumerate(traps):
        depth = scene.depth(trap.lobes(scene.wavelength)).max()
        if depth > 0.0:
            raise InvalidInput(
                f"trap {index} at {in_mm(points[index])} is too close to a body: one of its lobes, "
                f"{1e3 * scene.wavelength / 6.0:.2g} mm from the bead, is {1e3 * depth:.2g} mm "
                "inside the body. Move the trap away, or turn its axis.",
                points[index],
                code="inside_body",
            )


def merged(traps: Sequence[Trap], target: Target) -> Target:
    """Return the target of ``target_of`` with one focus per trap in place of its lobes."""
    counts = [len(trap.phasing) for trap in traps]
    points = [point_of(trap.point, "a trap")[None] for trap in traps]
    first = np.cumsum([0, *counts[:-1]])
    kept = np.concatenate([first, np.arange(sum(counts), len(target.points))])
    return Target(
        np.concatenate([*points, target.points[sum(counts) :]]),
        shares=None if target.shares is None else target.shares[kept],
        suppression_points=target.suppression_points,
    )


def holding(
    method: Callable[[TransferMatrix, Target], Drive], traps: Sequence[Trap]
) -> Callable[[TransferMatrix, Target], Drive]:
    """Adapt a method for foci so that it also computes traps.

    The adapted method takes the target of ``target_of`` and its transfer matrix. It replaces the
    lobes of each trap by a single focus, whose pressure is the sum of the lobe pressures with the
    weights ``Trap.phasing``. For a single trap, the drive has the phases of the trap's signature
    (see ``signature``).
    """

    def make(transfer: TransferMatrix, target: Target) -> Drive:
        phasing = [trap.phasing for trap in traps]
        rest = np.eye(len(transfer.matrix) - sum(len(weights) for weights in phasing))
        matrix = block_diag(*phasing, rest) @ transfer.matrix
        return method(TransferMatrix(matrix, transfer.estimated_error), merged(traps, target))

    return make


def hold(
    scene: Scene,
    array: PhasedArray,
    points: Real[np.ndarray, "traps 3"],
    kind: Literal["twin", "vortex"] = "twin",
    axis: Vector = (0, 1, 0),
    foci: Real[np.ndarray, "foci 3"] | None = None,
    focus_share: float = 1.0,
    solver: Solver | None = None,
) -> Drive:
    """Return a drive that creates a trap at each point and, optionally, foci on the skin.

    Parameters
    ----------
    scene : the air and the bodies in it.
    array : transducers in the frame of the scene.
    points : (T, 3) positions of the traps [m]. Traps shift each other slightly; ``find`` returns
        the positions at which the beads come to rest.
    kind, axis : kind and axis of all traps, see ``Trap``. Between boards that face each other, use
        "twin" along the normal of the boards.
    foci : (F, 3) additional foci on the skin [m]; none by default.
    focus_share : pressure at the foci divided by the pressure at the lobes of the traps.
    solver : solver that computes the field, as for ``force``.

    Returns
    -------
    The drive. It maximises the pressure of the weakest trap or focus, as ``best`` does.

    Raises
    ------
    InvalidInput
        If a lobe or a focus is in a body or behind the array, if the kind is unknown, or if the
        axis is zero.

    Examples
    --------
    >>> import airtact as at
    >>> places = np.array([[0, -0.1, 0], [0, 0.1, 0]])
    >>> pair = PhasedArray(places, np.array([[0, 1, 0], [0, -1, 0]]))
    >>> drive = hold(Scene(at.air()), pair, np.zeros((1, 3)))
    >>> np.round(drive.amplitudes[1] / drive.amplitudes[0], 6).real.item()
    -1.0
    """
    traps = [Trap(tuple(point), kind, axis) for point in points_of(points, "trap points")]
    check_free(traps, scene)
    target = target_of(traps, scene.wavelength, foci, focus_share)
    field = (solver or default_solver(scene)).radiate(scene, target.beacons())
    return holding(best, traps)(transfer_matrix(field, array), target)
