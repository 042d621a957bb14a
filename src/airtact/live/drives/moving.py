"""Drives for foci that move along paths on a moving hand: one cycle of frames per pose."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Complex64, Complex128, Float
from scipy.spatial.distance import cdist

from airtact.acoustics.target import Target
from airtact.drives.gerchberg_saxton import SINGLE, alternating_projections, phase
from airtact.drives.methods import METHODS
from airtact.drives.transfer import TransferMatrix
from airtact.live.scene import Foci, Frames, LiveScene, MovingFoci, PosedHand, Rows, moving_points


class Rounds:
    """Compute drives that move foci along their paths on a hand; call ``frames`` for each pose.

    Parameters
    ----------
    scene : scene of the live loop.
    moving : paths of the foci.
    open_air : function that returns the open-air pressure (F, R) [Pa] at foci (F, 3) per unit drive
        of each source.
    """

    def __init__(
        self, scene: LiveScene, moving: MovingFoci, open_air: Callable[[Foci], Rows]
    ) -> None:
        self._scene = scene
        self._moving = moving
        self._open_air = open_air
        self._previous: Frames | None = None
        self._phases = np.ones(moving.places.shape, dtype=np.complex128)

    def frames(
        self, posed: PosedHand, factors: Complex64[np.ndarray, "points sources"] | None, method: str
    ) -> Frames:
        """Compute the drives for all frames of the paths on a hand in a given pose.

        Parameters
        ----------
        posed : the hand in its current pose.
        factors : (N K, R) ratio of the pressure with the hand to that in open air, for each focus
            of each frame; None for open air.
        method : name of the method that computes each drive. Here "best" means weighted
            Gerchberg-Saxton.

        Returns
        -------
        (N, E) drives. The global phase of each drive is chosen so that the drive differs least from
        the previous frame and from the same frame of the previous cycle. Amplitudes and phases then
        change little over time.
        """
        points = moving_points(self._moving, posed)
        # The directivity towards a displaced focus is approximated by that towards its place; only
        # the distance differs.
        places = self._moving.places.ravel()
        elements = self._scene.with_images.array.positions
        before = cdist(posed.foci, elements)[places]
        after = cdist(points.reshape(-1, 3), elements)
        delay = phasors(self._scene.wavenumber.real * (after - before))
        rows = self._open_air(posed.foci)[places] * (before / after * delay)
        rows = self._scene.with_images.folded(rows if factors is None else rows * factors)
        matrices = rows.reshape(*points.shape[:2], -1)
        if method == "best":
            frames = self._projected(matrices)
        else:
            frames = np.stack(
                [
                    METHODS[method](TransferMatrix(matrix, float("nan")), Target(foci)).amplitudes
                    for matrix, foci in zip(matrices, points, strict=True)
                ]
            )
        self._previous = aligned(frames, self._previous)
        return self._previous

    def _projected(self, matrices: Complex128[np.ndarray, "frames together elements"]) -> Frames:
        """Maximise the weakest focus of each frame with all elements at full scale."""
        # Start from the phases of the last cycle at the foci, averaged with neighbouring frames.
        relative = phase(self._phases * phase(self._phases[:, :1]).conj())
        neighbours = np.roll(relative, 1, axis=0) + np.roll(relative, -1, axis=0)
        start = phase(relative + 0.5 * neighbours)
        # Treat each frame as an independent set of foci for the same elements.
        count, together, elements = matrices.shape
        sets = np.arange(count * together).reshape(count, together)
        rows = matrices.reshape(-1, elements)
        # With such a start, 10 iterations are enough.
        phases, _, drives = alternating_projections(rows, sets, np.ones(sets.shape), start, 10)
        self._phases = phases.astype(np.complex128)
        return (SINGLE * drives).astype(np.complex128)


def phasors(phases: Float[np.ndarray, "*any"]) -> Complex64[np.ndarray, "*any"]:
    """Return e^{iφ} in single precision, three times as fast as a complex exponential."""
    phases = phases.astype(np.float32, copy=False)
    values = np.empty(phases.shape, dtype=np.complex64)
    np.cos(phases, out=values.real)
    np.sin(phases, out=values.imag)
    return values


def aligned(frames: Frames, previous: Frames | None) -> Frames:
    """Align the global phase of each frame of a cycle, in place.

    Each frame is aligned with the sum of the preceding frame and of the frame one cycle earlier.
    """
    # Without the previous cycle, a frame unlike its neighbour could flip all later phases.
    for index in range(len(frames)):
        towards = np.zeros_like(frames[index])
        if index:
            towards = towards + frames[index - 1]
        if previous is not None:
            towards = towards + previous[index]
        frames[index] = turned_towards(frames[index], towards)
    return frames


def turned_towards(
    drives: Complex128[np.ndarray, "*shape"], reference: Complex128[np.ndarray, "*shape"]
) -> Complex128[np.ndarray, "*shape"]:
    """Align the global phase of drives with a reference; magnitudes of pressures stay the same."""
    product = complex(np.vdot(drives, reference))
    return drives * (product / abs(product)) if product else drives
