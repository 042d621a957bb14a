"""The page of a run: drive, fields, pressures at the foci, and how they were computed."""

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from airtact.drives.transfer import fraction
from airtact.errors import counted, in_mm
from airtact.evaluation.comparison import HELD_EQUAL
from airtact.evaluation.metrics import not_modelled, weakest_focus
from airtact.evaluation.slices import box_pressure, window_pressure
from airtact.evaluation.windows import box_around, plane_of_scene
from airtact.reports.array_figures import draw_phases, draw_scene, is_uniform
from airtact.reports.field_figure import (
    FAINT,
    Cut,
    draw_difference,
    draw_field,
    solid_depth,
)
from airtact.reports.page import picture, write_page
from airtact.reports.plots import draw_shares
from airtact.reports.viewer import (
    SceneView,
    scene_view,
    viewer_values,
)
from airtact.setup.exports import write_field
from airtact.setup.rendering import Rendering
from airtact.timing import Clock, Progress, duration


def write_run_page(run: Rendering, folder: Path, progress: Progress) -> tuple[Path, ...]:
    """Write field.vtkhdf and report.html, the field and the report of a rendering, to a folder."""
    clock = Clock(progress)
    setup = run.setup
    scene = setup.scene
    files = (folder / "field.vtkhdf", folder / "report.html")
    # Matplotlib draws in a second thread while the compiled kernels compute in this one.
    with ThreadPoolExecutor(1) as painter:
        pictures = painter.submit(_pictures, run)
        cut, view = fields_of(run, clock)
        fields = painter.submit(_fields, run, cut, view, _error_of_cut(run, cut))
        with clock.step("field", "writing the field around the foci"):
            # The drive is the first excitation.
            field = run.verification.field
            if view.slices.any_axis:
                box = box_around(setup.target.points, scene.wavelength)
            else:  # the planes are too far apart to interpolate the field between them
                box = view.slices.box
            pressure = run.drive.peak * box_pressure(field, view.slices, 0, box)
            write_field(files[0], box, pressure, [obstacle.surface for obstacle in scene.obstacles])
        progress("drawing the report")
        solve = sum(run.seconds[step] for step in ("beacons", "transfer", "drive"))
        write_page(
            files[1],
            "report.html.j2",
            title=f"airtact: {setup.title}",
            run=run,
            transducers=counted(len(setup.array), "transducer", "transducers"),
            frequency=f"{scene.frequency / 1e3:g} kHz",
            foci=counted(len(setup.foci), "focus", "foci"),
            bodies=" and ".join(setup.bodies),
            facts=[
                (weakest_focus(run.pressures, setup.target)[0], "at the weakest focus"),
                (duration(solve), "to solve and compute the drive"),
                (_percent(run.estimated_error), "estimated error of these pressures"),
            ],
            # Several steps may issue the same warning.
            warnings=list(dict.fromkeys(run.warnings)),
            **_foci(run),
            **_how(run, {**run.seconds, **clock.seconds}),
            # The scene is packed while Matplotlib draws the last pictures.
            space=viewer_values(view),
            fields=fields.result(),
            **pictures.result(),
        )
    return files


def fields_of(run: Rendering, clock: Clock) -> tuple[Cut, SceneView]:
    """Evaluate the fields for the pictures of a rendering, with all drives at equal energy."""
    setup = run.setup
    scales = [drive.factor_to_match(run.drive) for drive in run.drives.values()]
    plane = plane_of_scene(setup.scene, setup.target.points)
    with clock.step("cuts", "computing the field in the pictures"):
        depth = solid_depth(setup.scene, plane.points)
        pressure = window_pressure(run.verification.field.for_pictures, plane, depth)
        pressures = {
            name: scale * pressure[:, run.verification.column(name)]
            for name, scale in zip(run.drives, scales, strict=True)
        }
        cut = Cut(plane, pressures, depth)
    with clock.step("3-D scene", "computing the field in the 3-D scene"):
        field = run.verification.field
        view = scene_view(
            setup, field, run.verification.at_foci, run.drives, scales, plane, "equal energy"
        )
    return cut, view


