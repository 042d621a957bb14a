"""The pressure on the skin and in a slice that the page shows, including scattering by the hand.

A low-priority process solves for the whole hand with the newest drive, on panels that
bend with the hand. This takes most of a second, so the page displays the age of the
result.
"""

import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Complex128, Float64
from scipy.ndimage import zoom
from scipy.spatial import KDTree

from airtact.acoustics.sources import Monopoles
from airtact.errors import InvalidInput, NotConverged
from airtact.live.drives.bending import BendingHand
from airtact.live.scene import Amplitudes, Foci, Joints, LiveScene, pose_hand
from airtact.live.worker import Mailbox
from airtact.timing import give_way

# Side length of a slice [m].
SLICE_SIZE = 0.12

# Points along each side of a slice; a quarter of a wavelength apart at 40 kHz.
SLICE_POINTS = 56

Axis = Literal["x", "y", "z"]
Vector = Float64[np.ndarray, "3"]


@dataclass(frozen=True, eq=False)
class Section:
    """A plane slice of the field.

    Attributes
    ----------
    foci : (3,) mean position of the foci [m].
    across : axis normal to the slice.
    offset : offset of the slice from ``foci`` along the axis ``across`` [m].
    """

    foci: Vector
    across: Axis
    offset: float

    @property
    def axes(self) -> Float64[np.ndarray, "3 3"]:
        """Right-handed axes, one per row: right, up, and normal to the slice."""
        x, y, z = np.eye(3)
        along, up = {"x": (y, z), "y": (x, z), "z": (x, y)}[self.across]
        return np.stack([along, up, np.cross(along, up)])

    @property
    def middle(self) -> Vector:
        """Centre of the slice [m]."""
        return self.foci + self.offset * np.abs(self.axes[2])

    def points(self) -> Float64[np.ndarray, "points 3"]:
        """Return the points of the slice, row by row from the top [m]."""
        along, up, _ = self.axes
        steps = np.linspace(-0.5, 0.5, SLICE_POINTS) * SLICE_SIZE
        points = self.middle + steps[None, :, None] * along - steps[:, None, None] * up
        return points.reshape(-1, 3)


def enlarged(field: Complex128[np.ndarray, "points"]) -> Float64[np.ndarray, "rows columns"]:
    """Return the magnitude of a slice's field at every pixel, interpolated by cubic splines."""
    # Two pixels per point along each side.
    return np.abs(np.asarray(zoom(field.reshape(SLICE_POINTS, SLICE_POINTS), 2)))


def element_sources(scene: LiveScene, amplitudes: Amplitudes, middle: Vector) -> Monopoles:
    """Return monopoles that replace the elements and images for sound near ``middle`` (3,) [m].

    Near ``middle``, the monopoles produce the same pressure as the elements modelled with their
    full faces.
    """
    array = scene.with_images.array
    directions = middle - array.positions
    lengths = np.linalg.norm(directions, axis=1, keepdims=True)
    directions = directions / np.maximum(lengths, 1e-9)
    bitangents = np.cross(array.normals, array.tangents)
    axes = np.stack([array.tangents, bitangents, array.normals], axis=1)
    local = np.einsum("ed,ecd->ec", directions, axes)
    pattern = array.element.far_pattern(local, scene.wavenumber.real)
    if array.element.directional:
        pattern = pattern * (local[:, 2] > 0.0)
    driven = scene.with_images.unfolded(amplitudes)
    strengths = array.element.sensitivity * array.gains * pattern * driven
    return Monopoles(array.positions, strengths[:, None])


@dataclass(frozen=True, eq=False)
class SoundRequest:
    """A hand and a drive for which the pressure is to be computed.

    Attributes
    ----------
    time : time of the request, as returned by ``time.monotonic`` [s].
    joints : (25, 3) joints of the hand [m].
    foci : (F, 3) positions of the foci [m].
    amplitudes : (E,) amplitudes of the drive, as fractions of full scale.
    skin : (V, 3) points on the skin [m].
    section : slice in which the pressure is computed.
    """

    time: float
    joints: Joints
    foci: Foci
    amplitudes: Amplitudes
    skin: Float64[np.ndarray, "skin 3"]
    section: Section


@dataclass(frozen=True, eq=False)
class Sound:
    """The pressure computed for a ``SoundRequest``.

    Attributes
    ----------
    time : time of the request, as returned by ``time.monotonic`` [s].
    skin : (V,) peak pressure on the skin [Pa].
    section : slice in which the pressure was computed.
    field : (P,) pressure at the points of the slice [Pa]; 0 inside the hand.
    """

    time: float
    skin: Float64[np.ndarray, "skin"]
    section: Section
    field: Complex128[np.ndarray, "points"]


def solved_sound(scene: LiveScene, hand: BendingHand, request: SoundRequest) -> Sound:
    """Compute the pressure on the skin and in the slice for a request.

    ``hand`` is the solver for a hand in successive poses. It must keep all panels.

    Raises
    ------
    InvalidInput
        If the joints do not form a hand, or a focus lies inside the hand.
    NotConverged
        If the iteration does not converge.
    """
    sources = element_sources(scene, request.amplitudes, request.foci.mean(axis=0))
    solution = hand.received(request.joints, sources, 0.05)
    # Interpolate the pressure on the skin between the three nearest nodes of the panels. The
    # lower bound avoids a division by zero at a node.
    away, nearest = KDTree(solution.surface.nodes.points).query(request.skin, 3)
    weights = 1.0 / np.maximum(away, 1e-5) ** 2
    weights /= weights.sum(axis=1, keepdims=True)
    skin = np.einsum("pn,pn->p", weights, solution.pressure[nearest, 0])
    points = request.section.points()
    look = pose_hand(scene, request.joints).hand.shape.hulls.look(points)
    outside = look.distance > 0.0
    # Within 1 mm of the skin the panels are too coarse, so move such points out to 1 mm.
    lift = np.maximum(1e-3 - look.distance, 0.0)
    lifted = (points + lift[:, None] * look.gradient)[outside]
    field = np.zeros(len(points), dtype=np.complex128)
    field[outside] = solution.at(lifted, np.zeros(len(lifted), dtype=bool))[:, 0]
    return Sound(request.time, np.abs(skin), request.section, field)


def solve_sounds(mailbox: Mailbox, send: Callable[[Sound], None], scene: LiveScene) -> None:
    """Compute the pressure for the newest request until no more requests arrive."""
    give_way(8)  # a priority between those of the loop's own solvers
    hand = BendingHand(scene, accuracy=0.1, min_seen=0.0)
    while (request := mailbox.take()) is not None:
        begun = time.process_time()
        with suppress(InvalidInput, NotConverged):
            send(solved_sound(scene, hand, request))
        # Limit the process to 40 % of a processor.
        time.sleep(1.5 * (time.process_time() - begun))
