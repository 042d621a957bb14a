"""Reproduce the experiment of Inoue, Makino and Shinoda (SICE 2014) from the numbers in the paper.

Run ``python examples/inoue2014/reproduce.py [--quick] [--out FOLDER] [--parts PART ...]``. The
results are written to FOLDER (``out/inoue2014``): ``results.md``, its figures, and a CSV file with
the numbers of each figure and table. Each part is written as soon as it is complete, so an
interrupted run keeps the finished parts.
"""

import argparse
import csv
import json
import math
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure
from scipy.ndimage import binary_dilation
from scipy.spatial import KDTree

import airtact as at

AIR = at.Medium(sound_speed=343.1, density=1.293)  # Table 1 of the paper
WATER = at.Medium(sound_speed=1481.0, density=999.7)
WAVELENGTH = AIR.wavelength(40e3)
ARRAY = at.surrounding_box(at.monopole())
HELD_EQUAL = tuple(at.evaluation.HELD_EQUAL)  # equal peak, equal energy, phase only
RED = "#b3202a"


@dataclass(frozen=True)
class Extent:
    """Accuracies, sweeps and limits of a run, in metres, degrees and seconds.

    ``order`` and ``elements_per_wavelength`` apply to the finite elements that compute the drive.
    ``verifying`` and ``reference`` are the accuracies of the boundary elements that verify the
    drive and that serve as the reference for errors; ``sweep_drive`` and ``sweep_verify`` are used
    in the sweep of fingers. The mesh study skips solves that are expected to take more than
    ``study_limit``, and starts none after ``study_budget``. A node spacing of n is λ/n.
    """

    order: int = 5
    elements_per_wavelength: float = 1.7
    verifying: float = 0.005
    reference: float = 0.003
    sweep_drive: float = 0.02
    sweep_verify: float = 0.01
    # The standing wave between the fingers requires steps well below half a wavelength.
    gaps: Sequence[float] = (
        *(6e-3, 6.75e-3, 7.5e-3, 8.25e-3, 9e-3, 9.75e-3, 10.5e-3, 12e-3, 13.5e-3),
        *(15e-3, 16.5e-3, 18e-3, 19.5e-3, 21e-3, 24e-3, 27e-3, 30e-3),
    )
    radii: Sequence[float] = (6e-3, 8e-3, 10e-3)
    tilts: Sequence[float] = (0.0, 20.0, 40.0, 60.0)
    ways: Sequence[str] = ("from below", "from above", "from the side")
    tilt_gaps: Sequence[float] = (6e-3, 7.5e-3, 12e-3, 18e-3)
    scan_step: float = 0.25e-3
    study_orders: Sequence[int] = (1, 2, 3, 4, 5, 6)
    study_sizes: Sequence[float] = (1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 10.0)
    study_limit: float = 60.0
    study_budget: float = 640.0
    poses: int = 200
    node_spacings: Sequence[float] = (6.0, 10.0)


FULL = Extent()
QUICK = Extent(
    reference=0.01,
    sweep_drive=0.05,
    sweep_verify=0.03,
    gaps=(6e-3, 7.5e-3, 12e-3, 24e-3),
    tilts=(0.0, 20.0, 45.0),
    ways=("from below", "from the side"),
    tilt_gaps=(12e-3,),
    scan_step=0.5e-3,
    study_limit=12.0,
    study_budget=40.0,
    poses=10,
    node_spacings=(6.0,),
)


