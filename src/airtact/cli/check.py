"""``airtact check``: report the contents of a scene or a surface, or its first error."""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
from rich.markup import escape
from rich.table import Table

import airtact as at
from airtact.cli.console import (
    facts_table,
    plain_table,
    progress,
    repairs_table,
    sharp_edges_in_words,
    show,
)
from airtact.cli.options import (
    FILE,
    INPUT,
    as_json,
    given,
    quiet,
    scene_here,
    surface_settings,
)
from airtact.timing import Progress


@click.command(
    short_help="Report the contents of a scene or a surface, or its first error.",
    epilog="Example: airtact check pinch",
)
@click.argument(
    "scene",
    metavar="[SCENE_OR_SURFACE]",
    type=INPUT,
    default="scene.toml",
    callback=scene_here,
)
@click.option("--out", "folder", type=FILE, help="Folder for a picture of the bodies.")
@surface_settings
@as_json
@quiet
def check(scene: Path, folder: Path | None, **settings: Any) -> None:
    """Report the contents of a scene or surface file (STL, PLY, OBJ, GLB), or its first error.

    --out writes a picture of the bodies.
    """
    chosen = given(**settings)
    with progress() as report_step:
        from airtact.files.meshes import SUFFIXES

        if scene.suffix.lower() in SUFFIXES:
            tables, cautions, record = _check_surface(scene, folder, report_step, chosen)
        else:
            # Within a scene file, each surface has its own settings.
            for key, value in chosen.items():
                raise at.InvalidInput(
                    f"{key} = {value} on the command line only applies to surface files: set it in "
                    "the scene file.",
                    code="options_clash",
                )
            tables, cautions, record = _check_scene(scene, folder, report_step)
    show(*tables, warnings=cautions, record=record)


# Tables, warnings and the record for ``--json``
Shown = tuple[list[Table], tuple[str, ...], dict[str, Any]]


def _check_scene(path: Path, folder: Path | None, report_step: Progress) -> Shown:
    from airtact.setup.sentences import facing_away, reach_cautions
    from airtact.setup.solving import unknowns_of

    report_step(f"reading {path.name}")
    setup = at.read_scene(path, moving=True)
    if folder is not None:
        _draw_bodies(folder, setup.scene, setup.bodies, setup.target.points, report_step)
    report_step("counting unknowns")
    unknowns = (
        unknowns_of(setup.solver, setup.scene, setup.target.points)
        if isinstance(setup.solver, at.BoundaryElement)
        else None
    )
    report_step(f"checking which of {len(setup.target.points):,} foci the array reaches")
    cautions = [*reach_cautions(setup), *facing_away(setup)]
    if setup.contacts is not None and not len(setup.contacts):
        cautions.append(
            "no body touches an object in this pose. airtact live creates foci as soon as a hand "
            "touches one; airtact render requires a contact."
        )
    target = setup.target
    requested = [None] * len(setup.foci) if target.pressures is None else target.pressures.tolist()
    distances = -setup.scene.depth(target.points)
    record = {
        "bodies": [
            {"name": name, "boundary": obstacle.boundary, **_size(obstacle.surface)}
            for name, obstacle in zip(setup.bodies, setup.scene.obstacles, strict=True)
        ],
        "foci": [
            {
                "name": name,
                "position": target.points[index].tolist(),
                "asked": requested[index],
                "off_the_surface": float(distances[index]),
            }
            for index, name in enumerate(setup.foci)
        ],
        "planes": [
            {"point": plane.point.tolist(), "normal": plane.normal.tolist()}
            for plane in setup.scene.planes
        ],
        "transducers": len(setup.array),
        "suppression_points": len(target.suppression_points),
        "frequency": setup.scene.frequency,
        "wavelength": setup.scene.wavelength,
        "method": setup.method,
        "accuracy": setup.accuracy,
        "unknowns": unknowns,
    }
    return list(_scene_tables(setup, unknowns)), tuple(cautions), record


