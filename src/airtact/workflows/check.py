"""From a scene or a surface to what is in it, with a picture of its bodies or of its fault. Prints nothing."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from airtact.acoustics.medium import air
from airtact.acoustics.scene import Scene, sound_hard
from airtact.acoustics.solvers.bem.solver import BoundaryElement
from airtact.errors import InvalidInput, about
from airtact.files.atomic import writable_folder
from airtact.files.meshes import SUFFIXES
from airtact.geometry.files import load_surface
from airtact.live.session import Session, read_session
from airtact.live.verification import VerifiedSession, verify_session
from airtact.reports.body_figure import draw_bodies, draw_fault
from airtact.reports.page import write_picture
from airtact.setup.bodies import Triangles, bare_triangles, drawable_bodies
from airtact.setup.building import read_scene
from airtact.setup.sentences import reach_cautions as reach_cautions
from airtact.setup.setup import Setup
from airtact.setup.solving import memory_of_a_solve as memory_of_a_solve
from airtact.setup.solving import unknowns_of
from airtact.timing import Progress, no_progress

BODIES, FAULT = "bodies.png", "fault.png"
"""What is written, one or the other."""

DRIVES = 10
"""Drives of a session that are held against the hand that was there, unless another number is given."""


def check(
    path: Path, folder: Path | None = None, report_step: Progress = no_progress, **settings: float
) -> Setup | Scene:
    """Read a scene file, or a surface file into a scene of its own, and build what it describes.

    A picture of the bodies goes into the folder, if one is given; where the input is at fault one
    of the bodies and the position of the fault. ``settings`` are those of ``load_surface``, for a
    surface file only.

    Raises
    ------
    InvalidInput
        "options_clash": settings of a surface are given for a scene file; or the file or the folder is at fault.
    """
    if path.suffix.lower() in SUFFIXES:
        return _check_surface_file(path, folder, report_step, **settings)
    if settings:
        key, value = next(iter(settings.items()))
        raise InvalidInput(
            f"{key} = {value:g} stands in a scene file, beside its surface, not on the command line.",
            code="options_clash",
        )
    report_step(f"reading {path.name}")
    with _pictured(folder, lambda: drawable_bodies(path), report_step):
        setup = read_scene(path)
    _draw(folder, setup.scene, setup.bodies, setup.target.points, report_step)
    return setup


def _check_surface_file(
    path: Path, folder: Path | None, report_step: Progress, **settings: float
) -> Scene:
    """Put a surface into air as a sound-hard body, as a scene at 40 kHz would."""

    def triangles() -> list[Triangles]:
        bare = bare_triangles(path, settings.get("scale", 1.0))
        return [] if bare is None else [bare]

    with _pictured(folder, triangles, report_step):
        surface = load_surface(path, **settings, progress=report_step)
        with about(path.name):
            scene = Scene(air(), [sound_hard(surface)])
    _draw(folder, scene, [path.name], None, report_step)
    return scene


def _draw(
    folder: Path | None,
    scene: Scene,
    names: Sequence[str],
    foci: Float64[np.ndarray, "foci 3"] | None,
    report_step: Progress,
) -> None:
    if folder is not None:
        report_step(f"drawing {folder / BODIES}")
        surfaces = [one.surface for one in scene.obstacles]
        write_picture(folder / BODIES, draw_bodies(surfaces, names, foci, scene.planes))


def check_session(
    path: Path, drives: int = DRIVES, report_step: Progress = no_progress
) -> tuple[Session, VerifiedSession]:
    """Read a session, and hold drives spread evenly over it against the hand that was there.

    Raises
    ------
    InvalidInput
        "too_few" when no drive is asked for; as ``read_session`` and ``verify_session``.
    """
    if drives < 1:
        raise InvalidInput(
            f"--drives is {drives}, but 1 or more are held against the hand.", code="too_few"
        )
    report_step(f"reading {path}")
    session = read_session(path)
    every = max(1, -(-int(session.playing.sum()) // drives))
    return session, verify_session(session, every, report_step=report_step)


def unknowns_of_scene(setup: Setup) -> int | None:
    """Count or estimate the unknowns of a scene by boundary elements; None for other solvers."""
    if not isinstance(setup.solver, BoundaryElement):
        return None
    return unknowns_of(setup.solver, setup.scene, setup.target.points)


def unknowns_by_accuracy(scene: Scene) -> dict[float, int]:
    """Count the unknowns that solving a scene takes with no focus near its bodies, at 1 % and at 3 %."""
    lowest = np.min([obstacle.surface.vertices.min(axis=0) for obstacle in scene.obstacles], axis=0)
    far = np.asarray(lowest - 1.0)[None]
    return {
        accuracy: unknowns_of(BoundaryElement(accuracy=accuracy), scene, far)
        for accuracy in (0.01, 0.03)
    }


@contextmanager
def _pictured(
    folder: Path | None, bodies: Callable[[], list[Triangles]], report_step: Progress
) -> Iterator[None]:
    """Draw the fault of input that is rejected inside."""
    if folder is None:
        yield
        return
    try:
        yield
    except InvalidInput as fault:
        try:
            drawable = bodies()
        except InvalidInput:
            drawable = []
        if drawable:
            _clear(folder)
            report_step(f"drawing the fault into {folder / FAULT}")
            starts = np.cumsum([0] + [len(vertices) for vertices, _ in drawable])
            vertices = np.concatenate([vertices for vertices, _ in drawable])
            triangles = np.concatenate(
                [named + start for (_, named), start in zip(drawable, starts, strict=False)]
            )
            write_picture(
                folder / FAULT, draw_fault(vertices, triangles, str(fault), fault.position)
            )
        raise
    _clear(folder)


def _clear(folder: Path) -> None:
    # An older picture must not stand beside the new result.
    writable_folder(folder)
    for name in (BODIES, FAULT):
        (folder / name).unlink(missing_ok=True)
