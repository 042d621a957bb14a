"""The field that a drive makes, computed forwards: all elements emit at once, and the scene scatters."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Complex128, Real

from airtact.acoustics.scene import Scene
from airtact.acoustics.solvers.problem import Solver
from airtact.acoustics.sources import Monopoles, check_off_sources
from airtact.checks import counted, of_kind, points_of
from airtact.drives.drive import Drive, check_drive
from airtact.errors import InvalidInput
from airtact.timing import Progress, no_progress
from airtact.transducers.layout import PhasedArray
from airtact.transducers.placement import check_placement
from airtact.transducers.plates import strength_in


def check_solver(solver: Solver) -> None:
    """Raise ``InvalidInput`` for what is no solver, such as a solver's class."""
    name = solver.__name__ if isinstance(solver, type) else "BoundaryElement"
    of_kind(solver, Solver, "the solver", f"one such as {name}()")


def drive_sources(
    array: PhasedArray, drives: Sequence[Drive], scene: Scene | None = None
) -> Monopoles:
    """Return all face points of an array as monopoles, with one excitation per drive.

    Parameters
    ----------
    array : the transducers, E elements of Q face points.
    drives : S drives of E elements each.
    scene : where they emit; needed if it has reflecting boards, in whose faces elements have half
        the strength.

    Returns
    -------
    E·Q monopoles, element by element, each with S strengths sensitivity · w_j · g_e · d_e [Pa·m], g_e being the gain of
    element e.

    Raises
    ------
    InvalidInput
        If there is no drive, or a drive is silent, for another number of elements or no drive.
    """
    of_kind(array, PhasedArray, "the array", "one such as surrounding_box()")
    if len(drives) == 0:
        raise InvalidInput("an array needs at least 1 drive to emit, not 0.", code="too_few")
    for index, drive in enumerate(drives):
        check_drive(drive, f"drive {index}" if len(drives) > 1 else "the drive")
        if len(drive) != len(array):
            raise InvalidInput(
                f"drive {index} is for {counted(len(drive), 'element', 'elements')}, and the array has {len(array)}.",
                code="sizes_differ",
            )
        if not (array.gains * drive.amplitudes).any():
            raise InvalidInput(
                f"drive {index} is silent: all {len(drive)} amplitudes are 0 or of dead elements.",
                code="all_zero",
            )
    amplitudes = array.gains[:, None] * np.stack([drive.amplitudes for drive in drives], axis=1)
    full = array.element.sensitivity * (1.0 if scene is None else strength_in(scene, array))
    strengths = full * array.element.weights[None, :, None] * amplitudes[:, None, :]
    return Monopoles(array.face_points.reshape(-1, 3), strengths.reshape(-1, len(drives)))


def field_map(
    scene: Scene,
    array: PhasedArray,
    drive: Drive,
    points: Real[np.ndarray, "points 3"],
    *,
    solver: Solver,
    progress: Progress | None = None,
) -> Complex128[np.ndarray, "points"]:
    """Return the complex pressure that a drive makes at any points, scattering by all bodies included.

    It takes one solve with all face points of all elements as sources of one excitation. No
    transfer matrix is involved, so the result can verify a drive that was made from one.

    Parameters
    ----------
    scene : what is in the air.
    array : the transducers in the scene's frame, see ``PhasedArray.seen_from``.
    drive : what they emit.
    points : (P, 3) points [m]. Behind the faces of directional elements the result is meaningless:
        real ones are shielded there.
    solver : another one than made the drive, or a more accurate one.
    progress : callback that gets the words of each step as it begins, such as ``print``.

    Returns
    -------
    (P,) total pressure [Pa], NaN inside bodies.

    Raises
    ------
    InvalidInput
        If the drive is silent or for another number of elements, an element is inside a body, a body is behind the face
        of a directional element, a point is NaN, infinite or on a source, or something is of the wrong kind.
    """
    check_solver(solver)
    points = points_of(points, "points", least=0)
    sources = drive_sources(array, [drive], scene)
    check_placement(scene, array)
    check_off_sources(points, sources)
    field = solver.reporting(progress).radiate(scene, sources)
    (progress or no_progress)(f"evaluating the field at {counted(len(points), 'point', 'points')}")
    return field.at(points)[:, 0]
