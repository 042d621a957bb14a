"""Plots with matplotlib: the field in a plane, what each transducer emits, the scene in space, pressures at the foci.

Each function draws into ``ax``, or into a new figure where none is given, and returns the axes; the
page of a run uses the same drawings. Lengths are in millimetres. ``airtact.reports.plot`` is
imported, and matplotlib with it, when first used.
"""

from typing import Literal

import numpy as np
from matplotlib.axes import Axes
from mpl_toolkits.mplot3d import Axes3D

from airtact.acoustics.scene import Scene
from airtact.acoustics.solvers.problem import RadiatedField
from airtact.acoustics.target import Beacons, Target
from airtact.checks import counted, of_kind, positive
from airtact.drives.drive import Drive, check_drive
from airtact.errors import InvalidInput
from airtact.evaluation.comparison import Comparison
from airtact.evaluation.metrics import Evaluation
from airtact.evaluation.windows import Window, plane_across, plane_of_scene
from airtact.reports.array_figures import draw_faces, draw_in_space, view_of
from airtact.reports.field_figure import Cut, cut_bodies, draw_change, draw_pressure
from airtact.reports.plots import draw_foci
from airtact.reports.solids import behind_planes, broad_view, space_axes
from airtact.transducers.layout import PhasedArray

__all__ = ["field", "pads", "phases", "scene"]

Plane = Literal["xy", "xz", "yz"]


