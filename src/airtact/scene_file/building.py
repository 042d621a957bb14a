"""From the tables of a scene file to the scene, the array, the target and the way to make the drive."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from airtact.conventions import InvalidInput, about
from airtact.hand.files import ROOM, load_hand
from airtact.hand.pinch import pinch
from airtact.pose import Pose
from airtact.scene.medium import Medium, air
from airtact.scene.scene import Obstacle, Scene, check_outside, filled, impedance, sound_hard
from airtact.scene.target import Target
from airtact.scene_file.bare_triangles import Triangles, bare_triangles
from airtact.scene_file.keys import goes_with, one_of
from airtact.scene_file.merging import with_merged_bodies
from airtact.scene_file.tables import (
    ArrayTable,
    MediumTable,
    ObstacleTable,
    PoseTable,
    SceneFile,
    nearest,
    parse_scene,
)
from airtact.scene_file.targets import Places, target_of
from airtact.solvers.bem.solver import BoundaryElement
from airtact.solvers.fem.solver import FiniteElement
from airtact.solvers.free_field import FreeField
from airtact.solvers.problem import Solver
from airtact.surfaces.files import load_surface
from airtact.surfaces.primitives import capsule, sphere
from airtact.surfaces.surface import Surface
from airtact.synthesis.methods import METHODS
from airtact.text_table import read_text_table
from airtact.transducers.calibration import load_calibration
from airtact.transducers.element import Element, monopole, piston
from airtact.transducers.layout import PhasedArray, board_array, flat_boards, surrounding_box
from airtact.transducers.placement import check_placement
from airtact.transfer import Drive, TransferMatrix
from airtact.validation import counted, file_fault

SOLVERS = ("boundary_element", "finite_element", "free_field")
"""The solvers that a file can name."""

BOUNDARIES = {"boundary_element": ("sound_hard",), "finite_element": ("sound_hard", "impedance", "filled")}
"""The boundaries of bodies that each of them can solve."""

SURFACE_SETTINGS = ("scale", "largest_hole", "sharp_degrees")
"""Keys that go only with a surface, and what ``load_surface`` calls them."""


@dataclass(frozen=True, eq=False)
class Setup:
    """What a scene file asks for, ready to be solved.

    Attributes
    ----------
    path : the file.
    text : what it says.
    scene : the bodies in their medium.
    bodies : a name for each body.
    array : the transducers, in the obstacles' frame.
    target : the foci.
    foci : a name for each focus.
    solver : makes the drive.
    accuracy : that it is asked for.
    method : name of the way the drive is made.
    synthesise : that way.
    """

    path: Path
    text: str
    scene: Scene
    bodies: tuple[str, ...]
    array: PhasedArray
    target: Target
    foci: tuple[str, ...]
    solver: Solver
    accuracy: float
    method: str
    synthesise: Callable[[TransferMatrix, Target], Drive]


def read_scene(path: Path) -> Setup:
    """Read a scene file and build what it describes.

    Parameters
    ----------
    path : the TOML file; surfaces and array files that it names are found beside it.

    Raises
    ------
    InvalidInput
        The file cannot be read, has a wrong key or value, or describes an impossible scene; the message begins with the
        file's name and the table at fault.
    """
    text = _text(path)
    with about(path.name):
        return _set_up(path, text, parse_scene(text))


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise file_fault(path, error) from None
    except UnicodeDecodeError as error:
        raise InvalidInput(f"{path.name} is not a text file: byte {error.start} is not UTF-8.") from None


def _set_up(path: Path, text: str, file: SceneFile) -> Setup:
    with about("medium"):
        medium = _medium(file.medium, file.frequency)
    scene, bodies, places = _scene(file, medium, path.parent)
    with about("array"):
        array = _array(file.array, path.parent)
    surfaces = {name: obstacle.surface for name, obstacle in zip(bodies, scene.obstacles, strict=True)}
    target, foci = target_of(file.foci, file.suppression, places, surfaces, path.parent)
    solver = _solver(file, scene)
    with about("foci"):
        check_outside(scene, target.points, "focus")
    with about("suppression"):
        if len(target.suppression_points):
            check_outside(scene, target.suppression_points, "suppression point")
    with about("array"):
        check_placement(scene, array, target.points)
    with about("drive"):
        if file.drive.method not in METHODS:
            raise InvalidInput(f'"{file.drive.method}" is not a method here; {nearest(file.drive.method, METHODS)}')
        if file.drive.levels != 256:
            raise InvalidInput(f"levels = {file.drive.levels}, but drives are written in 256 levels.")
    return Setup(
        path=path,
        text=text,
        scene=scene,
        bodies=bodies,
        array=array,
        target=target,
        foci=foci,
        solver=solver,
        accuracy=file.solver.accuracy,
        method=file.drive.method,
        synthesise=METHODS[file.drive.method],
    )


def _solver(file: SceneFile, scene: Scene) -> Solver:
    with about("solver"):
        name = file.solver.name or ("boundary_element" if scene.obstacles else "free_field")
        if name not in SOLVERS:
            raise InvalidInput(f'"{name}" is not a solver here; {nearest(name, SOLVERS)}')
        if name == "free_field":
            if scene.obstacles:
                raise InvalidInput(
                    f"the scene has {counted(len(scene.obstacles), 'obstacle', 'obstacles')}, and free_field is for "
                    "open air; name boundary_element, or nothing."
                )
            return FreeField()
        if not scene.obstacles:
            raise InvalidInput(f"the scene has 0 obstacles, and {name} needs one or more; name free_field, or nothing.")
        for index, obstacle in enumerate(scene.obstacles):
            if obstacle.boundary not in BOUNDARIES[name]:
                raise InvalidInput(
                    f"body {index} is {obstacle.boundary}, but {name} solves {', '.join(BOUNDARIES[name])} bodies only."
                )
        if name == "finite_element":
            return FiniteElement.reaching(file.solver.accuracy)
        return BoundaryElement(accuracy=file.solver.accuracy)


def _medium(table: MediumTable, frequency: float) -> Medium:
    weather = {key: value for key in ("celsius", "humidity") if (value := getattr(table, key)) is not None}
    keys = ("sound_speed", "density", "absorption")
    fluid = {key: value for key in keys if (value := getattr(table, key)) is not None}
    if weather and not fluid:
        return air(**weather, frequency=frequency)
    if not weather and {"sound_speed", "density"} <= fluid.keys():
        return Medium(**fluid)
    given = ", ".join([*weather, *fluid]) or "nothing"
    raise InvalidInput(f"give celsius and humidity, or sound_speed and density; {given} given.")


def _scene(file: SceneFile, medium: Medium, folder: Path) -> tuple[Scene, tuple[str, ...], Places]:
    obstacles: list[Obstacle] = []
    bodies: list[str] = []
    places: Places = {}
    for index, table in enumerate(file.obstacles):
        with about(f"obstacles[{index}]"):
            named = tuple(focus.at for focus in file.foci if focus.at is not None)
            for name, surface in _bodies(table, folder, places, named).items():
                obstacles.append(_obstacle(table, surface, file.frequency))
                bodies.append(f"{name} {index + 1}" if name in bodies else name)
    if file.merge_bodies:
        with about("merge_bodies"):
            bodies, obstacles = with_merged_bodies(bodies, obstacles)
    return Scene(medium, obstacles, frequency=file.frequency), tuple(bodies), places


def _bodies(table: ObstacleTable, folder: Path, places: Places, named: tuple[str, ...] = ()) -> dict[str, Surface]:
    """Build an obstacle's bodies by name, and note the places that foci can ask for."""
    kind = one_of(table, ("pinch", "capsule", "sphere", "surface", "hand"))
    goes_with(table, "gap", "hand", kind == "hand")
    for key in SURFACE_SETTINGS:
        goes_with(table, key, "surface", kind == "surface")
    if table.pinch is not None:
        fingers = pinch(gap=table.pinch.gap)
        for name, pad, normal in zip(("thumb", "finger"), fingers.pads, fingers.normals, strict=True):
            places[f"{name}.pad"] = (pad, normal, fingers.gap)
        return {"thumb": fingers.surfaces[0], "finger": fingers.surfaces[1]}
    if table.capsule is not None:
        rod = table.capsule
        return {"capsule": capsule(np.array(rod.start), np.array(rod.end), radius=rod.radius, edge=rod.edge)}
    if table.sphere is not None:
        ball = table.sphere
        return {"sphere": sphere(radius=ball.radius, edge=ball.edge, centre=np.array(ball.centre))}
    if table.hand is not None:
        hand = load_hand(folder / table.hand, table.gap)
        for name in hand.places:
            places[name] = (*(hand.place(name) if name in named else hand.places[name]), ROOM)
        return {"hand": hand.surface}
    file = Path(str(table.surface))
    settings = {key: value for key in SURFACE_SETTINGS if (value := getattr(table, key)) is not None}
    return {file.stem: load_surface(folder / file, **settings)}


