"""The tables of a scene file, one class each.

All lengths are metres and all frames are the obstacles' frame unless a key says otherwise. An
attribute is a key of the table, unless its type is a choice of several ``Choice`` classes: then the
keys of the one that is chosen are in the table itself. A choice is made by the key that is the
class's tag (``sphere = {...}``, ``at = "thumb.pad"``), or by the value of a key (``layout =
"boards"``).
"""

from typing import Annotated

import msgspec

from airtact.errors import MOST_POINTS

Triple = tuple[float, float, float]


class Table(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """A table of the file; a key that it does not have is an error."""


class Choice(Table, frozen=True, tag_field="key"):
    """Keys that belong together and exclude those of other choices.

    Where the tag is an attribute, the keys stand side by side; else the tag is a key that holds a
    table of them.
    """


class WeatherTable(Choice, frozen=True, tag="celsius"):
    """Air by its temperature [°C] and relative humidity (0 to 1)."""

    celsius: float | None = None
    humidity: float | None = None


class FluidTable(Choice, frozen=True, tag="sound_speed"):
    """Any fluid by its speed of sound [m/s], density [kg/m³] and absorption [Np/m]."""

    sound_speed: float
    density: float
    absorption: float = 0.0


class MediumTable(Table, frozen=True):
    """What the sound travels in."""

    fluid: WeatherTable | FluidTable


class AxisTable(Choice, frozen=True, tag="axis"):
    """A rotation by ``degrees`` about ``axis``."""

    axis: Triple
    degrees: float


class MatrixTable(Choice, frozen=True, tag="rotation"):
    """A rotation matrix, row by row."""

    rotation: tuple[Triple, Triple, Triple]


class PoseTable(Table, frozen=True):
    """A rotation, then a ``translation`` [m]."""

    rotation: AxisTable | MatrixTable | None = None
    translation: Triple = (0.0, 0.0, 0.0)


class Layout(Table, frozen=True, tag_field="layout"):
    """How the transducers of an array are laid out, by the value of ``layout``."""


class SurroundingBoxTable(Layout, frozen=True, tag="surrounding_box"):
    """The paper's four boards around the origin, or a box of four of a kind of ``board``."""

    board: str | None = None


class FlatBoardsTable(Layout, frozen=True, tag="flat_boards"):
    """AUTD3 boards edge to edge in the plane z = 0."""

    rows: int | None = None
    columns: int | None = None


class BoardsTable(Layout, frozen=True, tag="boards"):
    """Boards of one kind, each at its pose."""

    poses: Annotated[list[PoseTable], msgspec.Meta(min_length=1)]
    board: str = "autd3"


class ListedTable(Layout, frozen=True, tag=".csv"):
    """Positions and normals in a .csv file, which is the value of ``layout``."""

    file: str


class ArrayTable(Table, frozen=True):
    """The transducers; ``pose`` places the whole array in the obstacles' frame.

    ``calibration`` is a .csv file beside the scene file with the gain of each element. ``source``
    is "piston", of the radius of the board's transducers or of ``piston_radius`` [m], or
    "monopole", alike in all directions. ``reflects`` makes rigid bodies of the boards.
    """

    layout: SurroundingBoxTable | FlatBoardsTable | BoardsTable | ListedTable
    calibration: str | None = None
    source: str = "piston"
    piston_radius: float | None = None
    sensitivity: float | None = None
    reflects: bool = False
    pose: PoseTable | None = None


class PinchTable(Choice, frozen=True, tag="pinch"):
    """The paper's thumb and forefinger, ``gap`` apart."""

    gap: float = 0.012


class CapsuleTable(Choice, frozen=True, tag="capsule"):
    """A round-ended rod.

    ``edge`` is the longest edge of its picture, not of the solver's panels.
    """

    start: Triple
    end: Triple
    radius: float
    edge: float = 2.5e-3


class SphereTable(Choice, frozen=True, tag="sphere"):
    """A ball; ``edge`` as for a capsule."""

    radius: float
    centre: Triple = (0.0, 0.0, 0.0)
    edge: float = 2.5e-3


class SurfaceTable(Choice, frozen=True, tag="surface"):
    """A mesh file beside the scene file, ``scale`` metres per unit.

    Holes up to ``largest_hole`` [m] are filled; edges that bend by more than ``sharp_degrees`` stay
    sharp. ``joints`` is a file of the hand's pose in the frame of the mesh [m], which names its
    pads where the mesh has no rig.
    """

    surface: str
    joints: str | None = None
    scale: float | None = None
    largest_hole: float | None = None
    sharp_degrees: float | None = None


class HandTable(Choice, frozen=True, tag="hand"):
    """A hand from a file of its pose; ``gap`` [m] opens thumb and index finger to that distance."""

    hand: str
    gap: float | None = None


# Kinds of bodies
Body = PinchTable | CapsuleTable | SphereTable | SurfaceTable | HandTable


class Boundary(Table, frozen=True, tag_field="boundary"):
    """What the surface of a body does to sound, by the value of ``boundary``."""


class SoundHardTable(Boundary, frozen=True, tag="sound_hard"):
    """A surface that does not move."""


class ImpedanceTable(Boundary, frozen=True, tag="impedance"):
    """A locally reacting surface; ``ratio`` is Z/(ρc), a number or [real, imaginary]."""

    ratio: float | tuple[float, float]


class FilledTable(Boundary, frozen=True, tag="filled"):
    """A body of another fluid."""

    medium: MediumTable


class ObstacleTable(Table, frozen=True):
    """A body, or the two of a pinch, and what its surface does to sound.

    ``pose`` places it, its named points too.
    """

    body: Body
    boundary: SoundHardTable | ImpedanceTable | FilledTable = SoundHardTable()
    pose: PoseTable | None = None


class PlaneTable(Table, frozen=True):
    """A rigid plane, such as a table, through ``point`` [m].

    Sound is on the side that ``normal`` points to.
    """

    point: Triple
    normal: Triple


class NamedPointTable(Choice, frozen=True, tag="at"):
    """A named point of a body, such as "thumb.pad"."""

    at: str


class PointTable(Choice, frozen=True, tag="point"):
    """One point [m]."""

    point: Triple


class SegmentTable(Choice, frozen=True, tag="segment"):
    """Points of a straight line, at most ``spacing`` apart [m]."""

    start: Triple
    end: Triple
    spacing: float


class PolylineTable(Choice, frozen=True, tag="polyline"):
    """Points of lines from corner to corner, and back to the first where it is ``closed``."""

    corners: list[Triple]
    spacing: float
    closed: bool = False


class CircleTable(Choice, frozen=True, tag="circle"):
    """Points of a circle in the plane at right angles to ``normal``."""

    centre: Triple
    radius: float
    spacing: float
    normal: Triple = (0.0, 0.0, 1.0)


class SphereShellTable(Choice, frozen=True, tag="sphere_shell"):
    """Points spread over a sphere, about ``spacing`` apart."""

    centre: Triple
    radius: float
    spacing: float


class Drawn(Choice, frozen=True):
    """Points of a drawing, with their ``spacing`` [m], read from where ``normal`` points to."""

    spacing: float
    centre: Triple = (0.0, 0.0, 0.0)
    normal: Triple = (0.0, 0.0, 1.0)
    up: Triple | None = None


class WritingTable(Drawn, frozen=True, kw_only=True, tag="text"):
    """Writing in single strokes; ``height`` is that of a capital letter."""

    words: str
    height: float


class DrawingFileTable(Choice, frozen=True, tag="file"):
    """An SVG file beside the scene file."""

    file: str


class DrawingPathTable(Choice, frozen=True, tag="path"):
    """The text of one SVG path."""

    path: str


class SvgTable(Drawn, frozen=True, kw_only=True, tag="svg"):
    """The lines of an SVG drawing, ``width`` wide."""

    source: DrawingFileTable | DrawingPathTable
    width: float


class SurfacePointsTable(Choice, frozen=True, tag="surface"):
    """Points on the surface of a ``body``, or those that face ``facing`` within some degrees."""

    body: str
    spacing: float
    facing: Triple | None = None
    within: float = 90.0


# Shapes whose keys are the arguments of the function that makes them
Shape = SegmentTable | PolylineTable | CircleTable | SphereShellTable | WritingTable


class FocusTable(Table, frozen=True):
    """Foci: a named point of a body, ``offset`` off its surface, a point, or the points of a shape.

    A point or shape ``onto`` a body is projected to its surface, and stands ``offset`` off it.
    Every point of it gets ``pressure`` [Pa], or a ``share`` in proportion to the others;
    ``phase_degrees`` fixes the phase.
    """

    points: NamedPointTable | PointTable | Shape | SvgTable
    offset: float | None = None
    onto: str | None = None
    pressure: float | None = None
    share: float | None = None
    phase_degrees: float | None = None
    name: str | None = None


class SuppressionTable(Table, frozen=True):
    """Where the sound is suppressed."""

    points: PointTable | Shape | SvgTable | SurfacePointsTable


class SolverTable(Table, frozen=True):
    """How the sound field is computed, by default as the bodies need.

    ``accuracy`` is the relative error asked for.
    """

    name: str | None = None
    accuracy: float = 0.01


class LevelsTable(Table, frozen=True):
    """How many levels of amplitude and of phase a drive is rounded to, 2 to 256 each."""

    amplitude: int = 256
    phase: int = 256


class ModulationKind(Table, frozen=True, tag_field="kind"):
    """What makes the drive perceptible, by the value of ``kind``."""


class AmplitudeTable(ModulationKind, frozen=True, tag="am"):
    """The force follows a cosine of a ``frequency`` [Hz] and ``depth``."""

    frequency: float = 200.0
    depth: float = 1.0


class Moving(ModulationKind, frozen=True):
    """Foci run along a "circle" of a ``radius`` or a "line" of a ``length`` [m].

    A path is run through ``frequency`` times a second in ``frames`` positions. It lies ``along``
    the "skin", or the plane across the direction to the "array".
    """

    path: str | None = None
    radius: float | None = None
    length: float | None = None
    frequency: float | None = None
    frames: int | None = None
    along: str | None = None


class LateralTable(Moving, frozen=True, tag="lm"):
    """Each focus runs along a small path around its position."""


class SpatiotemporalTable(Moving, frozen=True, tag="stm"):
    """One focus runs through all "points" in order, or each focus around its position."""


class ModulationTable(Table, frozen=True):
    """What makes the drive perceptible; skin hardly feels a constant force."""

    kind: AmplitudeTable | LateralTable | SpatiotemporalTable


class DriveTable(Table, frozen=True):
    """Method of the drive, its modulation, and the levels it is rounded to, 2 to 256."""

    method: str = "best"
    levels: int | LevelsTable = 256
    modulation: ModulationTable | None = None


class UncertaintyTable(Table, frozen=True):
    """Standard deviations of hand, air and transducers, as of ``airtact.Uncertainty``.

    ``samples`` is how many of them a drive is made for, drawn from a ``seed``.
    """

    position: float = 0.0
    rotation: float = 0.0
    own_position: float = 0.0
    own_rotation: float = 0.0
    along_skin: float = 0.0
    age: float = 0.0
    velocity: Triple = (0.0, 0.0, 0.0)
    temperature: float = 0.0
    humidity: float = 0.0
    gain: float = 0.0
    phase: float = 0.0
    dead: float = 0.0
    board_position: float = 0.0
    board_rotation: float = 0.0
    samples: int = 64
    seed: int = 0


class SceneFile(Table, frozen=True):
    """The whole file; ``merge_bodies`` joins sound-hard bodies nearer than 0.3 mm.

    ``most_points`` is the largest number of foci and suppression points together. ``tracker`` is
    where a tracker stands whose hand the sound follows, from its frame to the obstacles'.
    """

    medium: MediumTable
    array: ArrayTable
    foci: list[FocusTable]
    suppression: list[SuppressionTable] = []
    obstacles: list[ObstacleTable] = []
    planes: list[PlaneTable] = []
    frequency: float = 40e3
    merge_bodies: bool = False
    most_points: int = MOST_POINTS
    solver: SolverTable = SolverTable()
    drive: DriveTable = DriveTable()
    uncertainty: UncertaintyTable | None = None
    tracker: PoseTable | None = None
