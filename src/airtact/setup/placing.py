"""Search for board positions that make the weakest focus strongest over all poses of the hand.

A beacon at each focus is solved for once per pose of the hand, and its field is expanded in
outgoing waves. Each candidate layout then costs only an evaluation at its transducers and the
choice of a drive. Candidates come from a low-discrepancy sequence and face the foci. The best ones
are refined board by board (Nelder-Mead), which also tilts them.
"""

import re
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from os.path import relpath
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Complex128, Float64, Real
from scipy.optimize import brentq, minimize
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation
from scipy.stats import qmc

import airtact as at
from airtact.acoustics.planes import before_planes
from airtact.acoustics.scene import Scene, check_no_boards
from airtact.acoustics.solvers.bem.solver import BoundaryElement
from airtact.acoustics.solvers.problem import RadiatedField, Solver
from airtact.acoustics.target import Target
from airtact.drives.drive import Drive
from airtact.drives.gerchberg_saxton import best_sources, phase, starting_sources
from airtact.drives.reach import FociRows
from airtact.drives.transfer import transfer_to
from airtact.errors import (
    InvalidInput,
    Vector,
    check_seed,
    counted,
    of_kind,
    one_line,
    point_of,
    positive,
)
from airtact.files.atomic import whole_file, writable_folder
from airtact.geometry.pose import Pose
from airtact.setup.parsing import parse_scene
from airtact.setup.setup import Setup
from airtact.setup.solving import verification_solver
from airtact.timing import Progress
from airtact.transducers.layout import PhasedArray, board_array, join
from airtact.transducers.placement import check_placement

Points = Float64[np.ndarray, "points 3"]
# Two opposite corners of a box, or a function that returns True for points where a board may be
Region = (
    Real[np.ndarray, "2 3"] | tuple[Vector, Vector] | Callable[[Points], Bool[np.ndarray, "points"]]
)


@dataclass(frozen=True, eq=False, repr=False)
class Layout:
    """Places of boards.

    Attributes
    ----------
    poses : pose of each board, from the board's frame to the obstacles'.
    weakest : peak pressure at the weakest focus over all poses of the hand, with every element at
        full scale [Pa]. If the foci have shares, the pressure divided by the share.
    single : a single board in its own frame.
    """

    poses: tuple[Pose, ...]
    weakest: float
    single: PhasedArray

    def __repr__(self) -> str:
        boards = counted(len(self.poses), "board", "boards")
        return one_line(self, boards, f"weakest focus {self.weakest:,.0f} Pa")

    @cached_property
    def array(self) -> PhasedArray:
        """The transducers in the obstacles' frame."""
        return join([self.single.moved(pose) for pose in self.poses])

    @property
    def middles(self) -> Float64[np.ndarray, "boards 3"]:
        """(B, 3) middle of each board in the obstacles' frame [m]."""
        middle = _middle(self.single)
        return np.stack([pose.apply(middle) for pose in self.poses])


