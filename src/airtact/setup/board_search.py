"""Search over layouts of boards around hands for a high pressure at the weakest focus."""

import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from jaxtyping import Bool, Complex128, Float64
from scipy.optimize import brentq, minimize
from scipy.spatial.transform import Rotation
from scipy.stats import qmc

from airtact.acoustics.scene import Scene
from airtact.acoustics.solvers.problem import RadiatedField
from airtact.acoustics.target import Target
from airtact.drives.gerchberg_saxton import best_sources, phase, starting_sources
from airtact.drives.transfer import FociRows, transfer_to
from airtact.errors import InvalidInput, counted
from airtact.evaluation.slices import fine_meshes
from airtact.geometry.pose import Pose
from airtact.transducers.layout import PhasedArray

Points = Float64[np.ndarray, "points 3"]


@dataclass(frozen=True, eq=False)
class HandPose:
    """One pose of the hand, with the bodies, the foci, and the field of a source at each focus."""

    scene: Scene
    target: Target
    motion: Pose
    beacons: RadiatedField

    @cached_property
    def shares(self) -> Float64[np.ndarray, "asked"]:
        """Positive weights of the foci, divided by the largest weight."""
        weights = self.target.weights
        return weights[weights > 0.0] / weights.max()

    def rows(self, board: PhasedArray) -> FociRows:
        """Return the transfer matrix of a board, with each row divided by the weight of its focus.

        Rows of foci with weight 0 are omitted.
        """
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # a layout in the shadow of the hand is simply weak
            matrix = transfer_to(self.beacons, board.seen_from(self.motion)).matrix
        return matrix[self.target.weights > 0.0] / self.shares[:, None]


def drive_of(rows: FociRows) -> Complex128[np.ndarray, "elements"]:
    """Return the full-scale drive that maximises the pressure at the weakest focus.

    Each row of ``rows`` belongs to one focus.
    """
    if len(rows) == 1:
        return phase(rows[0].conj())
    equal = np.ones(len(rows))
    # With 100 iterations, it comes within 1 % of max_min in a tenth of the time.
    return phase(rows.conj().T @ best_sources(rows, equal, starting_sources(rows, equal), 100))


# Position of a board that faces the foci: a rotation about them, a distance between 0 (smallest)
# and 1 (largest), and tilts about the board's x and y axes [rad].
Place = tuple[Float64[np.ndarray, "3 3"], float, float, float]