def _check_surface(
    path: Path, folder: Path | None, report_step: Progress, settings: dict[str, Any]
) -> Shown:
    import numpy as np

    from airtact.errors import about, counted
    from airtact.geometry.mesh.triangles import shells
    from airtact.setup.solving import unknowns_of

    surface = at.load_surface(path, **settings, progress=report_step)
    # Treat the surface as a sound-hard body in a scene at 40 kHz.
    with about(path.name):
        scene = at.Scene(at.air(), [at.sound_hard(surface)])
    if folder is not None:
        _draw_bodies(folder, scene, [path.name], None, report_step)
    report_step("counting unknowns")
    # Panels are smaller near foci; with a distant focus they keep their usual size.
    distant = surface.vertices.min(axis=0)[None] - 1.0
    pieces = counted(int(shells(surface.triangles).max()) + 1, "closed piece", "closed pieces")
    extent = " x ".join(f"{1e3 * side:.4g}" for side in np.ptp(surface.vertices, axis=0))
    facts = [
        ("accepted", f"{path.name}: {len(surface.triangles):,} triangles, {pieces}"),
        ("extent", f"{extent} mm along x, y, z"),
        (
            "area",
            f"{1e4 * surface.area:.4g} cm² = {surface.area / scene.wavelength**2:.3g} λ² at 40 kHz",
        ),
        ("volume", f"{1e6 * surface.volume:.4g} cm³"),
        ("sharp edges", sharp_edges_in_words(surface)),
    ]
    unknowns = {}
    # The default accuracy, and that of a preview
    for accuracy in (0.01, 0.03):
        count = unknowns_of(at.BoundaryElement(accuracy=accuracy), scene, distant)
        unknowns[f"{accuracy:g}"] = count
        facts.append(
            (
                f"accuracy {accuracy:g}",
                f"{count:,} unknowns, about {_memory(count, accuracy)} to solve",
            )
        )
    return (
        [facts_table(facts), repairs_table(surface)],
        (),
        {"surface": _size(surface), "unknowns": unknowns},
    )


def _draw_bodies(
    folder: Path, scene: "at.Scene", names: Any, foci: Any, report_step: Progress
) -> None:
    from airtact.files.atomic import writable_folder
    from airtact.reports.body_figure import draw_bodies
    from airtact.reports.page import write_picture

    picture = writable_folder(folder) / "bodies.png"
    report_step(f"drawing {picture}")
    surfaces = [obstacle.surface for obstacle in scene.obstacles]
    write_picture(picture, draw_bodies(surfaces, names, foci, scene.planes))


def _size(surface: "at.Surface") -> dict[str, Any]:
    return {
        "triangles": len(surface.triangles),
        "area": surface.area,
        "volume": surface.volume,
        "repairs": list(surface.repairs),
    }


def _scene_tables(setup: "at.Setup", unknowns: int | None) -> Iterator[Table]:
    from airtact.errors import in_mm, millimetres

    scene = setup.scene
    named = dict(zip(setup.bodies, scene.obstacles, strict=True))
    if named:
        bodies = plain_table("bodies", "boundary", "triangles", "area")
        for name, obstacle in named.items():
            surface = obstacle.surface
            bodies.add_row(
                escape(name),
                obstacle.kind,
                f"{len(surface.triangles):,}",
                f"{1e4 * surface.area:.1f} cm² = {surface.area / scene.wavelength**2:.0f} λ²",
            )
        yield bodies
    for name, obstacle in named.items():
        if obstacle.surface.repairs:
            yield repairs_table(obstacle.surface, name)
    foci = plain_table("foci", "x", "y", "z", "distance from surface", "pressure")
    requested = setup.target.pressures
    distances = -scene.depth(setup.target.points)
    for index, (name, point) in enumerate(zip(setup.foci, setup.target.points, strict=True)):
        foci.add_row(
            escape(name),
            *(f"{1e3 * number:z.2f} mm" for number in point),
            millimetres(distances[index], 3) if setup.bodies else "–",
            "strongest" if requested is None else f"{requested[index]:g} Pa",
        )
    yield foci
    array = setup.array
    if scene.boards:
        away = ", in reflecting boards"
    elif named:
        away = f", at least {-1e3 * scene.depth(array.positions).max():.0f} mm from the bodies"
    else:
        away = ""
    facts = [
        (
            "transducers",
            f"{len(array)}, {array.element.sensitivity:g} Pa·m, uncalibrated{away}",
        ),
        ("pattern", array.element.pattern_in_words(scene.wavenumber.real)),
    ]
    if setup.objects:
        facts.append(("virtual objects", ", ".join(item.name for item in setup.objects)))
    for plane in scene.planes:
        height = 1e3 * plane.height(setup.target.points).min()
        facts.append(
            (
                "rigid plane",
                f"through {in_mm(plane.point)}, {height:.3g} mm from the nearest focus",
            )
        )
    if len(setup.target.suppression_points):
        facts.append(("suppression points", f"{len(setup.target.suppression_points)}"))
    facts += [
        ("wavelength", f"{1e3 * scene.wavelength:.2f} mm at {scene.frequency / 1e3:g} kHz"),
        ("drive", f"{setup.method.replace('_', ' ')}, accuracy {setup.accuracy:g}"),
    ]
    if unknowns is not None:
        facts.append(
            ("unknowns", f"{unknowns:,}, about {_memory(unknowns, setup.accuracy)} to solve")
        )
    yield facts_table(facts)


def _memory(unknowns: float, accuracy: float) -> str:
    from airtact.setup.solving import memory_of_a_solve

    size = memory_of_a_solve(unknowns, accuracy)
    return f"{size / 1e9:.1f} GB" if size > 1e9 else f"{math.ceil(size / 1e7) * 10} MB"