@dataclass(frozen=True, eq=False, repr=False)
class Placement:
    """Layouts of boards for a setup, and their performance.

    Attributes
    ----------
    setup : the setup with its present array.
    board : kind of the boards.
    layouts : all layouts that were tried, best first. The best few were refined.
    present : the weakest focus of the setup's present array [Pa], over the same poses of the hand;
        NaN if the array does not fit around one of them.
    verified : the weakest focus of the best layout by a finer solve of its drives [Pa].
    moves : (B, 6) relative change of the best layout's weakest focus if one board is moved by 1 cm
        along its x, y or z axis, or turned by 5 degrees about the axis through its middle: the
        worse of both directions, with a new drive.
    """

    setup: Setup
    board: str
    layouts: tuple[Layout, ...]
    present: float
    verified: float
    moves: Float64[np.ndarray, "boards 6"]

    def __repr__(self) -> str:
        best = self.layouts[0]
        return one_line(
            self,
            counted(len(self.layouts), "layout", "layouts"),
            f"best {best.weakest:,.0f} Pa",
            f"median {self.median:,.0f} Pa",
            f"present {self.present:,.0f} Pa",
        )

    @property
    def median(self) -> float:
        """Weakest focus of the median layout [Pa]."""
        return float(np.median([layout.weakest for layout in self.layouts]))

    def save(self, folder: str | Path, count: int = 3) -> tuple[Path, ...]:
        """Write the best layouts as scene files layout_1.toml and so on; return the files.

        Raises
        ------
        InvalidInput
            If the setup was not read from a scene file.
        """
        if self.setup.path is None:
            raise InvalidInput(
                "the setup was not read from a scene file, so no scene file can be written: use "
                "the array of a layout.",
                code="data_missing",
            )
        source = self.setup.path.resolve().parent
        folder = writable_folder(Path(folder))
        files = []
        for index, layout in enumerate(self.layouts[:count]):
            file = folder / f"layout_{index + 1}.toml"
            text = _with_array(self.setup.text, self._array_table(layout))

            # Paths in the scene file are relative to it, and the new file is in another folder.
            def moved(match: re.Match) -> str:
                if not (source / match[2]).is_file():
                    return match[0]
                return f'"{Path(relpath(source / match[2], folder.resolve())).as_posix()}"'

            text = re.sub(r"([\"'])([^\"'\n]{1,255})\1", moved, text)
            parse_scene(text)  # raises if the table of the array was written in an unusual way
            with whole_file(file) as partial:
                partial.write_text(text, encoding="utf-8")
            files.append(file)
        return tuple(files)

    def _array_table(self, layout: Layout) -> str:
        """Return the lines of [array] for a layout."""
        lines = ["[array]", 'layout = "boards"', f'board = "{self.board}"']
        element = layout.single.element
        lines.append(f"sensitivity = {element.sensitivity!r}")
        lines.append(f'source = "{"piston" if element.directional else "monopole"}"')
        if element.directional:
            lines.append(f"piston_radius = {element.radius!r}")
        for pose in layout.poses:
            rows = ", ".join(str([float(f"{x:.12g}") for x in row]) for row in pose.rotation)
            shift = [float(f"{x:.9g}") for x in pose.translation]
            lines += ["", "[[array.poses]]", f"rotation = [{rows}]", f"translation = {shift}"]
        return "\n".join(lines) + "\n"


def _with_array(text: str, table: str) -> str:
    """Replace the table [array] and its subtables in the text of a scene file."""
    kept = []
    inside = False
    top = True
    for line in text.splitlines():
        header = re.match(r"\s*\[+\s*([\w-]+)", line)
        # A list that spans lines may begin with numbers, but tables have names.
        if header and not re.match(r"\s*\[+\s*-?\d", line):
            inside = header[1] == "array"
            top = False
        # Before the first table, the array may be one line: array = { layout = ... }.
        if not inside and not (top and re.match(r"\s*array\s*[.=]", line)):
            kept.append(line)
    return "\n".join(kept).rstrip() + "\n\n" + table


@dataclass(frozen=True, eq=False)
class _HandPose:
    """A pose of the hand: bodies and foci, their motion to the obstacles' frame, solved beacons."""

    scene: Scene
    target: Target
    motion: Pose
    beacons: RadiatedField

    @cached_property
    def shares(self) -> Float64[np.ndarray, "asked"]:
        """Requests of the foci with a request, scaled so that the largest is 1."""
        weights = self.target.weights
        return weights[weights > 0.0] / weights.max()

    def rows(self, board: PhasedArray) -> FociRows:
        """Pressure at each focus per unit drive of each element, divided by the share."""
        seen = board.seen_from(self.motion)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # a layout in the shadow of the hand is merely weak
            matrix = transfer_to(self.beacons, seen).matrix
        return matrix[self.target.weights > 0.0] / self.shares[:, None]


