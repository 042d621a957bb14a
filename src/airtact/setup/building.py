"""From the tables of a scene file to its setup: medium, array, target, solver and drive."""

import math
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from jaxtyping import Float64, Num

import airtact as at
from airtact.acoustics.medium import Medium, air
from airtact.acoustics.planes import plane
from airtact.acoustics.scene import Scene, check_no_planes
from airtact.acoustics.solvers.arrays import Points
from airtact.acoustics.solvers.problem import Solver
from airtact.acoustics.target import Target
from airtact.errors import LARGEST_SCENE_FILE, MOST_POINTS, InvalidInput, about
from airtact.files.bounded import text_of
from airtact.geometry.pose import Pose
from airtact.geometry.surface import Surface
from airtact.setup import tables
from airtact.setup.bodies import NamedPoints, bodies_of, built, pose_of
from airtact.setup.parsing import Value, nearest, parse_scene
from airtact.setup.setup import Setup, default_solver
from airtact.transducers.boards import MURATA_RADIUS, board_named
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

# Distance of a focus from the surface of its body [m]
DEFAULT_OFFSET = 0.5e-3


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
        The file cannot be read, has a wrong key or value, or describes an impossible scene; the
        message begins with the file's name and the table at fault. "unknown_key": a path of
        ``changes`` leads nowhere.
    """
    path = Path(path)
    if path.suffix.lower() == ".json":
        raise InvalidInput(
            f"{path.name} is not a scene file (.toml): a scene names the pose of a hand by "
            "[[obstacles]] hand = "
            f'"{path.name}", and airtact hand shows it.',
            code="unknown_format",
        )
    text = text_of(path, LARGEST_SCENE_FILE)
    with about(path.name):
        return _set_up(path, text, parse_scene(text, changes), followed)


def _set_up(path: Path, text: str, file: tables.SceneFile, followed: bool) -> Setup:
    with about("medium"):
        medium = medium_of(file.medium, file.frequency)
    bodies, obstacles, points, hands = bodies_of(
        file, path.parent, lambda table: medium_of(table, file.frequency)
    )
    planes = []
    for index, table in enumerate(file.planes):
        with about(f"planes[{index}]"):
            planes.append(plane(table.point, table.normal))
    wavenumber = medium.wavenumber(file.frequency).real
    with about("array"):
        array, board = _array(file.array, wavenumber, path.parent)
        plates = ()
        if file.array.reflects:
            plates = at.reflecting_boards(array)
    # Reflecting boards are bodies of the scene too, so they need names in warnings and reports.
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
    if table is None:
        return {}
    values = msgspec.structs.asdict(table)
    samples = values.pop("samples")
    seed = values.pop("seed")
    with about("uncertainty"):
        return {"uncertainty": at.Uncertainty(**values), "samples": samples, "seed": seed}


def _modulation(
    table: tables.ModulationTable | None, foci: int
) -> "AmplitudeModulation | at.drives.Motion | None":
    if table is None:
        return None
    kind = table.kind
    if isinstance(kind, tables.AmplitudeTable):
        return AmplitudeModulation(kind.frequency, kind.depth)
    from airtact.drives.motion import ALONG, PATHS, Motion

    if kind.path == "line" and kind.radius is not None:
        raise InvalidInput(
            "radius goes only with a circle; give the length of a line.", code="key_misplaced"
        )
    if kind.path != "line" and kind.length is not None:
        raise InvalidInput(
            'length goes only with path = "line"; give the radius of a circle.',
            code="key_misplaced",
        )
    for key, word, options in (("path", kind.path, PATHS), ("along", kind.along, ALONG)):
        if word is not None and word not in options:
            raise InvalidInput(
                f'{key} = "{word}" is unknown; {nearest(word, options)}', code="unknown_name"
            )
    # Keys that are left out get the defaults of Motion, which depend on its kind and path.
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
    solvable = {
        "boundary_element": ("sound_hard", "impedance"),
        "finite_element": ("sound_hard", "impedance", "filled"),
        "free_field": (),
    }
    name = file.solver.name or ("boundary_element" if scene.obstacles else "free_field")
    if name not in solvable:
        raise InvalidInput(
            f'"{name}" is not a solver here; {nearest(name, solvable)}', code="unknown_name"
        )
    if name == "free_field" and scene.obstacles:
        raise InvalidInput(
            "the scene has obstacles, and free_field is for open air; name boundary_element, or "
            "nothing.",
            code="not_supported",
        )
    if name != "free_field" and not scene.obstacles:
        raise InvalidInput(
            f"the scene has no obstacles, and {name} needs one or more; name free_field, or "
            "nothing.",
            code="not_supported",
        )
    for index, obstacle in enumerate(scene.obstacles):
        if obstacle.boundary not in solvable[name]:
            raise InvalidInput(
                f"body {index} is {obstacle.boundary}, but {name} solves "
                f"{', '.join(solvable[name])} bodies only.",
                code="not_supported",
            )
    if name == "finite_element":
        check_no_planes(scene, name)
        return at.FiniteElement.reaching(file.solver.accuracy)
    return default_solver(scene, file.solver.accuracy)


def medium_of(table: tables.MediumTable, frequency: float) -> Medium:
    """Build the fluid of a table; the absorption of air is that at a frequency [Hz]."""
    if isinstance(table.fluid, tables.FluidTable):
        return Medium(table.fluid.sound_speed, table.fluid.density, table.fluid.absorption)
    return built(partial(air, frequency=frequency), table.fluid)


def _array(
    table: tables.ArrayTable, wavenumber: float, folder: Path
) -> tuple[PhasedArray, str | None]:
    array, board = _layout(table, _element(table, wavenumber), folder)
    if table.calibration is not None:
        from airtact.transducers.calibration import calibrated_by

        with about("calibration"):
            array = calibrated_by(folder / table.calibration, array)
    if table.pose is None:
        return array, board
    with about("pose"):
        return array.moved(pose_of(table.pose)), board


def _element(table: tables.ArrayTable, wavenumber: float) -> Element:
    sensitivity = DEFAULT_SENSITIVITY if table.sensitivity is None else table.sensitivity
    sources = ("piston", "monopole")
    if table.source not in sources:
        raise InvalidInput(
            f'source = "{table.source}" is not known; {nearest(table.source, sources)}',
            code="unknown_name",
        )
    if table.source == "monopole":
        if table.piston_radius is not None:
            raise InvalidInput(
                f'piston_radius = {table.piston_radius:g} goes only with source = "piston".',
                code="key_misplaced",
            )
        return monopole(sensitivity)
    radius = table.piston_radius
    if radius is None:
        # Transducers of unknown make are taken for Murata's, the usual ones.
        match table.layout:
            case tables.ListedTable():
                radius = MURATA_RADIUS
            case tables.FlatBoardsTable():
                radius = board_named("autd3").radius
            case tables.BoardsTable(board=board) | tables.SurroundingBoxTable(board=board):
                radius = board_named(board or "autd3").radius
    # A larger face takes more points to keep the far pattern of a piston.
    points = 12 if wavenumber * radius <= MAX_PISTON_SIZE[12] else 19
    return piston(radius, sensitivity, points=points)


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
    from airtact.files.text_table import read_text_table

    table = read_text_table(path)
    names = ("x", "y", "z", "nx", "ny", "nz")
    table.require(*names)
    if not table.rows:
        raise InvalidInput(f"{path.name} holds no transducers.", code="empty")
    columns = np.stack([table.numbers(name) for name in names], axis=1)
    return PhasedArray(columns[:, :3], columns[:, 3:], element)


def target_of(
    foci: Sequence[tables.FocusTable],
    suppression: Sequence[tables.SuppressionTable],
    named: NamedPoints,
    bodies: Mapping[str, Surface],
    folder: Path,
    most_points: int = MOST_POINTS,
) -> tuple[Target, tuple[str, ...]]:
    """Build the target of a scene file, and a name for each of its foci.

    Foci can name the points in ``named`` and the bodies by their names; drawings are in
    the folder. Raise "too_many" where there are more than ``most_points`` foci and
    suppression points.
    """

    def check_total(count: int) -> None:
        if count > most_points:
            raise InvalidInput(
                f"there are {count:,} foci and suppression points or more, but most_points is "
                f"{most_points:,}: give fewer, or a larger most_points at the top of the file.",
                code="too_many",
            )

    # Each table is at least one point; a shape may be thousands, so the total is checked again
    # after each table, before memory runs out.
    check_total(len(foci) + len(suppression))
    points = [np.empty((0, 3))]
    names = []
    for index, table in enumerate(foci):
        with about(f"foci[{index}]"):
            of_table = _foci(table, named, bodies, folder)
            names += _names(table, index, len(of_table))
            points.append(of_table)
        check_total(sum(map(len, points)))
    zones = [np.empty((0, 3))]
    for index, zone in enumerate(suppression):
        with about(f"suppression[{index}]"):
            if isinstance(zone.points, tables.SurfacePointsTable):
                body = _body(zone.points.body, bodies, "body")
                zones.append(
                    built(
                        partial(at.acoustics.surface_points, body),
                        zone.points,
                        leave_out=("body",),
                    )
                )
            else:
                zones.append(_drawn(zone.points, folder))
        check_total(sum(map(len, points + zones)))
    with about("foci"):
        target = Target(
            np.concatenate(points),
            suppression_points=np.concatenate(zones),
            **_wanted(foci, [len(of_table) for of_table in points[1:]]),
        )
    return target, tuple(names)


def riding_of(
    foci: Sequence[tables.FocusTable], count: int
) -> tuple[tuple[str, float] | None, ...]:
    """Return for each focus the named point that it is before and the distance from it [m]."""
    if any(not isinstance(table.points, tables.NamedPointTable) for table in foci):
        return (None,) * count
    offsets = [DEFAULT_OFFSET if table.offset is None else table.offset for table in foci]
    names = [table.points.at for table in foci if isinstance(table.points, tables.NamedPointTable)]
    return tuple(zip(names, offsets, strict=True))


def _wanted(
    foci: Sequence[tables.FocusTable], counts: Sequence[int]
) -> dict[str, Num[np.ndarray, "foci"]]:
    """Return the pressures or shares of all foci, or nothing where all are alike."""
    pressures = _each(foci, "pressure", counts)
    shares = _each(foci, "share", counts)
    degrees = _each(foci, "phase_degrees", counts)
    if pressures is not None and shares is not None:
        raise InvalidInput(
            "the foci have pressures and shares; give one of the two.", code="options_clash"
        )
    # Target takes phases as those of complex pressures or shares.
    phased = 1.0 if degrees is None else np.exp(1j * np.radians(degrees))
    if pressures is not None:
        return {"pressures": pressures * phased}
    if shares is not None:
        return {"shares": shares * phased}
    if degrees is not None:
        return {"shares": np.asarray(phased)}
    return {}


def _each(
    foci: Sequence[tables.FocusTable], key: str, counts: Sequence[int]
) -> Float64[np.ndarray, "foci"] | None:
    """Spread a key over the points of each table; None where no table has it."""
    values = [getattr(table, key) for table in foci]
    missing = values.count(None)
    if missing == len(values):
        return None
    if missing:
        otherwise = " for as strong as possible" if key == "pressure" else ""
        raise InvalidInput(
            f"{len(foci) - missing} of {len(foci)} have a {key}; give it to all, or to "
            f"none{otherwise}.",
            code="key_missing",
        )
    return np.repeat(np.array(values, dtype=np.float64), counts)


def _names(table: tables.FocusTable, index: int, count: int) -> list[str]:
    match table.points:
        case tables.NamedPointTable(at=at):
            return [table.name or at]
        case tables.PointTable():
            return [table.name or f"focus {index + 1}"]
    kind = table.name or table.points.__struct_config__.tag
    return [f"{kind} {number + 1}" for number in range(count)]


def _foci(
    table: tables.FocusTable, named: NamedPoints, bodies: Mapping[str, Surface], folder: Path
) -> Points:
    offset = DEFAULT_OFFSET if table.offset is None else table.offset
    if isinstance(table.points, tables.NamedPointTable):
        if table.onto is not None:
            raise InvalidInput("onto goes only with a point or a shape.", code="key_misplaced")
        return _named(table.points.at, named, offset)[None]
    if table.offset is not None and table.onto is None:
        raise InvalidInput("offset goes only with at or onto.", code="key_misplaced")
    points = _drawn(table.points, folder)
    if table.onto is not None:
        points = at.acoustics.onto_surface(points, _body(table.onto, bodies, "onto"), offset)
    return points


def _drawn(table: tables.PointTable | tables.Shape | tables.SvgTable, folder: Path) -> Points:
    # Foci and suppression zones take the same shapes.
    match table:
        case tables.PointTable(point=point):
            return np.array([point], dtype=np.float64)
        case tables.SvgTable(source=source):
            if isinstance(source, tables.DrawingFileTable):
                drawing = folder / source.file
            else:
                drawing = source.path
            return built(partial(at.acoustics.svg_path, drawing), table, leave_out=("source",))
        case tables.WritingTable():
            return built(at.acoustics.text, table)
        case tables.SegmentTable():
            return built(at.acoustics.segment, table)
        case tables.PolylineTable():
            return built(at.acoustics.polyline, table)
        case tables.CircleTable():
            return built(at.acoustics.circle, table)
        case tables.SphereShellTable():
            return built(at.acoustics.sphere_shell, table)


def _body(name: str, bodies: Mapping[str, Surface], key: str) -> Surface:
    if name not in bodies:
        hint = nearest(name, bodies) if bodies else "there is no body."
        raise InvalidInput(f'{key} = "{name}" is not a body; {hint}', code="unknown_name")
    return bodies[name]


def _named(name: str, named: NamedPoints, offset: float) -> Float64[np.ndarray, "3"]:
    if name not in named:
        hint = "no body has named points, so give point = [x, y, z]."
        if named:
            hint = nearest(name, named)
        raise InvalidInput(
            f'at = "{name}" is not a named point of a body; {hint}', code="unknown_name"
        )
    if not (math.isfinite(offset) and offset >= 0):
        raise InvalidInput(
            f"offset = {offset} m must be 0 (on the surface) or more.", code="out_of_range"
        )
    point, normal, room = named[name]
    # The usual cause: an offset in millimetres puts the focus beyond the next body.
    if offset >= room:
        raise InvalidInput(
            f"offset = {offset:g} m does not lie in the gap of {1e3 * room:g} mm before {name}: is "
            "it in millimetres? Give metres.",
            code="out_of_range",
        )
    return point + offset * normal
