"""Times, memory and error of the jobs of a moving hand, as ``airtact.benching`` defines them.

``asv run NEW`` measures a commit in an environment of its own, ``asv continuous OLD NEW`` compares
two.
"""

import numpy as np

import airtact as at
from airtact.benching.real_time import slice_points, to_drive
from airtact.benching.scenes import Bodies, deformed, moved_each, two_fingers, whole_motion
from airtact.benching.timing import relative_error


class TwoFingers:
    """Two fingers and 996 elements at 3 %."""

    timeout = 600.0

    def setup(self) -> None:
        self.solver, self.array = at.BoundaryElement(accuracy=0.03), at.surrounding_box()
        self.rest, self.frame = two_fingers(), 0
        self.field = self.solver.radiate(self.rest.scene, self.rest.target.beacons())
        self.points = slice_points(side=100)

    def time_deformed_to_drive(self) -> None:
        self.frame += 1  # another shape every time
        to_drive(self.solver, deformed(self.frame), self.array)

    def time_each_moved_to_drive(self) -> None:
        self.frame += 1
        to_drive(self.solver, moved_each(self.rest, self.frame), self.array)

    def time_whole_moved_to_drive(self) -> None:
        self.frame += 1
        transfer = at.transfer_matrix(self.field, self.array.seen_from(whole_motion(self.frame)))
        at.time_reversal(transfer, self.rest.target)

    def time_slice(self) -> None:
        self.field.at(self.points)

    def peakmem_solve(self) -> None:
        self.solver.radiate(self.rest.scene, self.rest.target.beacons())


class Ball:
    """A ball, whose field is known in closed form."""

    unit, timeout = "1", 600.0

    def setup(self) -> None:
        self.bodies = Bodies(
            (at.sphere(8e-3, 2e-3),), np.array([[0.0, 0.0, 8.5e-3], [0.0, 9e-3, 0.0]])
        )
        self.elements = at.surrounding_box().positions

    def track_error(self) -> float:
        scene, beacons = self.bodies.scene, self.bodies.target.beacons()
        fields = [
            solver.radiate(scene, beacons)
            for solver in (at.BoundaryElement(accuracy=0.03), at.SphereSeries())
        ]
        found, true = (field.at(self.elements).T for field in fields)
        return relative_error(found, true)
