"""From a scene file to the scene, the array, the target and the way to make the drive."""

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from airtact.acoustics.medium import Medium, air
from airtact.acoustics.planes import plane
from airtact.acoustics.scene import Scene, check_no_planes
from airtact.acoustics.solvers.bem.solver import BoundaryElement
from airtact.acoustics.solvers.fem.solver import FiniteElement
from airtact.acoustics.solvers.free_field import FreeField
from airtact.acoustics.solvers.problem import Solver
from airtact.acoustics.uncertainty import Uncertainty
from airtact.checks import counted
from airtact.drives.motion import ALONG, PATHS, Motion
from airtact.errors import LARGEST_SCENE_FILE, InvalidInput, about
from airtact.files.bounded import text_of
from airtact.files.text_table import read_text_table
from airtact.geometry.pose import Pose
from airtact.setup import tables
from airtact.setup.bodies import bodies_of, built, pose_of
from airtact.setup.changes import Value, with_changes
from airtact.setup.parsing import nearest, parse_scene
from airtact.setup.setup import Setup
from airtact.setup.targets import riding_of, target_of
from airtact.transducers.boards import MURATA_RADIUS, board_named
from airtact.transducers.calibration import calibrated_by
from airtact.transducers.element import (
    DEFAULT_SENSITIVITY,
    MAX_PISTON_SIZE,
    Element,
    monopole,
    piston,
)
from airtact.transducers.layout import PhasedArray, board_array, flat_boards, surrounding_box
from airtact.transducers.levels import Levels
from airtact.transducers.modulation import AmplitudeModulation
from airtact.transducers.plates import reflecting_boards

SOLVERS = {
    "boundary_element": ("sound_hard", "impedance"),
    "finite_element": ("sound_hard", "impedance", "filled"),
    "free_field": (),
}
"""The solvers that a file can name, and the boundaries of bodies that each of them can solve."""

SOURCES = ("piston", "monopole")
"""What a file can name as the kind of transducer."""


def read_scene(
    path: str | Path, changes: Mapping[str, Value] | None = None, followed: bool = False
) -> Setup:
    """Read a scene file and build what it describes.

    Parameters
    ----------
    path : the TOML file; surfaces, hands, drawings and array files that it names are found beside
        it.
    changes : values that take the place of the file's, by the paths of their keys, such as
        ``{"foci[0].offset": 1e-3, "hand.gap": 0.01}``; None takes a key away. ``hand`` is the only
        obstacle of that kind.
    followed : whether the hand will be followed live: a method for what is in doubt needs no
        ``[uncertainty]`` then, as the prediction says how far it is in doubt.

    Raises
    ------
    InvalidInput
        The file cannot be read, has a wrong key or value, or describes an impossible scene; the message begins with the
        file's name and the table at fault. "unknown_key": a path of ``changes`` leads nowhere.
    """
    path = Path(path)
    if path.suffix.lower() == ".json":
        raise InvalidInput(
            f"{path.name} is not a scene file (.toml): a pose of a hand stands in one as [[obstacles]] hand = "
            f'"{path.name}", and airtact hand shows it.',
            code="unknown_format",
        )
    text = text_of(path, LARGEST_SCENE_FILE)
    with about(path.name):
        file = parse_scene(text, partial(with_changes, changes=changes) if changes else None)
        return _set_up(path, text, file, followed)