def drawable_bodies(path: Path) -> list[Triangles]:
    """Find the triangles of the bodies of a scene file that is refused, as far as they can be read.

    Parameters
    ----------
    path : the TOML file.

    Raises
    ------
    InvalidInput
        The file itself cannot be read or is no scene file.
    """
    found = []
    for table in parse_scene(_text(path)).obstacles:
        try:
            found += [(body.vertices, body.triangles) for body in _bodies(table, path.parent, {}).values()]
        except InvalidInput:
            scale = 1.0 if table.scale is None else table.scale
            bare = None if table.surface is None else bare_triangles(path.parent / table.surface, scale)
            found += [] if bare is None else [bare]
    return found


def _obstacle(table: ObstacleTable, surface: Surface, frequency: float) -> Obstacle:
    goes_with(table, "ratio", 'boundary = "impedance"', table.boundary == "impedance")
    goes_with(table, "medium", 'boundary = "filled"', table.boundary == "filled")
    if table.boundary == "impedance":
        if table.ratio is None:
            raise InvalidInput('boundary = "impedance" needs ratio, Z/(ρc), a number or [real, imaginary].')
        return impedance(surface, complex(*table.ratio) if isinstance(table.ratio, tuple) else complex(table.ratio))
    if table.boundary == "filled":
        if table.medium is None:
            raise InvalidInput('boundary = "filled" needs medium, what the body is filled with.')
        with about("medium"):
            return filled(surface, _medium(table.medium, frequency))
    return sound_hard(surface)


