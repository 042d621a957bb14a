"""Separately factorised bodies, for foci that change and bodies that move rigidly.

Each body is reduced once (``reduced_body``). The skeletons of the placed bodies scatter each
other's fields and radiate the field around the bodies.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Complex, Complex128, Float64

from airtact import _kernels
from airtact.acoustics.scene import Scene, check_sources
from airtact.acoustics.solvers.bem.layer_potentials import double_layer_transposed, project_contacts
from airtact.acoustics.solvers.bem.quadrature import CONTACT_REACH
from airtact.acoustics.solvers.bem.reduced_body import (
    Matrix,
    ReducedBody,
    product,
    rounded,
)
from airtact.acoustics.solvers.problem import (
    RadiatedField,
    Solver,
    SolveReport,
    SurfaceField,
)
from airtact.acoustics.solvers.shared import (
    GmresResult,
    Mask,
    NodeValues,
    Points,
    Pressures,
    SourcePoints,
    Strengths,
    Vectors,
    gmres,
    monopole_pressure,
)
from airtact.acoustics.sources import Monopoles
from airtact.errors import InvalidInput, counted, one_line
from airtact.geometry.panels import LARGEST_TO_POINT, LONGEST_TO_EQUILATERAL
from airtact.geometry.pose import Pose
from airtact.geometry.surface import rigid_motion
from airtact.timing import Clock


@dataclass(frozen=True, eq=False)
class PlacedBody:
    """A reduced body and its pose, which maps the body's frame to the scene's frame."""

    reduced: ReducedBody
    pose: Pose

    @cached_property
    def local(self) -> Pose:
        """Pose that maps the scene's frame to the body's frame."""
        return self.pose.inverse()

    @cached_property
    def ball(self) -> tuple[Float64[np.ndarray, "3"], float]:
        """Centre and radius of a ball that contains all nodes [m]."""
        tree = self.reduced.tree
        centre = self.pose.apply(0.5 * (tree.mins + tree.maxes))
        return centre, 0.5 * float(np.linalg.norm(tree.maxes - tree.mins))

    def clear_of(self, points: Points, reach: float) -> bool:
        """Return whether all points are more than ``reach`` [m] from the ball around the nodes."""
        centre, radius = self.ball
        offset = points - centre
        squares = np.einsum("pd,pd->p", offset, offset)
        return bool(squares.min(initial=np.inf) > (radius + reach) ** 2)

    def reaches(self, points: Points) -> Mask:
        """Return a mask of the points so close to the body that its reduced nodes are inaccurate.

        The reduced nodes (skeletons) represent the body accurately only at a distance.
        """
        reach = self.reduced.reach
        near = self.in_box(points, reach)
        if near.any():
            local = self.local.apply(points[near])
            near[near] = np.isfinite(self.reduced.tree.query(local, distance_upper_bound=reach)[0])
        return near

    def in_box(self, points: Points, beyond: float = 0.0) -> Mask:
        """Return a mask of the points in the body's bounding box, extended by ``beyond`` [m]."""
        tree = self.reduced.tree
        local = self.local.apply(points)
        return ((local > tree.mins - beyond) & (local < tree.maxes + beyond)).all(axis=1)

    def right_side(
        self,
        positions: SourcePoints,
        strengths: Strengths,
        contact: Bool[np.ndarray, "sources"],
    ) -> NodeValues:
        """Return the right-hand side at all nodes; ``contact`` marks monopoles on the surface."""
        surface = self.reduced.surface
        return double_layer_transposed(
            self.local.apply(positions),
            surface.nodes,
            strengths,
            surface.wavenumber,
            near_rule=surface.near_rule,
            precision=surface.precision,
            contact=contact,
        )

    def coupling_from(self, source: "PlacedBody") -> Complex[np.ndarray, "rows columns"]:
        """Return the matrix −D(x) + i D(x') from the columns of ``source`` to this body's rows.

        The rows and columns belong to the skeletons of the bodies, and D is the double layer.
        """
        count = len(self.reduced.rows)
        points = self.pose.apply(self.reduced.row_points)
        nodes, normals, single = source.reduced.column_nodes
        layer = _kernels.Layer(
            source.pose.apply(nodes),
            source.pose.rotate(normals),
            single,
            complex(self.reduced.surface.wavenumber),
        )
        precision = self.reduced.surface.precision
        return _kernels.dual_matrix(points[:count], points[count:], layer, precision)


