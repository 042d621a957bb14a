"""Build the setup of a scene file from its tables: medium, array, target, solver and drive."""

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from jaxtyping import Num

import airtact as at
from airtact.acoustics.medium import Medium, air
from airtact.acoustics.scene import Scene, check_no_planes, plane
from airtact.acoustics.solvers.problem import Solver
from airtact.acoustics.solvers.shared import Points
from airtact.acoustics.target import Target
from airtact.errors import LARGEST_SCENE_FILE, InvalidInput, about
from airtact.files.bounded import text_of
from airtact.files.text_table import read_text_table
from airtact.geometry.pose import Pose
from airtact.geometry.surface import Surface
from airtact.setup.bodies import NamedPoints, bodies_of, built, pose_of, unsided
from airtact.setup.examples import file_or_example
from airtact.setup.parsing import Value, nearest, parse_scene
from airtact.setup.setup import Setup, default_solver
from airtact.setup.tables import (
    ArrayTable,
    FocusTable,
    LevelsTable,
    MediumTable,
    ModulationTable,
    SceneFile,
    Shape,
)
from airtact.setup.touching import nearest_skin, touched
from airtact.transducers.boards import MURATA_RADIUS, board_named
from airtact.transducers.element import (
    DEFAULT_SENSITIVITY,
    MAX_PISTON_SIZE,
    monopole,
    piston,
)
from airtact.transducers.layout import (
    KNOWN_ARRAYS,
    PhasedArray,
    board_array,
    flat_boards,
    known_array,
    surrounding_box,
)
from airtact.transducers.levels import AmplitudeModulation, Levels

# Default distance of a focus from the surface of its body [m]
DEFAULT_OFFSET = 0.5e-3


def read_scene(
    path: str | Path, changes: Mapping[str, Value] | None = None, moving: bool = False
) -> Setup:
    """Read a scene file and build its setup, which ``render`` and other functions take.

    Parameters
    ----------
    path : TOML file; or, if there is no such file, the name of an example such as "pinch".
        Surfaces, hands, drawings and array files named in the file are looked up in its folder.
    changes : mapping from the path of a key to the value that replaces the one in the file, such as
        ``{"foci[0].offset": 1e-3, "hand.gap": 0.01}``. The value None removes a key. ``hand``
        refers to the only obstacle that is a hand; the same applies to other kinds of bodies. The
        file itself does not change.
    moving : whether the bodies will move later, so that contacts may be missing at first. If True,
        a scene without foci and contacts gets one focus, where the skin is nearest to an object; if
        False, ``InvalidInput`` is raised for such a scene.

    Returns
    -------
    The ``Setup`` that the file describes, in the frame of the obstacles.

    Raises
    ------
    InvalidInput
        If the file cannot be read, has an invalid key or value, or describes an impossible scene,
        or if a path in ``changes`` does not exist. The message begins with the names of the file
        and the table.
    """
    path = file_or_example(path)
    if path.suffix.lower() == ".json":
        raise InvalidInput(
            f'{path.name} is not a scene file (.toml). To use it, write hand = "{path.name}" under '
            "[[obstacles]] of a scene file; airtact hand displays it.",
            code="unknown_format",
        )
    text = text_of(path, LARGEST_SCENE_FILE)
    with about(path.name):
        return _set_up(path, text, parse_scene(text, changes), moving)


