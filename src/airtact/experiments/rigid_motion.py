"""Section 3.3 of the paper: one solution for a rigidly moved hand, evaluated from nodes or by the surface integral."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Complex128, Float64
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter
from scipy.ndimage import binary_dilation
from scipy.spatial import KDTree

from airtact.acoustics.scene import Scene
from airtact.acoustics.solvers.bem.solver import BoundaryElement
from airtact.acoustics.solvers.problem import RadiatedField
from airtact.acoustics.solvers.sampled_field import SampledField
from airtact.acoustics.sources import Monopoles
from airtact.experiments.dummies import dummies
from airtact.experiments.part import Part, write_columns
from airtact.experiments.settings import Settings
from airtact.geometry.pose import Pose
from airtact.printing import in_short
from airtact.reports.page import paragraph, picture, table
from airtact.timing import Clock
from airtact.transducers.element import monopole
from airtact.transducers.layout import surrounding_box

FARTHEST, WIDEST = 5e-3, 10.0
"""Largest motion of the hand along each axis [m], and largest rotation about any axis [degrees]."""

SAMPLED = 5
"""Poses for the interpolation in containing tetrahedra, which takes long."""

SEED = 33

SHIFT = 0.3
"""Largest offset of nodes from a grid, over its step: the nodes of a mesh of tetrahedra are not in rows."""


@dataclass(frozen=True, eq=False)
class Nodes:
    """A field known at nodes alone; ``carrier`` gives e^{ikr}/r of the beacon at points, ``tree`` the nearest nodes."""

    points: Float64[np.ndarray, "nodes 3"]
    pressure: Complex128[np.ndarray, "nodes"]
    carrier: Callable[[Float64[np.ndarray, "points 3"]], Complex128[np.ndarray, "points"]]
    tree: KDTree

    __repr__ = in_short

    def literal(
        self, points: Float64[np.ndarray, "points 3"]
    ) -> tuple[Complex128[np.ndarray, "points"], Bool[np.ndarray, "points"]]:
        """Interpolate as the paper does, in the tetrahedron of the 4 nearest nodes; also whether points lie outside."""
        nearest, shares = self._shares(points)
        return (shares * self.pressure[nearest]).sum(axis=1), shares.min(axis=1) < -1e-9

    def carrier_free(
        self, points: Float64[np.ndarray, "points 3"]
    ) -> tuple[Complex128[np.ndarray, "points"], Bool[np.ndarray, "points"]]:
        """Do the same with the beacon's own e^{ikr}/r divided out first and multiplied in again."""
        nearest, shares = self._shares(points)
        smooth = self.pressure[nearest] / self.carrier(self.points[nearest].reshape(-1, 3)).reshape(
            nearest.shape
        )
        return self.carrier(points) * (shares * smooth).sum(axis=1), shares.min(axis=1) < -1e-9

    def _shares(self, points: Float64[np.ndarray, "points 3"]) -> tuple[np.ndarray, np.ndarray]:
        """Return the 4 nearest nodes and their weights; the nearest has all the weight where the 4 lie in a plane."""
        nearest = np.asarray(self.tree.query(points, k=4)[1])
        corners = self.points[nearest]
        edges = (corners[:, 1:] - corners[:, :1]).transpose(0, 2, 1)
        flat = np.abs(np.linalg.det(edges)) < 1e-12 * np.linalg.norm(edges, axis=1).prod(axis=1)
        edges[flat] = np.eye(3)
        others = np.linalg.solve(edges, (points - corners[:, 0])[:, :, None])[:, :, 0]
        others[flat] = 0.0
        return nearest, np.concatenate([1 - others.sum(axis=1, keepdims=True), others], axis=1)


def nodes_beside(
    points: Float64[np.ndarray, "points 3"], step: float, scene: Scene
) -> Float64[np.ndarray, "nodes 3"]:
    """Nodes of an uneven grid within two steps of some points, outside the bodies."""
    low = points.min(axis=0) - 3 * step
    cells = np.floor((points - low) / step).astype(np.int64)
    wanted = np.zeros(cells.max(axis=0) + 4, dtype=np.bool_)
    wanted[tuple(cells.T)] = True
    wanted = binary_dilation(wanted, np.ones((3, 3, 3)), iterations=1)
    grid = (
        np.argwhere(wanted)
        + 0.5
        + np.random.default_rng(SEED).uniform(-SHIFT, SHIFT, (int(wanted.sum()), 3))
    )
    nodes = low + step * grid
    return nodes[scene.depth(nodes) < 0.0]


def random_poses(count: int) -> list[Pose]:
    """Return small random motions of a hand, the same every time."""
    chance = np.random.default_rng(SEED)
    poses = []
    for _ in range(count):
        axis, angle = chance.standard_normal(3), np.radians(chance.uniform(-WIDEST, WIDEST))
        shift = chance.uniform(-FARTHEST, FARTHEST, 3)
        poses.append(Pose.turn(tuple(axis), angle, translation=tuple(shift)))
    return poses