def field(
    result: Evaluation | Comparison | RadiatedField,
    target: Target | None = None,
    *,
    drive: str | int = 0,
    over: str | None = None,
    plane: Plane | None = None,
    most: float | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Plot the pressure in a plane through the foci, with the bodies in grey; foci off the plane are dashed.

    Parameters
    ----------
    result : from ``evaluate``, from ``compare``, or a solver's field.
    target : the foci; needed for a solver's field unless it is that of beacons.
    drive : of a comparison the name of a drive, of a solver's field the index of an excitation.
    over : of a comparison the name of another drive: then the level of ``drive`` over that one [dB]
        is plotted.
    plane : "xy", "xz" or "yz" through the middle of the foci; the plane that fits foci and bodies
        best unless given.
    most : pressure at which the colours end [Pa]; the largest in the plane unless given.
    ax : axes to draw into; those of a new figure unless given.

    Returns
    -------
    The axes. Drives of a comparison have their strongest element at full scale.

    Raises
    ------
    InvalidInput
        If there are no foci, a name or an index is unknown, or a drive is compared in something other than a
        comparison.
    """
    of_kind(
        result,
        Evaluation | Comparison | RadiatedField,
        "what is plotted",
        "what evaluate or compare returned",
    )
    sound = _sound(result)
    foci = _foci(result, target)
    column = _column(result, drive)
    window = _window(sound.scene, foci, plane)
    pressures = sound.at(window.points)
    shown = {str(drive): pressures[:, column]}
    if over is not None:
        if not isinstance(result, Comparison):
            raise InvalidInput(
                "1 drive cannot be shown over another: give what compare returned.",
                code="options_clash",
            )
        shown[over] = pressures[:, result.column(over)]
    surfaces = [one.surface for one in sound.scene.obstacles if one.boundary != "filled"]
    cut = Cut(
        window, shown, cut_bodies(window, surfaces) + behind_planes(window, sound.scene.planes)
    )
    strongest = float(np.nanmax([np.abs(one) for one in shown.values()]))
    most = strongest if most is None else positive(most, "most", "Pa")
    axes = _axes(ax)
    if over is None:
        draw_pressure(axes, cut, str(drive), most, foci)
        axes.set_title(drive if isinstance(drive, str) else "")
    else:
        draw_change(axes, cut, (str(drive), over), most, foci)
    return axes


def phases(
    array: PhasedArray,
    drive: Drive,
    *,
    show: Literal["phase", "amplitude"] = "phase",
    ax: Axes | None = None,
) -> Axes:
    """Plot phase or amplitude of every transducer as a disc at its position, the faces of an array side by side.

    A face is seen from the side to which it radiates.

    Parameters
    ----------
    array : the transducers.
    drive : what they emit.
    show : "phase" [rad] or "amplitude" [of full scale].
    ax : axes to draw into; those of a new figure unless given.

    Raises
    ------
    InvalidInput
        If the drive is for another number of elements, or ``show`` is something else.
    """
    _check_fits(array, drive)
    if show not in ("phase", "amplitude"):
        raise InvalidInput(
            f"show is {show!r}, but it is 1 of phase, amplitude.", code="unknown_name"
        )
    axes = _axes(ax)
    draw_faces(axes, array.positions, array.normals, drive.amplitudes, show)
    return axes


def scene(
    scene: Scene,
    array: PhasedArray | None = None,
    drive: Drive | None = None,
    target: Target | None = None,
    *,
    ax: Axes3D | None = None,
) -> Axes3D:
    """Plot bodies, transducers and foci in space, the transducers coloured by their phase where a drive is given.

    Transducers that turn their back to the viewer are faint rings.

    Parameters
    ----------
    scene : the bodies.
    array : the transducers in the scene's frame, see ``PhasedArray.seen_from``.
    drive : what they emit.
    target : the foci.
    ax : axes with ``projection="3d"`` to draw into; those of a new figure unless given.

    Raises
    ------
    InvalidInput
        If there is nothing to plot, a drive has no array or another number of elements, or the axes are flat.
    """
    of_kind(scene, Scene, "the scene", "Scene(medium, obstacles)")
    if drive is not None:
        _check_fits(array, drive)
    surfaces = [one.surface for one in scene.obstacles]
    foci = np.empty((0, 3)) if target is None else target.points
    if array is None and not surfaces and not len(foci):
        raise InvalidInput(
            "0 bodies, transducers and foci are in the scene: there is nothing to plot.",
            code="empty",
        )
    none = np.empty((0, 3))
    positions, normals = (none, none) if array is None else (array.positions, array.normals)
    angles = None if drive is None else np.angle(drive.amplitudes)
    if ax is not None and not isinstance(ax, Axes3D):
        words = (
            "the axes have 2 dimensions, but a scene needs 3: figure.add_subplot(projection='3d')."
        )
        raise InvalidInput(words, code="wrong_kind")
    if ax is None:
        from matplotlib import pyplot

        seen = np.concatenate([*(surface.vertices for surface in surfaces), foci])
        ax = space_axes(
            pyplot.figure(layout="constrained"),
            broad_view(seen) if array is None else view_of(normals),
        )
    draw_in_space(ax, positions, normals, angles, surfaces, foci, scene.planes)
    return ax


def pads(
    result: Evaluation | Comparison, *, held_equal: str = "equal peak", ax: Axes | None = None
) -> Axes:
    """Plot the pressure at each focus as a bar, a group of bars for the drives of a comparison, and what was asked.

    Parameters
    ----------
    result : from ``evaluate`` or ``compare``.
    held_equal : of a comparison the normalisation, one of ``evaluation.HELD_EQUAL``.
    ax : axes to draw into; those of a new figure unless given.

    Raises
    ------
    InvalidInput
        If the normalisation is not known.
    """
    of_kind(result, Evaluation | Comparison, "what is plotted", "what evaluate or compare returned")
    if isinstance(result, Comparison):
        got = dict(zip(result.names, result.under(held_equal), strict=True))
        asked = None
    else:
        got = {"": result.magnitudes}
        asked = result.target.pressures
    axes = _axes(ax)
    draw_foci(axes, got, asked)
    axes.set_title(held_equal if isinstance(result, Comparison) else "")
    return axes


def _axes(ax: Axes | None) -> Axes:
    if ax is not None:
        return of_kind(ax, Axes, "ax", "axes of matplotlib, such as pyplot.subplots()[1]")
    from matplotlib import pyplot

    return pyplot.subplots(layout="constrained")[1]


def _sound(result: Evaluation | Comparison | RadiatedField) -> RadiatedField:
    if isinstance(result, RadiatedField):
        return result
    if result.field is None:
        raise InvalidInput(
            "1 evaluation has no field: give what evaluate returned, not a part of it.",
            code="empty",
        )
    return result.field


def _foci(result: Evaluation | Comparison | RadiatedField, target: Target | None) -> np.ndarray:
    if target is not None:
        return of_kind(target, Target, "the target", "Target(points, pressures)").points
    if not isinstance(result, RadiatedField):
        return result.target.points
    if isinstance(result.sources, Beacons):
        return result.sources.refined_positions
    count = counted(len(result.sources.positions), "source", "sources")
    raise InvalidInput(
        f"a field of {count} does not say where the foci are: give the target.", code="empty"
    )


def _column(result: Evaluation | Comparison | RadiatedField, drive: str | int) -> int:
    if isinstance(result, Comparison):
        return result.column(result.names[drive] if isinstance(drive, int) else drive)
    count = 1 if isinstance(result, Evaluation) else result.sources.strengths.shape[1]
    if not (isinstance(drive, int) and 0 <= drive < count):
        raise InvalidInput(
            f"drive is {drive!r}, but the field has {counted(count, 'excitation', 'excitations')}, from 0.",
            code="unknown_name",
        )
    return drive


def _window(scene: Scene, foci: np.ndarray, plane: Plane | None) -> Window:
    if plane is None:
        return plane_of_scene(scene, foci)
    if plane not in ("xy", "xz", "yz"):
        raise InvalidInput(f"plane is {plane!r}, but it is 1 of xy, xz, yz.", code="unknown_name")
    return plane_across(foci, plane, scene.wavelength)


def _check_fits(array: PhasedArray | None, drive: Drive) -> None:
    check_drive(drive, "the drive")
    of_kind(array, PhasedArray, "the array", "one such as surrounding_box()")
    if array is not None and len(drive) != len(array):
        raise InvalidInput(
            f"a drive of {counted(len(drive), 'element', 'elements')} does not fit an array of {len(array)}.",
            code="sizes_differ",
        )
