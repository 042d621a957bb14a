"""Pictures of bodies, panels and point clouds, each seen from two sides."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float64, Real
from matplotlib import colormaps
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from mpl_toolkits.mplot3d import Axes3D

from airtact.acoustics.scene import Plane
from airtact.geometry.mesh.triangles import QuadraticTriangles, smallest_angles
from airtact.geometry.mesh_shape import MeshShape
from airtact.geometry.surface import Surface
from airtact.hands.fitting.fit import FittedHand
from airtact.reports.solids import (
    FOCI,
    SHEET,
    add_solid,
    broad_view,
    draw_sheets,
    frame,
    space_axes,
)

SHARP = (0.75, 0.11, 0.11, 1.0)


def _two_views(
    height: float, points: Float64[np.ndarray, "points 3"]
) -> tuple[Figure, list[Axes3D]]:
    # Create a figure with a given height [inches] and two orthographic views of points from
    # opposite sides. The padding leaves room for labels in 3-D.
    azimuth, elevation = broad_view(points)
    views = ((azimuth, elevation), (azimuth + 180.0, -elevation))
    figure = Figure(figsize=(13.0, height), layout=ConstrainedLayoutEngine(w_pad=0.35, h_pad=0.12))
    panels = [space_axes(figure, view, (1, 2, 1 + side)) for side, view in enumerate(views)]
    for axes in panels:
        axes.set_proj_type("ortho")
    return figure, panels


def draw_bodies(
    bodies: Sequence[Surface],
    names: Sequence[str],
    foci: Real[np.ndarray, "foci 3"] | None = None,
    planes: Sequence[Plane] = (),
) -> Figure:
    """Draw bodies with their triangles, foci (F, 3) [m] as dots, and planes as sheets."""
    corners = 1e3 * np.concatenate([body.corners for body in bodies])
    # Pale colours leave some range for shading.
    tints = colormaps["Pastel2"](np.arange(len(bodies)) % 8)
    colours = np.repeat(tints, [len(body.triangles) for body in bodies], axis=0)
    dots = np.empty((0, 3)) if foci is None else 1e3 * foci
    everything = np.concatenate([corners.reshape(-1, 3), dots])
    sharp = np.concatenate([sharp_edges(body) for body in bodies])
    figure, panels = _two_views(6.0, everything)
    for axes in panels:
        outlined = len(corners) <= 8000  # the edges of finer meshes would look black
        add_solid(axes, corners, colours, outlined=outlined, marked=sharp, mark=SHARP)
        axes.scatter(*dots.T, s=30, **FOCI)  # pyright: ignore
        frame(axes, np.concatenate([everything, draw_sheets(axes, planes, 1e-3 * everything)]))
    handles: list[Patch | Line2D] = [
        Patch(color=tint, label=name) for tint, name in zip(tints, names, strict=True)
    ]
    if sharp.any():
        handles.append(Line2D([], [], color=SHARP, label="sharp edges"))
    if len(dots):
        label = "foci, also drawn behind bodies"
        handles.append(Line2D([], [], color=FOCI["c"], marker="o", linestyle="none", label=label))
    if planes:
        handles.append(Patch(color=SHEET, label="rigid plane"))
    figure.legend(handles=handles, loc="outside lower center", ncols=6, frameon=False)
    return figure


def sharp_edges(body: Surface) -> Bool[np.ndarray, "triangles 3"]:
    """Return whether edges 01, 12 and 20 of each triangle stay sharp when the surface is curved."""
    if not isinstance(body.shape, MeshShape):
        return np.zeros((len(body.triangles), 3), dtype=bool)
    return body.shape.mesh.sharp


def draw_panels(quadratic_triangles: QuadraticTriangles) -> Figure:
    """Draw curved panels and their edges, coloured by the smallest angle of each panel."""
    # The angles of an equilateral panel are 60°.
    scale = ScalarMappable(Normalize(0.0, 60.0), "viridis")
    hexagons = _hexagons(quadratic_triangles)
    figure, panels = _two_views(6.4, hexagons.reshape(-1, 3))
    for axes in panels:
        colours = scale.to_rgba(smallest_angles(quadratic_triangles))
        add_solid(axes, hexagons, colours, outlined=True)
        frame(axes, hexagons.reshape(-1, 3))
    label = "smallest angle of the panel [degrees]"
    figure.colorbar(scale, ax=panels, label=label, shrink=0.6, aspect=28)
    return figure


def _hexagons(
    quadratic_triangles: QuadraticTriangles,
) -> Float64[np.ndarray, "panels 6 3"]:
    # Corners and edge midpoints of panels, in order around each panel [mm]
    return 1e3 * quadratic_triangles[:, [0, 3, 1, 4, 2, 5]]


def draw_cloud(
    quadratic_triangles: QuadraticTriangles,
    fitted: FittedHand,
    distances: Float64[np.ndarray, "points"],
) -> Figure:
    """Draw a point cloud on the fitted skin: blue outside, red inside, outliers as crosses.

    ``distances`` contains the distance of each point from the skin [m], positive outside.
    """
    points = 1e3 * fitted.points
    used = ~fitted.outliers
    scale = ScalarMappable(Normalize(-5.0, 5.0), "RdBu")
    residuals = scale.to_rgba(1e3 * distances[used])
    purple = "#9775fa"
    hexagons = _hexagons(quadratic_triangles)
    figure, panels = _two_views(6.4, hexagons.reshape(-1, 3))
    for axes in panels:
        add_solid(axes, hexagons, np.tile((0.82, 0.82, 0.80, 1.0), (len(hexagons), 1)))
        axes.scatter(*points[used].T, s=5, c=residuals, depthshade=False, zorder=4)  # pyright: ignore
        axes.scatter(*points[~used].T, s=8, c=purple, marker="x", linewidths=0.6, zorder=4)  # pyright: ignore
        frame(axes, hexagons.reshape(-1, 3))
    label = "distance of points from the skin, positive outside [mm]"
    figure.colorbar(scale, ax=panels, label=label, shrink=0.6, aspect=28, extend="both")
    outlier = Line2D([], [], color=purple, marker="x", linestyle="none")
    words = "outliers, ignored by the fit"
    figure.legend([outlier], [words], loc="outside lower center", frameon=False)
    return figure
