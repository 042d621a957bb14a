"""The transfer matrix of one sample: evaluated from one solve, or solved with its bodies where they are.

Before a rigid plane one solve serves the samples whose hands see the plane at the same place: those
that were shifted along it or turned about its normal. All others are solved, in air as warm as
theirs is.
"""

from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import islice
from typing import TypeVar

import numpy as np
from jaxtyping import Complex128, Float64, Int64, Real

from airtact.acoustics.planes import Plane
from airtact.acoustics.scene import Scene, check_no_boards
from airtact.acoustics.solvers.free_field import FreeField
from airtact.acoustics.solvers.problem import RadiatedField, Solver
from airtact.acoustics.solvers.spherical.multipole_field import (
    MultipoleField,
    ball_of,
    multipole_expansion,
)
from airtact.acoustics.sources import Monopoles
from airtact.acoustics.target import Beacons
from airtact.acoustics.target_points import frame_of, outward
from airtact.acoustics.uncertainty import Uncertainty
from airtact.checks import counted, of_kind
from airtact.drives.sampling.draws import Draw, draws
from airtact.drives.transfer import transfer_matrix
from airtact.errors import InvalidInput
from airtact.geometry.pose import Pose
from airtact.printing import in_short
from airtact.transducers.boards import kind_of_array
from airtact.transducers.layout import PhasedArray, join
from airtact.transducers.placement import check_placement

LEFT_OUT = {
    "bodies_overlap",
    "inside_body",
    "behind_faces",
    "out_of_range",
    "behind_plane",
}
"""Faults of a sample that cannot be; it is left out."""

ANGLES = 400
"""Angles at which the pattern of an element is tabulated."""

SAME_PLANE = 9
"""Decimals of a plane's normal, and of its distance [m], up to which two hands see it at the same place."""

WORTH_EXPANDING = 4
"""Samples from which on a field that serves them all is expanded."""

AT_ONCE = 16
"""Samples that are evaluated together."""

Ball = tuple[Float64[np.ndarray, "3"], float]
"""Centre and radius of a ball around all bodies [m]."""

Made = TypeVar("Made")

Groups = tuple[Int64[np.ndarray, "group"], ...]
"""Indices of the foci that move together."""


