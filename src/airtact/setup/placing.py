"""Search for board positions that maximise the pressure at the weakest focus over all hand poses.

For each pose of the hand, one solve computes the field of a source (beacon) at each focus, and this
field is expanded in outgoing waves. For each candidate layout it is then enough to evaluate the
field at the transducers and to compute a drive. The boards of a candidate face the foci, and their
positions come from a low-discrepancy sequence. The best ones are refined board by board
(Nelder-Mead), which also tilts the boards.
"""

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from os.path import relpath
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float64, Real
from scipy.spatial.distance import cdist

import airtact as at
from airtact.acoustics.scene import Scene, before_planes, check_no_boards
from airtact.acoustics.solvers.bem.solver import BoundaryElement
from airtact.acoustics.solvers.problem import RadiatedField, Solver
from airtact.acoustics.target import Target
from airtact.drives.drive import Drive
from airtact.errors import (
    InvalidInput,
    Vector,
    check_choice,
    check_seed,
    counted,
    of_kind,
    one_line,
    point_of,
    within,
)
from airtact.files.atomic import whole_file, writable_folder
from airtact.geometry.pose import Pose
from airtact.setup.board_search import HandPose, Points, Search, drive_of, middle_of
from airtact.setup.parsing import parse_scene
from airtact.setup.setup import Setup
from airtact.setup.solving import verification_solver
from airtact.timing import Progress
from airtact.transducers.boards import kind_of_array
from airtact.transducers.layout import MAX_ARRAY_EXTENT, PhasedArray, board_array, join
from airtact.transducers.placement import check_placement

# Two opposite corners of a box
Box = Real[np.ndarray, "2 3"] | tuple[Vector, Vector]
# A box, or a function that returns True for points at which a board may be
Region = Box | Callable[[Points], Bool[np.ndarray, "points"]]


@dataclass(frozen=True, eq=False, repr=False)
class Layout:
    """A layout of boards that ``place`` tried, in ``Placement.layouts``.

    Attributes
    ----------
    poses : pose of each board, which maps the frame of ``single`` to that of the obstacles.
    weakest : peak pressure at the weakest focus [Pa], with all elements at full scale, in the worst
        of the poses of the hand that were passed to ``place``, or else in that of the setup. With
        the objective "lowest_tenth", it is the pressure that the weakest focus exceeds in nine
        poses out of ten. The pressure at each focus is divided by the ratio of its request
        (pressure or share) to the largest request; foci whose request is 0 are ignored.
    single : transducers of a single board, in the frame of the board; ``array`` has all boards.
    """

    poses: tuple[Pose, ...]
    weakest: float
    single: PhasedArray

    def __repr__(self) -> str:
        return one_line(
            self,
            counted(len(self.poses), "board", "boards"),
            f"weakest focus {self.weakest:,.0f} Pa",
        )

    @cached_property
    def array(self) -> PhasedArray:
        """The transducers in the frame of the obstacles."""
        return join([self.single.moved(pose) for pose in self.poses])

    @property
    def middles(self) -> Float64[np.ndarray, "boards 3"]:
        """(B, 3) centre of each board in the frame of the obstacles [m]."""
        return np.stack([pose.apply(middle_of(self.single)) for pose in self.poses])