class Results:
    """The page ``results.md``, its figures and its CSV files."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.lines = ["# Reproduction of Inoue, Makino and Shinoda (2014)"]
        folder.mkdir(parents=True, exist_ok=True)

    def add(self, *paragraphs: str) -> None:
        """Append paragraphs of Markdown and write the page."""
        self.lines += paragraphs
        (self.folder / "results.md").write_text("\n\n".join(self.lines) + "\n", encoding="utf-8")

    def data(self, name: str, header: Sequence[str], rows: Iterable[Sequence]) -> None:
        """Write a CSV file."""
        with (self.folder / f"{name}.csv").open("w", newline="", encoding="utf-8") as stream:
            csv.writer(stream).writerows([header, *rows])

    def table(self, header: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
        """Append a table."""
        lines = [header, ["---"] * len(header), *rows]
        self.add("\n".join(f"| {' | '.join(line)} |" for line in lines))

    def figure(self, name: str, figure: Figure, caption: str) -> None:
        """Save a figure and append it."""
        figure.savefig(self.folder / f"{name}.png", dpi=110)
        self.add(f"![{caption}]({name}.png)", f"*{caption} Numbers: {name}.csv.*")


# --- the paper's model ---------------------------------------------------------------------------


@dataclass(frozen=True)
class Fingers:
    """A thumb and a finger as capsules, tip to tip along x, with the parameters missing in the paper.

    ``gap`` and ``radius`` are in metres. ``tilt`` is in degrees; at 90, both fingers lie along x.
    """

    gap: float = 12e-3
    radius: float = 8e-3
    tilt: float = 20.0
    entering: str = "from below"

    def __str__(self) -> str:
        sizes = f"gap {1e3 * self.gap:g} mm, radius {1e3 * self.radius:g} mm"
        return f"{sizes}, tilt {self.tilt:g}°, {self.entering}"

    @cached_property
    def surfaces(self) -> list[at.Surface]:
        """Both capsules, with axes 44 mm long."""
        ways = {"from below": (0, 0, -1), "from above": (0, 0, 1), "from the side": (0, -1, 0)}
        tilt = math.radians(self.tilt)
        bodies = []
        for side in (-1.0, 1.0):
            tip = np.array([side * (self.gap / 2 + self.radius), 0.0, 0.0])
            outwards = np.array([side, 0.0, 0.0])
            along = math.sin(tilt) * outwards + math.cos(tilt) * np.array(ways[self.entering])
            bodies.append(at.capsule(tip + 44e-3 * along, tip, self.radius, edge=2.5e-3))
        return bodies

    @cached_property
    def scene(self) -> at.Scene:
        """The fingers as rigid bodies."""
        return at.Scene(AIR, [at.sound_hard(one) for one in self.surfaces], frequency=40e3)

    @property
    def foci(self) -> np.ndarray:
        """Foci where the fingers are closest to each other (2, 3) [m]."""
        return np.array([[-self.gap / 2, 0.0, 0.0], [self.gap / 2, 0.0, 0.0]])

    @property
    def beacons(self) -> at.Monopoles:
        """Both beacons in phase, as the paper's plane of symmetry implies."""
        return at.Monopoles(self.foci, np.ones(2))


@dataclass(frozen=True)
class Solved:
    """The drives of the paper, computed by finite elements and verified by boundary elements."""

    fingers: Fingers
    field: at.acoustics.RadiatedField
    received: np.ndarray
    drives: dict[str, at.Drive]
    compared: at.evaluation.Comparison

    @cached_property
    def factors(self) -> np.ndarray:
        """Factors (4,) that give both drives, and their phases alone, equal energy."""
        energy, peak = (
            self.compared.pressures[held][:, 0] for held in ("equal energy", "equal peak")
        )
        return np.concatenate([energy / peak, np.ones(2)])


def solve(extent: Extent) -> Solved:
    """Compute the drives that consider and ignore the fingers, and verify both."""
    fingers = Fingers()
    solver = at.FiniteElement(extent.order, extent.elements_per_wavelength)
    field = solver.radiate(fingers.scene, fingers.beacons)
    received = field.at(ARRAY.positions)[:, 0]
    target = at.Target(fingers.foci)
    drives = {
        "considered": at.Drive(received.conj() / np.abs(received).max()),
        "ignored": at.focus_by_distance(ARRAY, target, AIR, 40e3),
    }
    drives = {name: at.quantise(drive).drive() for name, drive in drives.items()}
    verifier = at.BoundaryElement(accuracy=extent.verifying)
    compared = at.compare(fingers.scene, ARRAY, drives, target, solver=verifier)
    return Solved(fingers, field, received, drives, compared)


# --- figures 5 to 10, Table 1 --------------------------------------------------------------------


def plane(half_x: float, half_z: float, step: float, centre: float = 0.0) -> np.ndarray:
    """Points (rows, columns, 3) of a rectangle in the plane y = 0 of both fingers [m]."""
    x = centre + np.linspace(-half_x, half_x, round(2 * half_x / step) + 1)
    z = np.linspace(-half_z, half_z, round(2 * half_z / step) + 1)
    across, up = np.meshgrid(x, z)
    return np.stack([across, np.zeros_like(across), up], axis=2)


def draw_planes(
    points: np.ndarray, values: dict[str, np.ndarray], label: str, foci: np.ndarray, **scale
) -> Figure:
    """Draw values in a plane side by side on the same scale, with bodies (NaN) in grey."""
    figure = Figure(figsize=(5.5 * len(values) + 1, 5.5), layout="constrained")
    row = figure.subplots(1, len(values), squeeze=False, sharey=True)[0]
    x, z = 1e3 * points[0, :, 0], 1e3 * points[:, 0, 2]
    for axes, (title, shown) in zip(row, values.items(), strict=True):
        image = axes.pcolormesh(x, z, shown.reshape(points.shape[:2]), shading="nearest", **scale)
        axes.plot(1e3 * foci[:, 0], 1e3 * foci[:, 2], "o", mfc="none", mec="white", ms=9)
        axes.set(title=title, xlabel="x [mm]", aspect="equal", facecolor="0.66")
    row[0].set_ylabel("z [mm]")
    figure.colorbar(image, ax=list(row), label=label)
    return figure