def _drive(rows: FociRows) -> Complex128[np.ndarray, "elements"]:
    """Return the drive, with every element at full scale, whose weakest row is strongest."""
    if len(rows) == 1:
        return phase(rows[0].conj())
    equal = np.ones(len(rows))
    # 100 iterations come within 1 % of max_min in a tenth of its time.
    return phase(rows.conj().T @ best_sources(rows, equal, starting_sources(rows, equal), 100))


# The place of a board that faces the foci: a rotation about them, a distance from 0 (smallest) to 1
# (largest), and tilts about the board's x and y axes [rad].
Place = tuple[Float64[np.ndarray, "3 3"], float, float, float]


@dataclass(frozen=True, eq=False)
class _Search:
    """Allowed layouts, and the pressure at the weakest focus of each."""

    hands: list[_HandPose]
    single: PhasedArray
    half: Float64[np.ndarray, "2"]
    distance: tuple[float, float]
    allowed: Callable[[Points], Bool[np.ndarray, "points"]]

    @cached_property
    def foci(self) -> Points:
        """Foci in all poses of the hand [m]."""
        return np.concatenate([hand.motion.apply(hand.target.points) for hand in self.hands])

    @cached_property
    def skin(self) -> Points:
        """Foci, points of the bodies a few millimetres apart, and their images in planes [m]."""
        import trimesh  # imported here because the import takes as long as that of airtact

        points = [self.foci]
        for hand in self.hands:
            for obstacle in hand.scene.obstacles:
                corners = hand.motion.apply(obstacle.surface.corners)
                # A flat side may have corners only at its ends, so it is divided.
                fine = trimesh.remesh.subdivide_to_size(
                    corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3), 8e-3
                )[0]
                _, first = np.unique(np.round(fine / 3e-3), axis=0, return_index=True)
                points.append(fine[first])
        skin = np.concatenate(points)
        # Elements radiate forwards only, so images must be in front of them like the bodies.
        images = [plane.image(skin) for plane in self.hands[0].scene.planes]
        return np.concatenate([skin, *images])

    @cached_property
    def face(self) -> Points:
        """Points at most 10 mm apart over the outline of a board, in its frame [m]."""
        x, y = (np.linspace(-side, side, int(side / 5e-3) + 2) for side in self.half)
        grid = np.stack(np.meshgrid(x, y, 0.0), axis=-1).reshape(-1, 3)
        return grid + _middle(self.single)

    def pose(self, place: Place) -> Pose | None:
        """Pose of a board at a place; None if it is too near the hand or outside the region."""
        turn, depth, *tilt = place
        rotation = turn @ Rotation.from_rotvec([*tilt, 0.0]).as_matrix()
        centre = self.foci.mean(axis=0)
        # From the middle of a board ``away`` from the foci, the skin is at local + away · way.
        local = (self.skin - centre) @ rotation
        way = turn[:, 2] @ rotation
        nearest, farthest = self.distance
        # The points leave out up to half a millimetre of the skin; 1 µm for rounding.
        left_out = 0.5e-3 if len(self.skin) > len(self.foci) else -1e-6

        def spare(away: float) -> float:
            seen = local + away * way
            beside = np.maximum(np.abs(seen[:, :2]) - self.half, 0.0)
            gaps = np.sum(beside**2, axis=1) + seen[:, 2] ** 2
            # Elements radiate forwards only, so the whole hand must be in front of them.
            gap = np.sqrt(gaps.min()) - nearest - left_out
            return float(min(gap, seen[:, 2].min() - 2e-3))

        if spare(farthest) < 0.0:
            return None
        away = 0.0
        if spare(away) < 0.0:
            crossing = float(brentq(spare, away, farthest, xtol=1e-5))  # pyright: ignore[reportArgumentType]
            away = min(crossing + 1e-4, farthest)
        away += depth * (farthest - away)
        middle = centre - away * turn[:, 2]
        pose = Pose(rotation, middle - rotation @ _middle(self.single))
        return pose if spare(away) >= 0.0 and self.allowed(pose.apply(self.face)).all() else None

    def clash(self, first: Pose, second: Pose) -> bool:
        """Whether two boards are within 10 mm, or one is between the other and a focus."""
        for pose, blocking in ((first, second), (second, first)):
            inverse = blocking.inverse()
            middle = _middle(self.single)
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
        """Rows of one board for each pose of the hand."""
        board = self.single.moved(pose)
        return [hand.rows(board) for hand in self.hands]

    def weakest(self, boards: Sequence[list[FociRows]]) -> float:
        """Pressure at the weakest focus over all poses of the hand [Pa], from the boards' rows."""
        weakest = np.inf
        for parts in zip(*boards, strict=True):
            rows = np.concatenate(parts, axis=1)
            weakest = min(weakest, float(np.abs(rows @ _drive(rows)).min()))
        return weakest

    def places(self, seed: int) -> Iterator[tuple[Place, Pose | None]]:
        """Yield places of a board that faces the foci, evenly over rotations and distances."""
        sequence = qmc.Halton(4, rng=np.random.default_rng(seed))
        order = np.random.default_rng(seed)
        while True:
            # Shuffled, because neighbours in the sequence lie in opposite halves, and a layout's
            # boards would too.
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
                yield place, self.pose(place)

    def candidates(self, boards: int, tries: int, seed: int) -> list[tuple[float, list[Place]]]:
        """Return the weakest focus and the places of each of ``tries`` layouts."""
        found: list[tuple[float, list[Place]]] = []
        layout: list[tuple[Place, Pose]] = []
        for index, (place, pose) in enumerate(self.places(seed)):
            # If few places are allowed, there are fewer layouts than requested.
            if index >= 5000 * boards + 100 * len(found):
                break
            if pose is None:
                continue
            layout = [other for other in layout if not self.clash(pose, other[1])]
            layout.append((place, pose))
            if len(layout) == boards:
                weakest = self.weakest([self.rows(pose) for _, pose in layout])
                found.append((weakest, [place for place, _ in layout]))
                layout = []
                if len(found) == tries:
                    break
        if not found:
            raise InvalidInput(
                f"there is no space for {counted(boards, 'board', 'boards')} "
                f"{1e3 * self.distance[0]:g} to {1e3 * self.distance[1]:g} mm from the hand and "
                "inside the region: use a larger distance or region.",
                code="out_of_range",
            )
        return found

    def refined(self, weakest: float, layout: list[Place]) -> tuple[float, list[Place]]:
        """Improve a layout, one board after the other."""
        layout = list(layout)
        for _ in range(3):
            before = weakest
            for index in range(len(layout)):
                others = self.poses(layout[:index] + layout[index + 1 :])
                weakest, layout[index] = self.refined_place(weakest, layout[index], others)
            if weakest < 1.003 * before:
                break
        return weakest, layout

    def refined_place(
        self, weakest: float, place: Place, others: list[Pose]
    ) -> tuple[float, Place]:
        """Improve the position of one board while the others stay."""
        turn, depth, *tilt = place
        rows = [self.rows(pose) for pose in others]

        def place_of(step: Float64[np.ndarray, "6"]) -> Place:
            around = Rotation.from_rotvec(step[:3]).as_matrix()
            return around @ turn, float(step[3]), float(step[4]), float(step[5])

        def loss(step: Float64[np.ndarray, "6"]) -> float:
            pose = self.pose(place_of(step))
            if pose is None or any(self.clash(pose, other) for other in others):
                return 0.0
            return -self.weakest([*rows, self.rows(pose)])

        start = np.array([0.0, 0.0, 0.0, depth, *tilt])
        # First steps of 9 degrees around the foci and of tilt, and a fifth of the distances
        steps = np.array([0.15, 0.15, 0.15, -0.2 if depth > 0.5 else 0.2, 0.15, 0.15])
        found = minimize(
            loss,
            start,
            method="Nelder-Mead",
            bounds=[(-np.pi, np.pi)] * 3 + [(0.0, 1.0)] + [(-0.8, 0.8)] * 2,
            options={
                "initial_simplex": np.vstack([start, start + np.diag(steps)]),
                "maxfev": 100,
                "xatol": 5e-3,
                "fatol": 1e-3 * weakest,
            },
        )
        # Nelder-Mead keeps its start, so the result is never worse.
        return -float(found.fun), place_of(found.x)

    def poses(self, layout: Sequence[Place]) -> list[Pose]:
        """Pose of each board of an allowed layout."""
        return [pose for place in layout if (pose := self.pose(place)) is not None]

    def moves(self, poses: Sequence[Pose], weakest: float) -> Float64[np.ndarray, "boards 6"]:
        """Relative change of the weakest focus for each move of one board, see ``Placement``."""
        rows = [self.rows(pose) for pose in poses]
        middle = _middle(self.single)
        changes = np.empty((len(poses), 6))
        for board, pose in enumerate(poses):
            for axis, unit in enumerate(np.eye(3)):
                shifts = [Pose.shift(way * 10e-3 * unit) for way in (-1.0, 1.0)]
                turns = [Pose.turn(unit, way * np.radians(5.0)) for way in (-1.0, 1.0)]
                for kind, motions in enumerate((shifts, turns)):
                    moved = []
                    for motion in motions:
                        about = Pose.shift(middle) @ motion @ Pose.shift(-middle)
                        others = rows[:board] + rows[board + 1 :]
                        moved.append(self.weakest([*others, self.rows(pose @ about)]))
                    changes[board, axis + 3 * kind] = min(moved) / weakest - 1.0
        return changes