def _set_up(path: Path, text: str, file: SceneFile, moving: bool) -> Setup:
    def medium_of(table: MediumTable) -> Medium:
        if table.sound_speed is None:
            return built(partial(air, frequency=file.frequency), table)
        return built(Medium, table)

    with about("medium"):
        medium = medium_of(file.medium)
    bodies, obstacles, points, hands = bodies_of(file, path.parent, medium_of)
    planes = []
    for index, table in enumerate(file.planes):
        with about(f"planes[{index}]"):
            planes.append(plane(table.point, table.normal))
    with about("array"):
        array, board = _array(file.array, medium.wavenumber(file.frequency).real, path.parent)
        plates = at.reflecting_boards(array) if file.array.reflects else ()
    # Applications may request foci on a tracked hand.
    if not (file.foci or file.objects or file.traps or (moving and hands)):
        raise InvalidInput(
            "the key foci is missing: add [[foci]] or [[objects]].", code="key_missing"
        )
    objects, contacts = touched(file, path.parent, bodies, obstacles, hands, moving)
    if file.traps and contacts is not None:
        raise InvalidInput(
            "traps cannot be combined with foci at contacts with objects: add [[foci]] to define "
            "the foci.",
            code="options_clash",
        )
    traps = tuple(built(at.traps.Trap, table) for table in file.traps)
    # Reflecting boards are bodies of the scene too, so warnings and reports need their names.
    bodies += ["boards"] if len(plates) == 1 else [f"board {index}" for index in range(len(plates))]
    scene = Scene(medium, [*obstacles, *plates], frequency=file.frequency, planes=planes)
    surfaces = {
        name: obstacle.surface for name, obstacle in zip(bodies, scene.obstacles, strict=True)
    }
    target, foci = _target(
        file, points, surfaces, path.parent, contacts, traps=traps, wavelength=scene.wavelength
    )
    if traps:
        from airtact.traps.holding import check_free

        check_free(traps, scene)
    with about("solver"):
        solver = _solver(file, scene)
    with about("tracker"):
        tracker = Pose.identity() if file.tracker is None else pose_of(file.tracker)
    with about("drive"):
        levels = file.drive.levels
        if isinstance(levels, int):
            levels = LevelsTable(levels, levels)
        with about("modulation"):
            modulation = _modulation(file.drive.modulation, len(foci))
        if modulation is None and contacts is not None and contacts.runs:
            from airtact.drives.motion import Motion

            modulation = Motion("stm", "points")
    uncertainty: dict[str, Any] = {}
    if file.uncertainty is not None:
        values = msgspec.structs.asdict(file.uncertainty)
        uncertainty = {name: values.pop(name) for name in ("samples", "seed")}
        with about("uncertainty"):
            uncertainty["uncertainty"] = at.Uncertainty(**values)
    riding = [
        None
        if focus.at is None
        else (focus.at if len(hands) > 1 else unsided(focus.at), _offset(focus))
        for focus in file.foci
    ]
    return Setup(
        scene,
        array,
        target,
        solver=solver,
        accuracy=file.solver.accuracy,
        method=file.drive.method,
        levels=Levels.even(levels.amplitude, levels.phase),
        modulation=modulation,
        bodies=tuple(bodies),
        foci=foci,
        traps=traps,
        board=board,
        hands=tuple(hands.values()),
        riding=() if traps or None in riding else tuple(riding),
        objects=objects,
        contacts=contacts,
        tracker=tracker,
        path=path,
        text=text,
        **uncertainty,
    )


def _modulation(
    table: ModulationTable | None, foci: int
) -> "AmplitudeModulation | at.drives.Motion | None":
    if table is None:
        return None
    if table.kind == "am":
        return built(AmplitudeModulation, table, "kind")
    from airtact.drives.motion import Motion

    # The defaults of missing keys depend on kind and path, so leave them to ``Motion``.
    size = table.length if table.path == "line" else table.radius
    motion = Motion(table.kind, table.path, size, table.frequency, table.frames, table.along)
    if motion.path == "points" and foci < 2:
        raise InvalidInput(
            f'path = "points" requires at least 2 points, but there is only {foci}.',
            code="too_few",
        )
    return motion


def _solver(file: SceneFile, scene: Scene) -> Solver:
    accuracy = file.solver.accuracy
    name = file.solver.name or ("boundary_element" if scene.obstacles else "free_field")
    if (name == "free_field") == bool(scene.obstacles):
        raise InvalidInput(
            f"{name} cannot solve a scene with {'' if scene.obstacles else 'no '}obstacles: remove "
            "the key name from [solver].",
            code="not_supported",
        )
    if name == "finite_element":
        check_no_planes(scene, name)
        return at.FiniteElement.reaching(accuracy)
    for index, obstacle in enumerate(scene.obstacles):
        if obstacle.boundary == "filled":
            raise InvalidInput(
                f"{name} cannot solve for body {index}, because it is filled with a fluid: set "
                'name = "finite_element".',
                code="not_supported",
            )
    return default_solver(scene, accuracy)


