"""Fig. 4 and 5 of the paper: the model as meshed, the phase of the beacons' field, and that of each transducer."""

from pathlib import Path

import numpy as np
from jaxtyping import Bool, Complex128, Float64
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from airtact.acoustics.solvers.fem.system import System
from airtact.acoustics.solvers.problem import SolveReport
from airtact.evaluation.windows import AXES, Window
from airtact.experiments.part import Part, coordinates, corners, draw_planes, write_columns
from airtact.experiments.settings import Settings
from airtact.experiments.solved import CONSIDERED, Solved
from airtact.geometry.mesh.quadratic_triangles import QuadraticTriangles
from airtact.reports.array_figures import draw_phases
from airtact.reports.field_figure import cut_bodies, past_the_surface
from airtact.reports.page import paragraph, picture
from airtact.reports.surface_figure import draw_panels
from airtact.timing import Clock

ON_PLANE = 1e-6
"""Corners nearer to a symmetry plane than this lie on it [λ]."""

ON_BEACON = 1e-6
"""Points nearer to a beacon than this are on it [m]."""


def beacons(made: Solved, settings: Settings, folder: Path, clock: Clock) -> Part:
    """Show the model, the field of the beacons, and the phase and amplitude of each transducer."""
    system, report = made.field.system, made.field.report
    with clock.step("phases", "evaluating the field of the beacons in the plane of the fingers"):
        window = _workspace(made.dummies.middle, settings.plane_step)
        pressure = _pressure(made, window.points)
    phase = np.angle(pressure)
    drive = made.drives[CONSIDERED].amplitudes
    columns = {"pressure": ("Pa", np.abs(pressure)), "phase": ("rad", phase)}
    write_columns(folder, "beacon_field", coordinates(window.points) | columns)
    _write_transducers(made, drive, folder)
    _write_mesh(system, made.scene.wavelength, folder)
    outlines = cut_bodies(window, made.dummies.surfaces)
    shown = {"phase of the beacons' field": past_the_surface(window, phase, 2)}
    scale = ("twilight", -np.pi, np.pi, "phase of the beacons' field [rad]")
    pieces = (
        paragraph(_how_meshed(report)),
        picture(
            draw_mesh(system, made.scene.wavelength),
            "Fig. 4 of the paper: the model as meshed, cut in the plane of both fingers; dark: the perfectly matched "
            "layer. The left edge is a plane of symmetry, and the circle is the beacon. data/mesh_cut",
            "triangles in a plane round half a finger, and a darker layer round them",
        ),
        picture(
            draw_panels(whole_surface(system) * made.scene.wavelength),
            "The surfaces as meshed: a quarter and its mirror images, curved triangles coloured by their smallest "
            "angle. data/mesh_surfaces",
            "two fingers covered with curved triangles",
        ),
        picture(
            draw_planes(window, shown, outlines, made.dummies.foci, scale),
            "Fig. 5 of the paper: the phase of the field of both beacons in step, in the plane of both fingers. The "
            "upright edges are where the transducers stand. data/beacon_field",
            "rings of phase round two fingers, bent by them",
        ),
        picture(
            draw_phases(made.array.positions, made.array.normals, drive),
            f"Phase and amplitude of the {len(made.array)} transducers: the conjugate of that field, 256 levels each. "
            "data/transducers",
            "four faces of discs coloured by phase, and by amplitude",
        ),
    )
    return Part("The model and the phases (Fig. 4 and 5)", pieces)


def _pressure(
    made: Solved, points: Float64[np.ndarray, "points 3"]
) -> Complex128[np.ndarray, "points"]:
    """Pressure of the beacons, NaN in the bodies and at the beacons themselves, where it is infinite."""
    away = np.linalg.norm(points[:, None] - made.dummies.foci, axis=2).min(axis=1) > ON_BEACON
    pressure = np.full(len(points), np.nan, dtype=np.complex128)
    pressure[away] = made.field.at(points[away])[:, 0]
    return pressure


def _how_meshed(report: SolveReport) -> str:
    settings = report.settings
    return (
        "The paper meshes a quarter of its whole box and reads the field off the mesh; COMSOL took about 120 minutes. "
        f"Here only a tight box round the fingers is meshed ({settings['tetrahedra']} tetrahedra of order "
        f"{settings['order']}, {report.nodes} unknowns, planes of symmetry across "
        f"{' and '.join(str(settings['mirrors']))}), which took {sum(report.seconds.values()):.1f} s with solving; "
        "outside it the field follows from the pressure on the fingers by the surface integral of Kirchhoff and "
        "Helmholtz."
    )