@dataclass(frozen=True)
class Reading:
    """Errors and time of one way to evaluate the field at the transducers.

    ``errors`` are those of the drive in each pose, ``alone`` against the surface integral over the
    same solution; ``typical`` is the median error of one transducer over all poses, ``outside`` the
    share of points outside their tetrahedron (NaN where there is none), ``seconds`` the time for
    one pose.
    """

    name: str
    errors: tuple[float, ...]
    alone: tuple[float, ...]
    typical: float
    outside: float
    seconds: float


def rigid_motion(settings: Settings, folder: Path, clock: Clock) -> Part:
    """Compare ways to evaluate one solution at the transducers of a moved hand."""
    fingers, array = dummies(), surrounding_box(monopole())
    scene, poses = fingers.scene, random_poses(settings.poses)
    beacon = Monopoles(fingers.foci[1:], np.ones(1))
    with clock.step("moved", f"moving the hand to {len(poses)} poses"):
        field = BoundaryElement(accuracy=0.01).radiate(scene, beacon)
        reference = BoundaryElement(accuracy=0.5 * settings.reference).radiate(scene, beacon)
        positions = np.stack([array.seen_from(pose).positions for pose in poses])
        true = reference.at(positions.reshape(-1, 3))[:, 0].reshape(len(poses), -1)
    with clock.step("surface integral", f"evaluating {len(poses)} poses by the surface integral"):
        first, received = _timed(
            "surface integral", positions, true, None, lambda at: (field.at(at)[:, 0], None)
        )
    readings, counts, held = [first], [], []
    some = slice(None, SAMPLED)
    for spacing in settings.node_spacings:
        with clock.step(
            f"nodes {spacing:g}", f"reading the moved transducers off nodes at λ/{spacing:g}"
        ):
            nodes = _sampled(field, positions.reshape(-1, 3), scene.wavelength / spacing)
            counts.append(f"{len(nodes.points):,} at λ/{spacing:g}")
            if not held:
                name, read = (
                    f"tetrahedron round the point, λ/{spacing:g}",
                    _held_by(field, positions[some], spacing),
                )
                held = [_timed(name, positions[some], true[some], received[some], read)[0]]
            for name, way in (
                (f"4 nearest nodes, λ/{spacing:g}", nodes.literal),
                (f"the same without e^ikr/r, λ/{spacing:g}", nodes.carrier_free),
            ):
                readings.append(_timed(name, positions, true, received, way)[0])
    readings += held
    _write(readings, len(poses), folder)
    return Part("Rigid motion (section 3.3)", _shown(readings, len(poses), counts, settings))


def _shown(
    readings: list[Reading], poses: int, counts: list[str], settings: Settings
) -> tuple[str, ...]:
    return (
        paragraph(
            f"One solution serves every rigid motion. The hand was moved {poses} times at random, by up to "
            f"{1e3 * FARTHEST:.0f} mm along each axis and {WIDEST:.0f} degrees; each time the beacon was read at the "
            "996 transducers: by the surface integral over the same solution, and by the paper's scheme, the "
            "4 nearest nodes and linear interpolation in their tetrahedron (a k-d tree in place of FLANN). The nodes "
            f"form an uneven grid (nodes: {', '.join(counts)}) and know the pressure of that same solution, so that "
            "interpolation alone is compared. The error is that of the drive against boundary elements at "
            f"{100 * 0.5 * settings.reference:g} %."
        ),
        table(
            [
                "read by",
                "median error",
                "largest",
                "reading alone",
                "one transducer",
                "points outside",
                "time a pose",
            ],
            [_row(one) for one in readings],
            "Error of the drive (the conjugate of the pressure at the transducers) over the poses; the reading alone "
            "against the surface integral over the same solution (median); of one transducer (median), which is "
            "smaller where a few tetrahedra are nearly flat; the share of points outside their tetrahedron, where the "
            "paper's scheme extrapolates. Without e^ikr/r: the beacon's own wave divided out before and multiplied in "
            "after. The last row is SampledField, in the tetrahedron of Delaunay's that holds the point, the first "
            f"{SAMPLED} poses.",
        ),
        picture(
            _draw(readings),
            "Error of the drive in each pose, the poses sorted by it; the thin line is that of the reading alone. "
            "data/rigid_motion",
            "curves of errors over poses",
        ),
    )


def _write(readings: list[Reading], poses: int, folder: Path) -> None:
    def column(values: Sequence[float]) -> tuple[str, Sequence[float]]:
        return "", [*values, *[np.nan] * (poses - len(values))]

    errors = {_plain(one.name): column(one.errors) for one in readings}
    alone = {f"{_plain(one.name)}_alone": column(one.alone) for one in readings[1:]}
    write_columns(folder, "rigid_motion", {"pose": ("", range(poses)), **errors, **alone})
    columns = {
        "read_by": ("", [one.name for one in readings]),
        "median_error": ("", [np.median(one.errors) for one in readings]),
        "largest_error": ("", [max(one.errors) for one in readings]),
        "alone": ("", [np.median(one.alone) for one in readings]),
        "one_transducer": ("", [one.typical for one in readings]),
        "outside": ("", [one.outside for one in readings]),
        "time": ("s", [one.seconds for one in readings]),
    }
    write_columns(folder, "rigid_motion_readings", columns)


