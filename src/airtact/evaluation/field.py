"""The field of a drive from a forward solve: all elements emit, and the bodies scatter sound."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Complex128, Float64, Real

from airtact.acoustics.scene import Scene, check_outside
from airtact.acoustics.solvers.problem import RadiatedField, Solver
from airtact.acoustics.sources import Monopoles, check_off_sources
from airtact.drives.drive import Drive, check_drive
from airtact.errors import InvalidInput, counted, of_kind, points_of
from airtact.timing import Progress, no_progress
from airtact.transducers.layout import PhasedArray
from airtact.transducers.placement import check_placement, strength_in


def drive_sources(
    array: PhasedArray, drives: Sequence[Drive], scene: Scene | None = None
) -> Monopoles:
    """Return all face points of an array as monopoles, with one excitation per drive.

    Parameters
    ----------
    array : the transducers: E elements with Q face points each.
    drives : S drives of E elements each.
    scene : the scene; required if it contains reflecting boards, because an element in the face of
        such a board has half the strength.

    Returns
    -------
    E·Q monopoles, element by element, each with S strengths sensitivity · w_j · g_e · d_e [Pa·m],
    where w_j is the weight of the face point, g_e the gain of the element and d_e its drive.

    Raises
    ------
    InvalidInput
        If there is no drive, or if a drive is silent, does not have as many elements as the array
        or is not a ``Drive``.
    """
    of_kind(array, PhasedArray, "the array", "one such as surrounding_box()")
    if len(drives) == 0:
        raise InvalidInput("there is no drive; pass at least one.", code="too_few")
    for index, drive in enumerate(drives):
        check_drive(drive, f"drive {index}" if len(drives) > 1 else "the drive")
        if len(drive) != len(array):
            raise InvalidInput(
                f"drive {index} has {counted(len(drive), 'element', 'elements')}, but the array "
                f"has {len(array)}. Use the array for which the drive was computed.",
                code="sizes_differ",
            )
        # Dead elements have a gain of 0, so a drive that uses only those is silent as well.
        if not (array.gains * drive.amplitudes).any():
            raise InvalidInput(
                f"drive {index} is silent: all amplitudes are 0 or belong to dead elements. Use a "
                "drive with sound.",
                code="all_zero",
            )
    # (E, 1) gains times (E, S) amplitudes, then (1, Q, 1) weights: element by element, as
    # ``face_points`` are.
    amplitudes = array.gains[:, None] * np.stack([drive.amplitudes for drive in drives], axis=1)
    if scene is not None:
        amplitudes = amplitudes * strength_in(scene, array)[:, None]
    strengths = (
        array.element.sensitivity * array.element.weights[None, :, None] * amplitudes[:, None, :]
    )
    return Monopoles(array.face_points.reshape(-1, 3), strengths.reshape(-1, len(drives)))


def radiate_drives(
    scene: Scene,
    array: PhasedArray,
    drives: Sequence[Drive],
    solver: Solver,
    *,
    foci: Real[np.ndarray, "foci 3"] | None = None,
    points: Mapping[str, Float64[np.ndarray, "points 3"]] | None = None,
    progress: Progress | None = None,
) -> RadiatedField:
    """Solve for several drives at once, with one right-hand side per drive.

    The function also checks the placement: the foci and other ``points`` must lie outside the
    bodies and away from the elements. In messages, a misplaced point is named by its key in
    ``points``. The function raises the same errors as ``evaluate``.
    """
    # Users often pass the class instead of an instance; the message then names that class.
    kind = solver.__name__ if isinstance(solver, type) else "BoundaryElement"
    of_kind(solver, Solver, "the solver", f"an instance such as {kind}()")
    sources = drive_sources(array, drives, scene)
    check_placement(scene, array, foci)
    # Foci first, so that the message names a focus if several points are misplaced.
    checked = dict(points or {}) if foci is None else {"focus": foci, **(points or {})}
    for word, positions in checked.items():
        if len(positions):
            check_outside(scene, positions, word)
            check_off_sources(positions, sources)
    return solver.reporting(progress).radiate(scene, sources)


def field_map(
    scene: Scene,
    array: PhasedArray,
    drive: Drive,
    points: Real[np.ndarray, "points 3"],
    *,
    solver: Solver,
    progress: Progress | None = None,
) -> Complex128[np.ndarray, "points"]:
    """Return the complex pressure of a drive at any points, including scattering by all bodies.

    A single solve uses the face points of all elements as its sources. It uses no transfer matrix,
    so the result can verify a drive that was computed from one.

    Parameters
    ----------
    scene : the air and the bodies in it.
    array : the transducers in the scene's frame; see ``PhasedArray.seen_from``.
    drive : the drive of the array.
    points : (P, 3) points at which the pressure is evaluated [m]. Behind the faces of directional
        elements the result is meaningless, because real elements are shielded there.
    solver : solver for the field. To verify a drive, use a more accurate solver than the one
        for its transfer matrix, or another method.
    progress : function, such as ``print``, that is called with a description of each step as it
        begins.

    Returns
    -------
    (P,) total pressure [Pa], NaN inside bodies.

    Raises
    ------
    InvalidInput
        If the drive is silent or does not have as many elements as the array, if an element is
        inside a body, if a body is behind the face of a directional element, if a point is NaN,
        infinite or on a source, or if an argument has the wrong type.
    """
    points = points_of(points, "points", least=0)
    # Check before the solve, because that may take a minute.
    check_off_sources(points, drive_sources(array, [drive], scene))
    field = radiate_drives(scene, array, [drive], solver, progress=progress)
    (progress or no_progress)(f"evaluating the field at {counted(len(points), 'point', 'points')}")
    return field.at(points)[:, 0]