def _array(table: ArrayTable, wavenumber: float, folder: Path) -> tuple[PhasedArray, str | None]:
    listed = table.layout.endswith(".csv")
    board = None if listed or table.layout in KNOWN_ARRAYS else table.board or "autd3"
    # Most arrays of unknown make consist of Murata transducers.
    radius = table.piston_radius or (MURATA_RADIUS if board is None else board_named(board).radius)
    sensitivity = table.sensitivity or DEFAULT_SENSITIVITY
    # The far-field pattern of a larger piston requires more points.
    points = 12 if wavenumber * radius <= MAX_PISTON_SIZE[12] else 19
    element = (
        monopole(sensitivity)
        if table.source == "monopole"
        else piston(radius, sensitivity, points=points)
    )
    match table.layout:
        case "surrounding_box":
            array = surrounding_box(element=element, board=table.board)
        case "flat_boards":
            array = flat_boards(table.rows or 2, table.columns or 2, element)
        case "boards":
            array = board_array(board or "", [pose_of(pose) for pose in table.poses or ()], element)
        case _ if listed:
            file = read_text_table(folder / table.layout)
            names = ("x", "y", "z", "nx", "ny", "nz")
            if table.source == "monopole" and not {"nx", "ny", "nz"} & set(file.names):
                names = ("x", "y", "z")  # monopoles have no direction
            file.require(*names)
            if not file.rows:
                raise InvalidInput(f"{table.layout} contains no transducers.", code="empty")
            columns = np.stack([file.numbers(name) for name in names], axis=1)
            orders = [file.order(name) for name in ("index", "element") if name in file.names]
            if len(orders) == 2 and not np.array_equal(orders[0], orders[1]):
                raise InvalidInput(
                    f"the columns index and element of {table.layout} differ; keep one of them.",
                    code="does_not_match",
                )
            columns = columns[orders[0]] if orders else columns
            array = PhasedArray(columns[:, :3], columns[:, 3:] if len(names) > 3 else None, element)
        case name if name in KNOWN_ARRAYS:
            array = known_array(name, element)
        case _:
            names = ("surrounding_box", "flat_boards", "boards", *KNOWN_ARRAYS)
            raise InvalidInput(
                f'layout = "{table.layout}" is neither a .csv file nor a known layout; '
                f"{nearest(table.layout, names)}",
                code="unknown_name",
            )
    if table.calibration is not None:
        from airtact.transducers.calibration import calibrated_by

        with about("calibration"):
            array = calibrated_by(folder / table.calibration, array)
    return array if table.pose is None else array.moved(pose_of(table.pose)), board


def _target(
    file: SceneFile,
    named: NamedPoints,
    bodies: Mapping[str, Surface],
    folder: Path,
    contacts: "at.touch.Contacts | None",
    *,
    traps: "tuple[at.traps.Trap, ...]",
    wavelength: float,
) -> tuple[Target, tuple[str, ...]]:
    """Build the target from the foci or contacts; return it with a name for each focus."""

    def check_total(count: int) -> None:
        if count > file.most_points:
            raise InvalidInput(
                f"there are at least {count:,} foci and suppression points, more than most_points "
                f"({file.most_points:,}): use fewer, or raise most_points at the top of the file.",
                code="too_many",
            )

    # Each table defines one or more points. Shapes may have thousands, so the total is checked
    # again after each table, before memory runs out.
    check_total(len(file.traps) + len(file.foci) + len(file.suppression))
    total = 0
    points = []
    names = []
    wanted: dict[str, Any] = {}
    if contacts is not None and not len(contacts):
        points.append(nearest_skin(contacts))
        names.append("nearest skin")
        total += 1
    elif contacts is not None:
        with about("objects"):
            touch = contacts.target(wavelength=wavelength)
            names += list(contacts.foci(wavelength=wavelength).names)
        if contacts.runs:
            names = [f"outline {index + 1}" for index in range(len(touch.points))]
        points.append(touch.points)
        wanted = {} if touch.shares is None else {"shares": touch.shares}
        total += len(touch.points)
        check_total(total)
    for index, trap in enumerate(traps):
        with about(f"traps[{index}]"):
            points.append(trap.lobes(wavelength))
        names += [f"trap {index + 1} lobe {lobe + 1}" for lobe in range(len(points[-1]))]
        total += len(points[-1])
    for index, table in enumerate(file.foci):
        with about(f"foci[{index}]"):
            points.append(_foci(table, named, bodies, folder))
            names += _names(table, index, len(points[-1]))
        total += len(points[-1])
        check_total(total)
    zones = [np.empty((0, 3))]
    for index, zone in enumerate(file.suppression):
        with about(f"suppression[{index}]"):
            if zone.surface is None:
                zones.append(_points(zone, folder))
            else:
                body = _body(zone.surface.body, bodies, "body")
                zones.append(
                    built(partial(at.acoustics.surface_points, body), zone.surface, "body")
                )
        total += len(zones[-1])
        check_total(total)
    with about("foci"):
        target = Target(
            np.concatenate(points),
            suppression_points=np.concatenate(zones),
            **(wanted or _wanted(file, [len(of_table) for of_table in points])),
        )
    return target, tuple(names)