@dataclass(frozen=True, eq=False)
class Coupling:
    """Matrix blocks for the sound that each body receives from each of the other bodies."""

    placed: tuple[PlacedBody, ...]
    blocks: dict[tuple[int, int], Complex[np.ndarray, "rows columns"]]

    @classmethod
    def of(cls, placed: Sequence[PlacedBody]) -> "Coupling | None":
        """Compute the blocks; return None if skeletons are inaccurate, as for close bodies."""
        for index, first in enumerate(placed):
            for second in placed[:index]:
                points = second.pose.apply(second.reduced.surface.nodes.points)
                if first.reaches(points).any():
                    return None
        blocks = {
            (receiver, emitter): placed[receiver].coupling_from(placed[emitter])
            for receiver in range(len(placed))
            for emitter in range(len(placed))
            if receiver != emitter
        }
        return cls(tuple(placed), blocks)

    def times(
        self, densities: Complex[np.ndarray, "excitations rows"]
    ) -> Complex[np.ndarray, "excitations rows"]:
        """Return y_b + Σ_c S_b K_cbᵀ y_c, the left-hand side of the equation for the densities y.

        S_b is the scattering matrix of body b, and K_cb the block from body c to body b. The sum is
        over all other bodies c.
        """
        out = densities.copy()
        for body, rows in enumerate(self.parts):
            # This is the field of the other bodies at this body's columns, then its scattering.
            incident = [
                product(self.blocks[emitter, body], densities[:, part], transposed=True)
                for emitter, part in enumerate(self.parts)
                if emitter != body
            ]
            if incident:
                total = incident[0] if len(incident) == 1 else np.sum(incident, axis=0)
                out[:, rows] += product(self.placed[body].reduced.scattering, total)
        return out

    @cached_property
    def parts(self) -> list[slice]:
        """Slice of each body's entries in the vector of all densities."""
        ends = np.cumsum([len(body.reduced.rows) for body in self.placed]).tolist()
        return [slice(begin, end) for begin, end in pairwise([0, *ends])]


@dataclass(frozen=True, eq=False, repr=False)
class FactorisedField(RadiatedField):
    """The field of monopoles around factorised bodies, known only away from the surfaces.

    Attributes
    ----------
    densities : strengths of the skeletons' monopoles, which radiate the scattered field [Pa·m].
    factors : factor for the strength of each source: 1 away from the surfaces, and 2 on a surface,
        where the source coincides with its mirror image.
    """

    placed: tuple[PlacedBody, ...]
    densities: Complex128[np.ndarray, "rows excitations"]
    factors: Float64[np.ndarray, "sources"]

    @property
    def on_surface(self) -> SurfaceField:
        """Raise ``InvalidInput``, because reduced bodies have no pressure on their surfaces."""
        raise InvalidInput(
            "the pressure on the surfaces of factorised bodies is not available; solve the scene "
            "with BoundaryElement.",
            code="not_supported",
        )

    def _valid(self, points: Vectors) -> Mask:
        # The field is valid outside the bodies and beyond the reach of their skeletons.
        if all(body.clear_of(points, body.reduced.reach) for body in self.placed):
            return np.ones(len(points), dtype=bool)
        valid = ~np.any([body.reaches(points) for body in self.placed], axis=0)
        within = valid & np.any([body.in_box(points) for body in self.placed], axis=0)
        valid[within] = self.scene.depth(points[within]) < 0
        return valid

    def _at(self, points: Vectors) -> Pressures:
        emitted = self.factors[:, None] * self.sources.strengths
        return self._pressure(points, self.sources.positions, emitted)

    def _scattered_at(self, points: Vectors) -> Pressures:
        # A source on a surface has an image there, which counts as scattering.
        image = self.factors > 1
        return self._pressure(points, self.sources.positions[image], self.sources.strengths[image])

    def _pressure(
        self, points: Vectors, positions: SourcePoints, strengths: Strengths
    ) -> Pressures:
        valid = self._valid(points)
        inside = points if valid.all() else points[valid]
        wavenumber = self.scene.wavenumber
        precision = self.placed[0].reduced.surface.precision
        pressure = monopole_pressure(inside, positions, strengths, wavenumber, "float64")
        scattering, densities = self._scattering(inside)
        pressure += monopole_pressure(inside, scattering, densities, wavenumber, precision)
        if valid.all():
            return pressure
        out = self.nowhere(points)
        out[valid] = pressure
        return out

    def _scattering(
        self, points: Vectors
    ) -> tuple[Float64[np.ndarray, "sources 3"], Complex[np.ndarray, "sources excitations"]]:
        """Return the monopoles of the scattered field: the skeletons, or fewer for far points."""
        positions = []
        strengths = []
        begin = 0
        for body in self.placed:
            reduced = body.reduced
            far = reduced.far
            density = self.densities[begin : begin + len(reduced.rows)]
            begin += len(density)
            # Fewer monopoles are enough for far receivers, such as an array.
            if body.clear_of(points, far.reach):
                positions.append(body.pose.apply(far.positions))
                strengths.append(product(far.combinations, density.T).T)
            else:
                positions.append(body.pose.apply(reduced.row_points))
                strengths += [density, -1j * density]
        return np.concatenate(positions), np.concatenate(strengths)


