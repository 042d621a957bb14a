"""Solutions that are kept, and the choice of the one that is expected to keep most pressure now.

A solution is as good as the pose that it was made for is like the pose of now, however old it is: a
hand that pinches again comes back to poses that were solved before.
"""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from airtact.live.drives.factors import HandFactors
from airtact.live.drives.riding import Riding, gap_change, turn
from airtact.live.parts import LiveScene, Rule

PARTS: tuple[Rule, ...] = ("phalanges", "fingers", "hand", "carried")

KEPT: dict[Rule, float] = {
    "distances": 0.55,
    "phalanges": 0.93,
    "fingers": 0.935,
    "hand": 0.98,
    "carried": 0.94,
}
"""Share of the attainable pressure that a drive keeps where the pose is the one that was solved."""

LEAST: dict[Rule, float] = {
    "distances": 0.55,
    "phalanges": 0.7,
    "fingers": 0.7,
    "hand": 0.66,
    "carried": 0.7,
}
"""The same where the pose is quite another one."""

SPOILED: dict[Rule, float] = {**LEAST, "carried": 0.48}
"""The same where noise has spoiled the pose that was solved."""

GAP, TURN = 1.0e-3, 0.2
"""Change of the gaps between the foci's bones [m], and turn of the hand [rad], from which on most of the difference is
lost."""

CARRIED = 4.0
"""How much less it matters how unlike poses are where the sound by way of each bone is carried along with it."""

KEPT_LESS, FEW = 0.0175, 2
"""Phalanges keep so much less of the share for each focus beyond so many, and poses must be alike in proportion."""

GAP_NOISE, CARRIED_NOISE, FOCUS_NOISE = 1.5, 3.0, 3.3e-3
"""Noise of the gaps over that of a tracker's coordinates, the same where a whole hand is carried along, and the noise
that takes most pressure from any drive [m]."""

CAPACITY, FEWER = 400, 16
"""Solutions of each part that are kept; of those that were carried along, whose sources are kept elsewhere."""

MOST_NUMBERS, FEWEST = 12_000_000, 40
"""Factors that solutions of a part hold together at most (96 MB), and solutions that are kept at least."""

SAME_GAP, SAME_TURN = 0.25e-3, 0.02
"""A solution replaces one of a pose that differs less [m], [rad]."""


def expected_kept(
    part: Rule,
    gap: Float64[np.ndarray, "poses"],
    turned: Float64[np.ndarray, "poses"],
    noise: float = 0.0,
    foci: int = FEW,
) -> Float64[np.ndarray, "poses"]:
    """Share of the attainable pressure that is expected at the weakest focus of a drive.

    The numbers are medians over 1,700 pairs of poses, one solved and one played, of a thumb and an
    index finger that open and close 200 mm before 2 x 2 flat boards while the hand moves by 150 mm
    (``tests/tracking/motions.py``), by solutions of the whole hand. The share falls within a
    millimetre, an eighth of the wavelength, because the sound between both fingers goes to and fro;
    the whole hand is lost as fast as the phalanges. What noise takes is fitted to drives for the
    same motion seen with 0 and 1 mm of it (``benchmarks/live.py``); for a whole hand that is
    carried, to 30 drives each for an open hand that waves its fingers, seen with 0, 0.5 and 1 mm:
    it kept 0.89, 0.51 and 0.46 in the median, distances 0.56, 0.55 and 0.54. The solution suffers
    most: one without noise keeps 0.61 for poses with 1 mm. How it falls with the number of foci is
    from 160 pairs of poses of an open hand with foci at its palm and all fingertips.

    Parameters
    ----------
    part : that was solved; for distances the poses do not matter.
    gap : ``gap_change`` from the pose that was solved to that of now [m].
    turned : ``turn`` from the one to the other [rad].
    noise : standard deviation of each coordinate of the tracker's landmarks [m].
    foci : how many there are.
    """
    slower, gap_noise = (CARRIED, CARRIED_NOISE) if part == "carried" else (1.0, GAP_NOISE)
    alike = np.exp(-unlike(gap, turned, FEW if part == "carried" else foci) / slower)
    least, more, spoiled = LEAST[part], max(foci - FEW, 0), SPOILED[part]
    most = max(KEPT[part] - KEPT_LESS * more * (part == "phalanges"), least)
    clean, sure = least + (most - least) * alike, np.exp(-((gap_noise * noise / GAP) ** 2))
    return np.exp(-((noise / FOCUS_NOISE) ** 2)) * (spoiled + (clean - spoiled) * sure)


