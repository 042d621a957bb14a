"""The page of one run: what the transducers emit, what it does, and how it was computed."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from airtact.acoustics.planes import Plane
from airtact.acoustics.scene import Obstacle
from airtact.acoustics.solvers.problem import SolveReport
from airtact.checks import counted, in_mm
from airtact.drives.transfer_ensemble import TransferEnsemble
from airtact.evaluation.comparison import HELD_EQUAL
from airtact.evaluation.headline import pascals
from airtact.evaluation.metrics import not_modelled
from airtact.files.atomic import whole_file
from airtact.reports.array_figures import draw_phases, draw_scene
from airtact.reports.field_figure import FAINT, Cut, draw_close_ups, draw_difference, draw_field
from airtact.reports.page import page_from, picture
from airtact.reports.plots import draw_shares, draw_shifts
from airtact.reports.viewer import SceneView, viewer_alternative, viewer_values
from airtact.setup.rendering import Rendering

CITATION = (
    "S. Inoue, Y. Makino, H. Shinoda, Producing Airborne Ultrasonic 3D Tactile Image by Time Reversal Field Rendering, "
    "SICE Annual Conference 2014, 1360"
)


@dataclass(frozen=True, eq=False)
class Fields:
    """The fields that a page shows.

    Attributes
    ----------
    plane : pressures under drive and control, at equal energy, in the plane through the foci.
    close_ups : the same across each focus; may be none.
    view : the scene in space.
    """

    plane: Cut
    close_ups: Sequence[Cut]
    view: SceneView


def write_page(path: Path, run: Rendering, fields: Fields, seconds: Mapping[str, float]) -> None:
    """Write a rendering as one self-contained HTML file; ``seconds`` is the wall time by step [s]."""
    values = {
        **_summary(run),
        **_pictures(run, fields),
        **_foci(run),
        **_how(run, seconds),
        "space": viewer_values(fields.view, run.setup.title),
    }
    title = f"airtact: {run.setup.title}"
    with whole_file(path) as partial:
        partial.write_text(page_from("report.html.j2", title=title, run=run, **values), "utf-8")


def _summary(run: Rendering) -> dict[str, Any]:
    solve = sum(run.seconds[step] for step in ("beacons", "transfer", "drive"))
    scatter = "scatters" if len(run.setup.bodies) == 1 else "scatter"
    return {
        "transducers": _transducers(run),
        "frequency": f"{run.setup.scene.frequency / 1e3:g} kHz",
        "foci": counted(len(run.setup.foci), "focus", "foci"),
        "stand": "stands" if len(run.setup.foci) == 1 else "stand",
        "where": f"beside {_and(run.setup.bodies)}, which {scatter} the sound"
        if run.setup.bodies
        else "in open air",
        "facts": [
            (f"{pascals(run.pressures.min())}", "at the weakest focus"),
            (f"{solve:.2f} s", "to solve and make the drive"),
            (
                _percent(run.verification.report.estimated_error),
                "estimated error of these pressures",
            ),
        ],
        "warnings": list(dict.fromkeys(run.warnings)),
    }


def _transducers(run: Rendering) -> str:
    return counted(len(run.setup.array), "transducer", "transducers")


def _pictures(run: Rendering, fields: Fields) -> dict[str, Any]:
    phases = picture(
        draw_phases(run.setup.array.positions, run.setup.array.normals, run.drive.amplitudes),
        f"Phase and amplitude, of full scale, of each transducer by {run.method}, each face as seen from the side that "
        "it radiates to, in the order in which a viewer inside who turns to the right sees them (compare Fig. 5 of the "
        "paper). Phases "
        f"are those of Re[u e^(−iωt)]. Rounded to {len(run.frame.levels.amplitudes)} levels of amplitude and "
        f"{run.frame.levels.phases} of phase (drive.csv) they change the pressure at the foci by {_rounding(run):.2%} "
        "at most.",
        f"Phases and amplitudes of all {_transducers(run)}, face by face",
        wide=True,
    )
    bodies = [obstacle.surface for obstacle in run.setup.scene.obstacles]
    still = picture(
        draw_scene(
            run.setup.array.positions,
            run.setup.array.normals,
            run.drive.amplitudes,
            bodies,
            run.setup.target.points,
            run.setup.scene.planes,
        ),
        "Transducers coloured by phase, bodies in grey, foci in orange. Transducers that face away from the viewer are "
        "faint rings.",
        viewer_alternative(fields.view),
    )
    return {"fields": _fields(run, fields), "phases": phases, "still": still, "doubt": _doubt(run)}


def _doubt(run: Rendering) -> list[Markup]:
    """Draw what the drive keeps where the hand is not as expected: over samples, and by shifts of the hand."""
    doubt = run.robustness
    if doubt is None or not isinstance(run.transfer, TransferEnsemble):
        return []
    off = run.transfer.uncertainty.shift
    count = counted(doubt.pressures.shape[1], "sample", "samples")
    shares = picture(
        draw_shares(
            dict(zip(doubt.names, doubt.pressures, strict=True)),
            dict(zip(doubt.names, doubt.expected, strict=True)),
        ),
        f"Share of {count} of what is in doubt in which the weakest focus gets less than a pressure; no drive was made "
        "for them. Dots: what is expected with nothing in doubt. All at equal energy.",
        "; ".join(
            f"{name}: at least {low:.0f} Pa 9 of 10 times"
            for name, low in zip(doubt.names, doubt.lowest_tenth, strict=True)
        ),
    )
    ring = f" The ring is one standard deviation, {1e3 * off:.3g} mm." * bool(off)
    shifts = picture(
        draw_shifts(doubt.maps, doubt.names, off),
        "What the weakest focus gets where the hand as a whole is shifted: along the plane of the foci (above) and at "
        f"right angles to it (below). All at equal energy.{ring}",
        "; ".join(
            f"{name}: {_rounded(low)} to {_rounded(high)} Pa"
            for name, low, high in zip(
                doubt.names,
                np.nanmin([shift_map.pressures for shift_map in doubt.maps], axis=(0, 2)),
                np.nanmax([shift_map.pressures for shift_map in doubt.maps], axis=(0, 2)),
                strict=True,
            )
        ),
        wide=True,
    )
    return [shares, shifts]


def _fields(run: Rendering, fields: Fields) -> list[Markup]:
    """Draw both drives and their difference: in the plane through the foci, or across each focus of a hand."""
    names = run.verification.names
    most = fields.view.most
    points = run.setup.target.points
    got = fields.view.reached
    error = max(cut.error for cut in (fields.close_ups or [fields.plane]))
    estimate = (
        f" The pressures there are estimated to be {100 * error:.1g} % off." if error > 0.0 else ""
    )
    if fields.close_ups:
        changes = zip(run.setup.foci, 20.0 * np.log10(got[:, 0] / got[:, 1]), strict=True)
        return [
            picture(
                draw_close_ups(fields.close_ups, run.setup.foci, most),
                f"Across each focus, at right angles to the surface, which lies below it.{estimate}",
                f"Maps around each focus, up to {_rounded(most)} Pa; {names[0]} over {names[1]} in dB: "
                + ", ".join(f"{name} {change:+.1f}" for name, change in changes),
                wide=True,
            )
        ]
    off = 1e3 * np.abs(fields.plane.window.height_of(points)).max()
    plane = "Plane through the foci."
    if off >= 0.5:
        plane = f"Plane nearest to the foci, which are up to {off:.1f} mm off it; those off it are dashed."
    panels = [
        picture(
            draw_field(fields.plane, name, most, points, run.setup.foci),
            f"{name.capitalize()}. {plane}{estimate}",
            f"Map of pressure, {name}: {_rounded(some.min())} to {_rounded(some.max())} Pa at the foci",
        )
        for name, some in zip(names, got.T, strict=True)
    ]
    if len(names) == 1:
        return panels
    change = 20.0 * np.log10(got[:, 0] / got[:, 1])
    difference = picture(
        draw_difference(fields.plane, (names[0], names[1]), most, points, run.setup.foci),
        f"Red: more with {names[0]}. Grey: less than {FAINT:.0%} of the largest pressure in both.",
        f"Map of the difference in dB: {change.min():+.1f} to {change.max():+.1f} dB at the foci",
    )
    return [*panels, difference]


def _rounding(run: Rendering) -> float:
    """Largest relative change of the pressure at a focus that rounding to levels makes."""
    exact, rounded = (
        np.abs(run.transfer.pressure(drive))[: len(run.setup.foci)]
        for drive in (run.drive, run.frame.drive())
    )
    return float(np.max(np.abs(rounded / exact - 1)))


def _foci(run: Rendering) -> dict[str, Any]:
    depths = -1e3 * run.setup.scene.depth(run.setup.target.points)
    asked = run.setup.target.pressures
    rows = []
    for index, (name, point, got) in enumerate(
        zip(run.setup.foci, 1e3 * run.setup.target.points, run.pressures, strict=True)
    ):
        wanted = (
            ["as strong as possible", "–"]
            if asked is None
            else [_pascal(asked[index]), _share(got, asked[index])]
        )
        position = [f"{number:.2f}" for number in point]
        rows.append(
            [
                name,
                *position,
                f"{depths[index]:.2f}",
                *wanted,
                _pascal(got),
                _kilopascal_squared(got),
            ]
        )
    axes = ["x [mm]", "y [mm]", "z [mm]"]
    return {
        "focus_header": [
            "focus",
            *axes,
            "off the surface [mm]",
            "asked [Pa]",
            "reached",
            "p [Pa]",
            "p² [kPa²]",
        ],
        "focus_rows": rows,
        "amplitude": f"{run.drive.peak:.2f}",
        "comparisons": [
            (f"{held_equal.capitalize()}: {meaning}", *_comparison(run, held_equal))
            for held_equal, meaning in HELD_EQUAL.items()
            if run.setup.bodies
        ],
    }


def _comparison(run: Rendering, held_equal: str) -> tuple[list[str], list[list[str]]]:
    """Header and rows of what each focus gets from both drives, and how many times as much from the first."""
    pressures = run.verification.pressures[held_equal]
    ratios = run.verification.ratios(held_equal)
    rows = []
    for index, name in enumerate(run.setup.foci):
        first, second = pressures[:, index]
        squares = _kilopascal_squared(first), _kilopascal_squared(second)
        with np.errstate(divide="ignore"):  # the second may give it nothing
            times = 1.0 / ratios[1, index]
        rows.append(
            [name, _pascal(first), _pascal(second), f"{times:.3f}", *squares, f"{times**2:.3f}"]
        )
    pressure, squared = (
        [quantity.format(name) for name in run.verification.names]
        for quantity in ("p {} [Pa]", "p² {} [kPa²]")
    )
    return ["focus", *pressure, "times p", *squared, "times p²"], rows


def _how(run: Rendering, seconds: Mapping[str, float]) -> dict[str, Any]:
    medium = run.setup.scene.medium
    scene = run.setup.scene
    reports = (run.beacons, run.verification.report)
    pairs = list(zip(run.setup.bodies, scene.obstacles, strict=True))
    repairs = " ".join(
        f"{name}: {note}" for name, obstacle in pairs for note in obstacle.surface.repairs
    )
    return {
        "report_rows": [
            ["solver", *(report.solver for report in reports)],
            ["settings", *(_listed(report.settings) for report in reports)],
            ["unknowns", *(f"{report.nodes:,}" for report in reports)],
            [
                "unknowns per λ²",
                *(f"{report.nodes_per_square_wavelength:.0f}" for report in reports),
            ],
            [
                "iterations, residual",
                *(f"{report.iterations}, {report.residual:.1e}" for report in reports),
            ],
            ["estimated error", *(_percent(report.estimated_error) for report in reports)],
            ["panels off the triangles given", *(_off_triangles(report) for report in reports)],
            [
                "seconds",
                *(
                    _listed({name: f"{t:.2f}" for name, t in report.seconds.items()})
                    for report in reports
                ),
            ],
        ],
        "setting_rows": [
            [
                "medium",
                f"{medium.sound_speed:g} m/s, {medium.density:g} kg/m³, absorption {medium.absorption:g} Np/m",
            ],
            ["frequency", f"{scene.frequency:g} Hz, wavelength {1e3 * scene.wavelength:.2f} mm"],
            ["bodies", ", ".join(_body(*pair) for pair in pairs)],
            *([["rigid planes", ", ".join(map(_plane, scene.planes))]] if scene.planes else []),
            ["repaired", repairs or "nothing"],
            [
                "array",
                f"{_transducers(run)} of {run.setup.array.element.sensitivity:g} Pa·m (peak, uncalibrated)",
            ],
            ["pattern", run.setup.array.element.pattern_in_words(scene.wavenumber.real)],
            ["not in the model", not_modelled(run.verification.report)],
            ["wall time", _listed({name: f"{time:.2f} s" for name, time in seconds.items()})],
        ],
        "citations": list(
            dict.fromkeys([CITATION, *run.beacons.citations, *run.verification.report.citations])
        ),
    }


def _body(name: str, obstacle: Obstacle) -> str:
    return f"{name} ({obstacle.kind}, {1e4 * obstacle.surface.area:.1f} cm²)"


def _plane(plane: Plane) -> str:
    return f"through {in_mm(plane.point)} with the normal {np.round(plane.normal, 3) + 0.0}"


def _off_triangles(report: SolveReport) -> str:
    farthest = 1e3 * report.farthest_off_triangles
    mean = 1e3 * report.mean_off_triangles
    return (
        f"{farthest:.2g} mm at most, {mean:.2g} mm in the mean"
        if farthest > 1e-4
        else "under 0.1 µm"
    )


def _listed(facts: Mapping[str, object]) -> str:
    return ", ".join(f"{name.replace('_', ' ')} {_short(value)}" for name, value in facts.items())


def _short(value: object) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def _pascal(pressure: float) -> str:
    return f"{pressure:,.0f}" if pressure >= 100 else f"{pressure:.1f}"


def _percent(share: float) -> str:
    return f"{share:.2%}" if share >= 1e-4 else "< 0.01%"


def _and(names: Sequence[str]) -> str:
    return " and ".join(part for part in (", ".join(names[:-1]), names[-1]) if part)


def _rounded(pressure: float) -> str:
    """Three digits, which is what the computation is good for."""
    return f"{float(f'{pressure:.3g}'):,g}"


def _kilopascal_squared(pressure: float) -> str:
    square = (pressure / 1e3) ** 2
    return (
        f"{square:.3f}" if square < 10 else f"{square:.1f}" if square < 1000 else f"{square:,.0f}"
    )


def _share(got: float, asked: float) -> str:
    return f"{got / asked:.1%}" if asked > 0 else "–"
