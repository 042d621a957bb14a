"""Library of solutions, and the choice of the best solution for the current pose.

The value of a solution depends on how similar its pose is to the current one, not
on its age: a hand that pinches repeatedly returns to poses for which solutions
exist.
"""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from airtact.live.drives.factors import HandFactors
from airtact.live.moment import Rule
from airtact.live.scene import LiveScene, PosedHand, gap_change, turn

# One value for each solved pose.
Poses = Float64[np.ndarray, "poses"]


# Fitted shares of the attainable pressure of a drive if the current pose equals the solved
# one, if it is very different, and if the tracker's noise makes the solution useless.
SHARES: dict[Rule, tuple[float, float, float]] = {
    "distances": (0.55, 0.55, 0.55),
    "phalanges": (0.93, 0.7, 0.7),
    "hand": (0.98, 0.66, 0.66),
    "carried": (0.94, 0.7, 0.48),
}

# Number of foci for which the shares were fitted.
FITTED_FOCI = 2

# Change in the gaps between the foci's bones at which a solution loses most of its benefit [m].
GAP_SCALE = 1.0e-3


def expected_kept(
    part: Rule, gap: Poses, turned: Poses, noise: float = 0.0, foci: int = FITTED_FOCI
) -> Poses:
    """Return the fraction of the attainable pressure expected at the weakest focus of a drive.

    The fractions are medians over 1,700 pairs of poses of a pinch. For each pair, the drive for one
    pose is computed from the solution for the whole hand in the other pose. In these poses, the
    thumb and index finger open and close 200 mm in front of 2 x 2 flat boards, while the hand moves
    by 150 mm. The fraction falls when the gap changes by a millimetre, an eighth of the wavelength,
    because of multiple reflections between the two fingers. Solutions for the whole hand lose their
    benefit as fast as those for the phalanges.

    The effect of noise, after filtering by ``Predictor``, was fitted manually to medians from
    ``benchmarks/live.py --emulated`` at 60 frames/s. With 1 mm of noise, 148 drives for the same
    motion reached 0.78 of the attainable pressure. For an open hand with waving fingers, 17 drives
    computed from moved solutions for the whole hand reached 0.79 (0.89 without noise), more than
    the estimate of 0.72. The decrease with the number of foci was measured on 160 pairs of poses of
    an open hand with foci at its palm and all fingertips.

    Parameters
    ----------
    part : part of the hand whose scattering the drive accounts for, as in ``Moment.rule``. For
        "distances" (no scattering), the result does not depend on the poses.
    gap : rms change of the distances between foci and bones, relative to the solved pose [m].
    turned : rms change, relative to the solved pose, of the directions from the foci to the
        elements in the coordinates of the bones [rad].
    noise : standard deviation of each coordinate of the tracker's landmarks [m].
    foci : number of foci.
    """
    same, different, spoiled = SHARES[part]
    # Solutions that are moved with the bones tolerate larger differences between the poses.
    difference = unlike(gap, turned) / 4.0 if part == "carried" else unlike(gap, turned, foci)
    if part == "phalanges":
        same -= 0.0175 * max(foci - FITTED_FOCI, 0)
    same = max(same, different)
    # Without noise, the share falls from ``same`` to ``different`` as the poses diverge. Noise
    # lowers it to ``spoiled``; with strong noise, the sound misses the foci altogether.
    clean = different + (same - different) * np.exp(-difference)
    # The fitted factor 0.64 is about the error of a predicted gap divided by the tracker's noise.
    certain = np.exp(-((0.64 * noise / GAP_SCALE) ** 2))
    at_focus = np.exp(-((noise / 3.3e-3) ** 2))
    return at_focus * (spoiled + (clean - spoiled) * certain)


def unlike(gap: Poses, turned: Poses, foci: int = FITTED_FOCI) -> Poses:
    """Return a measure of the difference between two poses.

    A value of 1 means that the solution for one pose has lost most of its benefit for the other.
    """
    scale = (max(foci, FITTED_FOCI) / FITTED_FOCI) ** 2
    return scale * ((gap / GAP_SCALE) ** 2 + (turned / 0.2) ** 2)


