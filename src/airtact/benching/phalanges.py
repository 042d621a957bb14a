"""Times from a new pose to the drive, solving the last phalanges only as the live loop does, with how right that is."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from jaxtyping import Complex128, Float64

from airtact.acoustics.medium import air
from airtact.acoustics.scene import Scene, sound_hard
from airtact.acoustics.solvers.bem.solver import BoundaryElement
from airtact.acoustics.target import Target
from airtact.benching.real_time import Row
from airtact.benching.timing import correlation, timed
from airtact.drives.linear_methods import time_reversal
from airtact.drives.transfer import TransferMatrix
from airtact.hands.files import load_hand
from airtact.hands.hand import Hand
from airtact.live.drives.factors import (
    HandFactors,
    OpenAir,
    PartSolver,
    beacon_points,
    factors_of,
    part_of,
    solved,
)
from airtact.live.drives.riding import ride
from airtact.live.parts import LiveScene
from airtact.setup.examples import example
from airtact.transducers.layout import flat_boards

GAPS = 6e-3, 20e-3
"""Gaps between thumb and index finger that the poses run through [m]."""

DISTANCE = 0.2
"""From the boards to the pads [m]."""

REFERENCE_ACCURACY = 0.01
"""Accuracy of the solution that rows are compared with."""

EVERY = 7
"""Of so many poses one is compared."""

Solve = Callable[[Float64[np.ndarray, "25 3"]], HandFactors]


@dataclass(frozen=True)
class Phalanges:
    """The rows of the packaged pinch before four boards; its poses open the fingers from one gap to another."""

    runs: int

    @cached_property
    def hand(self) -> Hand:
        """The hand between both gaps."""
        return load_hand(example("pinch.json")).open_to(float(np.mean(GAPS)))

    @cached_property
    def scene(self) -> LiveScene:
        """Foci 1 mm off both pads, 2 x 2 boards before them."""
        pads = self.hand.pads[:2].mean(axis=0)
        array = flat_boards(2, 2).facing(tuple(pads), (1.0, 0.0, 0.0), DISTANCE)
        places, offsets = ("thumb.pad", "index.pad"), np.full(2, 1e-3)
        return LiveScene(
            air(celsius=22), 40e3, array, self.hand.side, self.hand.radii, places, offsets
        )

    @cached_property
    def open_air(self) -> OpenAir:
        """What the elements bring to the foci without the hand."""
        return OpenAir(self.scene)

    def rigid(self) -> Row:
        """Time them as rigid bodies, each factorised once."""
        solver = PartSolver(self.scene)
        asked = "8 ms, correlation 0.995"
        return self._row(
            "factorised once", asked, lambda joints: solver.solved(joints, "phalanges", 0.0)
        )

    def meshed_anew(self) -> Row:
        """Time them as one body meshed in each pose, which is what the live loop does for fingers that touch."""
        how = "as one body meshed in each pose"
        return self._row(how, "-", lambda joints: solved(self.scene, joints, "phalanges", 0.0))

    def _poses(self) -> Sequence[Float64[np.ndarray, "25 3"]]:
        gaps = [GAPS[1], *np.linspace(*GAPS, self.runs)]  # the first one warms up
        return [self.hand.open_to(float(gap)).joints for gap in gaps]

    def _row(self, how: str, asked: str, solve: Solve) -> Row:
        def to_rows(joints: Float64[np.ndarray, "25 3"]) -> Complex128[np.ndarray, "foci elements"]:
            found = solve(joints)
            matrix = self.open_air.rows(found.foci) * found.factors
            time_reversal(TransferMatrix(matrix, 0.0), Target(found.foci))
            return matrix

        poses = self._poses()
        took, matrices = timed([partial(to_rows, joints) for joints in poses])
        compared = list(zip(poses[1:], matrices, strict=True))[::EVERY]
        alike = min(self._likeness(joints, matrix) for joints, matrix in compared)
        return Row(
            f"two last phalanges in a new pose, to the drive, {how}",
            asked,
            f"{took}",
            f"worst row of the transfer matrix: correlation {alike:.4f} (against {REFERENCE_ACCURACY:.0%})",
            numbers={"seconds": took.seconds, "correlation": alike},
        )

    def _likeness(
        self, joints: Float64[np.ndarray, "25 3"], matrix: Complex128[np.ndarray, "foci elements"]
    ) -> float:
        """Least correlation of a row with that of the same phalanges, solved more accurately as one body."""
        scene, riding = self.scene, ride(self.scene, joints)
        body = Scene(
            scene.medium,
            [sound_hard(part_of(riding.hand, "phalanges", scene.places))],
            frequency=scene.frequency,
        )
        beacons = Target(beacon_points(scene, riding)).beacons()
        field = BoundaryElement(accuracy=REFERENCE_ACCURACY, estimate=False).radiate(body, beacons)
        fine = factors_of(scene, riding, "phalanges", 0.0, field.at(scene.array.positions)).factors
        exact = self.open_air.rows(riding.foci) * fine
        return min(correlation(one, other) for one, other in zip(matrix, exact, strict=True))
