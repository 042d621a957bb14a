"""Plots with matplotlib: field in a plane, drive, scene in 3-D, pressures at the foci.

Each function draws into ``ax``, or by default into a new figure, and returns the axes.
Reports show the same plots. Lengths are in millimetres. Matplotlib is imported on first
use.
"""

from dataclasses import replace
from typing import Literal

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from mpl_toolkits.mplot3d import Axes3D

from airtact.acoustics.scene import Scene
from airtact.acoustics.solvers.problem import RadiatedField
from airtact.acoustics.target import Beacons, Target
from airtact.drives.drive import Drive, check_drive
from airtact.errors import InvalidInput, counted, of_kind, positive
from airtact.evaluation.comparison import Comparison
from airtact.evaluation.metrics import Evaluation
from airtact.evaluation.windows import plane_across, plane_of_scene
from airtact.reports.array_figures import draw_faces, draw_in_space, view_of
from airtact.reports.field_figure import COLOURS, Cut, draw_difference, draw_field, solid_depth
from airtact.reports.plots import draw_foci
from airtact.reports.solids import View, add_solid, broad_view, frame, space_axes
from airtact.setup.reaching import ReachMap
from airtact.setup.rendering import Rendering
from airtact.transducers.layout import PhasedArray

__all__ = ["field", "pads", "phases", "reach", "scene"]

Plane = Literal["xy", "xz", "yz"]

FieldResult = Evaluation | Comparison | RadiatedField