def place(
    setup: Setup,
    boards: int = 1,
    board: str = "autd3",
    distance: tuple[float, float] = (0.15, 0.25),
    region: Region | None = None,
    hands: "Sequence[at.Hand | Pose] | None" = None,
    tries: int = 2000,
    seed: int = 0,
    *,
    refine: int = 4,
    progress: Progress | None = None,
) -> Placement:
    """Search for the board layouts with the strongest weakest focus.

    Boards may be tilted. The boards neither overlap nor stand between another board and a focus,
    and the whole hand is in front of each board. The sound that boards reflect is not included.

    Parameters
    ----------
    setup : scene and target; its array is compared with the layouts.
    boards : number of boards.
    board : kind of the boards, see ``airtact boards``.
    distance : smallest distance of any part of a board from the bodies and foci, and largest
        distance of a board's middle from the middle of the foci [m].
    region : two opposite corners of a box in which the boards must stand [m], or a function of
        points (N, 3) that returns True (N,) where boards may be; by default everywhere.
    hands : poses of the hand for which the layout must be good, instead of the setup's: hands that
        replace the setup's only body, whose foci are on its named points, or motions of all bodies.
    tries : number of layouts before the best few are refined; fewer in a small region.
    seed : seed of the search. The same arguments give the same result.
    refine : number of layouts that are refined, the best that differ by over 40 mm; may be 0.
    progress : called with a description of each step as it begins.

    Returns
    -------
    The layouts, best first.

    Raises
    ------
    InvalidInput
        If no layout fits, a number is not above zero, the board is unknown, the boards of the scene
        reflect, a plane is behind them, or a hand cannot replace the setup's body.

    Examples
    --------
    >>> import airtact as at
    >>> target = at.Target((0.0, 0.0, 0.15))
    >>> setup = at.Setup(at.Scene(at.air(), []), at.autd3_board(), target)
    >>> result = at.place(setup, tries=20, refine=1)
    >>> result.layouts[0].weakest > 1.2 * result.median
    True
    """
    of_kind(setup, Setup, "the setup", "read_scene(path)")
    setup.check_no_traps("place")
    check_no_boards(setup.scene, "place")
    check_seed(seed)
    if setup.left_out:
        raise InvalidInput(
            "the scene has a plane behind its boards, which would reflect the sound of boards "
            "elsewhere: remove the plane, and use a region above it.",
            code="not_supported",
        )
    for count, name in ((boards, "boards"), (tries, "tries")):
        if not isinstance(count, int | np.integer) or count < 1:
            raise InvalidInput(
                f"the number of {name} is {count!r}: use a whole number, at least 1.",
                code="out_of_range",
            )
    nearest = positive(distance[0], "the smallest distance", "m")
    farthest = positive(distance[1], "the largest distance", "m")
    if farthest < nearest:
        raise InvalidInput(
            f"the largest distance, {farthest:g} m, is below the smallest, {nearest:g} m: use "
            "the smallest first.",
            code="out_of_range",
        )
    # The same boards keep their transducers, such as those of a scene file.
    single = board_array(board, element=setup.array.element if board == setup.board else None)
    sides = at.transducers.board_named(board).outline
    # The pitch of transducers is 10 mm.
    spread = np.ptp(single.positions[:, :2], axis=0) + 10e-3
    report = progress or (lambda step: None)
    solved = []
    for index, (scene, target, motion) in enumerate(_hand_poses(setup, hands)):
        report(f"solving for a beacon in each focus of hand {index + 1}")
        # Hands that only move share a solve.
        same = [hand for hand in solved if hand.scene is scene]
        beacons = same[0].beacons if same else _beacons(setup.solver, scene, target)
        solved.append(_HandPose(scene, target, motion, beacons))
    half = 0.5 * (spread if sides is None else np.array(sides))
    search = _Search(solved, single, half, (nearest, farthest), _allowed(region, setup.scene))
    report(f"trying {tries:,} layouts")
    found = sorted(search.candidates(boards, tries, seed), key=lambda layout: -layout[0])
    report("refining the best layouts")
    layouts = [Layout(tuple(search.poses(places)), weakest, single) for weakest, places in found]
    # Starts that differ by more than 40 mm in some board lead to different layouts.
    starts: list[int] = []
    for index, layout in enumerate(layouts):
        if len(starts) < refine and all(_apart(layout, layouts[other]) > 40e-3 for other in starts):
            starts.append(index)
    best: list[Layout] = []
    for index in starts:
        weakest, places = search.refined(*found[index])
        best.append(Layout(tuple(search.poses(places)), weakest, single))
    rest = [layout for index, layout in enumerate(layouts) if index not in starts]
    # Two starts may lead to the same layout.
    best.sort(key=lambda layout: -layout.weakest)
    best = [
        layout
        for index, layout in enumerate(best)
        if all(_apart(layout, other) > 10e-3 for other in best[:index])
    ]
    layouts = sorted([*best, *rest], key=lambda layout: -layout.weakest)
    report("verifying the best layout by a finer solve")
    winner = layouts[0]
    return Placement(
        setup,
        board,
        tuple(layouts),
        _present(search, setup.array),
        _verified(setup, search, winner.array),
        search.moves(winner.poses, winner.weakest),
    )