def _pictures(run: Rendering) -> dict[str, Any]:
    array = run.setup.array
    exact = np.abs(run.transfer.pressure(run.drive))[: len(run.setup.foci)]
    rounded = np.abs(run.transfer.pressure(run.frame.drive()))[: len(run.setup.foci)]
    asked = run.setup.target.weights > 0.0
    rounding = float(np.max(np.abs(rounded[asked] / exact[asked] - 1)))
    levels = run.frame.levels
    uniform = is_uniform(run.drive.amplitudes)
    shown = "Phase" if uniform else "Phase and amplitude"
    amplitude = f" All amplitudes are {run.drive.peak:.2f} of full scale." if uniform else ""
    order = ""
    if np.ptp(array.normals, axis=0).max() > 1e-3:
        order = (
            " The faces are in the order that a viewer inside the array sees when turning right "
            "(compare Fig. 5 of Inoue, Makino and Shinoda, 2014)."
        )
    figure = draw_phases(array.positions, array.normals, run.drive.amplitudes)
    phases = picture(
        figure,
        f"{shown} of each transducer for the method {run.method}, in Re[u e^(−iωt)].{amplitude} "
        f"Each face is drawn as seen from the side to which it radiates.{order} "
        f"Rounding to {len(levels.amplitudes)} amplitude levels and "
        f"{levels.phases} phase levels (drive.csv) changes the pressure at the foci by at most "
        f"{rounding:.2%}.",
        f"{shown} of {len(array)} transducers, face by face",
        wide=bool(figure.get_figwidth() > 7.0),
    )
    bodies = [obstacle.surface for obstacle in run.setup.scene.obstacles]
    still = picture(
        draw_scene(
            array.positions,
            array.normals,
            run.drive.amplitudes,
            bodies,
            run.setup.target.points,
            run.setup.scene.planes,
        ),
        "Transducers are coloured by phase, bodies are grey, and foci are orange. Transducers that "
        "face away from the viewer are faint rings.",
        f"{counted(len(array), 'transducer', 'transducers')}, bodies and foci in space",
    )
    pictures = {"phases": phases, "still": still, "doubt": Markup()}
    doubt = run.robustness
    if doubt is not None:
        count = counted(doubt.pressures.shape[1], "sample", "samples")
        pictures["doubt"] = picture(
            draw_shares(
                dict(zip(doubt.names, doubt.pressures, strict=True)),
                dict(zip(doubt.names, doubt.expected, strict=True)),
            ),
            f"Fraction of {count} of the uncertain scene in which the pressure at the weakest "
            "focus is below a value. These samples were not used to compute the drives. Dots mark "
            "the pressure without deviations. All drives have equal energy.",
            "; ".join(
                f"{name}: at least {low:.0f} Pa in 9 of 10 cases"
                for name, low in zip(doubt.names, doubt.lowest_tenth, strict=True)
            ),
        )
    return pictures


def _error_of_cut(run: Rendering, cut: Cut) -> float:
    """Return the relative error of the pressures in the picture; 0 if the solver estimates none."""
    outside = np.flatnonzero(cut.depth < 0.0)
    # At most 100 points, to limit the time. Evenly spaced points could all be points at which the
    # field was evaluated, without the error of the interpolation between them.
    sample = np.random.default_rng(0).permutation(outside)[:100]
    field = run.verification.field
    error = float(np.max(field.error_at(cut.window.points[sample]), initial=0.0))
    if error > 0.0:
        # The pressure in the picture is less accurate than the field.
        name = run.verification.names[0]
        scale = run.drives[name].factor_to_match(run.drive)
        exact = scale * field.at(cut.window.points[sample])[:, 0]
        gap = cut.pressures[name][sample] - exact
        known = np.isfinite(gap)
        error = float(np.hypot(error, np.linalg.norm(gap[known]) / np.linalg.norm(exact[known])))
    return error