def unlike(
    gap: Float64[np.ndarray, "poses"], turned: Float64[np.ndarray, "poses"], foci: int = FEW
) -> Float64[np.ndarray, "poses"]:
    """Say how unlike poses are for the sound at so many foci; at 1 most of what a solution brings is lost."""
    return (max(foci, FEW) / FEW) ** 2 * ((gap / GAP) ** 2 + (turned / TURN) ** 2)


def worth_solving(parts: Iterable[Rule], noise: float, foci: int) -> bool:
    """Say whether a solution of one of some parts, however fresh, is expected to keep more than distances do.

    Parameters
    ----------
    parts : that are solved.
    noise : standard deviation of each coordinate of the tracker's landmarks [m].
    foci : how many there are.
    """
    same = np.zeros(1)
    least = expected_kept("distances", same, same, noise)[0]
    return any(expected_kept(part, same, same, noise, foci)[0] > least for part in parts)


class Library:
    """The solutions of a part, newest poses replacing the oldest.

    It keeps ``CAPACITY`` of them, or as many as ``MOST_NUMBERS`` allow; of those that were carried
    along ``FEWER``.

    Parameters
    ----------
    part : that was solved.
    scene : of the live loop.
    """

    def __init__(self, part: Rule, scene: LiveScene) -> None:
        self.part: Rule = part
        points = len(scene.places) + (0 if scene.moving is None else scene.moving.places.size)
        most = int(np.clip(MOST_NUMBERS // (points * len(scene.sounding.array)), FEWEST, CAPACITY))
        self._capacity = FEWER if part == "carried" else most
        self._found: list[HandFactors] = []
        self._distances = np.empty((0, 0))
        self._directions = np.empty((0, 0, 0, 0))
        # Memory that is touched at once: a part that is first solved after an hour must not find
        # too little.
        self._factors = np.full(
            (self._capacity, points, len(scene.sounding.array)), 0, dtype=np.complex64
        )
        self._oldest = 0

    def __len__(self) -> int:
        return len(self._found)

    def add(self, one: HandFactors) -> None:
        """Keep a solution, in the place of one for nearly the same pose, or of the oldest where there are too many."""
        if not self._found:
            self._distances = np.empty((self._capacity, *one.distances.shape))
            self._directions = np.empty((self._capacity, *one.directions.shape))
        index = len(self._found)
        if index:
            gap, turned = self._changes(one.distances, one.directions)
            alike = int(np.argmin(gap / SAME_GAP + turned / SAME_TURN))
            if gap[alike] < SAME_GAP and turned[alike] < SAME_TURN:
                index = alike
            elif index == self._capacity:
                index, self._oldest = self._oldest, (self._oldest + 1) % self._capacity
        self._factors[index] = one.factors
        self._found[index : index + 1] = [replace(one, factors=self._factors[index])]
        self._distances[index], self._directions[index] = one.distances, one.directions

    def best(self, riding: Riding, noise: float = 0.0) -> tuple[float, HandFactors | None]:
        """Find the solution that is expected to keep most for a pose, and how much that is.

        Parameters
        ----------
        riding : the hand now.
        noise : standard deviation of each coordinate of the tracker's landmarks [m].
        """
        if not self._found:
            return 0.0, None
        gap, turned = self._changes(riding.distances, riding.directions)
        foci = len(riding.foci)
        index = int(unlike(gap, turned, foci).argmin())
        kept = expected_kept(
            self.part, gap[index : index + 1], turned[index : index + 1], noise, foci
        )
        return float(kept[0]) * self._found[index].share, self._found[index]

    def _changes(
        self,
        distances: Float64[np.ndarray, "pairs"],
        directions: Float64[np.ndarray, "foci samples 3"],
    ) -> tuple[Float64[np.ndarray, "found"], Float64[np.ndarray, "found"]]:
        count = len(self._found)
        return gap_change(self._distances[:count], distances), turn(
            self._directions[:count], directions
        )