@dataclass(frozen=True, eq=False, repr=False)
class Placement:
    """Layouts of boards for a setup, and the pressures that they produce; see ``place``.

    All pressures are peak values at the weakest focus at full scale, as in ``Layout.weakest``.

    Attributes
    ----------
    setup : the setup, with its present array.
    board : name of the kind of the boards.
    layouts : all layouts that were tried, as ``Layout`` objects, best first. The best few were
        refined.
    present : pressure with the setup's present array, for the same poses of the hand as for the
        layouts [Pa]; NaN if the array overlaps the hand in one of these poses.
    verified : pressure with the best layout [Pa], verified by a second solve.
    moves : (B, 6) relative change of the pressure (−0.1 is a loss of 10 %) if one of the B boards
        of the best layout is moved by 1 cm along x, y or z of the scene, or turned by 5 degrees
        about one of these axes through its centre. The drive is recomputed after each move. Each
        board is moved in both directions, and the value is for the direction with the lower
        pressure.
    """

    setup: Setup
    board: str
    layouts: tuple[Layout, ...]
    present: float
    verified: float
    moves: Float64[np.ndarray, "boards 6"]

    def __repr__(self) -> str:
        return one_line(
            self,
            counted(len(self.layouts), "layout", "layouts"),
            f"best {self.layouts[0].weakest:,.0f} Pa",
            f"median {self.median:,.0f} Pa",
            f"present {self.present:,.0f} Pa",
        )

    @property
    def median(self) -> float:
        """Median, over all layouts, of the pressure at the weakest focus [Pa]."""
        return float(np.median([layout.weakest for layout in self.layouts]))

    def save(self, folder: str | Path, count: int = 3) -> tuple[Path, ...]:
        """Write the best ``count`` layouts as scene files layout_1.toml, ...; return their paths.

        Existing files are replaced.

        Raises
        ------
        InvalidInput
            If the setup was not read from a scene file, or a file cannot be written.
        """
        if self.setup.path is None:
            raise InvalidInput(
                "the setup was not read from a scene file, so no scene file can be written: use "
                "layouts[0].array instead.",
                code="data_missing",
            )
        source = self.setup.path.resolve().parent
        folder = writable_folder(Path(folder))
        files = []
        for index, layout in enumerate(self.layouts[:count]):
            file = folder / f"layout_{index + 1}.toml"
            text = _with_array(self.setup.text, self._array_table(layout))

            # Paths in a scene file are relative to its folder, and the new file is in another one.
            def moved(match: re.Match) -> str:
                if not (source / match[2]).is_file():
                    return match[0]
                return f'"{Path(relpath(source / match[2], folder.resolve())).as_posix()}"'

            text = re.sub(r"([\"'])([^\"'\n]{1,255})\1", moved, text)
            parse_scene(text)  # raises an error if the table of the array had an unusual form
            with whole_file(file) as partial:
                partial.write_text(text, encoding="utf-8")
            files.append(file)
        return tuple(files)

    def _array_table(self, layout: Layout) -> str:
        """Return the lines of the table [array] for a layout."""
        element = layout.single.element
        lines = [
            "[array]",
            'layout = "boards"',
            f'board = "{self.board}"',
            f"sensitivity = {element.sensitivity!r}",
            f'source = "{"piston" if element.directional else "monopole"}"',
        ]
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
        # A list over several lines may begin with numbers, but tables have names.
        if header and not re.match(r"\s*\[+\s*-?\d", line):
            inside = header[1] == "array"
            top = False
        # Before the first table, the array may be written in one line: array = { layout = ... }.
        if not inside and not (top and re.match(r"\s*array\s*[.=]", line)):
            kept.append(line)
    return "\n".join(kept).rstrip() + "\n\n" + table


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
    keep_out: Sequence[Box] = (),
    fixed: Sequence[int] = (),
    symmetric: Literal["x", "y", "z"] | None = None,
    tilted: bool = True,
    objective: Literal["weakest", "lowest_tenth"] = "weakest",
) -> Placement:
    """Search for the layouts of boards that maximise the pressure at the weakest focus.

    Boards do not overlap, no board is between another board and a focus, and the
    whole hand is in front of each board. Sound reflected by the boards is not
    included.

    Parameters
    ----------
    setup : scene, target, and the array with which the layouts are compared. All positions are in
        the frame of the scene.
    boards : number of boards to place, 1 or more.
    board : kind of the boards: "autd3", "sonicsurface", "nano16" or "openmpd".
    distance : smallest distance of any part of a board from the bodies and foci, and largest
        distance of a board's centre from the centre of the foci [m]; both above zero and at most
        10, the smallest first.
    region : two opposite corners of a box that must contain all boards [m], or a function that
        takes points (N, 3) [m] and returns an array (N,) that is True where boards are allowed. By
        default, they are allowed everywhere.
    hands : poses of the hand for which the layouts are optimised, instead of the setup's pose. Each
        is either a hand or a ``Pose``. A hand replaces the only body of the scene, and its named
        points are the foci. A pose moves all bodies and foci.
    tries : number of random layouts to try before refinement, 1 or more; in a small region, fewer
        may fit.
    seed : seed of the search, an integer of at least 0. The same arguments lead to the same result.
    refine : number of layouts to refine, 0 or more. The best layouts are refined, except those
        within 40 mm of a better one.
    progress : function called with a description of each step as it begins.
    keep_out : boxes that must not contain any board, each given by two opposite corners [m].
    fixed : indices of boards of the setup's array that are part of every layout. In the results,
        they come after the placed boards.
    symmetric : axis along which boards are mirrored to form pairs, which requires an even number of
        boards; None places boards independently. The mirror plane passes through the centre of the
        region if it is a box, and otherwise through the centre of the foci.
    tilted : whether boards may be tilted; otherwise each faces the centre of the
        foci.
    objective : quantity to maximise: "weakest" is the pressure at the weakest focus in the worst
        pose of the hand; "lowest_tenth" is the pressure that the weakest focus exceeds in nine
        poses out of ten.

    Returns
    -------
    A ``Placement`` with the layouts, best first, and their pressures.

    Raises
    ------
    InvalidInput
        If no layout fits, a number is outside its range, the board is unknown, or "lowest_tenth" is
        requested for fewer than two hands. The error is also raised if the boards of the scene
        reflect sound, if a plane is behind the boards, if the setup has traps, or if a hand cannot
        replace the setup's body because there are several bodies or a focus is not at a named
        point.
    NotConverged
        If a solver stops before it converges.

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
            "the scene has a plane behind its boards, which would reflect the sound of boards at "
            "other positions: remove the plane, and set a region above it.",
            code="not_supported",
        )
    for count, name in ((boards, "boards"), (tries, "tries")):
        if not isinstance(count, int | np.integer) or count < 1:
            raise InvalidInput(
                f"the number of {name} is {count!r}: use a whole number of at least 1.",
                code="out_of_range",
            )
    if symmetric is not None:
        check_choice(symmetric, "the axis of symmetry", ("x", "y", "z"))
        if boards % 2:
            raise InvalidInput(
                f"{counted(boards, 'board', 'boards')} cannot be mirrored in pairs along "
                f"{symmetric}, because the number is odd: use {boards + 1} boards.",
                code="options_clash",
            )
    check_choice(objective, "the objective", ("weakest", "lowest_tenth"))
    if objective == "lowest_tenth" and (hands is None or len(hands) < 2):
        raise InvalidInput(
            "the objective lowest_tenth needs several poses of the hand: add a recording, or use "
            "the objective weakest.",
            code="data_missing",
        )
    nearest = within(distance[0], 0.0, MAX_ARRAY_EXTENT, "the smallest distance", "m")
    farthest = within(distance[1], 0.0, MAX_ARRAY_EXTENT, "the largest distance", "m")
    if farthest < nearest:
        raise InvalidInput(
            f"the largest distance, {farthest:g} m, is below the smallest, {nearest:g} m: "
            "pass the smallest distance first.",
            code="out_of_range",
        )
    # Boards of the same kind keep their transducers, as set in the scene file.
    single = board_array(board, element=setup.array.element if board == setup.board else None)
    sides = at.transducers.board_named(board).outline
    # Transducers are 10 mm apart.
    spread = np.ptp(single.positions[:, :2], axis=0) + 10e-3
    report = progress or (lambda step: None)
    solved = []
    for index, (scene, target, motion) in enumerate(_hand_poses(setup, hands)):
        report(f"solving for a beacon in each focus of hand {index + 1}")
        # Hands that are only moved share a solve.
        same = [hand for hand in solved if hand.scene is scene]
        solved.append(
            HandPose(
                scene,
                target,
                motion,
                same[0].beacons if same else _beacons(setup.solver, scene, target),
            )
        )
    half = 0.5 * (spread if sides is None else np.array(sides))
    middle = np.concatenate([hand.motion.apply(hand.target.points) for hand in solved]).mean(axis=0)
    if region is not None and not callable(region):
        middle = np.mean([point_of(corner, "a corner of the region") for corner in region], axis=0)
    mirror = None
    if symmetric is not None:
        axis = "xyz".index(symmetric)
        mirror = (axis, float(middle[axis]))
    search = Search(
        solved,
        single,
        half,
        (nearest, farthest),
        _allowed(region, keep_out, setup.scene),
        fixed=_fixed(setup, board, fixed),
        mirror=mirror,
        tilted=tilted,
        share=0.1 if objective == "lowest_tenth" else 0.0,
    )
    report(f"trying {tries:,} layouts")
    found = sorted(search.candidates(boards, tries, seed), key=lambda layout: -layout[0])
    report("refining the best layouts")
    layouts = [Layout(tuple(search.poses(places)), weakest, single) for weakest, places in found]
    # Starting points that differ by more than 40 mm in some board lead to different layouts.
    starts = _distinct(layouts, 40e-3, refine)
    best = []
    for index in starts:
        weakest, places = search.refined(*found[index])
        best.append(Layout(tuple(search.poses(places)), weakest, single))
    best.sort(key=lambda layout: -layout.weakest)
    rest = [layout for index, layout in enumerate(layouts) if index not in starts]
    # Two starting points may lead to the same layout.
    layouts = [*(best[index] for index in _distinct(best, 10e-3, refine)), *rest]
    layouts.sort(key=lambda layout: -layout.weakest)
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
    """Yield the scene, the target and the motion for each pose of the hand."""
    scene = setup.scene
    if hands is None:
        hands = [Pose.identity()]
    if len(of_kind(hands, list | tuple, "the hands", "a list of Hand or Pose")) == 0:
        raise InvalidInput("the list of hands is empty; pass at least one hand.", code="empty")
    for hand in hands:
        if isinstance(hand, Pose):
            if not all(plane.kept_by(hand) for plane in scene.planes):
                raise InvalidInput(
                    "a motion of the hand moves the plane of the scene: use only motions along "
                    "the plane.",
                    code="not_supported",
                )
            yield scene, setup.target, hand
            continue
        of_kind(hand, at.Hand, "a hand", "hand_from_joints(joints) or a Pose")
        if len(scene.obstacles) != 1 or None in setup.riding:
            raise InvalidInput(
                "hands require a scene with a single body and with all foci at named points: "
                'set at = "thumb.pad" in [[foci]].',
                code="not_supported",
            )
        points = np.stack([hand.focus(*ride) for ride in setup.riding if ride is not None])
        body = replace(scene.obstacles[0], surface=hand.surface)
        yield (
            replace(scene, obstacles=[body]),
            Target(points, shares=setup.target.weights),
            Pose.identity(),
        )


def _beacons(solver: Solver, scene: Scene, target: Target) -> RadiatedField:
    """Solve for a beacon at each focus, with the accuracy that the search requires."""
    if isinstance(solver, BoundaryElement):
        # Errors of 4 % only reorder layouts of almost equal pressure, and the best is verified.
        solver = replace(solver, accuracy=max(solver.accuracy, 0.04), estimate=False)
    field = solver.radiate(scene, target.beacons())
    return at.multipole_expansion(field) if scene.obstacles else field


def _fixed(setup: Setup, board: str, indices: Sequence[int]) -> list[Pose]:
    """Return the poses of the setup's boards that stay in place."""
    if not len(indices):
        return []
    array = setup.array
    kind = kind_of_array(array.positions, array.normals)
    poses = kind[1] if kind is not None and kind[0].name == board else []
    if not set(indices) <= set(range(len(poses))) or len(set(indices)) < len(indices):
        words = "board" if len(indices) == 1 else "boards"
        fault = (
            f"the scene has {counted(len(poses), 'board', 'boards')}. Name each of them once, "
            "counting from 0."
        )
        if kind is None or kind[0].name != board:
            made = "of different or unknown kinds" if kind is None else kind[0].name
            fault = f"the scene's boards are {made}, not {board}. Place boards of the same kind."
        raise InvalidInput(
            f"{words} {', '.join(map(str, indices))} cannot stay in place: {fault}",
            code="unknown_name",
        )
    if np.any(array.gains != 1.0):
        raise InvalidInput(
            "fixed boards would lose the gains of the scene's array: remove its calibration.",
            code="not_supported",
        )
    return [poses[index] for index in indices]