def field(
    result: FieldResult | Rendering,
    target: Target | None = None,
    *,
    drive: str | int = 0,
    over: str | None = None,
    plane: Plane | None = None,
    size: float | None = None,
    most: float | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Plot the pressure in a plane through the foci; foci outside the plane are dashed.

    Parameters
    ----------
    result : result of ``render``, ``focus``, ``evaluate`` or ``compare``, or a field computed by a
        solver. The result of ``render`` is drawn with the amplitudes of its drive.
    target : the foci; only required for a field whose sources were not created by
        ``Target.beacons``.
    drive : name of a drive in a comparison, or index of an excitation in a field computed by a
        solver.
    over : name of a second drive in a comparison; the plot then shows the level of ``drive``
        relative to it [dB].
    plane : "xy", "xz" or "yz" for a plane through the centre of the foci; by default, the plane
        that best fits the foci and bodies.
    size : width and height of the picture [m]; by default, the picture extends a few wavelengths
        beyond the foci.
    most : pressure at the end of the colour scale [Pa]; by default, the largest pressure in the
        plane.
    ax : axes to draw into; by default, those of a new figure.

    Returns
    -------
    The axes. Drives of a comparison are scaled so that the strongest element of each is at full
    scale.

    Raises
    ------
    InvalidInput
        If there are no foci, a name or index is unknown, or ``over`` is set without a comparison.
    """
    scale = 1.0
    if isinstance(result, Rendering):
        scale = result.drive.peak
        result = result.verification
    plotted: FieldResult = of_kind(
        result, FieldResult, "the plotted result", "the result of render() or evaluate()"
    )
    field_of_result = plotted if isinstance(plotted, RadiatedField) else plotted.field
    if field_of_result is None:
        raise InvalidInput(
            "this evaluation contains no field. Pass the object that evaluate() returned.",
            code="empty",
        )
    scene = field_of_result.scene
    foci = _foci(plotted, target)
    column = _column(plotted, drive)
    if plane is None:
        window = plane_of_scene(scene, foci)
    elif plane in ("xy", "xz", "yz"):
        window = plane_across(foci, plane, scene.wavelength)
    else:
        raise InvalidInput(f"plane is {plane!r}. Use xy, xz or yz.", code="unknown_name")
    if size is not None:
        width = positive(size, "the size of a plot", "m")
        wavelength = scene.wavelength
        # At most 100,000 points.
        step = max(width / 300, min(width / 150, wavelength / 8))
        window = replace(window, width=width, height=width, step=step)
    pressures = scale * field_of_result.at(window.points)
    shown = {str(drive): pressures[:, column]}
    if over is not None:
        if not isinstance(plotted, Comparison):
            raise InvalidInput(
                "a level difference requires two drives of a comparison. Pass the object that "
                "compare() returned.",
                code="options_clash",
            )
        shown[over] = pressures[:, plotted.column(over)]
    cut = Cut(window, shown, solid_depth(scene, window.points))
    if most is None:
        most = float(np.nanmax([np.abs(values) for values in shown.values()]))
    peak = positive(most, "most", "Pa")
    axes = _axes(ax)
    if over is None:
        draw_field(cut, str(drive), peak, foci, axes=axes)
        axes.set_title(drive if isinstance(drive, str) else "")
    else:
        draw_difference(cut, (str(drive), over), peak, foci, axes=axes)
    return axes


def phases(
    array: PhasedArray,
    drive: Drive,
    *,
    show: Literal["phase", "amplitude"] = "phase",
    ax: Axes | None = None,
) -> Axes:
    """Plot the phase or amplitude of each transducer as a disc at its position.

    Each flat face of the array is drawn separately, as seen from the side to which it radiates.

    Parameters
    ----------
    array : the transducers.
    drive : drive whose phases or amplitudes are plotted.
    show : "phase" [rad] or "amplitude", as a fraction of full scale.
    ax : axes to draw into; by default, those of a new figure.

    Returns
    -------
    The axes.

    Raises
    ------
    InvalidInput
        If the drive does not have as many elements as the array, or ``show`` is unknown.
    """
    _check_fits(array, drive)
    if show not in ("phase", "amplitude"):
        raise InvalidInput(f"show is {show!r}. Use phase or amplitude.", code="unknown_name")
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
    """Plot bodies, transducers and foci in 3-D, with transducers coloured by the phase of a drive.

    Transducers that face away from the viewer are drawn as faint rings.

    Parameters
    ----------
    scene : the bodies and the medium.
    array : transducers in the frame of the scene; see ``PhasedArray.seen_from``.
    drive : drive whose phases colour the transducers, which are grey without a drive.
    target : the foci.
    ax : axes with ``projection="3d"`` to draw into; by default, those of a new figure.

    Returns
    -------
    The axes.

    Raises
    ------
    InvalidInput
        If there is nothing to plot, the drive does not fit the array, or the axes are not 3-D.
    """
    of_kind(scene, Scene, "the scene", "Scene(medium, obstacles)")
    if drive is not None:
        _check_fits(array, drive)
    surfaces = [body.surface for body in scene.obstacles]
    empty = np.empty((0, 3))
    foci = empty if target is None else target.points
    if array is None and not surfaces and not len(foci):
        raise InvalidInput(
            "there is nothing to plot; pass bodies, transducers or foci.", code="empty"
        )
    if ax is not None and not isinstance(ax, Axes3D):
        raise InvalidInput(
            "a scene requires 3-D axes: figure.add_subplot(projection='3d').", code="wrong_kind"
        )
    positions = empty if array is None else array.positions
    normals = empty if array is None else array.normals
    angles = None if drive is None else np.angle(drive.amplitudes)
    if ax is None:
        from matplotlib import pyplot

        solid = np.concatenate([*(surface.vertices for surface in surfaces), foci])
        view = broad_view(solid) if array is None else view_of(normals)
        ax = space_axes(pyplot.figure(layout="constrained"), view)
    draw_in_space(ax, positions, normals, angles, surfaces, foci, scene.planes)
    return ax


def pads(
    result: Evaluation | Comparison | Rendering,
    *,
    held_equal: str = "equal peak",
    ax: Axes | None = None,
) -> Axes:
    """Plot the pressure at each focus as one bar per drive, with lines at the requested pressures.

    Parameters
    ----------
    result : result of ``render``, ``focus``, ``evaluate`` or ``compare``.
    held_equal : normalisation of the drives of a comparison: "equal peak" (the strongest element of
        each drive is at full scale), "equal energy", or "phase only" (all active elements are at
        full scale).
    ax : axes to draw into; by default, those of a new figure.

    Returns
    -------
    The axes.

    Raises
    ------
    InvalidInput
        If the normalisation is unknown.
    """
    if isinstance(result, Rendering):
        result = result.evaluation
    plotted: Evaluation | Comparison = of_kind(
        result,
        Evaluation | Comparison,
        "the plotted result",
        "the result of render() or evaluate()",
    )
    axes = _axes(ax)
    if isinstance(plotted, Comparison):
        draw_foci(axes, dict(zip(plotted.names, plotted.under(held_equal), strict=True)), None)
        axes.set_title(held_equal)
    else:
        draw_foci(axes, {"": plotted.magnitudes}, plotted.target.pressures)
    return axes


def reach(result: ReachMap, *, ax: Axes3D | None = None) -> Axes3D:
    """Plot the skin, coloured by the largest pressure that the array can produce there.

    The axes are in millimetres in the frame of the scene. Colours are peak pressures in kPa.

    Parameters
    ----------
    result : ``ReachMap`` of the largest pressures on the skin, as returned by the function
        ``airtact.reach``.
    ax : Matplotlib axes with ``projection="3d"`` to draw into; their view is not changed. By
        default, the axes of a new figure, which show the skin from the side of the array.

    Returns
    -------
    The ``Axes3D`` with the plot and a colour bar; ``ax.figure.savefig(path)`` saves it.

    Raises
    ------
    InvalidInput
        If ``result`` is not a ``ReachMap``.
    """
    of_kind(result, ReachMap, "the plotted result", "the result of reach()")
    if ax is None:
        from matplotlib import pyplot

        ax = space_axes(pyplot.figure(layout="constrained"), view_of_reach(result))
    kilopascals = 1e-3 * result.on_skin[result.triangles].mean(axis=1)
    ends = (1e-3 * lowest_colour(result), 1e-3 * result.bounds.max())
    scale = ScalarMappable(Normalize(*ends), colormaps[COLOURS])
    add_solid(ax, 1e3 * result.vertices[result.triangles], scale.to_rgba(kilopascals))
    frame(ax, 1e3 * result.vertices)
    ax.figure.colorbar(scale, ax=ax, label="largest peak pressure [kPa]", shrink=0.6)
    return ax


def lowest_colour(result: ReachMap) -> float:
    """Return the lowest pressure [Pa] on the colour scale of a map of attainable pressures."""
    # A scale from 0 would leave its lower part unused; equal values leave no other choice.
    lowest = float(result.bounds.min())
    return lowest if lowest < 0.99 * result.bounds.max() else 0.0


def view_of_reach(result: ReachMap) -> View:
    """Return the azimuth and elevation from which to show the skin [degrees].

    The skin is seen from the array or, if the array is a box, from the side where the skin is
    broadest.
    """
    towards = -result.setup.array.normals.mean(axis=0)
    length = float(np.linalg.norm(towards))
    if length < 0.3:
        return broad_view(result.vertices)
    azimuth = float(np.degrees(np.arctan2(towards[1], towards[0])))
    # Turn by 20 degrees, because a view along the normal of a palm would hide its shape.
    return azimuth + 20.0, float(np.degrees(np.arcsin(towards[2] / length)))


def _axes(ax: Axes | None) -> Axes:
    if ax is not None:
        return of_kind(ax, Axes, "ax", "axes of matplotlib, such as pyplot.subplots()[1]")
    from matplotlib import pyplot

    return pyplot.subplots(layout="constrained")[1]


def _foci(result: FieldResult, target: Target | None) -> np.ndarray:
    if target is not None:
        return of_kind(target, Target, "the target", "Target(points, pressures)").points
    if not isinstance(result, RadiatedField):
        return result.target.points
    if isinstance(result.sources, Beacons):
        return result.sources.refined_positions
    count = counted(len(result.sources.positions), "source", "sources")
    raise InvalidInput(
        f"the field has {count}, but its foci are unknown: pass the target.", code="empty"
    )


def _column(result: FieldResult, drive: str | int) -> int:
    if isinstance(result, Comparison):
        return result.column(result.names[drive] if isinstance(drive, int) else drive)
    count = 1 if isinstance(result, Evaluation) else result.sources.strengths.shape[1]
    if not (isinstance(drive, int) and 0 <= drive < count):
        raise InvalidInput(
            f"drive is {drive!r}, but the field only has "
            f"{counted(count, 'excitation', 'excitations')}. Use an index from 0 to {count - 1}.",
            code="unknown_name",
        )
    return drive


def _check_fits(array: PhasedArray | None, drive: Drive) -> None:
    check_drive(drive, "the drive")
    of_kind(array, PhasedArray, "the array", "one such as surrounding_box()")
    if array is not None and len(drive) != len(array):
        raise InvalidInput(
            f"a drive of {counted(len(drive), 'element', 'elements')} does not fit an array of "
            f"{len(array)} elements.",
            code="sizes_differ",
        )