def _fields(run: Rendering, cut: Cut, view: SceneView, error: float) -> list[Markup]:
    names = run.verification.names
    peak = view.peak
    points = run.setup.target.points
    got = view.reached
    estimate = f" Their estimated error is {100 * error:.1g} %." if error > 0.0 else ""
    # More than two foci on pads rarely lie in one plane.
    off = 1e3 * np.abs(cut.window.height_of(points)).max()
    plane = "Plane through the foci."
    if off >= 0.5:
        plane = (
            f"Plane closest to the foci, which are up to {off:.1f} mm away from it; foci outside "
            "the plane are dashed."
        )
    panels = [
        picture(
            draw_field(cut, name, peak, points, run.setup.labels),
            f"{name.capitalize()}. {plane}{estimate}",
            f"Pressure map, {name}: {_rounded(column.min())} to {_rounded(column.max())} Pa at the "
            "foci",
        )
        for name, column in zip(names, got.T, strict=True)
    ]
    if len(names) == 1:
        return panels
    change = 20.0 * np.log10(got[:, 0] / got[:, 1])
    difference = picture(
        draw_difference(cut, (names[0], names[1]), peak, points, run.setup.labels),
        f"Red: higher with {names[0]}. Grey: below {FAINT:.0%} of the largest pressure in both.",
        f"Map of the difference in dB: {change.min():+z.1f} to {change.max():+z.1f} dB at the foci",
    )
    return [*panels, difference]


def _foci(run: Rendering) -> dict[str, Any]:
    scene = run.setup.scene
    points = run.setup.target.points
    asked = run.setup.target.pressures
    header = ["focus", "x [mm]", "y [mm]", "z [mm]", "distance from the surface [mm]", "p [Pa]"]
    columns = [
        run.setup.foci,
        *([f"{value:z.2f}" for value in axis] for axis in 1e3 * points.T),
        [f"{-1e3 * depth:z.2f}" if scene.obstacles else "–" for depth in scene.depth(points)],
        [_pascal(pressure) for pressure in run.pressures],
    ]
    if asked is not None:
        shares = fraction(run.pressures, run.setup.target)
        header += ["requested [Pa]", "reached"]
        columns.append([_pascal(pressure) for pressure in asked])
        columns.append(["–" if np.isnan(share) else f"{share:.1%}" for share in shares])
    trap_rows = [
        [
            f"trap {index}",
            *(f"{value:z.2f}" for value in 1e3 * verdict.point),
            *(f"{value:.3g}" for value in verdict.stiffness.diagonal()),
            f"{verdict.holds:.1f}",
            "yes" if verdict.is_trap else "no",
        ]
        for index, verdict in enumerate(run.traps, 1)
    ]
    trap_panels: list[list[Markup]] = []
    if run.traps:
        from airtact.reports.trap_figures import trap_pictures  # imports scipy.integrate

        trap_panels = [trap_pictures(run, index) for index in range(min(len(run.traps), 6))]
    # Describe the sound that produces the pressures in the table of foci, with its peak.
    emitted = f"this drive. The largest amplitude is {run.drive.peak:.2f} of full scale"
    if run.setup.in_turn and run.sequence is not None:
        peak = float(np.abs(run.sequence.drives).max())
        emitted = (
            "the sequence while the moving focus is at this point. The values come from the "
            "transfer matrix, which the verification of all foci at once confirms. The largest "
            f"amplitude is {peak:.2f} of full scale"
        )
    return {
        "trap_rows": trap_rows,
        "trap_pictures": trap_panels,
        "focus_header": header,
        "focus_rows": list(zip(*columns, strict=True)),
        "emitted": emitted,
        "comparison_header": ["focus", *(f"{name} [Pa]" for name in run.drives), "ratio"],
        "comparisons": _comparisons(run) if run.setup.bodies else {},
    }