def _set_up(path: Path, text: str, file: tables.SceneFile, followed: bool) -> Setup:
    with about("medium"):
        medium = medium_of(file.medium, file.frequency)
    bodies, obstacles, points, hands = bodies_of(
        file, path.parent, lambda table: medium_of(table, file.frequency)
    )
    planes = []
    for index, one in enumerate(file.planes):
        with about(f"planes[{index}]"):
            planes.append(plane(one.point, one.normal))
    wavenumber = medium.wavenumber(file.frequency).real
    with about("array"):
        array, board = _array(file.array, wavenumber, path.parent)
        plates = reflecting_boards(array) if file.array.reflects else ()
    bodies += ["boards"] if len(plates) == 1 else [f"board {index}" for index in range(len(plates))]
    scene = Scene(medium, [*obstacles, *plates], frequency=file.frequency, planes=planes)
    surfaces = {
        name: obstacle.surface for name, obstacle in zip(bodies, scene.obstacles, strict=True)
    }
    target, foci = target_of(
        file.foci, file.suppression, points, surfaces, path.parent, file.most_points
    )
    with about("solver"):
        solver = _solver(file, scene)
    with about("tracker"):
        tracker = Pose.identity() if file.tracker is None else pose_of(file.tracker)
    with about("drive"):
        count = file.drive.levels
        if isinstance(count, int):
            count = tables.LevelsTable(amplitude=count, phase=count)
        levels = Levels.even(count.amplitude, count.phase)
        with about("modulation"):
            modulation = _modulation(file.drive.modulation, len(foci))
    return Setup(
        scene,
        array,
        target,
        solver=solver,
        accuracy=file.solver.accuracy,
        method=file.drive.method,
        levels=levels,
        modulation=modulation,
        bodies=tuple(bodies),
        foci=foci,
        board=board,
        hands=tuple(hands),
        riding=riding_of(file.foci, len(foci)),
        tracker=tracker,
        followed=followed,
        path=path,
        text=text,
        **_uncertainty(file.uncertainty),
    )


def _uncertainty(table: tables.UncertaintyTable | None) -> dict[str, Any]:
    """Return the uncertainty, the number of samples and their seed."""
    if table is None:
        return {}
    values = msgspec.structs.asdict(table)
    samples = values.pop("samples")
    seed = values.pop("seed")
    with about("uncertainty"):
        return {"uncertainty": Uncertainty(**values), "samples": samples, "seed": seed}


def _modulation(
    table: tables.ModulationTable | None, foci: int
) -> AmplitudeModulation | Motion | None:
    if table is None:
        return None
    kind = table.kind
    if isinstance(kind, tables.AmplitudeTable):
        return AmplitudeModulation(kind.frequency, kind.depth)
    if kind.path == "line" and kind.radius is not None:
        raise InvalidInput(
            "radius goes only with a circle; give the length of a line.", code="key_misplaced"
        )
    if kind.path != "line" and kind.length is not None:
        raise InvalidInput(
            'length goes only with path = "line"; give the radius of a circle.',
            code="key_misplaced",
        )
    for key, known in (("path", PATHS), ("along", ALONG)):
        word = getattr(kind, key)
        if word is not None and word not in known:
            raise InvalidInput(
                f'{key} = "{word}" is unknown; {nearest(word, known)}', code="unknown_name"
            )
    name = "stm" if isinstance(kind, tables.SpatiotemporalTable) else "lm"
    size = kind.length if kind.path == "line" else kind.radius
    motion = Motion(name, kind.path, size, kind.frequency, kind.frames, kind.along)  # pyright: ignore[reportArgumentType]
    if motion.path == "points" and foci < 2:
        raise InvalidInput(
            f'path = "points" leads a focus along 2 or more points, and there is {foci}.',
            code="too_few",
        )
    return motion