def _wanted(file: SceneFile, counts: list[int]) -> dict[str, Num[np.ndarray, "foci"]]:
    # Return the pressures or shares of all foci, or an empty mapping if no table sets any.
    values: dict[str, Any] = {}
    if not file.foci:
        return values
    if file.traps:
        # Lobes of traps have a share of 1.
        if any(table.pressure or table.phase_degrees for table in file.foci):
            raise InvalidInput(
                "with traps, set a share for the foci instead of pressure or phase_degrees.",
                code="options_clash",
            )
        shares = [1.0 if table.share is None else table.share for table in file.foci]
        return {"shares": np.repeat([*(1.0 for _ in file.traps), *shares], counts)}
    for key in ("pressure", "share", "phase_degrees"):
        of_tables = [getattr(table, key) for table in file.foci]
        missing = of_tables.count(None)
        if 0 < missing < len(of_tables):
            raise InvalidInput(
                f"only {len(of_tables) - missing} of {len(of_tables)} tables set a {key}: set "
                "this key in all tables or in none.",
                code="key_missing",
            )
        if not missing:
            values[key] = np.repeat(np.array(of_tables, dtype=np.float64), counts)
    if "pressure" in values and "share" in values:
        raise InvalidInput(
            "the foci have both pressures and shares: set only one of them.", code="options_clash"
        )
    if not values:
        return {}
    # Phases enter a Target as those of complex pressures or shares.
    degrees = values.get("phase_degrees")
    phased = 1.0 if degrees is None else np.exp(1j * np.radians(degrees))
    if "pressure" in values:
        return {"pressures": values["pressure"] * phased}
    return {"shares": values.get("share", 1.0) * phased}


def _names(table: FocusTable, index: int, count: int) -> list[str]:
    if table.at is not None:
        return [table.name or table.at]
    if table.point is not None:
        return [table.name or f"focus {index + 1}"]
    kind = table.name or next(name for name in Shape.__struct_fields__ if getattr(table, name))
    return [f"{kind} {number + 1}" for number in range(count)]


def _offset(table: FocusTable) -> float:
    return DEFAULT_OFFSET if table.offset is None else table.offset


def _foci(
    table: FocusTable, named: NamedPoints, bodies: Mapping[str, Surface], folder: Path
) -> Points:
    offset = _offset(table)
    if table.at is None:
        points = _points(table, folder)
        if table.onto is None:
            return points
        return at.acoustics.onto_surface(points, _body(table.onto, bodies, "onto"), offset)
    if table.at not in named:
        hint = (
            'no body has named points: use point = [x, y, z], or set joints = "FILE.json" for the '
            "mesh of a hand."
        )
        if named:
            hint = nearest(table.at, named)
        raise InvalidInput(
            f'at = "{table.at}" is not a named point of a body; {hint}', code="unknown_name"
        )
    point, normal, room = named[table.at]
    # An offset given in millimetres would put the focus beyond the next body.
    if offset >= room:
        raise InvalidInput(
            f"offset = {offset:g} m exceeds the gap of {1e3 * room:g} mm in front of {table.at}: "
            "is it in millimetres? Use metres.",
            code="not_in_metres",
        )
    return (point + offset * normal)[None]


def _points(table: Shape, folder: Path) -> Points:
    """Return a single point, or the points of a shape."""
    if table.point is not None:
        return np.array([table.point], dtype=np.float64)
    if table.svg is not None:
        drawing = table.svg.path or folder / (table.svg.file or "")
        return built(partial(at.acoustics.svg_path, drawing), table.svg, "file", "path")
    shapes = {
        name: shape
        for name in ("segment", "polyline", "circle", "sphere_shell", "text")
        if (shape := getattr(table, name)) is not None
    }
    ((name, shape),) = shapes.items()
    return built(getattr(at.acoustics, name), shape)


def _body(name: str, bodies: Mapping[str, Surface], key: str) -> Surface:
    if name not in bodies:
        hint = nearest(name, bodies) if bodies else "the scene has no body."
        raise InvalidInput(f'{key} = "{name}" is not a body; {hint}', code="unknown_name")
    return bodies[name]