def beacons(results: Results, extent: Extent, solved: Solved) -> None:
    """Fig. 5: the phase of the beacons' field in the box, and at the transducers."""
    points = plane(0.07, 0.09, 1e-3 if extent == FULL else 1.4e-3) + [0.3e-3, 0.0, 0.3e-3]
    pressure = solved.field.at(points.reshape(-1, 3))[:, 0]  # points are off the infinite beacons
    columns = [*points.reshape(-1, 3).T, np.abs(pressure), np.angle(pressure)]
    header = ["x_m", "y_m", "z_m", "pressure_Pa", "phase_rad"]
    results.data("beacon_field", header, zip(*columns, strict=True))
    drive = solved.drives["considered"].amplitudes
    columns = [*ARRAY.positions.T, np.abs(drive), np.angle(drive)]
    header = ["x_m", "y_m", "z_m", "amplitude", "phase_rad"]
    results.data("transducers", header, zip(*columns, strict=True))
    report = solved.field.report
    results.add(
        "## The field of the beacons (Fig. 5)",
        "The paper meshes a quarter of the whole box, which took about 120 minutes in COMSOL. Here, "
        f"a tight box around the fingers is meshed ({report.settings['tetrahedra']} tetrahedra of "
        f"order {report.settings['order']}, {report.nodes} unknowns) and solved in "
        f"{sum(report.seconds.values()):.1f} s. The field outside this box is computed by the "
        "Kirchhoff-Helmholtz integral over the surfaces.",
    )
    shown = {"phase of the beacons' field": np.angle(pressure)}
    caption = (
        "Fig. 5 of the paper: the field of both beacons in phase, in the plane of the fingers."
    )
    scale = {"cmap": "twilight", "vmin": -np.pi, "vmax": np.pi}
    figure = draw_planes(points, shown, "phase [rad]", solved.fingers.foci, **scale)
    results.figure("beacon_field", figure, caption)


def pressures(results: Results, extent: Extent, solved: Solved) -> None:
    """Fig. 6 and 7: the pressure with the fingers considered and ignored."""
    compared, foci = solved.compared, solved.fingers.foci
    half = 3 * WAVELENGTH
    points = plane(half + foci[1, 0], half, WAVELENGTH / 18)
    fields = compared.at(points.reshape(-1, 3))
    energy = {
        name: np.abs(fields[name]) * factor
        for name, factor in zip(("considered", "ignored"), solved.factors, strict=False)
    }
    header = ["x_m", "y_m", "z_m", "considered_Pa", "ignored_Pa"]
    results.data("pressures", header, zip(*points.reshape(-1, 3).T, *energy.values(), strict=True))
    # By reciprocity, the finite elements predict the sum of the pressures at both foci.
    drive = solved.drives["considered"].amplitudes
    predicted = ARRAY.element.sensitivity * (solved.received @ drive) / 2
    off = abs(compared.at(foci)["considered"].mean() - predicted) / abs(predicted)
    results.add(
        "## Fingers considered and ignored (Fig. 6 and 7)",
        "The drives are computed by finite elements and verified by boundary elements, which share "
        f"no code with them. The two differ by {off:.2%} at the foci. The estimated error of the "
        f"boundary elements is {compared.report.estimated_error:.1%}.",
    )
    strongest = max(np.nanmax(magnitude) for magnitude in energy.values())
    shown = {f"fingers {name}": magnitude / strongest for name, magnitude in energy.items()}
    caption = "Fig. 6 and 7 of the paper on the same scale, with both drives at equal energy."
    scale = {"cmap": "magma", "vmin": 0.0, "vmax": 1.0}
    figure = draw_planes(points, shown, "pressure relative to the largest", foci, **scale)
    results.figure("pressures", figure, caption)
    rows = [
        (held, name, focus, pressure)
        for held, both in compared.pressures.items()
        for name, row in zip(compared.names, both, strict=True)
        for focus, pressure in enumerate(row)
    ]
    results.data("foci", ["held_equal", "drive", "focus", "pressure_Pa"], rows)
    rows = []
    for held in HELD_EQUAL:
        ratio = compared.ratios(held)[1].mean()
        squared = (compared.ratios(held)[1] ** 2).mean()
        rows.append([held, f"{ratio:.3f}", f"{squared:.3f}", "about half", "0.60"])
    results.add(
        "Pressure at the foci with the fingers ignored, divided by that with them considered:"
    )
    header = [
        "equal quantity",
        "pressure",
        "pressure squared",
        "paper, simulated",
        "paper, measured",
    ]
    results.table(header, rows)