def _solver(file: tables.SceneFile, scene: Scene) -> Solver:
    name = file.solver.name or ("boundary_element" if scene.obstacles else "free_field")
    if name not in SOLVERS:
        raise InvalidInput(
            f'"{name}" is not a solver here; {nearest(name, SOLVERS)}', code="unknown_name"
        )
    if name == "free_field" and scene.obstacles:
        count = counted(len(scene.obstacles), "obstacle", "obstacles")
        raise InvalidInput(
            f"the scene has {count}, and free_field is for open air; name boundary_element, or nothing.",
            code="not_supported",
        )
    if name == "free_field":
        return FreeField()
    if not scene.obstacles:
        raise InvalidInput(
            f"the scene has 0 obstacles, and {name} needs one or more; name free_field, or nothing.",
            code="not_supported",
        )
    for index, obstacle in enumerate(scene.obstacles):
        if obstacle.boundary not in SOLVERS[name]:
            raise InvalidInput(
                f"body {index} is {obstacle.boundary}, but {name} solves {', '.join(SOLVERS[name])} bodies only.",
                code="not_supported",
            )
    if name == "finite_element":
        check_no_planes(scene, name)
        return FiniteElement.reaching(file.solver.accuracy)
    return BoundaryElement(accuracy=file.solver.accuracy)


def medium_of(table: tables.MediumTable, frequency: float) -> Medium:
    """Build the fluid of a table; the absorption of air is that at a frequency [Hz]."""
    if isinstance(table.fluid, tables.FluidTable):
        return Medium(table.fluid.sound_speed, table.fluid.density, table.fluid.absorption)
    return built(partial(air, frequency=frequency), table.fluid)


def _array(
    table: tables.ArrayTable, wavenumber: float, folder: Path
) -> tuple[PhasedArray, str | None]:
    """Build the transducers, and name the kind of board that they are made of."""
    array, board = _layout(table, _element(table, wavenumber), folder)
    if table.calibration is not None:
        with about("calibration"):
            array = calibrated_by(folder / table.calibration, array)
    if table.pose is None:
        return array, board
    with about("pose"):
        return array.moved(pose_of(table.pose)), board


def _element(table: tables.ArrayTable, wavenumber: float) -> Element:
    """Build the kind of transducer: that of the boards unless the table gives another one."""
    sensitivity = DEFAULT_SENSITIVITY if table.sensitivity is None else table.sensitivity
    if table.source not in SOURCES:
        raise InvalidInput(
            f'source = "{table.source}" is not known; {nearest(table.source, SOURCES)}',
            code="unknown_name",
        )
    if table.source == "monopole":
        if table.piston_radius is not None:
            raise InvalidInput(
                f'piston_radius = {table.piston_radius:g} goes only with source = "piston".',
                code="key_misplaced",
            )
        return monopole(sensitivity)
    radius = _own_radius(table) if table.piston_radius is None else table.piston_radius
    return piston(
        radius, sensitivity, points=12 if wavenumber * radius <= MAX_PISTON_SIZE[12] else 19
    )


def _own_radius(table: tables.ArrayTable) -> float:
    """Find the radius of the piston for the transducers of the boards of a table [m]."""
    match table.layout:
        case tables.ListedTable():
            return MURATA_RADIUS
        case tables.FlatBoardsTable():
            return board_named("autd3").radius
        case tables.BoardsTable(board=board) | tables.SurroundingBoxTable(board=board):
            return board_named(board or "autd3").radius


def _layout(
    table: tables.ArrayTable, element: Element, folder: Path
) -> tuple[PhasedArray, str | None]:
    match table.layout:
        case tables.SurroundingBoxTable(board=board):
            return surrounding_box(element=element, board=board), board or "autd3"
        case tables.FlatBoardsTable():
            return built(partial(flat_boards, element=element), table.layout), "autd3"
        case tables.BoardsTable(board=board, poses=poses):
            return board_array(board, [pose_of(pose) for pose in poses], element), board
        case tables.ListedTable(file=file):
            return _array_from_csv(folder / file, element), None


def _array_from_csv(path: Path, element: Element) -> PhasedArray:
    table = read_text_table(path)
    names = ("x", "y", "z", "nx", "ny", "nz")
    table.require(*names)
    if not table.rows:
        raise InvalidInput(f"{path.name} holds 0 transducers.", code="empty")
    columns = np.stack([table.numbers(name) for name in names], axis=1)
    return PhasedArray(columns[:, :3], columns[:, 3:], element)