def worth_solving(parts: Iterable[Rule], noise: float, foci: int) -> bool:
    """Return whether solving for one of the parts is expected to increase the pressure.

    Parameters
    ----------
    parts : parts of the hand to solve, such as "phalanges" or "hand".
    noise : standard deviation of each coordinate of the tracker's landmarks [m].
    foci : number of foci.
    """
    same = np.zeros(1)
    distances = expected_kept("distances", same, same, noise)[0]
    return any(expected_kept(part, same, same, noise, foci)[0] > distances for part in parts)


class Library:
    """Solutions for one part of a hand in several poses; new solutions replace the oldest.

    ``add`` stores a solution, and ``best`` returns the most suitable one for a pose.

    Parameters
    ----------
    part : part of the hand for which the solutions are computed.
    scene : scene of the live loop.
    """

    def __init__(self, part: Rule, scene: LiveScene) -> None:
        self.part: Rule = part
        points = len(scene.places) + (0 if scene.moving is None else scene.moving.places.size)
        sources = len(scene.with_images.array)
        # At most 400 solutions or 96 MB of factors, but at least 40 solutions. For carried
        # solutions 16 are enough, because the process that solves them keeps their sources.
        fitting = 12_000_000 // (points * sources)
        self._capacity = 16 if part == "carried" else min(max(fitting, 40), 400)
        self._solutions: list[HandFactors] = []
        self._distances = np.empty((0, 0))
        self._directions = np.empty((0, 0, 0, 0))
        # Fill the array to claim the memory now, so that it cannot run out when a part is first
        # solved an hour later.
        self._factors = np.full((self._capacity, points, sources), 0, dtype=np.complex64)
        self._oldest = 0

    def add(self, solution: HandFactors) -> None:
        """Store a solution.

        The solution replaces one for a similar pose or, if the library is full, the oldest one.
        """
        if not self._solutions:
            self._distances = np.empty((self._capacity, *solution.distances.shape))
            self._directions = np.empty((self._capacity, *solution.directions.shape))
        index = len(self._solutions)
        if index:
            gap, turned = self._changes(solution.distances, solution.directions)
            # Poses that differ by less than 0.25 mm and 0.02 rad count as nearly the same.
            nearest = int(np.argmin(gap / 0.25e-3 + turned / 0.02))
            if gap[nearest] < 0.25e-3 and turned[nearest] < 0.02:
                index = nearest
            elif index == self._capacity:
                index = self._oldest
                self._oldest = (self._oldest + 1) % self._capacity
        # The solution refers to a row of the table, so its factors are stored only once.
        self._factors[index] = solution.factors
        self._solutions[index : index + 1] = [replace(solution, factors=self._factors[index])]
        self._distances[index] = solution.distances
        self._directions[index] = solution.directions

    def best(self, posed: PosedHand, noise: float = 0.0) -> tuple[float, HandFactors | None]:
        """Return the pressure expected with the best solution for a pose, and the solution itself.

        The pressure is expressed as a fraction of the attainable pressure. An empty library returns
        0 and None.

        Parameters
        ----------
        posed : the hand in its current pose.
        noise : standard deviation of each coordinate of the tracker's landmarks
            [m].
        """
        if not self._solutions:
            return 0.0, None
        gap, turned = self._changes(posed.distances, posed.directions)
        foci = len(posed.foci)
        # The expected share falls with the difference, so the solution of the nearest pose is best.
        index = int(unlike(gap, turned, foci).argmin())
        nearest = slice(index, index + 1)
        kept = expected_kept(self.part, gap[nearest], turned[nearest], noise, foci)
        return float(kept[0]) * self._solutions[index].share, self._solutions[index]

    def _changes(
        self,
        distances: Float64[np.ndarray, "pairs"],
        directions: Float64[np.ndarray, "foci samples 3"],
    ) -> tuple[Poses, Poses]:
        count = len(self._solutions)
        gap = gap_change(self._distances[:count], distances)
        return gap, turn(self._directions[:count], directions)