def _pose(table: PoseTable) -> Pose:
    translation = np.array(table.translation)
    if table.rotation is not None:
        if table.axis is not None or table.degrees is not None:
            raise InvalidInput("give rotation, or axis and degrees, not both.")
        return Pose(np.array(table.rotation), translation)
    if table.axis is None and table.degrees is None:
        return Pose(np.eye(3), translation)
    if table.axis is None or table.degrees is None:
        raise InvalidInput("axis and degrees go together; only one of them is given.")
    return Pose.turn(np.array(table.axis), math.radians(table.degrees), translation)


def _array(table: ArrayTable, folder: Path) -> PhasedArray:
    loudness = {} if table.sensitivity is None else {"sensitivity": table.sensitivity}
    element = monopole(**loudness) if table.piston_radius is None else piston(table.piston_radius, **loudness)
    for key, owner in (("rows", "flat_boards"), ("columns", "flat_boards"), ("poses", "boards")):
        goes_with(table, key, f'layout = "{owner}"', table.layout == owner)
    owners = ("surrounding_box", "boards")
    goes_with(table, "board", " or ".join(f'layout = "{owner}"' for owner in owners), table.layout in owners)
    array = _layout(table, element, folder)
    if table.calibration is not None:
        with about("calibration"):
            array = array.calibrated(load_calibration(folder / table.calibration, len(array)))
    if table.pose is None:
        return array
    with about("pose"):
        return array.moved(_pose(table.pose))


def _layout(table: ArrayTable, element: Element, folder: Path) -> PhasedArray:
    if table.layout == "surrounding_box":
        return surrounding_box(element=element, board=table.board)
    if table.layout == "flat_boards":
        size = {key: value for key in ("rows", "columns") if (value := getattr(table, key)) is not None}
        return flat_boards(**size, element=element)
    if table.layout == "boards":
        if not table.poses:
            raise InvalidInput('layout = "boards" needs poses, one for each board; 0 given.')
        return board_array(table.board or "autd3", [_pose(pose) for pose in table.poses], element)
    if table.layout.endswith(".csv"):
        return _array_from_csv(folder / table.layout, element)
    known = nearest(table.layout, ("surrounding_box", "flat_boards", "boards"))
    raise InvalidInput(f'layout = "{table.layout}" is neither a known layout nor a .csv file; {known}')


def _array_from_csv(path: Path, element: Element) -> PhasedArray:
    table = read_text_table(path)
    names = ("x", "y", "z", "nx", "ny", "nz")
    table.require(*names)
    if not table.rows:
        raise InvalidInput(f"{path.name} holds 0 transducers.")
    columns = np.stack([table.numbers(name) for name in names], axis=1)
    return PhasedArray(columns[:, :3], columns[:, 3:], element)
