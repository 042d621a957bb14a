"""``airtact check``: what is in a scene or a surface, or what is wrong with it."""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from rich.markup import escape

import airtact as at
from airtact.cli.console import (
    facts_table,
    plain_table,
    progress,
    repairs_table,
    sharp_edges_in_words,
    show,
)
from airtact.cli.options import FILE, INPUT, as_json, given, quiet, surface_settings

if TYPE_CHECKING:
    from rich.table import Table

    from airtact.acoustics.planes import Plane
    from airtact.acoustics.scene import Scene
    from airtact.live.session import Session
    from airtact.live.verification import VerifiedSession
    from airtact.setup.setup import Setup


@click.command(
    short_help="Report what is in a scene, a surface or a session, or what is wrong with it.",
    epilog="Example: airtact check pinch",
)
@click.argument("scene", metavar="SCENE_OR_SURFACE_OR_SESSION", type=INPUT)
@click.option("--drives", type=int, help="Drives of a session that are solved; 10 by default.")
@click.option("--out", "folder", type=FILE, help="Folder for a picture of the bodies or the fault.")
@surface_settings
@as_json
@quiet
def check(scene: Path, drives: int | None, folder: Path | None, **settings: float | None) -> None:
    """Read a scene file or a surface file (STL, PLY, OBJ, GLB) and report what is in it, or what is wrong with it.

    Of a session of airtact live (session.h5, or its folder), drives spread over it are held against
    the whole hand that was there when they were in the air, some seconds each. With --out a picture
    of the bodies is written, or of the position of the fault where the input is rejected.
    """
    if _checked_session(scene, drives, **given(folder=folder, **settings)):
        return
    with progress() as report_step:
        from airtact.acoustics.scene import Scene
        from airtact.workflows import check as workflow

        checked = workflow.check(scene, folder, report_step, **given(**settings))
        report_step("counting unknowns")
        if isinstance(checked, Scene):
            counts = workflow.unknowns_by_accuracy(checked)
            tables, record, cautions = (
                list(_surface_tables(scene.name, checked, counts)),
                _surface_record(checked, counts),
                (),
            )
        else:
            count = workflow.unknowns_of_scene(checked)
            tables, record = list(_scene_tables(checked, count)), _scene_record(checked, count)
            report_step(
                f"looking which foci the array reaches, {len(checked.target.points):,} of them"
            )
            cautions = workflow.reach_cautions(checked)
    show(*tables, warnings=cautions, record=record)


def _checked_session(path: Path, drives: int | None, **others: Path | float) -> bool:
    """Hold a session against the hand that was there, and print it; return False for all that is no session."""
    if path.suffix != ".h5" and not path.is_dir():
        if drives is not None:
            sentence = f"--drives {drives} is for a session, and {path.name} is none: leave it out."
            raise at.InvalidInput(sentence, code="options_clash")
        return False
    if others:
        sentence = (
            f"{path.name} is a session, and {len(others)} option of a scene or a surface is given"
        )
        raise at.InvalidInput(
            f"{sentence}: leave --{next(iter(others))} out.", code="options_clash"
        )
    with progress() as report_step:
        report_step("starting")
        from airtact.workflows.check import check_session

        session, found = check_session(path, **given(drives=drives), report_step=report_step)
    show(*_session_tables(session, found), record=_session_record(session, found))
    return True


