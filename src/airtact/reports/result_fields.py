"""Fields on the page of a result: evaluate them, write field.vtkhdf, and draw them."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from airtact.acoustics.solvers.problem import RadiatedField
from airtact.acoustics.target_points import outward
from airtact.drives.drive import Drive
from airtact.evaluation.slices import slices_around, surface_pressure
from airtact.evaluation.windows import Window, box_around, close_up, plane_of_scene
from airtact.reports.field_figure import Cut, cut_bodies
from airtact.reports.methods_page import write_methods_page
from airtact.reports.run_page import Fields, write_page
from airtact.reports.solids import behind_planes
from airtact.reports.viewer import SceneView
from airtact.setup.comparing import MethodComparison
from airtact.setup.exports import write_field
from airtact.setup.rendering import Rendering
from airtact.setup.sequences import paths_of
from airtact.setup.setup import Setup
from airtact.timing import Clock, Progress


def report_rendering(result: Rendering, folder: Path, progress: Progress) -> tuple[Path, ...]:
    """Write field.vtkhdf and report.html of a rendering into a folder."""
    clock = Clock(progress)
    setup = result.setup
    scene = setup.scene
    comparison = result.verification
    files = (folder / "field.vtkhdf", folder / "report.html")
    for file in files:
        file.unlink(missing_ok=True)  # an older run's
    peak = result.drive.peak
    with clock.step("field", "computing the field around the foci"):
        box = box_around(setup.target.points, scene.wavelength)
        pressure = peak * comparison.at(box.points)[comparison.names[0]]
        write_field(files[0], box, pressure, [obstacle.surface for obstacle in scene.obstacles])
    fields = evaluate_fields(result, clock)
    progress("drawing the report")
    write_page(files[1], result, fields, {**result.seconds, **clock.seconds})
    return files


def evaluate_fields(result: Rendering, clock: Clock) -> Fields:
    """Evaluate the fields on the page of a rendering, all drives at the energy of the first."""
    scales = np.array([drive.factor_to_match(result.drive) for drive in result.drives.values()])
    with clock.step("cuts", "computing the field in the pictures"):
        plane, close_ups = _cuts(result, scales)
    with clock.step("scene in space", "computing the field in the scene to turn"):
        view = _scene_view(
            result.setup,
            result.verification.field,
            result.drives,
            scales,
            plane.window,
            "equal energy",
        )
    return Fields(plane, close_ups, view)


def report_methods(result: MethodComparison, folder: Path, progress: Progress) -> tuple[Path, ...]:
    """Write methods.html of a comparison into a folder."""
    clock = Clock(progress)
    setup = result.setup
    emitted = {contender.name: contender.emitted for contender in result.contenders}
    page = folder / "methods.html"
    page.unlink(missing_ok=True)  # an older run's
    with clock.step("cuts", "computing the fields in the pictures"):
        window = plane_of_scene(setup.scene, setup.target.points)
        pressures = dict(zip(emitted, result.field.at(window.points).T, strict=True))
        cut = Cut(window, pressures, _outlines(setup, window))
    with clock.step("scene in space", "computing the fields in the scene to turn"):
        view = _scene_view(
            setup,
            result.field,
            emitted,
            np.ones(len(emitted)),
            window,
            "the levels that they emit",
        )
    progress("drawing the page")
    write_methods_page(page, result, cut, view, {**result.seconds, **clock.seconds})
    return (page,)


def _cuts(result: Rendering, scales: Float64[np.ndarray, "drives"]) -> tuple[Cut, list[Cut]]:
    """Cut the field through the foci, and across each focus if one plane cannot show them all."""
    scene = result.setup.scene
    foci = result.setup.target.points

    def cut(window: Window) -> Cut:
        pressures = result.verification.at(window.points)
        scaled = {
            name: pressure * scale
            for (name, pressure), scale in zip(pressures.items(), scales, strict=True)
        }
        outside = window.points[scene.depth(window.points) < 0.0]
        # 300 points bound the time of the estimate.
        sample = outside[:: max(1, len(outside) // 300)]
        error = float("nan")
        if len(sample):
            error = float(np.max(result.verification.field.error_at(sample)))
        return Cut(window, scaled, _outlines(result.setup, window), error)

    plane = cut(plane_of_scene(scene, foci))
    # A plane fits two foci exactly.
    if len(foci) < 3 or not scene.obstacles:
        return plane, []
    outwards = outward(scene.depth, foci)
    return plane, [
        cut(close_up(focus, normal, scene.wavelength))
        for focus, normal in zip(foci, outwards, strict=True)
    ]


def _outlines(setup: Setup, window: Window) -> list[Float64[np.ndarray, "_ 3"]]:
    """Outlines of bodies without a field inside, and of the region behind planes [m]."""
    solid = [
        obstacle.surface for obstacle in setup.scene.obstacles if obstacle.boundary != "filled"
    ]
    return cut_bodies(window, solid) + behind_planes(window, setup.scene.planes)


def _scene_view(
    setup: Setup,
    field: RadiatedField,
    drives: Mapping[str, Drive],
    scales: Float64[np.ndarray, "drives"],
    window: Window,
    held_equal: str,
) -> SceneView:
    """Evaluate drives around the foci and on the bodies.

    Parameters
    ----------
    field : its first excitations are those of the drives.
    drives : by name, as they were solved.
    scales : (D,) factor on each drive for the picture.
    window : the plane of the foci.
    held_equal : the quantity that the scales make equal, in words.
    """
    columns = list(range(len(drives)))
    target = setup.target
    slices = slices_around(field, columns, target.points, window)
    surfaces = surface_pressure(field, columns)
    if surfaces is not None:
        surfaces = replace(surfaces, pressures=surfaces.pressures * scales)
    asked = ["as strong as possible"] * len(setup.foci)
    if target.pressures is not None:
        asked = [f"{pressure:,.0f} Pa" for pressure in target.pressures]
    return SceneView(
        drives={
            name: scale * drive.amplitudes
            for (name, drive), scale in zip(drives.items(), scales, strict=True)
        },
        positions=setup.array.positions,
        normals=setup.array.normals,
        foci=setup.foci,
        points=target.points,
        asked=asked,
        reached=np.abs(field.at(target.points)[:, columns]) * scales,
        surfaces=surfaces,
        slices=replace(slices, pressures=slices.pressures * scales),
        held_equal=held_equal,
        paths=paths_of(setup),
        planes=setup.scene.planes,
    )
