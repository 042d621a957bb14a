"""The tables of a scene file, one class per table, with the limits of every key.

Lengths are in metres and positions in the frame of the obstacles unless stated otherwise. Missing
keys without a default are None.
"""

from functools import cache
from typing import Annotated, ClassVar, Literal

import msgspec
from msgspec import Meta

from airtact.errors import MOST_POINTS, InvalidInput

Triple = tuple[float, float, float]
Positive = Annotated[float, Meta(gt=0)]
NotNegative = Annotated[float, Meta(ge=0)]
Share = Annotated[float, Meta(ge=0, le=1)]
Levels = Annotated[int, Meta(ge=2, le=256)]


class Rule:
    """Relation of a key to other keys, or to their values, such as ``layout = "boards"``.

    Parameters
    ----------
    words : "only with" rejects the key unless one of the conditions holds. "not with"
        rejects it if one holds. "needed by" is like "only with", and also requires the
        key if one holds.
    conditions : keys, or keys with a value, such as 'layout = "boards"'.
    """

    def __init__(self, words: str, *conditions: str) -> None:
        self.words = words
        self.conditions = conditions


# Resolving the annotations takes longer than reading a table.
_fields = cache(msgspec.structs.fields)


class Table(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """A table of a scene file; unknown keys raise an error.

    Attributes
    ----------
    one_of : keys of which exactly one must be set.
    """

    one_of: ClassVar[tuple[str, ...]] = ()

    def __post_init__(self) -> None:
        for field in _fields(type(self)):
            present = getattr(self, field.name) is not None
            for rule in getattr(field.type, "__metadata__", ()):
                if not isinstance(rule, Rule):
                    continue
                holds = any(self._has(condition) for condition in rule.conditions)
                words = " or ".join(rule.conditions)
                if present and holds == (rule.words == "not with"):
                    verb = "cannot be combined" if holds else "is valid only"
                    raise InvalidInput(f"{field.name} {verb} with {words}.", code="key_misplaced")
                if holds and not present and rule.words == "needed by":
                    raise InvalidInput(
                        f"{words} requires {field.name}: add it.", code="key_missing"
                    )
        count = sum(getattr(self, name) is not None for name in self.one_of)
        if self.one_of and count != 1:
            raise InvalidInput(
                f"set exactly one of {', '.join(self.one_of)}; {count} are set.",
                code="options_clash",
            )

    def _has(self, condition: str) -> bool:
        key, _, expected = condition.partition(" = ")
        value = getattr(self, key)
        return value == expected.strip('"') if expected else value is not None


class MediumTable(Table, frozen=True):
    """The fluid around the bodies: air at a temperature, or any fluid with a ``sound_speed``.

    Attributes
    ----------
    celsius : temperature of the air [°C].
    humidity : relative humidity of the air; by default 0.5.
    sound_speed : speed of sound of another fluid [m/s].
    density : density of the fluid [kg/m³].
    absorption : absorption of the fluid [Np/m]; by default 0.
    """

    one_of: ClassVar = ("celsius", "sound_speed")
    celsius: float | None = None
    humidity: Annotated[Share | None, Rule("only with", "celsius")] = None
    sound_speed: Positive | None = None
    density: Annotated[Positive | None, Rule("needed by", "sound_speed")] = None
    absorption: Annotated[NotNegative | None, Rule("only with", "sound_speed")] = None


class PoseTable(Table, frozen=True):
    """A rotation, given by ``axis`` or ``rotation``, followed by a ``translation``.

    Attributes
    ----------
    axis : axis of the rotation, through the origin.
    degrees : angle of rotation [°].
    rotation : rotation matrix, row by row.
    translation : translation after the rotation [m].
    """

    axis: Annotated[Triple | None, Rule("needed by", "degrees")] = None
    degrees: Annotated[float | None, Rule("needed by", "axis")] = None
    rotation: Annotated[tuple[Triple, Triple, Triple] | None, Rule("not with", "axis")] = None
    translation: Triple = (0.0, 0.0, 0.0)


class ArrayTable(Table, frozen=True):
    """The transducers.

    Attributes
    ----------
    layout : "surrounding_box" is the box of Inoue, Makino and Shinoda (2014) around the origin, or
        one of four boards of kind ``board``; "flat_boards" places AUTD3 boards edge to edge in the
        plane z = 0; "boards" places each board in its pose; "tinylev", "biglev", "flat_8x8" and
        "opposed_sonicsurfaces" are built-in arrays; a .csv file in the scene's folder contains a
        custom array.
    board : kind of board: "autd3", "sonicsurface", "nano16" or "openmpd"; by default
        "autd3".
    rows, columns : number of flat boards along y and along x; by default 2.
    poses : poses of the boards.
    calibration : .csv file with the gain of each element, in the folder of the
        scene.
    source : "piston" radiates only forward, "monopole" in all directions.
    piston_radius : radius of a transducer [m]; by default that of the board, or 4.5 mm
        for .csv.
    sensitivity : peak pressure at full scale, 1 m away, times 1 m [Pa·m]; by default
        4.38.
    reflects : whether the boards are rigid bodies that reflect sound.
    pose : pose of the whole array in the obstacles' frame.
    """

    layout: str
    board: Annotated[
        str | None, Rule("only with", 'layout = "surrounding_box"', 'layout = "boards"')
    ] = None
    rows: Annotated[int | None, Rule("only with", 'layout = "flat_boards"')] = None
    columns: Annotated[int | None, Rule("only with", 'layout = "flat_boards"')] = None
    poses: Annotated[
        Annotated[list[PoseTable], Meta(min_length=1)] | None,
        Rule("needed by", 'layout = "boards"'),
    ] = None
    calibration: str | None = None
    source: Literal["piston", "monopole"] = "piston"
    piston_radius: Annotated[Positive | None, Rule("only with", 'source = "piston"')] = None
    sensitivity: Positive | None = None
    reflects: bool = False
    pose: PoseTable | None = None


class PinchTable(Table, frozen=True):
    """The thumb and forefinger of Inoue, Makino and Shinoda (2014).

    Attributes
    ----------
    gap : distance between the pads [m].
    """

    gap: Positive = 0.012


class CapsuleTable(Table, frozen=True):
    """A cylinder with hemispherical ends.

    Attributes
    ----------
    start, end : ends of the axis [m].
    radius : radius of the cylinder and the ends [m].
    edge : longest triangle edge for display [m]; it does not affect the solver.
    """

    start: Triple
    end: Triple
    radius: Positive
    edge: Positive = 2.5e-3


class SphereTable(Table, frozen=True):
    """A sphere.

    Attributes
    ----------
    radius : radius of the sphere [m].
    centre : centre of the sphere [m].
    edge : longest triangle edge for display [m]; it does not affect the solver.
    """

    radius: Positive
    centre: Triple = (0.0, 0.0, 0.0)
    edge: Positive = 2.5e-3


class ObstacleTable(Table, frozen=True):
    """A body, or the two fingers of a pinch, and the boundary condition on its surface.

    Attributes
    ----------
    pinch, capsule, sphere : body of a built-in shape.
    surface : mesh file in the folder of the scene.
    joints : pose file of a scanned hand, in the frame of the mesh; it defines the named
        points.
    scale : length of one unit of the mesh file [m]; by default 1.
    largest_hole : widest hole that is filled [m]; by default 0.002.
    sharp_degrees : angle above which edges stay sharp [°]; by default 75.
    union : whether overlapping parts are replaced by their common outer surface.
    smallest : width below which bores are filled and walls are removed [m].
    hand : pose file of a hand.
    gap : desired distance between thumb and index finger [m].
    boundary : "sound_hard" reflects fully, "impedance" absorbs sound, "filled" contains another
        fluid.
    ratio : surface impedance Z/(ρc); [real, imaginary] if complex.
    medium : fluid inside the body.
    pose : pose of the body and its named points.
    """

    one_of: ClassVar = ("pinch", "capsule", "sphere", "surface", "hand")
    pinch: PinchTable | None = None
    capsule: CapsuleTable | None = None
    sphere: SphereTable | None = None
    surface: str | None = None
    joints: Annotated[str | None, Rule("only with", "surface")] = None
    scale: Annotated[Positive | None, Rule("only with", "surface")] = None
    largest_hole: Annotated[NotNegative | None, Rule("only with", "surface")] = None
    sharp_degrees: Annotated[NotNegative | None, Rule("only with", "surface")] = None
    union: Annotated[bool | None, Rule("only with", "surface")] = None
    smallest: Annotated[Positive | None, Rule("only with", "surface")] = None
    hand: str | None = None
    gap: Annotated[Positive | None, Rule("only with", "hand")] = None
    boundary: Literal["sound_hard", "impedance", "filled"] = "sound_hard"
    ratio: Annotated[
        float | tuple[float, float] | None, Rule("needed by", 'boundary = "impedance"')
    ] = None
    medium: Annotated[MediumTable | None, Rule("needed by", 'boundary = "filled"')] = None
    pose: PoseTable | None = None


class BoxTable(Table, frozen=True):
    """A box with edges parallel to the axes.

    Attributes
    ----------
    sides : lengths along x, y and z [m].
    centre : centre of the box [m].
    """

    sides: Triple
    centre: Triple = (0.0, 0.0, 0.0)


class CylinderTable(Table, frozen=True):
    """A cylinder with flat ends.

    Attributes
    ----------
    start, end : ends of the axis [m].
    radius : radius of the cylinder [m].
    """

    start: Triple
    end: Triple
    radius: Positive


class ButtonTable(Table, frozen=True):
    """A disc that can be pressed down.

    Attributes
    ----------
    centre : centre of the disc at rest [m].
    radius : radius of the disc [m].
    travel : distance by which the disc can be pressed [m].
    normal : direction from which the disc is pressed.
    """

    centre: Triple
    radius: Positive
    travel: Positive
    normal: Triple = (0.0, 0.0, 1.0)


class HalfSpaceTable(Table, frozen=True):
    """All points on or behind a plane.

    Attributes
    ----------
    point : any point on the plane [m].
    normal : direction that points out of the object.
    """

    point: Triple
    normal: Triple


class GratingTable(Table, frozen=True):
    """Parallel ridges on an object.

    Attributes
    ----------
    pitch : distance between neighbouring ridges [m].
    direction : direction across the ridges.
    """

    pitch: Positive
    direction: Triple = (1.0, 0.0, 0.0)


class ObjectKeys(Table, frozen=True):
    """Keys of virtual objects, in scene files as well as in messages from applications.

    Attributes
    ----------
    sphere, capsule, box, cylinder, half_space, button : object of a built-in shape.
    style : "points" puts a focus where the skin is deepest; "outline" moves a focus along the edge
        of the contact; "texture" is like "points", but stronger on the ridges of ``grating``.
    grating : ridges fixed to the object.
    stiffness : increase of strength per depth [1/m]; the strength is 0.2 at depth 0; by default
        400, or 0.8 / ``travel`` for a button.
    """

    sphere: SphereTable | None = None
    capsule: CapsuleTable | None = None
    box: BoxTable | None = None
    cylinder: CylinderTable | None = None
    half_space: HalfSpaceTable | None = None
    button: ButtonTable | None = None
    style: Literal["points", "outline", "texture"] = "points"
    grating: Annotated[GratingTable | None, Rule("needed by", 'style = "texture"')] = None
    stiffness: Positive | None = None


class ObjectTable(ObjectKeys, frozen=True):
    """A virtual object, which can be felt but does not affect the sound.

    Attributes
    ----------
    surface : closed mesh file in the folder of the scene.
    scale : length of one unit of the mesh file [m]; by default 1.
    name : name of the object in results.
    pose : pose of the object.
    """

    one_of: ClassVar = ("sphere", "capsule", "box", "cylinder", "half_space", "button", "surface")
    surface: str | None = None
    scale: Annotated[Positive | None, Rule("only with", "surface")] = None
    name: str = ""
    pose: PoseTable | None = None


class PlaneTable(Table, frozen=True):
    """A rigid plane, such as a table.

    Attributes
    ----------
    point : any point on the plane [m].
    normal : direction toward the side with the array.
    """

    point: Triple
    normal: Triple


class SegmentTable(Table, frozen=True):
    """Points on a straight line.

    Attributes
    ----------
    start, end : first and last point [m].
    spacing : largest distance between neighbours [m].
    """

    start: Triple
    end: Triple
    spacing: Positive


class PolylineTable(Table, frozen=True):
    """Points on straight lines between corners.

    Attributes
    ----------
    corners : corners of the line, in order [m].
    spacing : largest distance between neighbours [m].
    closed : whether a line connects the last corner to the first.
    """

    corners: list[Triple]
    spacing: Positive
    closed: bool = False


class CircleTable(Table, frozen=True):
    """Points on a circle.

    Attributes
    ----------
    centre : centre of the circle [m].
    radius : radius of the circle [m].
    spacing : largest distance between neighbours [m].
    normal : normal of the circle's plane.
    """

    centre: Triple
    radius: Positive
    spacing: Positive
    normal: Triple = (0.0, 0.0, 1.0)


class SphereShellTable(Table, frozen=True):
    """Points spread over a sphere.

    Attributes
    ----------
    centre : centre of the sphere [m].
    radius : radius of the sphere [m].
    spacing : mean distance between neighbours [m].
    """

    centre: Triple
    radius: Positive
    spacing: Positive


class TextTable(Table, frozen=True):
    """Points along text written in single strokes.

    Attributes
    ----------
    words : text to write.
    height : height of a capital letter [m].
    spacing : largest distance between neighbours [m].
    centre : centre of the text [m].
    normal : direction toward the reader.
    up : upward direction of the text.
    """

    words: str
    height: Positive
    spacing: Positive
    centre: Triple = (0.0, 0.0, 0.0)
    normal: Triple = (0.0, 0.0, 1.0)
    up: Triple | None = None


class SvgTable(Table, frozen=True):
    """Points along the lines of an SVG drawing.

    Attributes
    ----------
    file : SVG file in the folder of the scene.
    path : path data of a single SVG path.
    width : width of the drawing [m].
    spacing : largest distance between neighbours [m].
    centre : centre of the drawing [m].
    normal : direction toward the viewer.
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
    """Points on the surface of a body, or on the part of it that faces a direction.

    Attributes
    ----------
    body : name of the body.
    spacing : mean distance between neighbours [m].
    facing : direction that the selected part of the surface faces; by default any direction.
    within : largest angle between the surface's normal and ``facing`` [°].
    """

    body: str
    spacing: Positive
    facing: Triple | None = None
    within: NotNegative = 90.0


class Shape(Table, frozen=True):
    """One point, or the points of a shape, in scene coordinates, as keys of a scene file.

    This is the base class of ``FocusTable`` and ``SuppressionTable``. They add other ways to give
    points, and raise ``InvalidInput`` unless exactly one is used. A key such as ``circle`` is a
    table of parameters, for example a ``CircleTable``.

    Attributes
    ----------
    point : one point [m].
    segment, polyline, circle, sphere_shell, text, svg : points of a shape.
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
    at : named point of a body, such as "thumb.pad", or "left.thumb.pad" with two
        hands.
    onto : name of a body; the points are projected onto its surface.
    offset : distance from the body's surface [m]; by default 0.0005.
    pressure : peak pressure at every point [Pa]; by default as high as possible.
    share : requested pressure relative to other foci.
    phase_degrees : phase of the pressure [°]; by default free.
    name : name of the focus in results.
    """

    one_of: ClassVar = ("at", *SHAPES)
    at: str | None = None
    onto: Annotated[str | None, Rule("not with", "at")] = None
    offset: Annotated[NotNegative | None, Rule("only with", "at", "onto")] = None
    pressure: NotNegative | None = None
    share: NotNegative | None = None
    phase_degrees: float | None = None
    name: str | None = None


class SuppressionTable(Shape, frozen=True):
    """Points, or a surface, at which the sound is suppressed.

    Attributes
    ----------
    surface : points on the surface of a body.
    """

    one_of: ClassVar = (*SHAPES, "surface")
    surface: SurfacePointsTable | None = None


class TrapTable(Table, frozen=True):
    """A trap for a small bead.

    Attributes
    ----------
    point : centre of the bead [m].
    kind : "twin" has two lobes of opposite phase along ``axis``; "vortex" has a ring of pressure
        around it.
    axis : direction of the trap's axis, a vector of any length.
    radius : radius of the bead [m].
    density : density of the bead [kg/m³].
    sound_speed : speed of sound in the bead [m/s].
    """

    point: Triple
    kind: Literal["twin", "vortex"] = "twin"
    axis: Triple = (0.0, 1.0, 0.0)
    radius: Positive = 0.65e-3
    density: Positive = 29.36
    sound_speed: Positive = 900.0


class SolverTable(Table, frozen=True):
    """Computation of the field.

    Attributes
    ----------
    name : name of the solver; by default one that supports the bodies.
    accuracy : requested relative error of the field.
    """

    name: Literal["boundary_element", "finite_element", "free_field"] | None = None
    accuracy: Annotated[float, Meta(ge=1e-4, le=0.3)] = 0.01


class LevelsTable(Table, frozen=True):
    """Number of levels to which a drive is rounded.

    Attributes
    ----------
    amplitude, phase : number of levels.
    """

    amplitude: Levels = 256
    phase: Levels = 256


class ModulationTable(Table, frozen=True):
    """Modulation that makes the drive perceptible; skin hardly feels a constant force.

    Attributes
    ----------
    kind : "am" varies the amplitude; "lm" moves each focus along a small path
        around its position; "stm" moves one focus through all points, or along a
        path.
    frequency : frequency of the force, or repetitions of the path per second [Hz]; by default 200
        for "am", 50 for "lm", and 7 m/s along the path for "stm".
    depth : modulation depth of the force, above 0, at most 1; by default 1.
    path : shape of the path; "points" requires "stm".
    radius : radius of the circle, at most 0.1 [m]; by default 0.003 for "lm", 0.01 for "stm".
    length : length of the line, at most 0.1 [m]; by default 0.006 for "lm", 0.02 for "stm".
    frames : number of positions on the path, 4 to 1024; by default 16.
    along : whether the path lies on the nearest skin or in the plane facing the array; by default
        "skin" within 20 mm of skin, otherwise "array".
    """

    kind: Literal["am", "lm", "stm"]
    frequency: Positive | None = None
    depth: Annotated[float | None, Rule("only with", 'kind = "am"')] = None
    path: Annotated[Literal["circle", "line", "points"] | None, Rule("not with", 'kind = "am"')] = (
        None
    )
    radius: Annotated[
        Positive | None, Rule("not with", 'kind = "am"'), Rule("not with", 'path = "line"')
    ] = None
    length: Annotated[Positive | None, Rule("only with", 'path = "line"')] = None
    frames: Annotated[int | None, Rule("not with", 'kind = "am"')] = None
    along: Annotated[Literal["skin", "array"] | None, Rule("not with", 'kind = "am"')] = None


class DriveTable(Table, frozen=True):
    """Computation of the drive.

    Attributes
    ----------
    method : name of the method.
    levels : number of amplitude and phase levels to which the drive is rounded.
    modulation : modulation that makes the drive perceptible.
    """

    method: str = "best"
    levels: Levels | LevelsTable = 256
    modulation: ModulationTable | None = None


class UncertaintyTable(Table, frozen=True):
    """Standard deviations of the hand, the air and the transducers; see ``airtact.Uncertainty``.

    Attributes
    ----------
    position : standard deviation of the hand's position along each axis [m].
    rotation : standard deviation of the hand's rotation about a random axis [°].
    own_position : standard deviation of an additional shift of each body along each axis [m].
    own_rotation : standard deviation of an additional rotation of each body about a random axis
        [°].
    along_skin : standard deviation of each focus's position along the surface [m].
    age : standard deviation of the pose's age at the emission [s].
    velocity : velocity of the hand [m/s].
    temperature : standard deviation of the air's temperature [K].
    humidity : standard deviation of the air's relative humidity (0 to 1).
    gain : relative standard deviation of each element's amplitude.
    phase : standard deviation of each element's phase [°].
    dead : expected fraction of the elements that emit nothing.
    samples : number of samples that the method uses.
    seed : seed of the random samples.
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
    samples: Annotated[int, Meta(ge=1)] = 64
    seed: Annotated[int, Meta(ge=0)] = 0


class SceneFile(Table, frozen=True):
    """All tables of a scene file.

    Attributes
    ----------
    array : transducers.
    foci : points to be felt; by default the contacts of bodies with ``objects``.
    traps : traps for small beads.
    objects : virtual objects; at most 64.
    medium : fluid around the bodies; by default air at 20 °C.
    suppression : points at which the sound is suppressed.
    obstacles : bodies.
    planes : rigid planes; at most one.
    frequency : frequency of the sound [Hz].
    merge_bodies : whether to merge sound-hard bodies that overlap or are less than 0.3
        mm apart.
    most_points : largest number of foci and suppression points together.
    solver : settings of the solver.
    drive : settings for the drive.
    uncertainty : standard deviations used by the methods "robust" and
        "robust_phase_only".
    tracker : pose of the tracker in the obstacles' frame, for ``airtact live``.
    """

    array: ArrayTable
    foci: list[FocusTable] = []
    traps: list[TrapTable] = []
    objects: list[ObjectTable] = []
    medium: MediumTable = msgspec.field(default_factory=lambda: MediumTable(celsius=20.0))
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