def _hand_poses(
    setup: Setup, hands: "Sequence[at.Hand | Pose] | None"
) -> Iterator[tuple[Scene, Target, Pose]]:
    """Yield scene, target and motion for each pose of the hand."""
    scene = setup.scene
    if hands is None:
        hands = [Pose.identity()]
    if len(of_kind(hands, list | tuple, "the hands", "a list of Hand or Pose")) == 0:
        raise InvalidInput("the list of hands is empty; pass at least one hand.", code="empty")
    for hand in hands:
        if isinstance(hand, Pose):
            if not all(plane.kept_by(hand) for plane in scene.planes):
                raise InvalidInput(
                    "a motion of the hand moves the plane of the scene: use motions along it.",
                    code="not_supported",
                )
            yield scene, setup.target, hand
            continue
        of_kind(hand, at.Hand, "a hand", "hand_from_joints(joints) or a Pose")
        if len(scene.obstacles) != 1 or None in setup.riding:
            raise InvalidInput(
                "a hand replaces the only body of a scene, and its foci must be on named points: "
                'set at = "thumb.pad" in [[foci]].',
                code="not_supported",
            )
        points = np.stack([hand.focus(*ride) for ride in setup.riding if ride is not None])
        target = Target(points, shares=setup.target.weights)
        body = replace(scene.obstacles[0], surface=hand.surface)
        yield replace(scene, obstacles=[body]), target, Pose.identity()