@dataclass(frozen=True, eq=False)
class FactorisedBodies(Solver):
    """Solver for bodies that were factorised separately and may be in any pose.

    ``BoundaryElement.factorised`` creates it. Use it like any other solver, for scenes with the
    same bodies in any poses, the same medium and the same frequency. Each body is reduced to a
    scattering matrix between some of its nodes. ``radiate`` couples these matrices by iteration, so
    other poses and sources need no new factorisation. Its fields are only known away from the
    bodies.

    Attributes
    ----------
    scene : the bodies in the poses in which they were factorised.
    bodies : the reduced bodies, in the order of ``scene.obstacles``.
    fallback : solver for scenes in which two bodies are too close together for the coupling.
    tolerance : relative residual at which the iteration over the bodies stops, a tenth of the
        solver's ``accuracy``.
    smallest : edge length at which the refinement of panels stopped [m].
    report : ``SolveReport`` of the factorisation.
    """

    scene: Scene
    bodies: tuple[ReducedBody, ...]
    fallback: Solver
    tolerance: float
    smallest: float
    report: SolveReport

    def __repr__(self) -> str:
        return one_line(
            self, counted(len(self.bodies), "body", "bodies"), f"{self.report.nodes} unknowns"
        )

    def radiate(self, scene: Scene, sources: Monopoles) -> RadiatedField:
        """Compute the field of the monopoles, with each body in its pose in the scene.

        The scene must contain the factorised bodies, in any poses, and must have the medium and the
        frequency for which they were factorised. The monopoles must be outside the bodies or on
        their surfaces. If two bodies are too close together for this method, ``fallback`` solves
        the scene.

        Returns
        -------
        The field around the bodies, which is known only away from their surfaces.

        Raises
        ------
        InvalidInput
            If the bodies, the medium or the frequency differ from those of the factorisation, or if
            a source is inside a body.
        NotConverged
            If the iteration over the bodies does not reach the tolerance.
        """
        check_sources(scene, sources)
        clock = Clock()
        with clock.step("bodies"):
            coupling = self._coupling(scene)
            if coupling is None:
                return self.fallback.radiate(scene, sources)
            placed = coupling.placed
            sources, factors = _projected(scene, placed, sources)
            strengths = factors[:, None] * sources.strengths
            right_sides = [
                body.right_side(sources.positions, strengths, factors > 1).T for body in placed
            ]
            # The products run one after another, because threads would go idle between them.
            alone = [
                product(body.reduced.solved, side)
                for body, side in zip(placed, right_sides, strict=True)
            ]
            densities = np.concatenate(alone, axis=1)
            if coupling is self._at_rest:
                # Bodies that have not moved need no iteration.
                inverse, residual = self._inverse
                solution = product(inverse, densities, transposed=True)
                result = GmresResult(solution, np.full(len(densities), residual), 0)
            else:
                result = gmres(coupling.times, densities, self.tolerance)
        report = replace(
            self.report,
            residual=float(result.residuals.max()),
            iterations=result.iterations,
            seconds=clock.seconds,
            warnings=(*self.report.warnings, *self._coarse(placed, sources)),
        )
        return FactorisedField(
            scene, sources, report, placed, result.solution.T.astype(np.complex128), factors
        )

    def _coarse(self, placed: Sequence[PlacedBody], sources: Monopoles) -> Iterator[str]:
        for index, body in enumerate(placed):
            distance, node = body.reduced.tree.query(body.local.apply(sources.positions))
            edges = body.reduced.panel_edges[np.asarray(node) // 6]
            allowed = np.maximum(
                LONGEST_TO_EQUILATERAL * self.smallest, LARGEST_TO_POINT * np.asarray(distance)
            )
            for source in np.flatnonzero(edges > 1.001 * allowed):
                yield (
                    f"source {source} is {1e3 * distance[source]:.2g} mm from a node of body "
                    f"{index}, where panels are {1e3 * edges[source]:.2g} mm long, so the error "
                    "of its field may exceed the accuracy. Include this point in refined when you "
                    "factorise the bodies."
                )

    @cached_property
    def _inverse(self) -> tuple[Matrix, float]:
        """Inverse of the coupling of the bodies as factorised, and its largest residual."""
        assert self._at_rest is not None
        count = sum(len(body.rows) for body in self.bodies)
        matrix = self._at_rest.times(np.eye(count, dtype=self.bodies[0].solved.dtype))
        inverse = rounded(np.linalg.inv(matrix), self.tolerance)
        residual = product(inverse, matrix.T).T - np.eye(count)
        return inverse, float(np.linalg.norm(residual, axis=1).max())

    @cached_property
    def _at_rest(self) -> Coupling | None:
        return Coupling.of([PlacedBody(body, Pose.identity()) for body in self.bodies])

    def _coupling(self, scene: Scene) -> Coupling | None:
        """Return the coupling of the bodies in the scene, or None if two are too close."""
        if scene.medium != self.scene.medium or scene.frequency != self.scene.frequency:
            raise InvalidInput(
                f"the bodies were factorised for {self.scene.frequency:g} Hz in "
                f"{self.scene.medium}, but the scene is at {scene.frequency:g} Hz in "
                f"{scene.medium}. Factorise the bodies for this scene.",
                code="not_supported",
            )
        if len(scene.obstacles) != len(self.bodies):
            raise InvalidInput(
                f"{counted(len(self.bodies), 'body was', 'bodies were')} factorised, but the scene "
                f"has {len(scene.obstacles)}; factorise the bodies of this scene.",
                code="not_supported",
            )
        placed = []
        rest = []
        for index, (before, after) in enumerate(
            zip(self.scene.obstacles, scene.obstacles, strict=True)
        ):
            same = (before.boundary, before.ratio) == (after.boundary, after.ratio)
            pose, off = rigid_motion(before.surface, after.surface)
            # Vertices may deviate by a thousandth of the wavelength.
            if not same or off > 1e-3 * self.scene.wavelength:
                raise InvalidInput(
                    f"body {index} differs from the factorised body by more than a rigid motion. "
                    "Factorise the scene again, or solve it with BoundaryElement.",
                    code="not_supported",
                )
            placed.append(PlacedBody(self.bodies[index], pose))
            rest.append(before.surface is after.surface)
        return self._at_rest if all(rest) else Coupling.of(placed)


def _projected(
    scene: Scene, placed: Sequence[PlacedBody], sources: Monopoles
) -> tuple[Monopoles, Float64[np.ndarray, "sources"]]:
    """Project sources that touch a surface onto a panel; return them and a factor for each.

    The factor is 2 for these sources, because each coincides with its image, and 1 otherwise.
    """
    positions = np.array(sources.positions)
    factors = np.ones(len(positions))
    limit = CONTACT_REACH * max(body.reduced.surface.nodes.contact.max() for body in placed)
    if (np.abs(scene.depth(positions)) >= limit).all():
        return sources, factors
    for body in placed:
        local, contact = project_contacts(body.reduced.surface.nodes, body.local.apply(positions))
        positions[contact] = body.pose.apply(local[contact])
        factors[contact] = 2.0
    return replace(sources, positions=positions) if (factors > 1).any() else sources, factors