def _allowed(
    region: Region | None, keep_out: Sequence[Box], scene: Scene
) -> Callable[[Points], Bool[np.ndarray, "points"]]:
    """Return a function that is True for points at which boards are allowed."""

    def box(corners: Box) -> Callable[[Points], Bool[np.ndarray, "points"]]:
        ends = np.stack([point_of(corner, "a corner of a box") for corner in corners])
        low = ends.min(axis=0)
        high = ends.max(axis=0)
        return lambda points: ((points >= low) & (points <= high)).all(axis=1)

    inside = region if region is None or callable(region) else box(region)
    closed = [box(corners) for corners in keep_out]

    def allowed(points: Points) -> Bool[np.ndarray, "points"]:
        free = before_planes(scene.planes, points)
        for outside in closed:
            free &= ~outside(points)
        return free if inside is None else free & inside(points)

    return allowed


def _distinct(layouts: list[Layout], apart: float, most: int) -> list[int]:
    """Return the indices of layouts that differ from all better ones by over ``apart`` [m]."""
    kept: list[int] = []
    for index, layout in enumerate(layouts):
        if len(kept) == most:
            break
        distances = (cdist(layout.middles, layouts[other].middles) for other in kept)
        if all(distance.min(axis=1).max() > apart for distance in distances):
            kept.append(index)
    return kept


