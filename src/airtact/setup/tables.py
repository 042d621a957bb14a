"""The tables of a scene file, one class each, with the range of every key.

All lengths are metres and all frames are the obstacles' frame unless a key says otherwise. A key
that is left out is None, unless it has a default.
"""

from typing import Annotated, ClassVar, Literal, NamedTuple

import msgspec
from msgspec import Meta

from airtact.errors import MOST_POINTS, InvalidInput

Triple = tuple[float, float, float]
Positive = Annotated[float, Meta(gt=0)]
NotNegative = Annotated[float, Meta(ge=0)]
Share = Annotated[float, Meta(ge=0, le=1)]
Levels = Annotated[int, Meta(ge=2, le=256)]


class Rule(NamedTuple):
    """Which other keys, or values of them such as ``layout = "boards"``, a key goes with.

    Attributes
    ----------
    words : "only with", "not with" or "needed by".
    others : one of them is enough.
    """

    words: str
    others: tuple[str, ...]


def only_with(*others: str) -> Rule:
    """Reject a key without one of the others."""
    return Rule("only with", others)


def not_with(*others: str) -> Rule:
    """Reject a key beside one of the others."""
    return Rule("not with", others)


def needed_by(other: str) -> Rule:
    """Reject a key without another, and the other without the key."""
    return Rule("needed by", (other,))