def _sampled(field: RadiatedField, points: Float64[np.ndarray, "points 3"], step: float) -> Nodes:
    beacon, k = field.sources.positions[0], field.scene.wavenumber

    def carrier(at: Float64[np.ndarray, "points 3"]) -> Complex128[np.ndarray, "points"]:
        distance = np.linalg.norm(at - beacon, axis=1)
        return np.exp(1j * k * distance) / distance

    nodes = nodes_beside(points, step, field.scene)
    pressure = np.concatenate(
        [field.at(some)[:, 0] for some in np.array_split(nodes, 1 + len(nodes) // 50_000)]
    )
    return Nodes(nodes, pressure, carrier, KDTree(nodes))


def _held_by(
    field: RadiatedField, positions: Float64[np.ndarray, "poses elements 3"], spacing: float
) -> Callable[..., tuple[np.ndarray, np.ndarray]]:
    nodes = _sampled(field, positions.reshape(-1, 3), field.scene.wavelength / spacing)
    sampled = SampledField(field.scene, field.sources, nodes.points, nodes.pressure)
    sampled.valid(positions[0, :1])  # so that its search is made before it is timed

    def read(points: Float64[np.ndarray, "points 3"]) -> tuple[np.ndarray, np.ndarray]:
        pressure = sampled.at(points)[:, 0]
        return pressure, np.isnan(pressure)

    return read


def _timed(
    name: str,
    positions: Float64[np.ndarray, "poses elements 3"],
    true: Complex128[np.ndarray, "poses elements"],
    same: Complex128[np.ndarray, "poses elements"] | None,
    read: Callable[..., tuple[np.ndarray, np.ndarray | None]],
) -> tuple[Reading, Complex128[np.ndarray, "poses elements"]]:
    """Read all poses; ``same`` is the surface integral over the same solution."""
    begun = time.perf_counter()
    answers = [read(one) for one in positions]
    seconds = (time.perf_counter() - begun) / len(positions)
    found = np.stack([pressure for pressure, _ in answers])
    known = np.isfinite(found)
    each = float(np.median(np.abs((found - true) / true)[known]))
    outside = float(
        np.mean([float("nan") if beyond is None else beyond.mean() for _, beyond in answers])
    )
    alone = tuple(float("nan") for _ in positions) if same is None else _apart(found, same)
    return Reading(name, _apart(found, true), alone, each, outside, seconds), found


def _apart(
    found: Complex128[np.ndarray, "poses elements"], true: Complex128[np.ndarray, "poses elements"]
) -> tuple[float, ...]:
    """Relative error in each pose, over the points with a value."""
    known = np.isfinite(found)
    off = np.linalg.norm(np.where(known, found - true, 0), axis=1)
    return tuple((off / np.linalg.norm(np.where(known, true, 0), axis=1)).tolist())


def _plain(name: str) -> str:
    return (
        name.replace(", ", "_")
        .replace(" ", "_")
        .replace("/", "_")
        .replace("λ", "lambda")
        .replace("^", "")
    )


def _row(one: Reading) -> list[str]:
    errors = [np.median(one.errors), max(one.errors), np.median(one.alone), one.typical]
    cells = ["–" if np.isnan(error) else f"{100 * error:.3g} %" for error in errors]
    outside = "–" if np.isnan(one.outside) else f"{100 * one.outside:.0f} %"
    return [one.name, *cells, outside, f"{1e3 * one.seconds:.1f} ms"]


def _draw(readings: list[Reading]) -> Figure:
    figure = Figure(figsize=(10.0, 4.6), layout="constrained")
    axes = figure.subplots()
    # The first and the last lie on each other where interpolation costs nothing.
    widths = [4.0, *(1.6 for _ in readings[1:])]
    for one, width in zip(readings, widths, strict=True):
        share = np.linspace(0, 100, len(one.errors))
        line = axes.plot(
            share,
            sorted(one.errors),
            label=one.name,
            linewidth=width,
            alpha=0.45 if width > 2 else 1.0,
        )
        axes.plot(share, sorted(one.alone), color=line[0].get_color(), linewidth=0.6)
    axes.set(yscale="log", xlabel="share of the poses [%]", ylabel="error of the drive")
    axes.yaxis.set_major_formatter(FuncFormatter(lambda error, _: f"{100 * error:g} %"))
    axes.grid(axis="y", color="0.92")
    figure.legend(loc="outside right", fontsize=8, frameon=False)  # pyright: ignore[reportArgumentType]
    return figure