def _beacons(solver: Solver, scene: Scene, target: Target) -> RadiatedField:
    """Solve for a beacon at each focus with the accuracy that the search needs."""
    if isinstance(solver, BoundaryElement):
        # Errors of 4 % only reorder layouts of almost equal pressure; the winner is verified.
        solver = replace(solver, accuracy=max(solver.accuracy, 0.04), estimate=False)
    field = solver.radiate(scene, target.beacons())
    return at.multipole_expansion(field) if scene.obstacles else field


def _allowed(region: Region | None, scene: Scene) -> Callable[[Points], Bool[np.ndarray, "points"]]:
    """Return a function that is True at positions allowed for boards."""
    low = np.full(3, -np.inf)
    high = -low
    if region is not None and not callable(region):
        corners = np.stack([point_of(corner, "a corner of the region") for corner in region])
        low = corners.min(axis=0)
        high = corners.max(axis=0)

    def allowed(points: Points) -> Bool[np.ndarray, "points"]:
        inside = ((points >= low) & (points <= high)).all(axis=1)
        inside &= before_planes(scene.planes, points)
        return inside & region(points) if callable(region) else inside

    return allowed


def _apart(first: Layout, second: Layout) -> float:
    """Largest distance of a board's middle from the nearest one in another layout [m]."""
    return float(cdist(first.middles, second.middles).min(axis=1).max())