class Table(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """A table of the file; a key that it does not have is an error.

    Attributes
    ----------
    one_of : keys of which a table has exactly one.
    """

    one_of: ClassVar[tuple[str, ...]] = ()

    def __post_init__(self) -> None:
        """Raise where keys do not go together: "options_clash", "key_missing", "key_misplaced"."""
        for field in msgspec.structs.fields(self):
            given = getattr(self, field.name) is not None
            for rule in getattr(field.type, "__metadata__", ()):
                if not isinstance(rule, Rule):
                    continue
                there = any(self._has(other) for other in rule.others)
                others = " or ".join(rule.others)
                if given and there == (rule.words == "not with"):
                    verb = "does not go" if there else "goes only"
                    raise InvalidInput(f"{field.name} {verb} with {others}.", code="key_misplaced")
                if there and not given and rule.words == "needed by":
                    raise InvalidInput(
                        f"{field.name} is missing: {others} needs it.", code="key_missing"
                    )
        count = sum(getattr(self, name) is not None for name in self.one_of)
        if self.one_of and count != 1:
            raise InvalidInput(
                f"give exactly one of {', '.join(self.one_of)}; {count} given.",
                code="options_clash",
            )

    def _has(self, condition: str) -> bool:
        key, _, value = condition.partition(" = ")
        found = getattr(self, key)
        return found is not None if not value else found == value.strip('"')


class MediumTable(Table, frozen=True):
    """What the sound travels in: air of some weather, or any fluid by its ``sound_speed``.

    Attributes
    ----------
    celsius : temperature of air [°C].
    humidity : relative humidity of air, 0 to 1.
    sound_speed : [m/s].
    density : [kg/m³].
    absorption : [Np/m]; none if left out.
    """

    one_of: ClassVar = ("celsius", "sound_speed")
    celsius: float | None = None
    humidity: Annotated[Share | None, only_with("celsius")] = None
    sound_speed: Positive | None = None
    density: Annotated[Positive | None, needed_by("sound_speed")] = None
    absorption: Annotated[NotNegative | None, only_with("sound_speed")] = None


class PoseTable(Table, frozen=True):
    """A rotation, by ``axis`` or ``rotation``, then a ``translation``.

    Attributes
    ----------
    axis : direction of the axis.
    degrees : angle of the turn about it.
    rotation : a rotation matrix, row by row.
    translation : [m].
    """

    axis: Annotated[Triple | None, needed_by("degrees")] = None
    degrees: Annotated[float | None, needed_by("axis")] = None
    rotation: Annotated[tuple[Triple, Triple, Triple] | None, not_with("axis")] = None
    translation: Triple = (0.0, 0.0, 0.0)


class ArrayTable(Table, frozen=True):
    """The transducers.

    Attributes
    ----------
    layout : "surrounding_box", the paper's four boards around the origin, or a box of four of a
        kind of ``board``; "flat_boards", AUTD3 boards edge to edge in the plane z = 0; "boards" of
        one kind, each at its pose; or the name of a .csv file beside the scene file with positions
        and normals.
    board : kind of board; "autd3" if left out.
    rows, columns : how many flat boards along y and along x; 2 each if left out.
    poses : of boards.
    calibration : a .csv file beside the scene file with the gain of each element.
    source : "piston", or "monopole", alike in all directions.
    piston_radius : [m]; that of the board's transducers if left out.
    sensitivity : strength of a transducer at full scale [Pa·m].
    reflects : whether the boards are rigid bodies.
    pose : places the whole array in the obstacles' frame.
    """

    layout: str
    board: Annotated[str | None, only_with('layout = "surrounding_box"', 'layout = "boards"')] = (
        None
    )
    rows: Annotated[int | None, only_with('layout = "flat_boards"')] = None
    columns: Annotated[int | None, only_with('layout = "flat_boards"')] = None
    poses: Annotated[
        Annotated[list[PoseTable], Meta(min_length=1)] | None, needed_by('layout = "boards"')
    ] = None
    calibration: str | None = None
    source: Literal["piston", "monopole"] = "piston"
    piston_radius: Annotated[Positive | None, only_with('source = "piston"')] = None
    sensitivity: Positive | None = None
    reflects: bool = False
    pose: PoseTable | None = None


class PinchTable(Table, frozen=True):
    """The paper's thumb and forefinger.

    Attributes
    ----------
    gap : distance between their pads [m].
    """

    gap: Positive = 0.012


class CapsuleTable(Table, frozen=True):
    """A round-ended rod.

    Attributes
    ----------
    start, end : of its axis [m].
    radius : [m].
    edge : longest edge of its picture, not of the solver's panels [m].
    """

    start: Triple
    end: Triple
    radius: Positive
    edge: Positive = 2.5e-3


class SphereTable(Table, frozen=True):
    """A ball.

    Attributes
    ----------
    radius : [m].
    centre : [m].
    edge : longest edge of its picture, not of the solver's panels [m].
    """

    radius: Positive
    centre: Triple = (0.0, 0.0, 0.0)
    edge: Positive = 2.5e-3


class ObstacleTable(Table, frozen=True):
    """A body, or the two of a pinch, and what its surface does to sound.

    Attributes
    ----------
    pinch, capsule, sphere : a table of that body.
    surface : a mesh file beside the scene file.
    joints : a file of the pose of a scanned hand, in the frame of the mesh [m], which names its
        pads where the mesh has no rig.
    scale : metres per unit of the mesh file.
    largest_hole : widest hole that is filled [m].
    sharp_degrees : edges that turn by more stay sharp.
    hand : a file of the pose of a hand.
    gap : opens thumb and index finger of the hand to this distance [m].
    boundary : "sound_hard", "impedance" or "filled".
    ratio : impedance Z/(ρc) of the surface, a number or [real, imaginary].
    medium : that fills the body.
    pose : places the body and its named points.
    """

    one_of: ClassVar = ("pinch", "capsule", "sphere", "surface", "hand")
    pinch: PinchTable | None = None
    capsule: CapsuleTable | None = None
    sphere: SphereTable | None = None
    surface: str | None = None
    joints: Annotated[str | None, only_with("surface")] = None
    scale: Annotated[Positive | None, only_with("surface")] = None
    largest_hole: Annotated[NotNegative | None, only_with("surface")] = None
    sharp_degrees: Annotated[NotNegative | None, only_with("surface")] = None
    hand: str | None = None
    gap: Annotated[Positive | None, only_with("hand")] = None
    boundary: Literal["sound_hard", "impedance", "filled"] = "sound_hard"
    ratio: Annotated[float | tuple[float, float] | None, needed_by('boundary = "impedance"')] = None
    medium: Annotated[MediumTable | None, needed_by('boundary = "filled"')] = None
    pose: PoseTable | None = None


class PlaneTable(Table, frozen=True):
    """A rigid plane, such as a table.

    Attributes
    ----------
    point : of the plane [m].
    normal : direction to the side where the sound is.
    """

    point: Triple
    normal: Triple


class SegmentTable(Table, frozen=True):
    """Points of a straight line.

    Attributes
    ----------
    start, end : [m].
    spacing : largest distance between two points [m].
    """

    start: Triple
    end: Triple
    spacing: Positive


class PolylineTable(Table, frozen=True):
    """Points of lines from corner to corner.

    Attributes
    ----------
    corners : [m].
    spacing : largest distance between two points [m].
    closed : whether a line leads from the last corner to the first.
    """

    corners: list[Triple]
    spacing: Positive
    closed: bool = False


class CircleTable(Table, frozen=True):
    """Points of a circle.

    Attributes
    ----------
    centre : [m].
    radius : [m].
    spacing : largest distance between two points [m].
    normal : of the circle's plane.
    """

    centre: Triple
    radius: Positive
    spacing: Positive
    normal: Triple = (0.0, 0.0, 1.0)


class SphereShellTable(Table, frozen=True):
    """Points spread over a sphere.

    Attributes
    ----------
    centre : [m].
    radius : [m].
    spacing : usual distance between two points [m].
    """

    centre: Triple
    radius: Positive
    spacing: Positive


class TextTable(Table, frozen=True):
    """Points of writing in single strokes.

    Attributes
    ----------
    words : the text.
    height : of a capital letter [m].
    spacing : largest distance between two points [m].
    centre : [m].
    normal : direction to the reader.
    up : upward direction of the text.
    """

    words: str
    height: Positive
    spacing: Positive
    centre: Triple = (0.0, 0.0, 0.0)
    normal: Triple = (0.0, 0.0, 1.0)
    up: Triple | None = None


class SvgTable(Table, frozen=True):
    """Points of the lines of an SVG drawing.

    Attributes
    ----------
    file : an SVG file beside the scene file.
    path : the text of one SVG path.
    width : of the drawing [m].
    spacing : largest distance between two points [m].
    centre : [m].
    normal : direction to the viewer.
    up : upward direction of the drawing.
    """

    one_of: ClassVar = ("file", "path")
    width: Positive
    spacing: Positive
    file: str | None = None
    path: str | None = None
    centre: Triple = (0.0, 0.0, 0.0)
    normal: Triple = (0.0, 0.0, 1.0)
    up: Triple | None = None


class SurfacePointsTable(Table, frozen=True):
    """Points on the surface of a body, all or those that face a direction.

    Attributes
    ----------
    body : its name.
    spacing : usual distance between two points [m].
    facing : direction.
    within : largest angle between the surface's normal and that direction [degree].
    """

    body: str
    spacing: Positive
    facing: Triple | None = None
    within: NotNegative = 90.0


class Shape(Table, frozen=True):
    """Points: one, or those of a shape.

    Attributes
    ----------
    point : [m].
    segment, polyline, circle, sphere_shell, text, svg : a table of that shape.
    """

    point: Triple | None = None
    segment: SegmentTable | None = None
    polyline: PolylineTable | None = None
    circle: CircleTable | None = None
    sphere_shell: SphereShellTable | None = None
    text: TextTable | None = None
    svg: SvgTable | None = None


SHAPES = Shape.__struct_fields__


class FocusTable(Shape, frozen=True):
    """Foci: a named point of a body, a point, or the points of a shape.

    Attributes
    ----------
    at : a named point of a body, such as "thumb.pad".
    onto : body to whose surface a point or shape is projected.
    offset : distance from the body's surface [m]; 0.5 mm if left out.
    pressure : at every point [Pa].
    share : pressure in proportion to that of the other foci.
    phase_degrees : fixes the phase.
    name : of the focus.
    """

    one_of: ClassVar = ("at", *SHAPES)
    at: str | None = None
    onto: Annotated[str | None, not_with("at")] = None
    offset: Annotated[NotNegative | None, only_with("at", "onto")] = None
    pressure: NotNegative | None = None
    share: NotNegative | None = None
    phase_degrees: float | None = None
    name: str | None = None


class SuppressionTable(Shape, frozen=True):
    """Where the sound is suppressed: points, or a surface.

    Attributes
    ----------
    surface : a table of points on a body.
    """

    one_of: ClassVar = (*SHAPES, "surface")
    surface: SurfacePointsTable | None = None


class SolverTable(Table, frozen=True):
    """How the sound field is computed.

    Attributes
    ----------
    name : as the bodies need if left out.
    accuracy : relative error asked for.
    """

    name: Literal["boundary_element", "finite_element", "free_field"] | None = None
    accuracy: Annotated[float, Meta(ge=1e-4, le=0.3)] = 0.01


class LevelsTable(Table, frozen=True):
    """How many levels a drive is rounded to.

    Attributes
    ----------
    amplitude, phase : 2 to 256.
    """

    amplitude: Levels = 256
    phase: Levels = 256


class ModulationTable(Table, frozen=True):
    """What makes the drive perceptible; skin hardly feels a constant force.

    Attributes
    ----------
    kind : "am", the force follows a cosine; "lm", each focus runs along a small path around its
        position; "stm", one focus runs through all points in order, or each focus around its
        position.
    frequency : of the force, or rounds of the path a second [Hz].
    depth : of the variation of the force.
    path : "circle", "line", or of "stm" "points".
    radius : of a circle [m].
    length : of a line [m].
    frames : positions on a path.
    along : "skin", or "array" for the plane across the direction to the array.
    """

    kind: Literal["am", "lm", "stm"]
    frequency: Positive | None = None
    depth: Annotated[float | None, only_with('kind = "am"')] = None
    path: Annotated[Literal["circle", "line", "points"] | None, not_with('kind = "am"')] = None
    radius: Annotated[Positive | None, not_with('kind = "am"'), not_with('path = "line"')] = None
    length: Annotated[Positive | None, only_with('path = "line"')] = None
    frames: Annotated[int | None, not_with('kind = "am"')] = None
    along: Annotated[Literal["skin", "array"] | None, not_with('kind = "am"')] = None


class DriveTable(Table, frozen=True):
    """How the drive is made.

    Attributes
    ----------
    method : its name.
    levels : of amplitude and of phase that the drive is rounded to, a number or a table.
    modulation : a table.
    """

    method: str = "best"
    levels: Levels | LevelsTable = 256
    modulation: ModulationTable | None = None


class UncertaintyTable(Table, frozen=True):
    """Standard deviations of hand, air and transducers, see ``airtact.Uncertainty``.

    Attributes
    ----------
    position, rotation : of the hand [m, degree].
    own_position, own_rotation : of each body by itself [m, degree].
    along_skin : of each focus along its surface [m].
    age : of the pose [s].
    velocity : of the hand [m/s].
    temperature, humidity : of the air [K, parts of 1].
    gain, phase : of each element [share, degree].
    dead : share of elements that emit nothing.
    board_position, board_rotation : of each board [m, degree].
    samples : how many a drive is made for.
    seed : that they are drawn from.
    """

    position: NotNegative = 0.0
    rotation: NotNegative = 0.0
    own_position: NotNegative = 0.0
    own_rotation: NotNegative = 0.0
    along_skin: NotNegative = 0.0
    age: NotNegative = 0.0
    velocity: Triple = (0.0, 0.0, 0.0)
    temperature: NotNegative = 0.0
    humidity: NotNegative = 0.0
    gain: NotNegative = 0.0
    phase: NotNegative = 0.0
    dead: NotNegative = 0.0
    board_position: NotNegative = 0.0
    board_rotation: NotNegative = 0.0
    samples: Annotated[int, Meta(ge=1)] = 64
    seed: Annotated[int, Meta(ge=0)] = 0


class SceneFile(Table, frozen=True):
    """The whole file.

    Attributes
    ----------
    medium, array, foci, suppression, obstacles, planes, solver, drive, uncertainty : tables.
    frequency : of the sound [Hz].
    merge_bodies : whether sound-hard bodies nearer than 0.3 mm become one.
    most_points : largest number of foci and suppression points together.
    tracker : pose of a tracker whose hand the sound follows, from its frame to the obstacles'.
    """

    medium: MediumTable
    array: ArrayTable
    foci: Annotated[list[FocusTable], Meta(min_length=1)]
    suppression: list[SuppressionTable] = []
    obstacles: Annotated[list[ObstacleTable], Meta(max_length=256)] = []
    planes: list[PlaneTable] = []
    frequency: Positive = 40e3
    merge_bodies: bool = False
    most_points: Annotated[int, Meta(ge=1)] = MOST_POINTS
    solver: SolverTable = SolverTable()
    drive: DriveTable = DriveTable()
    uncertainty: UncertaintyTable | None = None
    tracker: PoseTable | None = None