def _session_tables(session: "Session", found: "VerifiedSession") -> "Iterator[Table]":
    """Tabulate what is in a session, and what its drives gave the hand that was there."""
    times = session.time_in_air
    facts = [
        ("frames", f"{len(session.frame_time):,}"),
        ("drives", f"{len(times):,} in {times[-1] - times[0]:.1f} s"),
    ]
    facts.append(("foci", ", ".join(session.scene.places)))
    rest = f"{len(found.kept)} of {int(session.playing.sum()):,} that play"
    facts.append(("held against the hand that was there", rest))
    facts.append(
        (
            "kept of the attainable pressure",
            f"{found.median:.0%}, nine of ten over {found.lowest_tenth:.0%}",
        )
    )
    yield facts_table(facts)
    table = plain_table("in the air at", "made from", "weakest focus gets", "kept", "expected")
    for time, rule, pressures, kept, expected in zip(
        found.times, found.rules, found.pressures, found.kept, found.expected, strict=True
    ):
        said = "–" if math.isnan(expected) else f"{expected:.0%}"
        table.add_row(
            f"{time - times[0]:.2f} s", rule, f"{pressures.min():,.0f} Pa", f"{kept:.0%}", said
        )
    yield table


def _session_record(session: "Session", found: "VerifiedSession") -> dict[str, Any]:
    """List what the drives of a session gave the hand that was there, for ``--json``."""
    rows = zip(
        found.indices,
        found.times,
        found.rules,
        found.pressures,
        found.kept,
        found.expected,
        strict=True,
    )
    verified = [
        {
            "index": index,
            "time": float(time),
            "rule": rule,
            "pressures": pressures.tolist(),
            "kept": float(kept),
            "expected": None if math.isnan(expected) else float(expected),
        }
        for index, time, rule, pressures, kept, expected in rows
    ]
    counts = {"frames": len(session.frame_time), "drives": len(session.time_in_air)}
    return {
        **counts,
        "median": found.median,
        "lowest_tenth": found.lowest_tenth,
        "verified": verified,
    }


def _scene_record(setup: "Setup", unknowns: int | None) -> dict[str, Any]:
    """List what is in a scene, for ``--json``."""
    target = setup.target
    asked = [None] * len(setup.foci) if target.pressures is None else target.pressures.tolist()
    rows = zip(
        setup.foci,
        target.points.tolist(),
        asked,
        (-setup.scene.depth(target.points)).tolist(),
        strict=True,
    )
    keys = ("name", "position", "asked", "off_the_surface")
    return {
        "bodies": [
            {"name": name, "boundary": one.boundary, **_size(one.surface)}
            for name, one in zip(setup.bodies, setup.scene.obstacles, strict=True)
        ],
        "foci": [dict(zip(keys, row, strict=True)) for row in rows],
        "planes": [
            {"point": one.point.tolist(), "normal": one.normal.tolist()}
            for one in setup.scene.planes
        ],
        "transducers": len(setup.array),
        "suppression_points": len(target.suppression_points),
        "frequency": setup.scene.frequency,
        "wavelength": setup.scene.wavelength,
        "method": setup.method,
        "accuracy": setup.accuracy,
        "unknowns": unknowns,
    }


def _surface_record(scene: "Scene", unknowns: dict[float, int]) -> dict[str, Any]:
    """List what is in a surface, for ``--json``."""
    counts = {f"{accuracy:g}": count for accuracy, count in unknowns.items()}
    return {"surface": _size(scene.obstacles[0].surface), "unknowns": counts}


def _size(surface: "at.Surface") -> dict[str, Any]:
    facts = {"triangles": len(surface.triangles), "area": surface.area, "volume": surface.volume}
    return {**facts, "repairs": list(surface.repairs)}