@dataclass(frozen=True, eq=False)
class Search:
    """Search for allowed layouts of boards with a high pressure at the weakest focus.

    Attributes
    ----------
    half : half the lengths of a board's sides [m].
    fixed : poses of boards that stay in place.
    mirror : index of the axis along which boards are mirrored in pairs, and coordinate of the
        mirror plane [m]; None if boards are not mirrored.
    share : layouts are ranked by the quantile ``share`` (from 0 to 1) of the pressure at the
        weakest focus over the poses of the hand. With 0, this is the pressure in the worst pose;
        with 0.1, the pressure that the weakest focus exceeds in 90 % of the poses.
    """

    hands: list[HandPose]
    single: PhasedArray
    half: Float64[np.ndarray, "2"]
    distance: tuple[float, float]
    allowed: Callable[[Points], Bool[np.ndarray, "points"]]
    fixed: list[Pose]
    mirror: tuple[int, float] | None
    tilted: bool
    share: float

    @cached_property
    def foci(self) -> Points:
        """Positions of the foci in all poses of the hand [m]."""
        return np.concatenate([hand.motion.apply(hand.target.points) for hand in self.hands])

    @cached_property
    def skin(self) -> Points:
        """Foci, points spread over the bodies, and mirror images of these points in planes [m]."""
        points = [self.foci]
        for hand in self.hands:
            surfaces = [obstacle.surface for obstacle in hand.scene.obstacles]
            if surfaces:
                fine = hand.motion.apply(fine_meshes(surfaces, 8e-3)[0])
                _, first = np.unique(np.round(fine / 3e-3), axis=0, return_index=True)
                points.append(fine[first])
        skin = np.concatenate(points)
        # Elements only radiate forwards, so images must be in front of them, like the bodies.
        images = [plane.image(skin) for plane in self.hands[0].scene.planes]
        return np.concatenate([skin, *images])

    @cached_property
    def face(self) -> Points:
        """Points [m] over the area of a board, at most 10 mm apart, in the frame of the board."""
        x, y = (np.linspace(-side, side, int(side / 5e-3) + 2) for side in self.half)
        return np.stack(np.meshgrid(x, y, 0.0), axis=-1).reshape(-1, 3) + middle_of(self.single)

    def spare(
        self, rotation: Float64[np.ndarray, "3 3"], middle: Float64[np.ndarray, "3"]
    ) -> float:
        """Return how far a board is beyond the smallest allowed distance from the hand [m].

        The value is negative if the board is too close, or part of the hand is not in front of it.
        """
        seen = (self.skin - middle) @ rotation
        beside = np.maximum(np.abs(seen[:, :2]) - self.half, 0.0)
        gaps = np.sum(beside**2, axis=1) + seen[:, 2] ** 2
        # The points miss up to half a millimetre of the skin; 1 µm allows for rounding.
        left_out = 0.5e-3 if len(self.skin) > len(self.foci) else -1e-6
        gap = np.sqrt(gaps.min()) - self.distance[0] - left_out
        # Elements only radiate forwards, so the whole hand must be in front of them.
        return float(min(gap, seen[:, 2].min() - 2e-3))

    def around(
        self, rotation: Float64[np.ndarray, "3 3"], middle: Float64[np.ndarray, "3"]
    ) -> Pose:
        """Return the pose of a board with the given rotation and centre."""
        return Pose(rotation, middle - rotation @ middle_of(self.single))

    def fits(self, pose: Pose) -> bool:
        """Return whether a board is at an allowed distance from the hand and inside the region."""
        middle = pose.apply(middle_of(self.single))
        away = np.linalg.norm(middle - self.foci.mean(axis=0))
        if away > self.distance[1] + 1e-6 or self.spare(pose.rotation, middle) < 0.0:
            return False
        return bool(self.allowed(pose.apply(self.face)).all())

    def group(self, place: Place) -> list[Pose] | None:
        """Return the poses of a board and of its mirror image, or None if they do not fit."""
        turn, depth, *tilt = place
        rotation = turn @ Rotation.from_rotvec([*tilt, 0.0]).as_matrix()
        centre = self.foci.mean(axis=0)
        farthest = self.distance[1]

        def spare(away: float) -> float:
            return self.spare(rotation, centre - away * turn[:, 2])

        if spare(farthest) < 0.0:
            return None
        away = 0.0
        if spare(away) < 0.0:
            crossing = float(brentq(spare, away, farthest, xtol=1e-5))  # pyright: ignore[reportArgumentType]
            away = min(crossing + 1e-4, farthest)
        away += depth * (farthest - away)
        poses = [self.around(rotation, centre - away * turn[:, 2])]
        if self.mirror is not None:
            axis, coordinate = self.mirror
            mirrored = np.eye(3)
            mirrored[axis, axis] = -1.0
            middle = mirrored @ poses[0].apply(middle_of(self.single))
            middle[axis] += 2.0 * coordinate
            # Boards are symmetric about their y axis, so the mirror image of a board is a board.
            poses.append(self.around(mirrored @ rotation @ np.diag([-1.0, 1.0, 1.0]), middle))
        if not all(self.fits(pose) for pose in poses) or self.clashing(poses[:1], poses[1:]):
            return None
        return None if self.clashing(poses, self.fixed) else poses

    def clashing(self, poses: Sequence[Pose], others: Sequence[Pose]) -> bool:
        """Return whether a board of one group clashes with a board of the other.

        Boards clash if they are less than 10 mm apart, or if one is between the other and a focus.
        """
        middle = middle_of(self.single)
        for pose, blocking in (*product(poses, others), *product(others, poses)):
            inverse = blocking.inverse()
            points = inverse.apply(pose.apply(self.face)) - middle
            foci = inverse.apply(self.foci) - middle
            beside = np.abs(points[:, :2]) - self.half
            if ((beside < 5e-3).all(axis=1) & (np.abs(points[:, 2]) < 10e-3)).any():
                return True
            # The straight line from a point behind the other board to a focus crosses its plane.
            back = points[points[:, 2] < 0.0]
            share = back[:, 2, None] / (back[:, 2, None] - foci[:, 2])
            crossing = back[:, None] + share[:, :, None] * (foci - back[:, None])
            if (np.abs(crossing[..., :2]) < self.half).all(axis=-1).any():
                return True
        return False

    def rows(self, pose: Pose) -> list[FociRows]:
        """Return the transfer matrix of one board for each pose of the hand (``HandPose.rows``)."""
        board = self.single.moved(pose)
        return [hand.rows(board) for hand in self.hands]

    def weakest(self, boards: Sequence[list[FociRows]]) -> float:
        """Return the pressure [Pa] by which a layout is ranked (see ``share``).

        Each item of ``boards`` contains the matrices of one board for all poses of the hand.
        """
        weakest = []
        for parts in zip(*boards, strict=True):
            rows = np.concatenate(parts, axis=1)
            weakest.append(np.abs(rows @ drive_of(rows)).min())
        return float(np.quantile(weakest, self.share))

    def places(self, seed: int) -> Iterator[tuple[Place, list[Pose] | None]]:
        """Yield positions of boards that face the foci, with rotations and distances spread evenly.

        Each position is yielded together with the poses of the boards at this position, or with
        None if the boards do not fit.
        """
        sequence = qmc.Halton(4, rng=np.random.default_rng(seed))
        order = np.random.default_rng(seed)
        while True:
            # Shuffle the sequence: neighbours lie in opposite halves, and so would the boards of a
            # layout.
            for first, second, third, depth in order.permutation(sequence.random(1000)):
                # Uniform over all rotations (K. Shoemake, Graphics Gems III (1992) 124).
                angles = 2.0 * np.pi * np.array([second, third])
                turn = Rotation.from_quat(
                    [
                        *np.sqrt(1.0 - first) * np.array([np.sin(angles[0]), np.cos(angles[0])]),
                        *np.sqrt(first) * np.array([np.sin(angles[1]), np.cos(angles[1])]),
                    ]
                ).as_matrix()
                place = (turn, float(depth), 0.0, 0.0)
                yield place, self.group(place)

    def candidates(self, boards: int, tries: int, seed: int) -> list[tuple[float, list[Place]]]:
        """Return up to ``tries`` random layouts, as pairs of a pressure [Pa] and the boards.

        The pressure is the one that ``weakest`` returns for the layout.
        """
        found: list[tuple[float, list[Place]]] = []
        layout: list[tuple[Place, list[Pose]]] = []
        fixed = [self.rows(pose) for pose in self.fixed]
        for index, (place, poses) in enumerate(self.places(seed)):
            # If only few positions are allowed, return fewer layouts than requested.
            if index >= 5000 * boards + 100 * len(found):
                break
            if poses is None:
                continue
            layout = [other for other in layout if not self.clashing(poses, other[1])]
            layout.append((place, poses))
            if len(layout) * len(poses) == boards:
                rows = [self.rows(pose) for _, poses in layout for pose in poses]
                found.append((self.weakest([*rows, *fixed]), [place for place, _ in layout]))
                layout = []
                if len(found) == tries:
                    break
        if not found:
            raise InvalidInput(
                f"no layout of {counted(boards, 'board', 'boards')} fits at least "
                f"{1e3 * self.distance[0]:g} mm from all bodies and foci, with board centres at "
                f"most {1e3 * self.distance[1]:g} mm from the centre of the foci and inside the "
                "region: allow a larger distance or region.",
                code="out_of_range",
            )
        return found

    def refined(self, weakest: float, layout: list[Place]) -> tuple[float, list[Place]]:
        """Improve a layout board by board; return the new pressure [Pa] and the new layout."""
        layout = list(layout)
        for _ in range(3):
            before = weakest
            for index in range(len(layout)):
                weakest, layout[index] = self.refined_place(
                    weakest, layout[index], self.poses(layout[:index] + layout[index + 1 :])
                )
            if weakest < 1.003 * before:
                break
        return weakest, layout

    def refined_place(
        self, weakest: float, place: Place, others: list[Pose]
    ) -> tuple[float, Place]:
        """Improve the position of one board; return the new pressure [Pa] and position."""
        turn, depth, *tilt = place
        rows = [self.rows(pose) for pose in others]

        def place_of(step: Float64[np.ndarray, "steps"]) -> Place:
            around = Rotation.from_rotvec(step[:3]).as_matrix()
            tilts = step[4:] if self.tilted else np.zeros(2)
            return around @ turn, float(step[3]), float(tilts[0]), float(tilts[1])

        def loss(step: Float64[np.ndarray, "steps"]) -> float:
            poses = self.group(place_of(step))
            if poses is None or self.clashing(poses, others):
                return 0.0
            return -self.weakest([*rows, *(self.rows(pose) for pose in poses)])

        # First steps: 9 degrees around the foci and of tilt, and a fifth of the distance range.
        count = 6 if self.tilted else 4
        start = np.array([0.0, 0.0, 0.0, depth, *tilt])[:count]
        steps = np.array([0.15, 0.15, 0.15, -0.2 if depth > 0.5 else 0.2, 0.15, 0.15])[:count]
        found = minimize(
            loss,
            start,
            method="Nelder-Mead",
            bounds=([(-np.pi, np.pi)] * 3 + [(0.0, 1.0)] + [(-0.8, 0.8)] * 2)[:count],
            options={
                "initial_simplex": np.vstack([start, start + np.diag(steps)]),
                "maxfev": 100,
                "xatol": 5e-3,
                "fatol": 1e-3 * weakest,
            },
        )
        # Nelder-Mead keeps the best point, so the result is never worse than the start.
        return -float(found.fun), place_of(found.x)

    def poses(self, layout: Sequence[Place]) -> list[Pose]:
        """Return the pose of each board of an allowed layout, followed by those of fixed boards."""
        return [*(pose for place in layout for pose in self.group(place) or ()), *self.fixed]

    def moves(self, poses: Sequence[Pose], weakest: float) -> Float64[np.ndarray, "boards 6"]:
        """Return the relative change of the pressure at the weakest focus for each move of a board.

        Each board is moved by 1 cm along x, y or z, or turned by 5 degrees about one of these axes.
        """
        rows = [self.rows(pose) for pose in poses]
        centred = Pose.shift(middle_of(self.single))
        motions = [Pose.shift(10e-3 * unit) for unit in np.eye(3)]
        motions += [Pose.turn(unit, np.radians(5.0)) for unit in np.eye(3)]
        changes = np.empty((len(poses), 6))
        for board, pose in enumerate(poses):
            others = rows[:board] + rows[board + 1 :]
            for column, motion in enumerate(motions):
                worse = min(
                    self.weakest([*others, self.rows(pose @ centred @ way @ centred.inverse())])
                    for way in (motion, motion.inverse())
                )
                changes[board, column] = worse / weakest - 1.0
        return changes


def middle_of(single: PhasedArray) -> Float64[np.ndarray, "3"]:
    """Return the centre of a board in the board's own frame [m]."""
    return 0.5 * (single.positions.min(axis=0) + single.positions.max(axis=0))