def _present(search: Search, array: PhasedArray) -> float:
    """Return the pressure at the weakest focus for the present array; NaN if it does not fit."""
    try:
        for hand in search.hands:
            check_placement(hand.scene, array.seen_from(hand.motion), hand.target.points)
    except InvalidInput:
        return np.nan
    return search.weakest([[hand.rows(array) for hand in search.hands]])


def _verified(setup: Setup, search: Search, array: PhasedArray) -> float:
    """Compute the pressure [Pa] at the weakest focus for the search's drives by a finer solver."""
    solver = (
        replace(setup.solver, accuracy=min(setup.solver.accuracy, 0.02))
        if isinstance(setup.solver, BoundaryElement)
        else verification_solver(setup)
    )
    weakest = []
    for hand in search.hands:
        drive = Drive(drive_of(hand.rows(array)))
        result = at.evaluate(
            hand.scene, array.seen_from(hand.motion), drive, hand.target, solver=solver
        )
        asked = hand.target.weights > 0.0
        weakest.append((result.magnitudes[asked] / hand.shares).min())
    return float(np.quantile(weakest, search.share))


def hands_of(setup: Setup, recording: Path, count: int) -> "list[at.Hand]":
    """Return up to ``count`` hands from a recording, evenly spaced in time.

    Their radii are those of the setup's hand.

    Raises
    ------
    InvalidInput
        If the setup does not contain exactly one hand, or no frame contains a hand.
    """
    from airtact.hands.joints import joints_of
    from airtact.hands.tracking.recordings import load_recording

    if len(setup.hands) != 1:
        raise InvalidInput(
            f"the scene contains {counted(len(setup.hands), 'hand', 'hands')} with joints, but a "
            "recording replaces exactly one.",
            code="not_supported",
        )
    hands = [
        frame
        for frame in load_recording(recording, leave_out=True).frames
        if frame.landmarks is not None
    ]
    if not hands:
        raise InvalidInput(f"no frame of {recording.name} contains a hand.", code="empty")
    chosen = np.unique(np.linspace(0, len(hands) - 1, count).round().astype(int))
    return [
        at.hand_from_joints(
            joints_of(setup.tracker.apply(hands[index].landmarks)),
            setup.hands[0].radii,
            side=hands[index].side,
        )
        for index in chosen
    ]