def _scene_tables(setup: "Setup", unknowns: int | None) -> "Iterator[Table]":
    """Tabulate the bodies, the foci, and what solving takes."""
    from airtact.checks import in_mm

    wavelength = setup.scene.wavelength
    bodies = plain_table("bodies", "boundary", "triangles", "area")
    surfaces = {
        name: one.surface for name, one in zip(setup.bodies, setup.scene.obstacles, strict=True)
    }
    for (name, surface), obstacle in zip(surfaces.items(), setup.scene.obstacles, strict=True):
        size = f"{1e4 * surface.area:.1f} cm² = {surface.area / wavelength**2:.0f} λ²"
        bodies.add_row(escape(name), obstacle.kind, f"{len(surface.triangles):,}", size)
    if surfaces:
        yield bodies
    yield from (
        repairs_table(surface, name) for name, surface in surfaces.items() if surface.repairs
    )
    yield _foci_table(setup)
    elements = setup.array
    clearance = -setup.scene.depth(elements.positions).max()
    facts = plain_table()
    away = f", {1e3 * clearance:.0f} mm off the bodies or more" if surfaces else ""
    away = ", in the faces of boards that reflect" if setup.scene.boards else away
    sensitivity = f"{elements.element.sensitivity:g} Pa·m, uncalibrated"
    facts.add_row("transducers", f"{len(elements)}, {sensitivity}{away}")
    facts.add_row("pattern", elements.element.pattern_in_words(setup.scene.wavenumber.real))
    for one in setup.scene.planes:
        facts.add_row(
            "rigid plane",
            f"through {in_mm(one.point)}, the nearest focus {_height(one, setup)} before it",
        )
    if len(setup.target.suppression_points):
        facts.add_row("suppression points", f"{len(setup.target.suppression_points)}")
    facts.add_row("wavelength", f"{1e3 * wavelength:.2f} mm at {setup.scene.frequency / 1e3:g} kHz")
    facts.add_row("drive", f"{setup.method.replace('_', ' ')}, accuracy {setup.accuracy:g}")
    if unknowns is not None:
        facts.add_row(
            "unknowns", f"{unknowns:,}, about {_memory(unknowns, setup.accuracy)} to solve"
        )
    yield facts


def _height(plane: "Plane", setup: "Setup") -> str:
    return f"{1e3 * plane.height(setup.target.points).min():.3g} mm"


def _foci_table(setup: "Setup") -> "Table":
    table = plain_table("foci", "x", "y", "z", "off the surface", "pressure")
    asked = setup.target.pressures
    distances = -setup.scene.depth(setup.target.points)
    for index, (name, point) in enumerate(zip(setup.foci, setup.target.points, strict=True)):
        wanted = "strongest" if asked is None else f"{asked[index]:g} Pa"
        position = [f"{1e3 * number:.2f} mm" for number in point]
        table.add_row(
            escape(name),
            *position,
            f"{1e3 * distances[index]:.3g} mm" if setup.bodies else "–",
            wanted,
        )
    return table


def _surface_tables(name: str, scene: "Scene", counts: dict[float, int]) -> "Iterator[Table]":
    """Tabulate what is in a surface, what was repaired, and what solving it takes."""
    import numpy as np

    from airtact.geometry.mesh.topology import shells

    surface = scene.obstacles[0].surface
    pieces = int(shells(surface.triangles).max()) + 1
    facts = plain_table()
    closed = f"{pieces} closed {'piece' if pieces == 1 else 'pieces'}"
    facts.add_row("accepted", f"{name}: {len(surface.triangles):,} triangles, {closed}")
    sides = " x ".join(f"{1e3 * side:.4g}" for side in np.ptp(surface.vertices, axis=0))
    facts.add_row("extent", f"{sides} mm along x, y, z")
    facts.add_row(
        "area",
        f"{1e4 * surface.area:.4g} cm² = {surface.area / scene.wavelength**2:.3g} λ² at 40 kHz",
    )
    facts.add_row("volume", f"{1e6 * surface.volume:.4g} cm³")
    facts.add_row("sharp edges", sharp_edges_in_words(surface))
    for accuracy, unknowns in counts.items():
        facts.add_row(
            f"accuracy {accuracy:g}",
            f"{unknowns:,} unknowns, about {_memory(unknowns, accuracy)} to solve",
        )
    yield facts
    yield repairs_table(surface)


def _memory(unknowns: float, accuracy: float) -> str:
    """Return how much memory the process takes to solve, in words."""
    from airtact.workflows.check import memory_of_a_solve

    size = memory_of_a_solve(unknowns, accuracy)
    return f"{size / 1e9:.1f} GB" if size > 1e9 else f"{math.ceil(size / 1e7) * 10} MB"