@dataclass(frozen=True, eq=False)
class Sampled:
    """What all samples share.

    Attributes
    ----------
    field : of the beacons, as a multipole expansion where there are bodies.
    array : the transducers.
    pieces : its boards where they are in doubt, else none.
    uncertainty : what is drawn from.
    solver : for bodies that move by themselves, and for hands that move towards a plane; or None.
    groups : foci that move together.
    bodies : (F,) the body that each focus is nearest to; 0 in open air.
    middle : (3,) of the foci [m], about which the hand turns.
    ball : around the bodies, or None.
    remainder : (F, E) what the nominal matrix has beyond centres and directivity, over its carrier
        wave [Pa].
    """

    field: RadiatedField
    array: PhasedArray
    pieces: tuple[PhasedArray, ...]
    uncertainty: Uncertainty
    solver: Solver | None
    groups: Groups
    bodies: Int64[np.ndarray, "foci"]
    middle: Float64[np.ndarray, "3"]
    ball: Ball | None
    remainder: Complex128[np.ndarray, "foci elements"]

    __repr__ = in_short

    @cached_property
    def pattern(self) -> tuple[Float64[np.ndarray, "angles"], Float64[np.ndarray, "angles"]]:
        """Sines of angles off an element's axis, and its far pressure there over that on the axis."""
        sines = np.linspace(0.0, 1.0, ANGLES)
        directions = np.stack([sines, np.zeros(ANGLES), np.sqrt(1.0 - sines**2)], axis=1)
        return sines, np.real(
            self.array.element.far_pattern(directions, self.field.scene.wavenumber.real)
        )

    @property
    def together(self) -> bool:
        """Whether all foci move as one."""
        doubt = self.uncertainty
        return not (doubt.own_position or doubt.own_rotation or doubt.along_skin)

    @classmethod
    def of(
        cls,
        beacons: RadiatedField,
        array: PhasedArray,
        nominal: Complex128[np.ndarray, "foci elements"],
        uncertainty: Uncertainty,
        solver: Solver | None,
    ) -> "Sampled":
        """Prepare what the samples need; ``nominal`` is the matrix with nothing in doubt."""
        if solver is not None:
            of_kind(solver, Solver, "the solver", "BoundaryElement()")
        scene, foci = beacons.scene, beacons.sources.positions
        check_no_boards(scene, "an ensemble, whose hands move against it,")
        if scene.planes and not scene.obstacles:
            solver = FreeField()
        felt = beacons.sources.foci if isinstance(beacons.sources, Beacons) else len(foci)
        by_themselves = bool(uncertainty.own_position or uncertainty.own_rotation)
        moving = scene.obstacles and (by_themselves or uncertainty.along_skin)
        solved = solver if moving or scene.planes else None
        expand = scene.obstacles and solved is None and not isinstance(beacons, MultipoleField)
        bodies = _nearest_bodies(scene, foci)
        field = multipole_expansion(beacons) if expand else beacons
        ball = (
            field.ball
            if isinstance(field, MultipoleField)
            else ball_of(scene)
            if scene.obstacles
            else None
        )
        sampled = cls(
            field,
            array,
            _boards(array) if uncertainty.board_position or uncertainty.board_rotation else (),
            uncertainty,
            solved,
            _groups(bodies, by_themselves, bool(uncertainty.along_skin)),
            bodies,
            foci[:felt].mean(axis=0),
            ball,
            np.zeros_like(nominal),
        )
        if solved is not None or scene.planes:
            return sampled
        alone, carrier = sampled._centres([(array, Pose.identity(), 1.0)], np.arange(len(foci)))
        return replace(sampled, remainder=(nominal - alone[0] * array.gains) / carrier[0])

    def draw(self, samples: int, seed: int) -> Iterator[Draw]:
        """Draw samples; with a solver each body has a motion of its own, else each group of foci."""
        foci, groups = self.field.sources.positions, self.groups
        pivots = [foci[group].mean(axis=0) for group in groups]
        if self.solver is not None and self.field.scene.obstacles:
            held = [foci[self.bodies == body] for body in range(len(self.field.scene.obstacles))]
            whole = [one.surface.vertices for one in self.field.scene.obstacles]
            pivots = [
                (some if len(some) else vertices).mean(axis=0)
                for some, vertices in zip(held, whole, strict=True)
            ]
        boards = [piece.positions.mean(axis=0) for piece in self.pieces]
        return draws(self.uncertainty, samples, seed, self.middle, pivots, len(foci), boards)

    def at_rest(self, pose: Pose, slower: float) -> Draw:
        """Draw nothing but a motion of the whole hand and a scale of the wavenumber."""
        still = (Pose.identity(),) * len(self.groups)
        return Draw(pose, still, np.zeros((len(self.field.sources.positions), 2)), (), slower)

    def matrices(
        self, given: Iterable[Draw]
    ) -> Iterator[Complex128[np.ndarray, "foci elements"] | None]:
        """Transfer matrix of each draw; None where it cannot be."""
        if self.field.scene.planes:
            yield from self._before_planes(list(given))
            return
        if self.solver is not None:
            for one in given:
                yield _unless_left_out(self._solved, one)
            return
        rest = iter(given)
        while some := list(islice(rest, AT_ONCE)):
            places = [_unless_left_out(self._places, one) for one in some]
            found = iter(self._evaluated([place for place in places if place is not None]))
            yield from (None if place is None else next(found) for place in places)

    def _array(self, draw: Draw) -> PhasedArray:
        if not self.pieces:
            return self.array
        return join(
            [piece.moved(pose) for piece, pose in zip(self.pieces, draw.boards, strict=True)]
        )

    def _places(self, draw: Draw) -> tuple[PhasedArray, Sequence[Pose], float]:
        """Return the array of a draw and the motion of each group of foci, which must keep them off each other."""
        array, foci = self._array(draw), self.field.sources.positions
        poses = [draw.hand] * len(self.groups)
        if not self.together:
            shifts = (
                along_skin(self.field.scene, foci, draw.skin)
                if draw.skin.any()
                else np.zeros_like(foci)
            )
            owns = zip(draw.own, self.groups, strict=True)
            poses = [
                draw.hand @ Pose(own.rotation, own.translation + shifts[group[0]])
                for own, group in owns
            ]
        for pose, group in zip(poses, self.groups, strict=True):
            _check(self.field.scene, array, pose, foci[group], self.ball)
        return array, poses, draw.slower

    def _evaluated(
        self, places: Sequence[tuple[PhasedArray, Sequence[Pose], float]]
    ) -> Complex128[np.ndarray, "samples foci elements"]:
        """Evaluate the solved field at the array from where each group of foci sees it, for several draws at once."""
        rows = np.empty((len(places), *self.remainder.shape), dtype=np.complex128)
        for number, group in enumerate(self.groups if places else ()):
            seen = [(array, poses[number], slower) for array, poses, slower in places]
            alone, carrier = self._centres(seen, group)
            rows[:, group] = alone * self.array.gains + self.remainder[group] * carrier
        return rows

    def _centres(
        self, seen: Sequence[tuple[PhasedArray, Pose, float]], group: Int64[np.ndarray, "group"]
    ) -> tuple[
        Complex128[np.ndarray, "samples group elements"],
        Complex128[np.ndarray, "samples group elements"],
    ]:
        """Pressure at the centres of the elements times their directivity towards each focus; and a wave from there.

        That costs a twelfth of the mean over their faces. What it lacks is taken from the nominal
        matrix.
        """
        element, wavenumber = self.array.element, self.field.scene.wavenumber
        slower = np.array([[[factor]] for _, _, factor in seen])
        turned = [(array.positions - pose.translation) @ pose.rotation for array, pose, _ in seen]
        points = self.middle + slower * (np.stack(turned) - self.middle)
        foci = self.middle + slower * (self.field.sources.positions[group] - self.middle)
        away = points[:, None] - foci[:, :, None]
        distance = np.sqrt(np.einsum("sfed,sfed->sfe", away, away))
        carrier = slower * np.exp(1j * wavenumber * distance) / distance
        received = (
            _columns(self.field, points.reshape(-1, 3), group)
            .reshape(*points.shape[:2], -1)
            .transpose(0, 2, 1)
        )
        if len(element.weights) > 1:
            normals = np.stack([array.normals @ pose.rotation for array, pose, _ in seen])
            cosines = np.einsum("sfed,sed->sfe", away, normals) / distance
            sines = slower * np.sqrt(np.maximum(1.0 - cosines**2, 0.0))
            received = received * np.interp(sines, *self.pattern)
        return slower * element.sensitivity * received, carrier

    def _solved(self, draw: Draw) -> Complex128[np.ndarray, "foci elements"]:
        """Solve the scene with its bodies where they are by themselves."""
        assert self.solver is not None
        there, foci = self._moved(draw, self.field.scene)
        array = self._array(draw)
        field = self.solver.radiate(there, Monopoles(foci, self.field.sources.strengths))
        _check(there, array, draw.hand, foci, ball_of(there))
        element, faces = array.element, array.face_points
        points = (faces.reshape(-1, 3) - draw.hand.translation) @ draw.hand.rotation
        points = self.middle + draw.slower * (points - self.middle)
        received = field.at(points).reshape(*faces.shape[:2], -1)
        means = np.einsum("eqf,q->fe", received, element.weights)
        return draw.slower * element.sensitivity * means * array.gains

    def _moved(self, draw: Draw, scene: Scene) -> tuple[Scene, Float64[np.ndarray, "foci 3"]]:
        """Move the bodies of a scene, and the foci, by what each of them is off by itself."""
        foci = self.field.sources.positions
        if self.together:
            return scene, foci
        carried = self.bodies if scene.obstacles else np.arange(len(foci))
        pairs = zip(scene.obstacles, draw.own, strict=False)
        there = replace(
            scene, obstacles=[replace(one, surface=one.surface.moved(pose)) for one, pose in pairs]
        )
        foci = np.stack(
            [draw.own[own].apply(point) for own, point in zip(carried, foci, strict=True)]
        )
        if draw.skin.any():
            shifted = foci + along_skin(there, foci, draw.skin)
            deeper = there.depth(shifted) - there.depth(foci)
            foci = shifted + deeper[:, None] * outward(there.depth, shifted)
        return there, foci

    def _before_planes(
        self, given: Sequence[Draw]
    ) -> Iterator[Complex128[np.ndarray, "foci elements"] | None]:
        """Transfer matrices before a plane, by one field for all hands that see it at the same place."""
        alike: dict[Hashable, list[int]] = {}
        for index, draw in enumerate(given):
            alike.setdefault(self._seen(draw) if self.together else index, []).append(index)
        found: list[Complex128[np.ndarray, "foci elements"] | None] = [None] * len(given)
        for some in alike.values():
            field = _unless_left_out(self._over_plane, given[some[0]])
            if field is None:
                continue
            if (
                len(some) >= WORTH_EXPANDING
                and field.scene.obstacles
                and not isinstance(field, MultipoleField)
            ):
                field = multipole_expansion(field)
            for index in some:
                found[index] = _unless_left_out(partial(self._at_array, field), given[index])
        yield from found

    def _seen(self, draw: Draw) -> Hashable:
        """Return what tells the planes that hands see, and their air, from one another."""
        seen = [_plane_seen(plane, draw.hand) for plane in self.field.scene.planes]
        numbers = [(*one.normal, one.height(np.zeros((1, 3)))[0]) for one in seen]
        return draw.slower, *(np.round(np.concatenate(numbers), SAME_PLANE) + 0.0).tolist()

    def _over_plane(self, draw: Draw) -> RadiatedField:
        """Return the field of the foci of a draw in the frame of its hand: that of the beacons, or a solved one."""
        scene, sources = self.field.scene, self.field.sources
        planes = [_plane_seen(plane, draw.hand) for plane in scene.planes]
        stayed = all(one is before for one, before in zip(planes, scene.planes, strict=True))
        if stayed and self.together and draw.slower == 1.0:
            return self.field
        if self.solver is None:
            raise InvalidInput(
                f"a sample before {counted(len(planes), 'plane', 'planes')} in which the hand is lifted or tilted, or "
                "bodies, foci or air are others, is another scene: give solver=BoundaryElement(), which solves each, "
                "or leave these doubts out.",
                code="not_converged",
            )
        medium = replace(scene.medium, sound_speed=scene.medium.sound_speed / draw.slower)
        there, foci = self._moved(draw, replace(scene, medium=medium, planes=planes))
        return self.solver.radiate(there, Monopoles(foci, sources.strengths))

    def _at_array(
        self, field: RadiatedField, draw: Draw
    ) -> Complex128[np.ndarray, "foci elements"]:
        """Evaluate a field in the frame of the hand of a draw at the array."""
        return transfer_matrix(field, self._array(draw).seen_from(draw.hand)).matrix