def _write_transducers(
    made: Solved, drive: Complex128[np.ndarray, "elements"], folder: Path
) -> None:
    columns = {
        "amplitude": ("", np.abs(drive)),
        "phase": ("rad", np.angle(drive)),
        "amplitude_level": ("", np.rint(255 * np.abs(drive)).astype(np.int64)),
        "phase_level": ("", np.rint(np.angle(drive) * 128 / np.pi).astype(np.int64) % 256),
    }
    write_columns(folder, "transducers", coordinates(made.array.positions) | columns)


def _write_mesh(system: System, wavelength: float, folder: Path) -> None:
    """Write the corners of what the pictures of the mesh show."""
    faces, layer = on_plane(system, _cut_axis(system))
    columns = {"perfectly_matched_layer": ("", layer.astype(np.int64))}
    write_columns(folder, "mesh_cut", corners(wavelength * faces) | columns)
    write_columns(folder, "mesh_surfaces", corners(wavelength * whole_surface(system)))


def _cut_axis(system: System) -> int:
    axes = [mirror.axis for mirror in system.box.mirrors]
    return 1 if 1 in axes else axes[0]


def _workspace(middle: Float64[np.ndarray, "3"], step: float) -> Window:
    up = np.abs(middle)
    return Window(np.zeros(3), AXES["x"], up, 0.14, 0.18 if up[2] else 0.14, step)


def whole_surface(system: System) -> QuadraticTriangles:
    """Meshed surfaces with their mirror images (T, 6, 3) [λ]."""
    quadratic_triangles = system.panels.quadratic_triangles
    for mirror in system.box.mirrors:
        image = np.array(quadratic_triangles[:, [0, 2, 1, 5, 4, 3]])
        image[:, :, mirror.axis] = (
            2 * mirror.position / system.scene.wavelength - image[:, :, mirror.axis]
        )
        quadratic_triangles = np.concatenate([quadratic_triangles, image])
    return quadratic_triangles


def on_plane(
    system: System, axis: int
) -> tuple[Float64[np.ndarray, "faces 3 3"], Bool[np.ndarray, "faces"]]:
    """Faces of tetrahedra on a plane of symmetry (T, 3, 3) [λ], and whether each is in the perfectly matched layer."""
    corners = system.tetrahedra.corners
    plane = (
        next(one.position for one in system.box.mirrors if one.axis == axis)
        / system.scene.wavelength
    )
    on = np.abs(corners[:, :, axis] - plane) < ON_PLANE
    flat = on.sum(axis=1) == 3
    faces = corners[flat][on[flat]].reshape(-1, 3, 3)
    return faces, ~system.box.holds(faces.mean(axis=1) * system.scene.wavelength)


def draw_mesh(system: System, wavelength: float) -> Figure:
    """Draw the tetrahedra where they meet the plane y = 0, or the first plane of symmetry there is."""
    axis = _cut_axis(system)
    faces, layer = on_plane(system, axis)
    shown = [index for index in range(3) if index != axis]
    flat = 1e3 * wavelength * faces[:, :, shown]
    figure = Figure(figsize=(6.0, 8.0), layout="constrained")
    axes = figure.subplots()
    for chosen, colour in ((~layer, "#e8eef7"), (layer, "#a9b8cf")):
        axes.add_collection(
            PolyCollection(list(flat[chosen]), facecolor=colour, edgecolor="0.3", linewidth=0.5)
        )
    axes.plot(
        *_beacon(system, shown),
        "o",
        markersize=9,
        markerfacecolor="none",
        markeredgecolor="#b3202a",
        mew=2,
    )
    low, high = flat.reshape(-1, 2).min(axis=0), flat.reshape(-1, 2).max(axis=0)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    axes.set(xlabel=f"{'xyz'[shown[0]]} [mm]", ylabel=f"{'xyz'[shown[1]]} [mm]")
    return figure


def _beacon(system: System, shown: list[int]) -> Float64[np.ndarray, "2"]:
    """Point of the surface that is nearest the middle, where the beacon is [mm]."""
    points = system.surface.points * system.scene.wavelength
    return 1e3 * points[np.argmin(np.abs(points[:, 0]))][shown]
