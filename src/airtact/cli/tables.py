"""What the command line prints, as tables of rich."""

import math
from collections.abc import Iterator

import numpy as np
from rich.markup import escape
from rich.table import Table

from airtact.cli.console import plain_table
from airtact.figures.body_figure import sharp_edges
from airtact.mesh.topology import shells
from airtact.pages.methods_page import Contest
from airtact.pages.run_page import Run
from airtact.scene.scene import Scene
from airtact.scene_file.building import Setup
from airtact.solvers.bem.solver import BoundaryElement
from airtact.surfaces.surface import Surface
from airtact.workflows.check import unknowns_by_accuracy
from airtact.workflows.compare_scan import Compared
from airtact.workflows.mesh import Meshed


def scene_tables(setup: Setup) -> Iterator[Table]:
    """Tables of the bodies, the foci, and what solving takes."""
    wavelength = setup.scene.wavelength
    bodies = plain_table("bodies", "boundary", "triangles", "area")
    for name, obstacle in zip(setup.bodies, setup.scene.obstacles, strict=True):
        surface = obstacle.surface
        size = f"{1e4 * surface.area:.1f} cm² = {surface.area / wavelength**2:.0f} λ²"
        bodies.add_row(escape(name), obstacle.boundary.replace("_", "-"), f"{len(surface.triangles):,}", size)
    if setup.bodies:
        yield bodies
    notes = [(name, one.surface) for name, one in zip(setup.bodies, setup.scene.obstacles, strict=True)]
    yield from (_mended(surface, name) for name, surface in notes if surface.repairs)
    foci = plain_table("foci", "x", "y", "z", "off the skin", "pressure")
    asked = setup.target.pressures
    off_skin = -setup.scene.depth(setup.target.points)
    for index, (name, point) in enumerate(zip(setup.foci, setup.target.points, strict=True)):
        wanted = "strongest" if asked is None else f"{asked[index]:g} Pa"
        place = [f"{1e3 * number:.2f} mm" for number in point]
        foci.add_row(escape(name), *place, f"{1e3 * off_skin[index]:.3g} mm" if setup.bodies else "–", wanted)
    yield foci
    elements = setup.array
    clearance = -setup.scene.depth(elements.positions).max()
    facts = plain_table("", "")
    sensitivity = f"{elements.element.sensitivity:g} Pa·m, uncalibrated"
    away = f", {1e3 * clearance:.0f} mm off the bodies or more" if setup.bodies else ""
    facts.add_row("transducers", f"{len(elements)}, {sensitivity}{away}")
    if len(setup.target.suppression_points):
        facts.add_row("suppression points", f"{len(setup.target.suppression_points)}")
    facts.add_row("wavelength", f"{1e3 * wavelength:.2f} mm at {setup.scene.frequency / 1e3:g} kHz")
    facts.add_row("drive", f"{setup.method.replace('_', ' ')}, accuracy {setup.accuracy:g}")
    if isinstance(setup.solver, BoundaryElement):
        unknowns = setup.solver.unknowns(setup.scene, setup.target.beacons())
        facts.add_row("unknowns", f"{unknowns:,}, matrix {_memory(unknowns)}")
    yield facts


def surface_tables(name: str, scene: Scene) -> Iterator[Table]:
    """Tables of what is in a surface, what was mended, and what solving it takes."""
    surface = scene.obstacles[0].surface
    pieces = int(shells(surface.triangles).max()) + 1
    facts = plain_table("", "")
    facts.add_row("accepted", f"{name}: {len(surface.triangles):,} triangles, {_pieces(pieces)}")
    facts.add_row("extent", f"{_sides(surface)} mm along x, y, z")
    facts.add_row("area", f"{1e4 * surface.area:.4g} cm² = {surface.area / scene.wavelength**2:.3g} λ² at 40 kHz")
    facts.add_row("volume", f"{1e6 * surface.volume:.4g} cm³")
    facts.add_row("sharp edges", _sharp(surface))
    for accuracy, unknowns in unknowns_by_accuracy(scene).items():
        facts.add_row(f"accuracy {accuracy:g}", f"{unknowns:,} unknowns, matrix {_memory(unknowns)}")
    yield facts
    yield _mended(surface)