def _plane_seen(plane: Plane, hand: Pose) -> Plane:
    """Return a plane in the frame of a hand that was moved: the plane itself after motions that keep it."""
    return plane if plane.kept_by(hand) else plane.moved(hand.inverse())


def _unless_left_out(make: Callable[[Draw], Made], draw: Draw) -> Made | None:
    """Make something of a draw; None where the draw cannot be."""
    try:
        return make(draw)
    except InvalidInput as fault:
        if fault.code not in LEFT_OUT:
            raise
        return None


def along_skin(
    scene: Scene, foci: Real[np.ndarray, "foci 3"], shifts: Real[np.ndarray, "foci 2"]
) -> Float64[np.ndarray, "foci 3"]:
    """Turn shifts in two directions along the surface to shifts of foci (F, 3) [m]."""
    frames = np.stack([np.stack(frame_of(normal)[:2]) for normal in outward(scene.depth, foci)])
    return np.einsum("fi,fid->fd", shifts, frames)


def _columns(
    field: RadiatedField, points: Float64[np.ndarray, "points 3"], group: Int64[np.ndarray, "group"]
) -> Complex128[np.ndarray, "points group"]:
    """Pressure of some of the beacons at points, by the part of an expansion that they need."""
    sources = field.sources
    if len(group) == len(sources.positions) or not isinstance(field, MultipoleField):
        return field.at(points)[:, group]
    away = np.linalg.norm(points - field.spheres.centre, axis=1)
    if away.min() < field.spheres.radius:
        return field.at(points)[:, group]
    values = np.ascontiguousarray(field.spheres.values[..., group])
    some = Monopoles(sources.positions[group], np.eye(len(group)))
    return replace(field, sources=some, spheres=replace(field.spheres, values=values)).at(points)