def _comparisons(run: Rendering) -> dict[str, list[tuple[str, ...]]]:
    """Return tables of the pressures of both drives, by caption; a single one if all are equal."""
    tables = {}
    for held_equal, pressures in run.felt.pressures.items():
        rows = []
        for name, (first, second) in zip(run.setup.foci, pressures.T, strict=True):
            ratio = f"{first / second:.3f}" if second > 0.0 else "–"
            rows.append((name, _pascal(first), _pascal(second), ratio))
        tables[f"{held_equal.capitalize()}: {HELD_EQUAL[held_equal]}"] = rows
    first, *others = tables.values()
    if all(rows == first for rows in others):
        return {"The pressures are the same whichever quantity is equal for both drives.": first}
    return tables


def _how(run: Rendering, seconds: Mapping[str, float]) -> dict[str, Any]:
    medium = run.setup.scene.medium
    scene = run.setup.scene
    reports = (run.beacons, run.verification.report)
    pairs = list(zip(run.setup.bodies, scene.obstacles, strict=True))
    bodies = [
        f"{name} ({obstacle.kind}, {1e4 * obstacle.surface.area:.1f} cm²)"
        for name, obstacle in pairs
    ]
    planes = [
        f"through {in_mm(plane.point)} with the normal {np.round(plane.normal, 3) + 0.0}"
        for plane in scene.planes
    ]
    repairs = " ".join(
        f"{name}: {note}" for name, obstacle in pairs for note in obstacle.surface.repairs
    )
    columns = [
        {
            "solver": report.solver,
            "settings": _listed(report.settings),
            # Closed forms have no unknowns and no iterations.
            "unknowns": f"{report.nodes:,}" if report.nodes else "",
            "unknowns per λ²": f"{report.nodes_per_square_wavelength:.0f}".replace("inf", ""),
            "iterations, residual": f"{report.iterations}, {report.residual:.1e}"
            if report.iterations
            else "",
            "estimated error": _percent(report.estimated_error),
            "seconds": _listed({name: f"{t:.2f}" for name, t in report.seconds.items()}),
        }
        for report in reports
    ]
    rows = [[name, *(column[name] or "–" for column in columns)] for name in columns[0]]
    return {
        "report_rows": [row for row in rows if row[1:] != ["–", "–"]],
        "setting_rows": [
            [
                "medium",
                f"{medium.sound_speed:g} m/s, {medium.density:g} kg/m³, "
                f"absorption {medium.absorption:g} Np/m",
            ],
            ["frequency", f"{scene.frequency:g} Hz, wavelength {1e3 * scene.wavelength:.2f} mm"],
            ["bodies", ", ".join(bodies) or "none"],
            *([["rigid planes", ", ".join(planes)]] if planes else []),
            *([["repaired", repairs or "nothing"]] if bodies else []),
            [
                "array",
                f"{len(run.setup.array)} transducers of {run.setup.array.element.sensitivity:g} "
                "Pa·m (peak, uncalibrated)",
            ],
            ["pattern", run.setup.array.element.pattern_in_words(scene.wavenumber.real)],
            ["not in the model", not_modelled(run.verification.report)],
            ["wall time", _listed({name: duration(time) for name, time in seconds.items()})],
        ],
        "citations": list(
            dict.fromkeys(
                [
                    "S. Inoue, Y. Makino, H. Shinoda, Producing Airborne Ultrasonic 3D Tactile "
                    "Image by Time Reversal Field Rendering, SICE Annual Conference 2014, 1360",
                    *run.beacons.citations,
                    *run.verification.report.citations,
                ]
            )
        ),
    }


def _listed(facts: Mapping[str, object]) -> str:
    return ", ".join(
        f"{name.replace('_', ' ')} {f'{value:.3g}' if isinstance(value, float) else value}"
        for name, value in facts.items()
    )


def _pascal(pressure: float) -> str:
    return f"{pressure:,.0f}" if pressure >= 100 else f"{pressure:.1f}"


def _percent(share: float) -> str:
    return f"{share:.2%}" if share >= 1e-4 else "< 0.01%"


def _rounded(pressure: float) -> str:
    # More than three digits would exceed the accuracy of the computation.
    return f"{float(f'{pressure:.3g}'):,g}"