def _middle(single: PhasedArray) -> Float64[np.ndarray, "3"]:
    return 0.5 * (single.positions.min(axis=0) + single.positions.max(axis=0))


def _present(search: _Search, array: PhasedArray) -> float:
    """Pressure at the weakest focus for the setup's array [Pa]; NaN if it does not fit."""
    try:
        for hand in search.hands:
            check_placement(hand.scene, array.seen_from(hand.motion), hand.target.points)
    except InvalidInput:
        return np.nan
    return search.weakest([[hand.rows(array) for hand in search.hands]])


def _verified(setup: Setup, search: _Search, array: PhasedArray) -> float:
    """Pressure at the weakest focus for the drives of the search, by a finer solver [Pa]."""
    solver = setup.solver
    if isinstance(solver, BoundaryElement):
        solver = replace(solver, accuracy=min(solver.accuracy, 0.02))
    else:
        solver = verification_solver(setup)
    weakest = np.inf
    for hand in search.hands:
        drive = Drive(_drive(hand.rows(array)))
        seen = array.seen_from(hand.motion)
        result = at.evaluate(hand.scene, seen, drive, hand.target, solver=solver)
        asked = hand.target.weights > 0.0
        weakest = min(weakest, float((np.abs(result.pressures[asked]) / hand.shares).min()))
    return weakest


def hands_of(setup: Setup, recording: Path, count: int) -> "list[at.Hand]":
    """Return hands from a recording, evenly spaced in time, with the skin of the setup's hand.

    Raises
    ------
    InvalidInput
        If the setup does not have exactly one hand, or no frame has a hand.
    """
    from airtact.hands.joints import joints_of
    from airtact.hands.tracking.recordings import load_recording

    if len(setup.hands) != 1:
        raise InvalidInput(
            f"the scene has {counted(len(setup.hands), 'hand', 'hands')} with joints, but a "
            "recording replaces exactly one.",
            code="not_supported",
        )
    frames = load_recording(recording, leave_out=True).frames
    hands = [frame for frame in frames if frame.landmarks is not None]
    if not hands:
        raise InvalidInput(f"no frame of {recording.name} has a hand.", code="empty")
    chosen = np.unique(np.linspace(0, len(hands) - 1, count).round().astype(int))
    return [
        at.hand_from_joints(
            joints_of(setup.tracker.apply(hands[index].landmarks)),
            setup.hands[0].radii,
            side=hands[index].side,
        )
        for index in chosen
    ]