def microphone(results: Results, extent: Extent, solved: Solved) -> None:
    """Fig. 8 to 10: a virtual measurement around one focus with a quarter-inch microphone."""
    focus = solved.fingers.foci[1]
    points = plane(10e-3, 10e-3, extent.scan_step, focus[0])
    readings = at.evaluation.Microphone().read(solved.compared.field, points.reshape(-1, 3))
    read = noisy(readings * solved.factors)
    header = ["considered", "ignored", "considered_phase_only", "ignored_phase_only"]
    header = ["x_m", "y_m", "z_m", *(f"{name}_Pa" for name in header)]
    results.data("microphone", header, np.column_stack([points.reshape(-1, 3), read]))
    results.add(
        "## A virtual measurement (Fig. 8 to 10)",
        "A quarter-inch microphone points down along z and moves around the focus on the right "
        "finger. "
        "It measures the mean pressure over its face with 1 % noise and does not scatter sound. At "
        f"{int(np.isnan(read[:, 0]).sum())} of {len(read)} positions, a finger is in the way.",
    )
    largest = np.nanmax(read[:, :2])
    shown = {f"fingers {name}": read[:, i] / largest for i, name in enumerate(solved.drives)}
    caption = "Fig. 9 and 10 of the paper: microphone readings with both drives at equal energy."
    scale = {"cmap": "magma", "vmin": 0.0, "vmax": 1.0}
    figure = draw_planes(points, shown, "reading relative to the largest", focus[None], **scale)
    results.figure("microphone", figure, caption)
    rows = [
        [held, f"{ratio:.3f}", f"{ratio**2:.3f}", "0.60"]
        for held, ratio in zip(HELD_EQUAL, peak_ratios(read, solved.factors), strict=True)
    ]
    results.add("Largest reading with the fingers ignored, divided by that with them considered:")
    results.table(["equal quantity", "pressure", "pressure squared", "paper"], rows)


def noisy(pressure: np.ndarray) -> np.ndarray:
    """Magnitudes [Pa] with complex noise of 1 % of the largest; NaN stays NaN."""
    random = np.random.default_rng(2014)
    real, imaginary = random.standard_normal((2, *pressure.shape)) / np.sqrt(2)
    return np.abs(pressure + 0.01 * np.nanmax(np.abs(pressure)) * (real + 1j * imaginary))


def peak_ratios(read: np.ndarray, factors: np.ndarray) -> tuple[float, float, float]:
    """Ratio of the largest readings (N, 4), ignored to considered, for each of ``HELD_EQUAL``."""
    considered, ignored, considered_phases, ignored_phases = np.nanmax(read, axis=0)
    energy = ignored / considered
    return energy * factors[0] / factors[1], energy, ignored_phases / considered_phases


def differences(results: Results, extent: Extent, solved: Solved) -> None:
    """Table 1: differences of water-filled and rigid fingers, and of the two solvers."""
    fingers = solved.fingers
    half = 3 * WAVELENGTH
    points = plane(half + fingers.foci[1, 0], half, WAVELENGTH / 18).reshape(-1, 3)[::7]
    points = points[fingers.scene.depth(points) < -0.5 * WAVELENGTH]
    everywhere = np.concatenate([ARRAY.positions, points])
    watery = at.Scene(AIR, [at.filled(one, WATER) for one in fingers.surfaces], frequency=40e3)
    finite = at.FiniteElement(extent.order, extent.elements_per_wavelength)
    boundary = at.BoundaryElement(accuracy=extent.reference)
    received = {
        "finite elements, rigid": solved.field,
        "boundary elements, rigid": boundary.radiate(fingers.scene, fingers.beacons),
        "finite elements, water": finite.radiate(watery, fingers.beacons),
    }
    received = {name: field.at(everywhere)[:, 0] for name, field in received.items()}
    names = list(received)
    rows = []
    for first, second in ((names[0], names[1]), (names[0], names[2]), (names[1], names[2])):
        one, two = received[first], received[second]
        count = len(ARRAY)
        errors = relative_error(one[:count], two[:count]), relative_error(one[count:], two[count:])
        rows.append((first, second, *errors))
    header = ["field", "against", "at_the_transducers", "in_the_plane"]
    results.data("differences", header, rows)
    results.add(
        "## Water-filled and rigid fingers, boundary and finite elements (Table 1)",
        "The fingers of the paper are filled with water, which reflects 0.9994 of the pressure. All "
        "results above are for rigid fingers. Relative differences of the beacons' field:",
    )
    header = ["field", "against", "at the transducers", "in the plane, 0.5 λ from the fingers"]
    results.table(header, [[*row[:2], f"{row[2]:.2%}", f"{row[3]:.2%}"] for row in rows])


