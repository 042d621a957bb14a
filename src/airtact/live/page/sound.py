"""The sound that the page shows on the skin and in a slice: direct, or solved with the hand.

The whole hand is solved for the newest drive, on panels that bend with it, in a process of low
priority. This takes the better part of a second, so the page states the age of the result.
"""

import os
import time
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection
from typing import Literal

import numpy as np
from jaxtyping import Complex128, Float64
from scipy.ndimage import zoom
from scipy.spatial import KDTree

from airtact.acoustics.solvers.bem.solutions import DirectSolution
from airtact.acoustics.solvers.open_air import monopole_pressure
from airtact.acoustics.sources import Monopoles
from airtact.errors import InvalidInput, NotConverged
from airtact.hands.shape import Hulls
from airtact.live.drives.bending import BendingHand
from airtact.live.scene import Amplitudes, Foci, Joints, LiveScene, pose_hand
from airtact.timing import give_way

SLICE_SIZE = 0.12
"""Side of a slice [m]."""

SLICE_POINTS = 56
"""Points along a side of a slice, a quarter of a wavelength apart at 40 kHz."""

SLICE_ZOOM = 2
"""Pixels per point of a slice along each side."""

Axis = Literal["x", "y", "z"]
Points = Float64[np.ndarray, "points 3"]
Vector = Float64[np.ndarray, "3"]


@dataclass(frozen=True, eq=False)
class Section:
    """A slice of the field.

    Attributes
    ----------
    foci : (3,) centre of the foci [m].
    across : axis normal to the slice.
    offset : of the slice from the foci along that axis [m].
    """

    foci: Vector
    across: Axis
    offset: float

    @property
    def axes(self) -> Float64[np.ndarray, "3 3"]:
        """Axes along the slice, up in it and across it, one per row; a right-handed system."""
        x, y, z = np.eye(3)
        along, up = {"x": (y, z), "y": (x, z), "z": (x, y)}[self.across]
        return np.stack([along, up, np.cross(along, up)])

    @property
    def middle(self) -> Vector:
        """Centre of the slice [m]."""
        return self.foci + self.offset * np.abs(self.axes[2])

    def points(self) -> Points:
        """Return the points, row by row from the top [m]."""
        along, up, _ = self.axes
        steps = np.linspace(-0.5, 0.5, SLICE_POINTS) * SLICE_SIZE
        points = self.middle + steps[None, :, None] * along - steps[:, None, None] * up
        return points.reshape(-1, 3)


def enlarged(field: Complex128[np.ndarray, "points"]) -> Float64[np.ndarray, "rows columns"]:
    """Return the magnitude of a slice's field at each pixel, interpolated by cubic splines."""
    return np.abs(np.asarray(zoom(field.reshape(SLICE_POINTS, SLICE_POINTS), SLICE_ZOOM)))


class DirectSound:
    """The direct sound of an array's drives, without the sound that the hand scatters.

    Each element is a point source with the strength that it radiates towards ``middle``; near there
    the pressure is that of the whole element.

    Parameters
    ----------
    scene : its medium, frequency and array are used.
    """

    def __init__(self, scene: LiveScene) -> None:
        self._with_images = scene.with_images
        self._array = scene.with_images.array
        self._wavenumber = scene.wavenumber
        # (R, A) which source is on which face of the array: those that look in one direction.
        normals = self._array.normals
        faces = []
        left = np.ones(len(normals), dtype=bool)
        while left.any():
            face = left & (normals @ normals[int(np.argmax(left))] > 0.99)
            faces.append(face.astype(np.float64))
            left &= ~face
        self._faces = np.stack(faces, axis=1)

    def at(
        self, points: Points, amplitudes: Amplitudes, middle: Vector
    ) -> Complex128[np.ndarray, "points"]:
        """Return the pressure in open air at points (P, 3) [m]: (P,) [Pa]."""
        return self._pressure(points, self._strengths(amplitudes, middle)[:, None])[:, 0]

    def sources(self, amplitudes: Amplitudes, middle: Vector) -> Monopoles:
        """Return the elements and images as monopoles that radiate towards ``middle`` [m] alike."""
        return Monopoles(self._array.positions, self._strengths(amplitudes, middle)[:, None])

    def on_skin(
        self, points: Points, normals: Points, amplitudes: Amplitudes, middle: Vector
    ) -> Float64[np.ndarray, "points"]:
        """Return the magnitude on a hard skin (P,) [Pa]: twice the direct sound where lit, else 0.

        This is the Kirchhoff approximation: no part of the hand shades another or scatters sound to
        it. The sound of each face of the array is taken to come from that face's centre.

        Source: A. D. Pierce, *Acoustics* (3rd edition), section 9.2: twice the incident pressure on
        the lit side.
        """
        strengths = self._strengths(amplitudes, middle)[:, None] * self._faces
        pressures = self._pressure(points, strengths)
        weight = np.abs(strengths) + 1e-300
        centres = weight.T @ self._array.positions / weight.sum(axis=0)[:, None]
        lit = np.einsum("pfd,pd->pf", centres[None] - points[:, None], normals) > 0.0
        return 2.0 * np.abs((pressures * lit).sum(axis=1))

    def _strengths(
        self, amplitudes: Amplitudes, middle: Vector
    ) -> Complex128[np.ndarray, "sources"]:
        array = self._array
        directions = middle - array.positions
        lengths = np.linalg.norm(directions, axis=1, keepdims=True)
        directions = directions / np.maximum(lengths, 1e-9)
        bitangents = np.cross(array.normals, array.tangents)
        axes = np.stack([array.tangents, bitangents, array.normals], axis=1)
        local = np.einsum("ed,ecd->ec", directions, axes)
        pattern = array.element.far_pattern(local, self._wavenumber.real)
        if array.element.directional:
            pattern = pattern * (local[:, 2] > 0.0)
        driven = self._with_images.unfolded(amplitudes)
        return array.element.sensitivity * array.gains * pattern * driven

    def _pressure(
        self, points: Points, strengths: Complex128[np.ndarray, "sources faces"]
    ) -> Complex128[np.ndarray, "points faces"]:
        positions = self._array.positions
        return monopole_pressure(points, positions, strengths, self._wavenumber, "float32")