def _check(
    scene: Scene,
    array: PhasedArray,
    pose: Pose,
    foci: Real[np.ndarray, "group 3"],
    ball: Ball | None,
) -> None:
    """Raise where an element reaches into a body or something is behind a face; at once where all are far away."""
    held, radii = pose.apply(foci), np.zeros(len(foci))
    if ball is not None:
        held, radii = np.vstack([held, pose.apply(ball[0])]), np.append(radii, ball[1])
        apart = np.linalg.norm(array.positions - held[-1], axis=1)
        if apart.min() <= ball[1] + array.element.reach:
            check_placement(scene, array.seen_from(pose), foci)
    heights = held @ array.normals.T - np.sum(array.positions * array.normals, axis=1)
    if array.element.directional and not (heights > radii[:, None]).all():
        check_placement(scene, array.seen_from(pose), foci)


def _nearest_bodies(scene: Scene, foci: Real[np.ndarray, "foci 3"]) -> Int64[np.ndarray, "foci"]:
    """Return the body that each focus is nearest to, 0 in open air."""
    if len(scene.obstacles) < 2:
        return np.zeros(len(foci), dtype=np.int64)
    return np.argmax([one.surface.depth(foci) for one in scene.obstacles], axis=0)


def _groups(bodies: Int64[np.ndarray, "foci"], by_themselves: bool, along_skin: bool) -> Groups:
    """Find the foci that move together: those of a body; each by itself on a single body, as on bones of a hand."""
    if not (by_themselves or along_skin):
        return (np.arange(len(bodies)),)
    if along_skin or len(np.unique(bodies)) == 1:
        return tuple(np.arange(len(bodies))[:, None])
    return tuple(np.flatnonzero(bodies == body) for body in np.unique(bodies))


def _boards(array: PhasedArray) -> tuple[PhasedArray, ...]:
    """Take an array of boards apart."""
    found: Sequence[Pose] = (kind_of_array(array.positions, array.normals) or (None, ()))[1]
    parts = (array.positions, array.normals, array.tangents, array.gains)
    pieces = zip(*(np.split(part, len(found)) for part in parts), strict=True)
    return tuple(
        PhasedArray(positions, normals, array.element, tangents, gains)
        for positions, normals, tangents, gains in pieces
    )