def relative_error(values: np.ndarray, reference: np.ndarray) -> float:
    """‖values − reference‖ / ‖reference‖."""
    return float(np.linalg.norm(values - reference) / np.linalg.norm(reference))


# --- the ratio over all that the paper leaves open -----------------------------------------------


def ratio_of(fingers: Fingers, extent: Extent) -> np.ndarray:
    """Mean ratio (3,) of the pressures at the foci, ignored to considered, per ``HELD_EQUAL``."""
    scene, target = fingers.scene, at.Target(fingers.foci)
    solver = at.BoundaryElement(accuracy=extent.sweep_drive)
    transfer = at.transfer_matrix(solver.radiate(scene, target.beacons()), ARRAY)
    drives = {
        "considered": at.time_reversal(transfer, target),
        "ignored": at.focus_by_distance(ARRAY, target, AIR, 40e3),
    }
    emitted = {name: at.quantise(drive).drive() for name, drive in drives.items()}
    verifier = at.BoundaryElement(accuracy=extent.sweep_verify)
    compared = at.compare(scene, ARRAY, emitted, target, solver=verifier)
    return np.array([compared.ratios(held)[1].mean() for held in HELD_EQUAL])


def ratios(results: Results, extent: Extent) -> None:
    """Sweep gap, radius, tilt and direction of entry."""
    swept = [Fingers(gap, radius) for gap, radius in product(extent.gaps, extent.radii)]
    for gap, tilt, way in product(extent.tilt_gaps, extent.tilts, extent.ways):
        swept.append(Fingers(gap, 8e-3, tilt, way))
    found: dict[Fingers, np.ndarray] = {}
    header = ["gap_m", "radius_m", "tilt_degrees", "entering", *HELD_EQUAL]
    for fingers in dict.fromkeys(swept):
        print(f"    {fingers}", flush=True)
        found[fingers] = ratio_of(fingers, extent)
        rows = [(f.gap, f.radius, f.tilt, f.entering, *ratio) for f, ratio in found.items()]
        results.data("sweep", header, rows)
    values = np.array(list(found.values()))
    spans = [
        f"{held} {low:.2f} to {high:.2f}"
        for held, low, high in zip(HELD_EQUAL, values.min(0), values.max(0), strict=True)
    ]
    results.add(
        "## Parameters missing in the paper",
        "The paper states neither the size, the gap and the tilt of the dummy fingers, nor which "
        f"quantity is equal for the two drives. For {len(found)} pairs of fingers, the pressure at "
        "the foci with the fingers ignored, divided by that with them considered, is: "
        f"{'; '.join(spans)}.",
    )
    caption = "Pressure ratio against gap, radius and tilt. Red lines: 0.60 and 0.50 of the paper."
    results.figure("sweep", draw_ratios(extent, found), caption)
    results.add("Fingers for which the ratio is closest to the numbers in the paper:")
    rows = []
    for wanted, power in product((0.5, 0.6), (1, 2)):
        for column, held in enumerate(HELD_EQUAL):
            distances = {one: abs(ratio[column] ** power - wanted) for one, ratio in found.items()}
            nearest = min(distances, key=distances.__getitem__)
            quantity = "pressure" if power == 1 else "pressure squared"
            ratio = found[nearest][column] ** power
            rows.append([f"{wanted:.2f}", quantity, held, f"{ratio:.3f}", str(nearest)])
    results.table(["paper", "interpreted as", "equal quantity", "closest ratio", "fingers"], rows)


def draw_ratios(extent: Extent, found: dict[Fingers, np.ndarray]) -> Figure:
    """Draw the ratio against gap and radius above, and against tilt below."""
    figure = Figure(figsize=(12.0, 7.0), layout="constrained")
    grid = figure.subplots(2, 3, sharey="row")
    shades = colormaps["viridis"](np.linspace(0, 0.88, max(len(extent.tilt_gaps), 3)))
    styles = {"from below": "-o", "from above": "--^", "from the side": ":s"}
    for column, held in enumerate(HELD_EQUAL):
        above, below = grid[:, column]
        for shade, radius in zip(shades, extent.radii, strict=False):
            line = [found[Fingers(gap, radius)][column] for gap in extent.gaps]
            label = f"radius {1e3 * radius:g} mm"
            above.plot(1e3 * np.array(extent.gaps), line, "-o", ms=3, color=shade, label=label)
        for (shade, gap), way in product(zip(shades, extent.tilt_gaps, strict=False), extent.ways):
            line = [found[Fingers(gap, 8e-3, tilt, way)][column] for tilt in extent.tilts]
            label = f"gap {1e3 * gap:g} mm, {way}"
            below.plot(extent.tilts, line, styles[way], ms=3, color=shade, label=label)
        for axes in (above, below):
            axes.axhline(0.6, color=RED, linewidth=1)
            axes.axhline(0.5, color=RED, linewidth=1, linestyle="--")
        above.set(title=held, xlabel="gap [mm]")
        below.set(xlabel="tilt [degrees]")
    grid[0, 0].set_ylabel("ignored / considered")
    grid[1, 0].set_ylabel("ignored / considered")
    grid[0, 2].legend(fontsize=8)
    grid[1, 2].legend(fontsize=8)
    return figure