@dataclass(frozen=True, eq=False)
class SoundRequest:
    """A moment whose sound is to be solved.

    Attributes
    ----------
    time : by ``time.monotonic`` [s].
    joints : (25, 3) of the hand [m].
    foci : (F, 3) [m].
    amplitudes : (E,) of the drive, share of full scale.
    skin : (V, 3) points on its skin [m].
    section : the slice.
    """

    time: float
    joints: Joints
    foci: Foci
    amplitudes: Amplitudes
    skin: Float64[np.ndarray, "skin 3"]
    section: Section


@dataclass(frozen=True, eq=False)
class Sound:
    """The sound of a moment.

    Attributes
    ----------
    time : when it was requested, by ``time.monotonic`` [s].
    hand : whether the hand is included; otherwise it is the direct sound.
    skin : (V,) peak pressure on the skin [Pa].
    section : the slice.
    field : (P,) pressure at its points [Pa], 0 inside an included hand.
    """

    time: float
    hand: bool
    skin: Float64[np.ndarray, "skin"]
    section: Section
    field: Complex128[np.ndarray, "points"]


class SoundSolver:
    """Solves the sound of one hand after another.

    Parameters
    ----------
    scene : of the live loop.
    """

    def __init__(self, scene: LiveScene) -> None:
        self._scene = scene
        self._direct = DirectSound(scene)
        self._hand = BendingHand(scene, accuracy=0.1, min_seen=0.0)

    def solved(self, request: SoundRequest) -> Sound:
        """Solve a moment.

        Raises
        ------
        InvalidInput
            The joints are not those of a hand, or a focus lies inside it.
        NotConverged
            The iteration did not converge.
        """
        sources = self._direct.sources(request.amplitudes, request.foci.mean(axis=0))
        solution = self._hand.received(request.joints, sources, 0.05)
        # On the skin the pressure is interpolated between the three nearest nodes of the panels;
        # the bound avoids a division by zero at a node.
        nodes = KDTree(solution.surface.nodes.points)
        away, nearest = nodes.query(request.skin, 3)
        weights = 1.0 / np.maximum(away, 1e-5) ** 2
        weights /= weights.sum(axis=1, keepdims=True)
        skin = np.einsum("pn,pn->p", weights, solution.pressure[nearest, 0])
        hulls = pose_hand(self._scene, request.joints).hand.shape.hulls
        field = _field_around(solution, hulls, request.section.points())
        return Sound(request.time, True, np.abs(skin), request.section, field)


def _field_around(
    solution: DirectSolution, hulls: Hulls, points: Points
) -> Complex128[np.ndarray, "points"]:
    """Return the pressure at points; 0 inside the hand."""
    skin = hulls.look(points)
    outside = skin.distance > 0.0
    # The panels are too coarse within 1 mm of the skin: such points are lifted to that distance.
    lift = np.maximum(1e-3 - skin.distance, 0.0)
    lifted = points + lift[:, None] * skin.gradient
    field = np.zeros(len(points), dtype=np.complex128)
    field[outside] = solution.at(lifted[outside], np.zeros(int(outside.sum()), dtype=bool))[:, 0]
    return field


class SoundProcess:
    """Solves one moment after another in a process; ``ask`` and ``newest`` return at once.

    Parameters
    ----------
    scene : of the live loop.
    """

    def __init__(self, scene: LiveScene) -> None:
        spawning = get_context("spawn")
        self._pipe, theirs = spawning.Pipe()
        self._process = spawning.Process(target=_solve_requests, args=(scene, theirs), daemon=True)
        self._process.start()
        theirs.close()
        self._ready = False
        self.newest: Sound | None = None

    def ask(self, request: SoundRequest) -> None:
        """Request a solution, unless one is being solved."""
        with suppress(OSError, EOFError):  # after the process has died, nothing is solved any more
            while self._pipe.poll():
                answer = self._pipe.recv()
                self._ready = answer is None
                self.newest = answer or self.newest
            if self._ready:
                self._pipe.send(request)
                self._ready = False

    def close(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.join()
        self._pipe.close()


def _solve_requests(scene: LiveScene, pipe: Connection) -> None:
    """Send None when ready, then the sound of the request that comes, if it can be solved."""
    with suppress(AttributeError, OSError):
        os.setsid()
    give_way(8)  # between the priorities of the loop's own solvers
    solver = SoundSolver(scene)
    with suppress(OSError, EOFError):
        while True:
            pipe.send(None)
            request = pipe.recv()
            begun = time.process_time()
            with suppress(InvalidInput, NotConverged):
                pipe.send(solver.solved(request))
            # Solving takes at most 40 % of a processor.
            time.sleep(1.5 * (time.process_time() - begun))
