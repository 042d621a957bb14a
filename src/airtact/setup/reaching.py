"""The largest pressure that an array can produce at each point of the skin."""

import csv
import io
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Float64, Int64
from scipy.spatial import KDTree

from airtact.acoustics.scene import before_planes
from airtact.acoustics.solvers.bem.solver import BoundaryElement
from airtact.acoustics.solvers.problem import SolveReport
from airtact.acoustics.target import Beacons
from airtact.drives.drive import Drive
from airtact.drives.transfer import TransferMatrix, transfer_to
from airtact.errors import InvalidInput, between, counted, of_kind, one_line
from airtact.evaluation.slices import fine_meshes
from airtact.files.atomic import whole_file
from airtact.setup.setup import Setup
from airtact.timing import Progress, no_progress
from airtact.touch.skin import skin_of

Points = Float64[np.ndarray, "points 3"]
Vertices = Float64[np.ndarray, "vertices 3"]


@dataclass(frozen=True, eq=False, repr=False)
class ReachMap:
    """The largest pressure that any drive can produce at points all over the skin.

    ``reach`` returns it. The attribute ``bounds`` contains this pressure for each of the P
    positions in the attribute ``points``.

    Attributes
    ----------
    setup : scene and array.
    vertices, vertex_normals : (V, 3) vertices on the skin of all bodies in the frame of the scene
        [m], and outward unit normals.
    triangles : (T, 3) indices of the vertices of each triangle.
    chosen : (P,) indices of the vertices at which the pressure was computed.
    places : for each chosen vertex, the name of its part of the skin, such as "index", "palm" or a
        body's name.
    transfer : (P, E) transfer matrix for the chosen vertices and the E elements.
    report : report of the solve for the transfer matrix.
    """

    setup: Setup
    vertices: Vertices
    vertex_normals: Vertices
    triangles: Int64[np.ndarray, "triangles 3"]
    chosen: Int64[np.ndarray, "points"]
    places: tuple[str, ...]
    transfer: TransferMatrix
    report: SolveReport

    def __repr__(self) -> str:
        return one_line(
            self,
            counted(len(self.chosen), "point", "points"),
            f"at most {self.bounds.min():,.0f} to {self.bounds.max():,.0f} Pa",
        )

    @property
    def points(self) -> Points:
        """(P, 3) points at which the pressure was computed [m]."""
        return self.vertices[self.chosen]

    @property
    def normals(self) -> Points:
        """(P, 3) outward unit normals at the points at which the pressure was computed."""
        return self.vertex_normals[self.chosen]

    @cached_property
    def bounds(self) -> Float64[np.ndarray, "points"]:
        """(P,) largest peak pressure [Pa] that any drive can produce at each point."""
        return np.abs(self.transfer.matrix).sum(axis=1)

    def drive(self, point: int) -> Drive:
        """Return the drive that produces the largest pressure at the point with this index."""
        if point not in range(len(self.chosen)):
            raise InvalidInput(
                f"there is no point {point!r}; use an index from 0 to {len(self.chosen) - 1}.",
                code="out_of_range",
            )
        return Drive(np.exp(-1j * np.angle(self.transfer.matrix[point])))

    @property
    def extremes(self) -> list[tuple[str, int, int]]:
        """Name of each part of the skin, with the indices of its weakest and strongest points.

        The parts are sorted by the pressure at their strongest point, highest first.
        """
        names = np.array(self.places)
        parts = [(name, np.flatnonzero(names == name)) for name in dict.fromkeys(self.places)]
        parts.sort(key=lambda part: -self.bounds[part[1]].max())
        return [
            (name, int(part[self.bounds[part].argmin()]), int(part[self.bounds[part].argmax()]))
            for name, part in parts
        ]

    @cached_property
    def on_skin(self) -> Float64[np.ndarray, "vertices"]:
        """(V,) largest peak pressure [Pa] at all vertices, interpolated from the nearest points."""
        # Opposite normals count as 16 mm apart, so that the two sides of a finger do not mix.
        sides = np.column_stack([self.vertices, 8e-3 * self.vertex_normals])
        count = min(6, len(self.chosen))
        found = map(np.asarray, KDTree(sides[self.chosen]).query(sides, k=count))
        distances, nearest = (values.reshape(-1, count) for values in found)
        weights = 1.0 / (distances + 1e-6) ** 2
        return (weights * self.bounds[nearest]).sum(axis=1) / weights.sum(axis=1)

    def table(self) -> list[dict[str, str | float]]:
        """Return one row per point: skin part, x, y, z [m], unit normal, largest pressure [Pa]."""
        columns = ("x", "y", "z", "normal_x", "normal_y", "normal_z", "bound_Pa")
        numbers = np.column_stack([self.points, self.normals, self.bounds])
        return [
            {"place": place, **dict(zip(columns, row, strict=True))}
            for place, row in zip(self.places, numbers.tolist(), strict=True)
        ]

    def save(self, path: str | Path) -> None:
        """Write the rows of ``table`` to a file (.csv); an existing file is replaced."""
        with whole_file(Path(path)) as partial:
            partial.write_text(self.csv, encoding="utf-8", newline="")

    @property
    def csv(self) -> str:
        """The rows of ``table`` as the text of a CSV file."""
        rows = self.table()
        text = io.StringIO()
        table = csv.writer(text)
        table.writerow(rows[0])
        for row in rows:
            table.writerow([x if isinstance(x, str) else f"{x:.6g}" for x in row.values()])
        return text.getvalue()