# --- section 3.3: one solution for a moved hand --------------------------------------------------


@dataclass(frozen=True)
class Nodes:
    """A field that is only known at nodes and is interpolated as in the paper."""

    points: np.ndarray
    pressure: np.ndarray
    carrier: Callable[[np.ndarray], np.ndarray]
    """e^{ikr}/r of the beacon at points (N, 3)."""

    @cached_property
    def tree(self) -> KDTree:
        """Search tree for the nearest nodes."""
        return KDTree(self.points)

    def literal(self, points: np.ndarray) -> np.ndarray:
        """Interpolate linearly in the tetrahedron of the 4 nearest nodes."""
        nearest, shares = self.weights(points)
        return (shares * self.pressure[nearest]).sum(axis=1)

    def carrier_free(self, points: np.ndarray) -> np.ndarray:
        """Do the same, but divide by the wave of the beacon before and multiply by it afterward."""
        nearest, shares = self.weights(points)
        carrier = self.carrier(self.points[nearest].reshape(-1, 3)).reshape(nearest.shape)
        return self.carrier(points) * (shares * self.pressure[nearest] / carrier).sum(axis=1)

    def weights(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the 4 nearest nodes and their weights (N, 4), negative for a point outside them."""
        nearest = np.asarray(self.tree.query(points, k=4)[1])
        corners = self.points[nearest]
        edges = (corners[:, 1:] - corners[:, :1]).transpose(0, 2, 1)
        flat = np.abs(np.linalg.det(edges)) < 1e-12 * np.linalg.norm(edges, axis=1).prod(axis=1)
        edges[flat] = np.eye(3)
        others = np.linalg.solve(edges, (points - corners[:, 0])[:, :, None])[:, :, 0]
        others[flat] = 0.0  # if the 4 nodes are coplanar, only the nearest has a weight
        return nearest, np.concatenate([1 - others.sum(axis=1, keepdims=True), others], axis=1)


def nodes_beside(points: np.ndarray, step: float, scene: at.Scene) -> np.ndarray:
    """Nodes of an uneven grid within two steps of points, outside the bodies [m]."""
    low = points.min(axis=0) - 3 * step
    cells = np.floor((points - low) / step).astype(np.int64)
    near = np.zeros(cells.max(axis=0) + 4, dtype=np.bool_)
    near[tuple(cells.T)] = True
    grid = np.argwhere(binary_dilation(near, np.ones((3, 3, 3)), iterations=1)) + 0.5
    grid += np.random.default_rng(33).uniform(-0.3, 0.3, grid.shape)  # as uneven as a mesh
    nodes = low + step * grid
    return nodes[scene.depth(nodes) < 0.0]


def random_poses(count: int) -> list[at.Pose]:
    """Random motions, equal in every run, by up to 5 mm along each axis and 10 degrees."""
    random = np.random.default_rng(33)
    poses = []
    for _ in range(count):
        axis, angle = random.standard_normal(3), np.radians(random.uniform(-10.0, 10.0))
        shift = random.uniform(-5e-3, 5e-3, 3)
        poses.append(at.Pose.turn(tuple(axis), angle, translation=tuple(shift)))
    return poses


def rigid_motion(results: Results, extent: Extent) -> None:
    """Evaluate one solution at the transducers for moved hands in several ways."""
    fingers = Fingers()
    beacon = at.Monopoles(fingers.foci[1:], np.ones(1))
    field = at.BoundaryElement(accuracy=0.01).radiate(fingers.scene, beacon)
    finer = at.BoundaryElement(accuracy=0.5 * extent.reference).radiate(fingers.scene, beacon)
    poses = [ARRAY.seen_from(pose).positions for pose in random_poses(extent.poses)]
    exact = [finer.at(positions)[:, 0] for positions in poses]

    def carrier(points: np.ndarray) -> np.ndarray:
        distance = np.linalg.norm(points - beacon.positions[0], axis=1)
        return np.exp(1j * field.scene.wavenumber * distance) / distance

    ways: dict[str, Callable[[np.ndarray], np.ndarray]] = {
        "surface integral": lambda points: field.at(points)[:, 0]
    }
    outside = {}
    for spacing in extent.node_spacings:
        points = nodes_beside(np.concatenate(poses), WAVELENGTH / spacing, fingers.scene)
        blocks = np.array_split(points, 1 + len(points) // 50_000)
        nodes = Nodes(points, np.concatenate([field.at(one)[:, 0] for one in blocks]), carrier)
        ways[f"4 nearest nodes, λ/{spacing:g}"] = nodes.literal
        ways[f"the same without e^ikr/r, λ/{spacing:g}"] = nodes.carrier_free
        outside[spacing] = np.mean([nodes.weights(one)[1].min(axis=1) < -1e-9 for one in poses])
    errors, rows = {}, []
    for name, read in ways.items():
        begun = time.perf_counter()
        received = [read(positions) for positions in poses]
        seconds = (time.perf_counter() - begun) / len(poses)
        errors[name] = [relative_error(*pair) for pair in zip(received, exact, strict=True)]
        single = np.median(np.abs(np.array(received) / np.array(exact) - 1.0))
        rows.append((name, np.median(errors[name]), max(errors[name]), single, seconds))
    results.data("rigid_motion", list(errors), zip(*errors.values(), strict=True))
    shares = [f"{share:.0%} at λ/{spacing:g}" for spacing, share in outside.items()]
    results.add(
        "## Rigid motion (section 3.3)",
        f"A single solution covers all rigid motions. The hand was moved {len(poses)} times at "
        "random, by up to 5 mm along each axis and 10 degrees. The field of the beacon at the "
        "transducers was computed by the surface integral, and by the paper's scheme, which "
        "interpolates linearly between the 4 nearest nodes. Most points lie outside the tetrahedron "
        f"of these nodes ({', '.join(shares)}), where the scheme extrapolates. The table lists the "
        "error of the drive, which is the conjugate of the pressure at the transducers:",
    )
    header = ["method", "median", "largest", "one transducer, median", "time per pose"]
    cells = [
        [row[0], *(f"{error:.3g}" for error in row[1:4]), f"{1e3 * row[4]:.1f} ms"] for row in rows
    ]
    results.table(header, cells)
    figure = Figure(figsize=(9.0, 4.5), layout="constrained")
    axes = figure.subplots()
    for name, values in errors.items():
        axes.plot(np.linspace(0, 100, len(values)), sorted(values), label=name)
    axes.set(yscale="log", xlabel="fraction of the poses [%]", ylabel="error of the drive")
    axes.legend(fontsize=8)
    results.figure("rigid_motion", figure, "Error of the drive, sorted over the poses.")


# --- future work 1: mesh and order ---------------------------------------------------------------


@dataclass(frozen=True)
class Mesh:
    """The cost of a solve in the mesh study and its error at the transducers."""

    order: int
    elements_per_wavelength: float
    tetrahedra: int = 0
    unknowns: int = 0
    seconds: float = math.nan
    memory: float = math.nan
    error: float = math.nan


def mesh_sizes(results: Results, extent: Extent) -> None:
    """Solve with several orders and mesh sizes, each in a separate process."""
    fingers = Fingers()
    accuracy = extent.reference
    exact, coarser = (
        at.BoundaryElement(accuracy=one).radiate(fingers.scene, fingers.beacons).at(ARRAY.positions)
        for one in (accuracy, 2 * accuracy)
    )
    begun = time.perf_counter()
    solved: list[Mesh] = []
    header = ["order", "elements_per_wavelength", "tetrahedra", "unknowns", "time_s"]
    waiting = [
        Mesh(order, size) for order, size in product(extent.study_orders, extent.study_sizes)
    ]
    waiting.sort(key=lambda mesh: mesh.order * mesh.elements_per_wavelength)
    expected: dict[int, float] = {}  # seconds of an order at one element per wavelength
    for mesh in waiting:
        size = mesh.elements_per_wavelength
        # The unknowns grow with the cube of the size, and so does the time for small meshes.
        over_limit = expected.get(mesh.order, 0.0) * size**3 > extent.study_limit
        if over_limit or time.perf_counter() - begun > extent.study_budget:
            continue
        print(f"    order {mesh.order} at λ/{size:g}", flush=True)
        done = run_mesh(mesh, exact[:, 0], 1.5 * extent.study_limit + 20)
        if done is None:
            expected[mesh.order] = math.inf
            continue
        expected[mesh.order] = done.seconds / size**3
        solved.append(done)
        rows = [tuple(vars(one).values()) for one in solved]
        results.data("mesh_sizes", [*header, "memory_B", "error"], rows)
    uncertain = relative_error(coarser, exact)
    results.add(
        "## Mesh and order (future work 1)",
        "The paper uses a rule of thumb for the mesh size, λ/6 to λ/10, and asks which mesh and "
        f"solver are best. {len(solved)} combinations of order and mesh size were solved, except "
        f"those expected to take more than {extent.study_limit:g} s. The error is that of the "
        "beacons' pressure at the transducers, relative to boundary elements (whose error is about "
        f"{uncertain:.1%}). Only a box around the fingers is meshed; the pressure outside is "
        "computed by the surface integral.",
    )
    good = [one for one in solved if one.error <= 0.02]
    if good:
        best = min(good, key=lambda one: one.seconds)
        results.add(
            f"The fastest combination with an error below 2 % is order {best.order} at "
            f"λ/{best.elements_per_wavelength:g}, with an error of {best.error:.1%} in "
            f"{best.seconds:.1f} s and {best.memory / 2**30:.2f} GiB."
        )
    caption = "Error against time, memory and mesh size. Grey: λ/6 to λ/10, as in the paper."
    results.figure("mesh_sizes", draw_meshes(extent, solved), caption)


def run_mesh(mesh: Mesh, exact: np.ndarray, limit: float) -> Mesh | None:
    """Solve in a separate process; return None if it fails or takes too long."""
    script = Path(__file__).with_name("solve_mesh.py")
    settings = json.dumps([mesh.order, mesh.elements_per_wavelength])
    call = [sys.executable, str(script), settings]
    try:
        done = subprocess.run(call, capture_output=True, text=True, timeout=limit, check=True)
    except (subprocess.TimeoutExpired, subprocess.CalledProcessError) as error:
        print(f"    failed: {error}", flush=True)
        return None
    answer = json.loads(done.stdout.splitlines()[-1])
    received = np.array(answer.pop("real")) + 1j * np.array(answer.pop("imaginary"))
    return replace(mesh, **answer, error=relative_error(received, exact))


def draw_meshes(extent: Extent, solved: list[Mesh]) -> Figure:
    """Draw the error against time, memory and elements per wavelength."""
    figure = Figure(figsize=(12.0, 4.5), layout="constrained")
    row = figure.subplots(1, 3, sharey=True)
    colours = colormaps["viridis"](np.linspace(0, 0.92, len(extent.study_orders)))
    for order in extent.study_orders:
        line = [one for one in solved if one.order == order]
        line.sort(key=lambda one: one.elements_per_wavelength)
        if not line:
            continue
        colour = colours[extent.study_orders.index(order)]
        error = [one.error for one in line]
        costs = ([one.seconds for one in line], [one.memory / 2**30 for one in line])
        sizes = [one.elements_per_wavelength for one in line]
        for axes, cost in zip(row, (*costs, sizes), strict=True):
            axes.plot(cost, error, "-o", ms=4, color=colour, label=f"order {order}")
    labels = ("time [s]", "memory of the process [GiB]", "elements per wavelength")
    for axes, label in zip(row, labels, strict=True):
        axes.set(xscale="log", yscale="log", xlabel=label)
    row[2].axvspan(6, 10, color="0.88", zorder=0)
    row[0].set_ylabel("error at the transducers")
    row[2].legend(fontsize=7)
    return figure


# --- command line --------------------------------------------------------------------------------

FIELD_PARTS = {
    "beacons": beacons,
    "pressures": pressures,
    "microphone": microphone,
    "differences": differences,
}
OTHER_PARTS = {"ratios": ratios, "rigid_motion": rigid_motion, "mesh_sizes": mesh_sizes}


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the parts and write the results."""
    parser = argparse.ArgumentParser(description="Reproduce the experiment of Inoue et al. (2014).")
    parser.add_argument("--quick", action="store_true", help="run a reduced version (3 minutes)")
    parser.add_argument(
        "--out", type=Path, default=Path("out/inoue2014"), help="folder for the results"
    )
    names = [*FIELD_PARTS, *OTHER_PARTS]
    parser.add_argument("--parts", nargs="+", choices=names, default=names, metavar="PART")
    given = parser.parse_args(arguments)
    extent = QUICK if given.quick else FULL
    results = Results(given.out)
    run = (
        "quick run with fewer fingers, poses and meshes and coarser solutions"
        if given.quick
        else "full run"
    )
    results.add(
        f"These are the results of a {run}. The model consists of 996 transducers (monopoles) "
        "around a box of 14 x 14 x 18 cm at 40 kHz, and of two fingers (capsules) with a focus on "
        "the skin of each. Every drive is rounded to 256 levels of amplitude and phase before it is "
        "verified."
    )
    solved = None
    for name in given.parts:
        begun = time.perf_counter()
        print(f"{name} ...", flush=True)
        if name in OTHER_PARTS:
            OTHER_PARTS[name](results, extent)
        else:
            solved = solved or solve(extent)
            FIELD_PARTS[name](results, extent, solved)
        print(f"{name}: {time.perf_counter() - begun:.0f} s", flush=True)
    print(f"Results: {given.out / 'results.md'}")


if __name__ == "__main__":
    main()