def quality_tables(meshed: Meshed) -> Iterator[Table]:
    """Tables of panels beside the triangles that they were made from."""
    sizes = plain_table("", "given", "panels")
    sizes.add_row(
        "triangles, panels", f"{len(meshed.surface.triangles):,}", f"{len(meshed.panels.quadratic_triangles):,}"
    )
    sizes.add_row("area", f"{1e4 * meshed.given_area:.4g} cm²", f"{1e4 * meshed.area:.4g} cm²")
    sizes.add_row("volume", f"{1e6 * meshed.given_volume:.4g} cm³", f"{1e6 * meshed.volume:.4g} cm³")
    yield sizes
    worst, first = meshed.angles
    facts = plain_table("", "")
    facts.add_row("smallest angle", f"{worst:.1f}°, 1 of 100 panels below {first:.1f}°")
    facts.add_row("edge", f"{1e3 * meshed.edge:.3g} mm asked, the longest has {1e3 * meshed.longest_edge:.3g} mm")
    panels = meshed.panels
    farthest, mean = _gap(panels.farthest.max()), _gap(panels.mean_distance.max())
    facts.add_row("off the triangles given", f"{farthest} at most, {mean} in the mean")
    facts.add_row("off the curved skin", f"{_gap(panels.deviation.max())} at most")
    facts.add_row("sharp edges", _sharp(meshed.surface))
    if meshed.open_edges:
        facts.add_row("open edges", f"{meshed.open_edges} in {meshed.file.name}: its triangles are not quite closed")
    yield facts
    yield _mended(meshed.surface)


def _mended(surface: Surface, name: str = "") -> Table:
    table = plain_table("", "")
    for index, note in enumerate(surface.repairs or ("nothing",)):
        table.add_row(escape(f"mended in {name}" if name else "mended") if index == 0 else "", escape(note))
    return table


def _gap(distance: float) -> str:
    return f"{1e3 * distance:.2g} mm" if distance >= 1e-7 else "under 0.1 µm"


def _pieces(count: int) -> str:
    return f"{count} closed {'piece' if count == 1 else 'pieces'}"


def _sides(surface: Surface) -> str:
    spans = surface.vertices.max(axis=0) - surface.vertices.min(axis=0)
    return " x ".join(f"{1e3 * span:.4g}" for span in spans)


def _sharp(surface: Surface) -> str:
    sharp = sharp_edges(surface)
    length = 1e3 * surface.edge_lengths[sharp].sum() / 2
    count = int(sharp.sum()) // 2
    if count == 0:
        return f"none turns by over {surface.sharp_degrees:g}°"
    return f"{count:,}, {length:.4g} mm together, that turn by over {surface.sharp_degrees:g}° or end a flat cap"


def run_table(run: Run) -> Table:
    """Tabulate what each focus gets, with the hand considered and ignored."""
    ratios = {name: run.comparison.ratios(name)[1] for name in run.comparison.pressures}
    table = plain_table("focus", "pressure", *ratios)
    table.title = "Pressure at the foci, and what ignoring the hand would leave of it"
    for index, name in enumerate(run.foci):
        shares = [f"{ratio[index]:.2f} ×" for ratio in ratios.values()]
        table.add_row(escape(name), f"{run.reached[index]:,.0f} Pa", *shares)
    return table


def methods_table(contest: Contest) -> Table:
    """Tabulate what the worst focus gets by each method, best first."""
    quiet = ["suppression points"] if len(contest.target.suppression_points) else []
    table = plain_table("method", "worst focus", "of the bound", "mean", "time", *quiet)
    table.title = "What the foci get; of the bound: at full scale, of what no drive can pass"
    for one in sorted(contest.contenders, key=contest.of_the_bound, reverse=True):
        worst, mean = one.pressures.min(), one.pressures.mean()
        share = contest.of_the_bound(one)
        level = [f"{one.suppression_level:+.1f} dB"] if quiet else []
        time = f"{1e3 * one.seconds:,.3g} ms" if one.seconds < 1.0 else f"{one.seconds:.1f} s"
        table.add_row(one.name, f"{worst:,.0f} Pa", f"{share:.0%}", f"{mean:,.0f} Pa", time, *level)
    return table


def scan_table(compared: Compared) -> Table:
    """Tabulate how well a scan and its prediction agree."""
    found = compared.overlay
    facts = plain_table("", "")
    held = "pressures with their phases" if found.scan.phased else "magnitudes, as no phase was measured"
    facts.add_row("relative error", f"{found.error:.1%}, after one scale, of {held}")
    facts.add_row("positions", f"{int(found.used.sum())} of {len(found.used)} compared")
    turn = f" at {np.degrees(np.angle(found.scale)):.1f}°" if found.scan.phased else ""
    facts.add_row("scale", f"{abs(found.scale):.4g} of the scan's unit for 1 Pa predicted{turn}")
    report = compared.report
    facts.add_row("predicted by", f"{report.solver}, estimated error {report.estimated_error:.2%}")
    return facts


def _memory(unknowns: float) -> str:
    """Say how large a complex matrix of single precision is."""
    size = 8 * unknowns**2
    return f"{size / 1e9:.1f} GB" if size > 1e9 else f"{math.ceil(size / 1e6)} MB"