def reach(
    setup: Setup,
    points: int = 500,
    accuracy: float = 0.03,
    progress: Progress = no_progress,
) -> ReachMap:
    """Compute the largest pressure that an array can produce at points all over the skin.

    Scattering by the bodies is included. By reciprocity, one solve with a source at each point
    yields the pressure that every element produces there. The bound at a point is the sum of the
    magnitudes of these pressures: all elements are at full scale and in phase there. Gains and dead
    elements are included. No drive exceeds the bound, and a drive can in general only reach it at
    one point at a time. Use the map to find places on the skin where a focus can be strong.

    Parameters
    ----------
    setup : scene and array; the foci are ignored.
    points : number of points, from 1 to 5,000, spread evenly over the skin.
    accuracy : requested relative error of the pressures, 0.001 to 0.3, if the solver is
        ``BoundaryElement``. Other solvers keep their own accuracy.
    progress : function called with a description of each step as it begins.

    Returns
    -------
    A ``ReachMap`` with the skin of all bodies, the ``points`` in the frame of the scene [m], and
    the largest peak pressure at each point, ``bounds`` [Pa]. Skin that no sound reaches, as in a
    crevice or behind a plane, gets no points.

    Raises
    ------
    InvalidInput
        If the scene contains no body other than reflecting boards, or a parameter is outside its
        range.
    NotConverged
        If the solver stops before it converges.

    Examples
    --------
    >>> import airtact as at
    >>> ball = at.Scene(at.air(), [at.sound_hard(at.sphere(0.01, 2e-3))])
    >>> above = at.Target((0.0, 0.0, 0.011))
    >>> board = at.autd3_board().facing((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 0.2)
    >>> result = at.reach(at.Setup(ball, board, above), points=40, accuracy=0.06)
    >>> bool(result.points[result.bounds.argmax(), 2] > 0.0)  # towards the board
    True
    """
    import trimesh  # imported here because the import takes as long as that of airtact

    of_kind(setup, Setup, "the setup", "read_scene(path)")
    if not isinstance(points, int | np.integer) or not 1 <= points <= 5000:
        raise InvalidInput(
            f"the number of points is {points!r}: use a whole number from 1 to 5000.",
            code="out_of_range",
        )
    scene = setup.scene
    surfaces = {
        name: obstacle.surface
        for name, obstacle in zip(setup.bodies, scene.obstacles, strict=True)
        if not obstacle.board
    }
    if not surfaces:
        raise InvalidInput(
            "the scene contains no body, so there is no skin to map: add a hand or another body.",
            code="empty",
        )
    progress(f"spreading {counted(points, 'point', 'points')} over the skin")
    vertices, triangles, body = fine_meshes([*surfaces.values()], 0.3 * scene.wavelength)
    normals = np.array(trimesh.Trimesh(vertices, triangles, process=False).vertex_normals)
    beside = vertices + 0.5e-3 * normals
    # Skin in a crevice, in contact with another body, or behind a plane receives no sound.
    candidates = np.flatnonzero(
        (scene.depth(beside) < -0.1e-3) & before_planes(scene.planes, beside)
    )
    chosen = candidates[_spread(vertices[candidates], points)]
    for index, surface in enumerate(surfaces.values()):
        # The triangles of the mesh are flat, but the bodies are curved.
        own = chosen[body[chosen] == index]
        vertices[own] = surface.shape.project(vertices[own])
    solver = setup.solver.reporting(progress)
    if isinstance(solver, BoundaryElement):
        accuracy = between(accuracy, 1e-3, 0.3, "the accuracy", "", "use a number such as 0.03.")
        solver = replace(solver, accuracy=accuracy, estimate=False)
    # These beacons are not foci, so panels are not refined around them. On the skin, coarse panels
    # cause an error of 1 %; half a millimetre above it, the error would be 2 %.
    beacons = solver.radiate(scene, Beacons(vertices[chosen], np.eye(len(chosen), dtype=complex)))
    progress(f"evaluating the beacons at {counted(len(setup.array), 'element', 'elements')}")
    transfer = transfer_to(beacons, setup.array)
    names = [*surfaces]
    places = _parts(setup, vertices[chosen], [names[index] for index in body[chosen]])
    return ReachMap(setup, vertices, normals, triangles, chosen, places, transfer, beacons.report)


def _spread(points: Points, count: int) -> list[int]:
    """Return the indices of ``count`` points, each as far as possible from all earlier ones."""
    chosen = [0]
    distance = np.full(len(points), np.inf)
    for _ in range(min(count, len(points)) - 1):
        distance = np.minimum(distance, np.linalg.norm(points - points[chosen[-1]], axis=1))
        chosen.append(int(distance.argmax()))
    return chosen


def _parts(setup: Setup, points: Points, bodies: list[str]) -> tuple[str, ...]:
    """Return the name of the part of the hand, or of the body, at each point."""
    names = np.array(bodies, dtype=object)
    for hand in setup.hands:
        parts = skin_of(hand, 10e-3)
        # A scanned skin deviates by a few millimetres from the skin given by its joints.
        away, nearest = map(np.asarray, KDTree(parts.points).query(points))
        near = away < 10e-3
        side = f"{hand.side}." if len(setup.hands) > 1 else ""
        names[near] = [side + parts.places[parts.place[index]] for index in nearest[near]]
    return tuple(names)
