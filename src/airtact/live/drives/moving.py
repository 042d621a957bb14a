"""Drives for foci that run along paths on a hand that moves itself: all frames of a round, made anew for each pose."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Complex64, Complex128, Float32, Float64

from airtact.acoustics.target import Target
from airtact.drives.gerchberg_saxton import SINGLE, alternating_projections, phase
from airtact.drives.methods import FOR_SAMPLES, METHODS
from airtact.drives.transfer import TransferMatrix
from airtact.live.drives.riding import Riding
from airtact.live.parts import LiveScene, MovingFoci

ITERATIONS = 10
"""Of weighted Gerchberg-Saxton for each frame, from the phases at the foci of the round before."""

Frames = Complex128[np.ndarray, "frames elements"]


OpenAirRows = Callable[[Float64[np.ndarray, "foci 3"]], Complex128[np.ndarray, "foci elements"]]


def moving_points(moving: MovingFoci, riding: Riding) -> Float64[np.ndarray, "frames together 3"]:
    """Return where the K foci of each of N frames are on a hand (N, K, 3) [m]."""
    shifts = np.einsum("nki,nkij->nkj", moving.shifts, riding.frames[moving.places])
    return riding.foci[moving.places] + shifts


class Rounds:
    """Makes the frames of one round after another.

    Parameters
    ----------
    scene : of the live loop.
    moving : how its foci do.
    open_air : gives the pressure at foci (F, 3) per unit drive of each element in open air (F, E)
        [Pa].
    """

    def __init__(self, scene: LiveScene, moving: MovingFoci, open_air: OpenAirRows) -> None:
        self._moving, self._open_air, self._sounding = moving, open_air, scene.sounding
        self._positions = scene.sounding.array.positions.astype(np.float32)
        self._wavenumber = scene.medium.wavenumber(scene.frequency)
        self._before: Frames | None = None
        self._sources = np.ones(moving.places.shape, dtype=np.complex128)

    def frames(
        self,
        riding: Riding,
        factors: Complex64[np.ndarray, "points sounding"] | None,
        method: str,
    ) -> Frames:
        """Make the frames for a hand in a pose.

        Parameters
        ----------
        riding : the hand now.
        factors : (N K, R) of the hand on the pressure at each focus of each frame; None for open
            air.
        method : name of the method that makes each drive; "best", as those for samples, is weighted
            Gerchberg-Saxton.

        Returns
        -------
        (N, E) drives. Each has the global phase that brings it nearest to the one before and to its own in the round
        before, so that amplitudes and phases step little from frame to frame.
        """
        points = moving_points(self._moving, riding)
        rows = self._rows(riding, points.reshape(-1, 3))
        rows = self._sounding.folded(rows if factors is None else rows * factors)
        matrices = rows.reshape(*points.shape[:2], -1)
        if method == "best" or method in FOR_SAMPLES:
            frames, self._sources = _projected(matrices, along_the_round(self._sources))
        else:
            pairs = zip(matrices, points, strict=True)
            drives = [
                METHODS[method](TransferMatrix(one, float("nan")), Target(foci))
                for one, foci in pairs
            ]
            frames = np.stack([drive.amplitudes for drive in drives])
        self._before = frames = aligned(frames, self._before)
        return frames

    def _rows(
        self, riding: Riding, points: Float64[np.ndarray, "points 3"]
    ) -> Complex128[np.ndarray, "points sounding"]:
        """Pressure at displaced foci per unit drive of each element in open air [Pa], in single precision.

        Beside a place an element radiates as towards the place itself: its row is carried on by the
        other distance.
        """
        places = self._moving.places.ravel()
        before = self._away(riding.foci.astype(np.float32))[places]
        after = self._away(points.astype(np.float32))
        delay = np.float32(self._wavenumber.real) * (after - before)
        carried = np.empty(delay.shape, dtype=np.complex64)
        carried.real, carried.imag = np.cos(delay), np.sin(delay)
        return self._open_air(riding.foci)[places] * (before / after * carried)

    def _away(
        self, points: Float32[np.ndarray, "points 3"]
    ) -> Float32[np.ndarray, "points elements"]:
        """Distance of each point from the middle of each element [m]."""
        ways = points[:, None] - self._positions
        return np.sqrt(np.einsum("ped,ped->pe", ways, ways))


def aligned(frames: Frames, before: Frames | None) -> Frames:
    """Turn the phase of each frame towards the one before and towards its own in the round before.

    Without the latter all that follows a frame unlike its neighbour may be opposite to what it was.
    """
    for index, frame in enumerate(frames):
        near = [frames[index - 1]] if index else []
        near += [] if before is None else [before[index]]
        frames[index] *= _turn(frame, np.sum(near, axis=0)) if near else 1.0
    return frames


def turned_towards(
    drives: Complex128[np.ndarray, "*shape"], before: Complex128[np.ndarray, "*shape"]
) -> Complex128[np.ndarray, "*shape"]:
    """Give drives the global phase that brings them nearest to others, which no focus feels."""
    return drives * _turn(drives, before)


def _turn(
    one: Complex128[np.ndarray, "*shape"], towards: Complex128[np.ndarray, "*shape"]
) -> complex:
    product = complex(np.vdot(one, towards))
    return product / abs(product) if product else 1.0


def along_the_round(
    sources: Complex128[np.ndarray, "frames together"],
) -> Complex128[np.ndarray, "frames together"]:
    """Bring the phases between the foci of each frame towards those of its neighbours; all of magnitude 1."""
    unit = phase(sources * phase(sources[:, :1]).conj())
    return phase(unit + 0.5 * (np.roll(unit, 1, axis=0) + np.roll(unit, -1, axis=0)))


def _projected(
    matrices: Complex128[np.ndarray, "frames together elements"],
    start: Complex128[np.ndarray, "frames together"],
) -> tuple[Frames, Complex128[np.ndarray, "frames together"]]:
    """Make the weakest focus of each frame strong, every element at full scale, from sources at the foci."""
    count, together, elements = matrices.shape
    sets = np.arange(count * together).reshape(count, together)
    rows = matrices.reshape(-1, elements)
    sources, _, drives = alternating_projections(rows, sets, np.ones(sets.shape), start, ITERATIONS)
    return (SINGLE * drives).astype(np.complex128), sources.astype(np.complex128)
