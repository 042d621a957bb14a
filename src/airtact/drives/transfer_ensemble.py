"""Transfer matrices of sampled hands (``ensemble``), from a single solve if the hands move rigidly.

In warmer air, the wavenumber is multiplied by a factor s below 1. The solved field is then
evaluated with all lengths scaled by s about the middle of the foci. As an approximation, this also
scales the bodies and the distances between foci, by 0.2 % per kelvin, and neglects the change of
absorption. Compared with solves of a pinch in air that is 2 K (5 K) warmer, the error of the matrix
is 1.3 % (3.2 %) in a box and 0.9 % (2.3 %) in front of flat boards. Without scaling, it is 24 to
138 %. The pressure of a drive at the weakest focus is within 0.2 % (0.4 %) (``benchmarks/robust.py
warmer``).

The pressure on an element is computed as the pressure at its centre times its directivity toward
each focus, plus the remainder of the nominal matrix. Compared with the mean over the faces, for
motions of 2 mm and 3 degrees, the error is 0.1 % in front of flat boards and 1 % in a box.

If bodies move independently, each sample is solved separately, in air of that sample's temperature.
In front of a rigid plane, one solve covers all hands at the same position relative to the plane:
those that were shifted along it or turned about its normal. For other rigid motions, only the sound
that the plane reflects is computed again, with twice the relative error (``BodiesBeforePlane``).
For an open hand 30 mm in front of a plane, solved with an accuracy of 3 %, the rows of the matrix
differ by 2 to 4 % from those obtained by solving each sample separately.
"""

from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import TypeVar

import numpy as np
from jaxtyping import Complex128, Float64, Int64, Real

from airtact.acoustics.scene import Plane, Scene, check_no_boards
from airtact.acoustics.solvers.bem.moving_panels import BodiesBeforePlane
from airtact.acoustics.solvers.bem.solver import BoundaryElement
from airtact.acoustics.solvers.problem import FreeField, RadiatedField, Solver
from airtact.acoustics.solvers.shared import monopole_pressure
from airtact.acoustics.solvers.spherical.multipole_field import (
    MultipoleField,
    ball_of,
    multipole_expansion,
)
from airtact.acoustics.sources import Monopoles
from airtact.acoustics.target import Beacons
from airtact.acoustics.target_points import frame_of, outward
from airtact.acoustics.uncertainty import Draw, Uncertainty, draws, gains
from airtact.drives.drive import Drive
from airtact.drives.transfer import FociRows, TransferMatrix, transfer_matrix
from airtact.errors import InvalidInput, check_seed, counted, of_kind, one_line
from airtact.geometry.pose import Pose
from airtact.transducers.layout import PhasedArray
from airtact.transducers.placement import MAX_ELEMENT_DISTANCE, check_placement, strength_in

# Largest allowed number of samples; a larger number is probably a mistake.
MAX_SAMPLES = 10_000

Made = TypeVar("Made")


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class TransferEnsemble(TransferMatrix):
    """The transfer matrices of a nominal hand and of S sampled hands, as returned by ``ensemble``.

    The nominal hand is the one without deviations. An ensemble is also a ``TransferMatrix``:
    functions that expect one use the nominal matrix, whereas ``robust`` uses all samples.

    Attributes
    ----------
    matrix : (F, E) nominal matrix [Pa]; it and further attributes are those of ``TransferMatrix``.
    geometry : (S, F, E) transfer matrices of the samples of the hand and the air, with nominal
        gains of the elements [Pa]. ``matrices`` is the product of ``geometry`` and ``gains``.
    gains : (S, E) complex factor by which each element's nominal gain is multiplied in each sample,
        or None if all factors are 1.
    uncertainty : the distributions from which the samples were drawn.
    seed : seed of the samples.
    left_out : number of further samples that were drawn but omitted because they are impossible,
        such as hands that overlap a transducer.
    draw : function that takes a number of samples and a seed and returns the matrices of those
        samples that are possible; None if the ensemble was not made by ``ensemble``.

    Raises
    ------
    InvalidInput
        If the nominal matrix is empty, is zero everywhere or contains an entry that is not finite,
        if there are no samples, or if the shape of the samples does not match that of the nominal
        matrix.
    """

    geometry: Complex128[np.ndarray, "samples foci elements"]
    gains: Complex128[np.ndarray, "samples elements"] | None = None
    uncertainty: Uncertainty = field(default_factory=Uncertainty)
    seed: int = 0
    left_out: int = 0
    draw: Callable[[int, int], list[FociRows]] | None = None

    def __repr__(self) -> str:
        samples, foci, elements = self.geometry.shape
        return one_line(
            self,
            counted(samples, "sample", "samples"),
            counted(foci, "focus", "foci"),
            counted(elements, "element", "elements"),
            f"{self.left_out} left out" if self.left_out else "",
        )

    def __post_init__(self) -> None:
        super().__post_init__()
        shape = np.shape(self.geometry)
        if len(shape) != 3 or shape[0] == 0 or shape[1:] != self.matrix.shape:
            foci, elements = self.matrix.shape
            raise InvalidInput(
                f"the samples have shape {shape}, but must have shape (samples, {foci}, "
                f"{elements}), with at least 1 sample.",
                code="wrong_shape",
            )
        for array in (self.geometry, self.gains):
            if array is not None:
                array.flags.writeable = False

    def of_rows(self, rows: Int64[np.ndarray, "rows"]) -> "TransferEnsemble":
        """Return the ensemble with only the given rows, in this order."""
        foci = None if self.foci is None else self.foci[rows]
        return replace(
            self,
            matrix=self.matrix[rows],
            foci=foci,
            geometry=self.geometry[:, rows],
            draw=None,
        )

    def resampled(self, samples: int, seed: int) -> "TransferEnsemble":
        """Return an ensemble of other samples of the same uncertainty.

        The result is that of ``ensemble`` with the same arguments except ``samples`` and ``seed``,
        within the accuracy of its solver, but is computed faster.

        Raises
        ------
        InvalidInput
            If this ensemble was not made by ``ensemble``, or for the reasons of ``ensemble``.
        """
        check_counts(samples, seed)
        if self.draw is None:
            raise InvalidInput(
                "only an ensemble that ensemble() returned can be sampled again.",
                code="wrong_kind",
            )
        matrices = self.draw(samples, seed)
        if not matrices:
            raise InvalidInput(
                f"all {samples} samples are impossible: an element is inside a body, or a body or "
                "a focus is behind the face of an element. Use smaller deviations or move the "
                "array away.",
                code="empty",
            )
        return replace(
            self,
            geometry=np.stack(matrices),
            gains=gains(self.uncertainty, len(matrices), seed, self.matrix.shape[1]),
            seed=seed,
            left_out=samples - len(matrices),
        )

    @property
    def matrices(self) -> Complex128[np.ndarray, "samples foci elements"]:
        """(S, F, E) transfer matrix of each sample [Pa]."""
        return self.geometry if self.gains is None else self.geometry * self.gains[:, None, :]

    def pressures(self, drive: Drive) -> Complex128[np.ndarray, "samples foci"]:
        """Return the (S, F) complex pressure of a drive at each focus of each sample [Pa].

        Raises
        ------
        InvalidInput
            If the drive does not have as many elements as the matrices.
        """
        self.check_fits(drive)
        if self.gains is None:
            return self.geometry @ drive.amplitudes
        return np.einsum("sfe,se->sf", self.geometry, self.gains * drive.amplitudes)


def ensemble(
    beacons: RadiatedField,
    array: PhasedArray,
    uncertainty: Uncertainty,
    samples: int = 64,
    seed: int = 0,
    *,
    solver: Solver | None = None,
) -> TransferEnsemble:
    """Compute transfer matrices for random deviations of the hand, the air and the transducers.

    Each sample is one set of random deviations, with its own transfer matrix. If the hand moves
    rigidly, no new solve is required: the multipole expansion of ``beacons`` is evaluated at the
    elements' positions relative to the moved hand. If bodies move independently or foci move along
    the skin, ``solver`` solves the scene of each sample; ``BoundaryElement().factorised(scene,
    refined=target.points)`` needs only milliseconds per sample. Without ``solver``, each focus is
    evaluated as if all bodies moved with it. A change of the air's temperature or humidity scales
    the wavenumber. In front of a rigid plane, one solve covers all motions along the plane, and
    ``solver`` solves the other samples.

    Parameters
    ----------
    beacons : field of a unit source (beacon) at each focus, ``solver.radiate(scene,
        target.beacons())``.
    array : the E transducers in the frame of the scene.
    uncertainty : ``Uncertainty`` with the standard deviations of the motions, the air and the
        gains.
    samples : number of samples, 1 to 10,000; 64 by default. Powers of 2 sample the distributions
        most evenly.
    seed : seed of the random numbers, an integer of at least 0; 0 by default.
    solver : solver for the samples if bodies move independently, if foci move along the skin, or if
        there is a plane.

    Returns
    -------
    A ``TransferEnsemble`` with the nominal transfer matrix and the transfer matrix of each sample.
    A sample is impossible if an element or a focus is inside a body, or if a body or a focus is
    behind the face of an element. Such samples are skipped and counted.

    Raises
    ------
    InvalidInput
        If ``beacons`` is not the field of unit beacons or is unknown at an element, if an element
        is inside a body, or if a focus or a body is behind the face of a directional element. The
        error is also raised if ``samples`` or ``seed`` is outside its range, or if all samples are
        impossible. Further causes are ``along_skin`` for a scene without bodies, a missing
        ``solver`` for samples in front of a plane, and an uncertain temperature or humidity of a
        medium other than air.
    NotConverged
        If ``solver`` stops before it converges.

    Examples
    --------
    >>> import airtact as at
    >>> scene, target = at.Scene(at.air(), [], frequency=40e3), at.Target(np.zeros((1, 3)))
    >>> beacons = at.FreeField().radiate(scene, target.beacons())
    >>> ensemble(beacons, at.surrounding_box(), Uncertainty(position=1e-3), samples=16)
    TransferEnsemble(16 samples, 1 focus, 996 elements)
    """
    of_kind(uncertainty, Uncertainty, "the uncertainty", "Uncertainty(position=1e-3, rotation=2.0)")
    check_counts(samples, seed)
    nominal = transfer_matrix(beacons, array)
    check_doubts(uncertainty, beacons.scene)
    sampler = _Sampler.of(beacons, array, nominal.matrix, uncertainty, solver)
    # The nominal matrix stands for the samples, which are computed next.
    return TransferEnsemble(
        matrix=nominal.matrix,
        estimated_error=nominal.estimated_error,
        foci=nominal.foci,
        wavelength=nominal.wavelength,
        geometry=nominal.matrix[None],
        uncertainty=uncertainty,
        draw=sampler.possible,
    ).resampled(samples, seed)


def check_counts(samples: int, seed: int) -> None:
    """Raise ``InvalidInput`` if the number of samples or the seed is out of range."""
    integer = isinstance(samples, int | np.integer) and not isinstance(samples, bool)
    if not integer or not 1 <= samples <= MAX_SAMPLES:
        raise InvalidInput(
            f"the number of samples is {samples!r}, but it must be a whole number from 1 to "
            f"{MAX_SAMPLES}.",
            code="out_of_range",
        )
    check_seed(seed)


def check_doubts(uncertainty: Uncertainty, scene: Scene) -> None:
    """Raise ``InvalidInput`` if an uncertainty does not apply to the scene."""
    speed = scene.medium.sound_speed
    if (uncertainty.temperature or uncertainty.humidity) and not 300.0 <= speed <= 370.0:
        raise InvalidInput(
            "temperature or humidity is uncertain, but the medium is not air: its sound speed is "
            f"{speed:g} m/s. Set both uncertainties to 0.",
            code="does_not_match",
        )
    if uncertainty.along_skin and not scene.obstacles:
        raise InvalidInput(
            "along_skin is not 0, but the scene has no bodies. Set it to 0.", code="empty"
        )


@dataclass(frozen=True, eq=False)
class _Sampler:
    """Computation of the transfer matrix for each draw.

    Attributes
    ----------
    field : field of the beacons, as a multipole expansion if there are bodies.
    array : the transducers.
    uncertainty : the distributions from which the samples are drawn.
    solver : solver for bodies that move independently and for hands that move toward a plane, or
        None.
    groups : for each group of foci that move together, the indices of these foci.
    bodies : (F,) index of the body nearest to each focus; 0 in open air.
    middle : (3,) middle of the foci [m]; the hand turns about it.
    ball : centre and radius of a ball around the bodies [m], or None.
    remainder : (F, E) difference between the nominal matrix and the product of centre pressure and
        directivity, divided by the carrier wave [Pa].
    """

    field: RadiatedField
    array: PhasedArray
    uncertainty: Uncertainty
    solver: Solver | None
    groups: tuple[Int64[np.ndarray, "_"], ...]
    bodies: Int64[np.ndarray, "foci"]
    middle: Float64[np.ndarray, "3"]
    ball: tuple[Float64[np.ndarray, "3"], float] | None
    remainder: Complex128[np.ndarray, "foci elements"]

    @classmethod
    def of(
        cls,
        beacons: RadiatedField,
        array: PhasedArray,
        nominal: FociRows,
        uncertainty: Uncertainty,
        solver: Solver | None,
    ) -> "_Sampler":
        """Prepare the data common to all samples; ``nominal`` is the matrix without deviations."""
        of_kind(solver, Solver | None, "the solver", "BoundaryElement()")
        scene = beacons.scene
        foci = beacons.sources.positions
        check_no_boards(scene, "an ensemble of moving hands")
        if scene.planes and not scene.obstacles:
            solver = FreeField()
        independent = uncertainty.own_position or uncertainty.own_rotation
        moving = scene.obstacles and (independent or uncertainty.along_skin)
        if not moving and not scene.planes:
            solver = None
        if scene.obstacles and solver is None:
            beacons = _expanded(beacons)
        ball = None
        if isinstance(beacons, MultipoleField):
            ball = beacons.ball
        elif scene.obstacles:
            ball = ball_of(scene)
        bodies = np.zeros(len(foci), dtype=np.int64)
        if len(scene.obstacles) > 1:
            depths = [obstacle.surface.depth(foci) for obstacle in scene.obstacles]
            bodies = np.argmax(depths, axis=0)
        # Suppression points do not contribute to the middle.
        asked = beacons.sources.foci if isinstance(beacons.sources, Beacons) else len(foci)
        sampler = cls(
            field=beacons,
            array=array,
            uncertainty=uncertainty,
            solver=solver,
            groups=_groups(bodies, bool(independent), bool(uncertainty.along_skin)),
            bodies=bodies,
            middle=foci[:asked].mean(axis=0),
            ball=ball,
            remainder=np.zeros_like(nominal),
        )
        if solver is not None or scene.planes:
            return sampler
        everything = np.arange(len(foci))
        centres, carrier = sampler._at_centres(Pose.identity(), 1.0, everything)
        return replace(sampler, remainder=(nominal - centres * array.gains) / carrier)

    @property
    def together(self) -> bool:
        """Whether all foci move as one group."""
        uncertainty = self.uncertainty
        return not (uncertainty.own_position or uncertainty.own_rotation or uncertainty.along_skin)

    def draw(self, samples: int, seed: int) -> Iterator[Draw]:
        """Draw samples in which each body moves alone or, without a solver, each group of foci."""
        foci = self.field.sources.positions
        obstacles = self.field.scene.obstacles
        if self.solver is None or not obstacles:
            pivots = [foci[group].mean(axis=0) for group in self.groups]
        else:
            pivots = []
            for body, obstacle in enumerate(obstacles):
                carried = foci[self.bodies == body]
                pivots.append((carried if len(carried) else obstacle.surface.vertices).mean(axis=0))
        return draws(self.uncertainty, samples, seed, self.middle, pivots, len(foci))

    def possible(self, samples: int, seed: int) -> list[FociRows]:
        """Draw samples, and return the transfer matrices of those that are possible."""
        matrices = self.matrices(self.draw(samples, seed))
        return [matrix for matrix in matrices if matrix is not None]

    def matrices(self, samples: Iterable[Draw]) -> Iterator[FociRows | None]:
        """Yield the transfer matrix of each draw, or None for an impossible draw."""
        if self.solver is not None or self.field.scene.planes:
            yield from self._solved(list(samples))
            return
        for draw in samples:
            yield _if_possible(self._evaluated, draw)

    # --- from one solve ---

    def _evaluated(self, draw: Draw) -> FociRows:
        foci = self.field.sources.positions
        poses = [draw.hand] * len(self.groups)
        if not self.together:
            shifts = along_skin(self.field.scene, foci, draw.skin)
            poses = [
                draw.hand @ Pose(motion.rotation, motion.translation + shifts[group[0]])
                for motion, group in zip(draw.groups, self.groups, strict=True)
            ]
        rows = np.empty_like(self.remainder)
        for pose, group in zip(poses, self.groups, strict=True):
            self._check(pose, foci[group])
            centres, carrier = self._at_centres(pose, draw.slower, group)
            rows[group] = centres * self.array.gains + self.remainder[group] * carrier
        return rows

    def _at_centres(
        self, pose: Pose, slower: float, group: Int64[np.ndarray, "group"]
    ) -> tuple[FociRows, FociRows]:
        """Return the pressure at the elements' centres times their directivity, and the carrier.

        This is twelve times as fast as computing the mean over the faces. The carrier is the wave
        from the focus to the centre. The remainder comes from the nominal matrix and is multiplied
        by the carrier.
        """
        element = self.array.element
        turned = (self.array.positions - pose.translation) @ pose.rotation
        # The scaling about the middle is explained in the module docstring.
        points = self.middle + slower * (turned - self.middle)
        foci = self.middle + slower * (self.field.sources.positions[group] - self.middle)
        away = points - foci[:, None]
        distance = np.sqrt(np.einsum("fed,fed->fe", away, away))
        carrier = slower * np.exp(1j * self.field.scene.wavenumber * distance) / distance
        received = self.field.at(points)[:, group].T
        if len(element.weights) > 1:
            cosines = np.einsum("fed,ed->fe", away, self.array.normals @ pose.rotation) / distance
            wavenumber = slower * self.field.scene.wavenumber.real
            received = received * element.directivity(cosines, wavenumber)
        return slower * element.sensitivity * received, carrier

    # --- one solve per hand ---

    def _solved(self, samples: Sequence[Draw]) -> Iterator[FociRows | None]:
        """Yield matrices, with a single solve for all hands in the same position in the scene."""
        rigid = self.together and type(self.solver) is BoundaryElement
        alike: dict[Hashable, list[int]] = {}
        for index, draw in enumerate(samples):
            alike.setdefault(self._view(draw) if self.together else index, []).append(index)
        matrices: list[FociRows | None] = [None] * len(samples)
        for indices in alike.values():
            # Warmer air would change the matrix of the bodies.
            nominal_air = samples[indices[0]].slower == 1.0
            if rigid and nominal_air and len(indices) < 4 and self.field.scene.obstacles:
                for index in indices:
                    matrices[index] = _if_possible(self._before_plane, samples[index])
                continue
            field = _if_possible(self._field_of, samples[indices[0]])
            if field is None:
                continue
            if len(indices) >= 4 and field.scene.obstacles:  # an expansion costs more for fewer
                field = _expanded(field)
            for index in indices:
                matrices[index] = _if_possible(partial(self._at_array, field), samples[index])
        yield from matrices

    def _moved(self, draw: Draw, scene: Scene) -> tuple[Scene, Float64[np.ndarray, "foci 3"]]:
        """Move each body of a scene and each focus by its own deviation."""
        foci = self.field.sources.positions
        if self.together:
            return scene, foci
        carrying = self.bodies if scene.obstacles else np.arange(len(foci))
        obstacles = [
            replace(obstacle, surface=obstacle.surface.moved(pose))
            for obstacle, pose in zip(scene.obstacles, draw.groups, strict=False)
        ]
        scene = replace(scene, obstacles=obstacles)
        pairs = zip(carrying, foci, strict=True)
        foci = np.stack([draw.groups[body].apply(point) for body, point in pairs])
        if draw.skin.any():
            shifted = foci + along_skin(scene, foci, draw.skin)
            # Keep the distance from the skin, which is curved.
            deeper = scene.depth(shifted) - scene.depth(foci)
            foci = shifted + deeper[:, None] * outward(scene.depth, shifted)
        return scene, foci

    def _view(self, draw: Draw) -> Hashable:
        """Return a key that is equal for hands in the same air and position relative to planes."""
        planes = [_plane_seen(plane, draw.hand) for plane in self.field.scene.planes]
        numbers = [(*plane.normal, plane.height(np.zeros((1, 3)))[0]) for plane in planes]
        return draw.slower, *(np.round(np.concatenate(numbers), 9) + 0.0).tolist()

    def _field_of(self, draw: Draw) -> RadiatedField:
        """Return the field of a draw's beacons in the frame of its hand, solving if necessary."""
        scene = self.field.scene
        planes = [_plane_seen(plane, draw.hand) for plane in scene.planes]
        pairs = zip(planes, scene.planes, strict=True)
        if all(plane is before for plane, before in pairs) and self.together and draw.slower == 1.0:
            return self.field
        if self.solver is None:
            raise InvalidInput(
                "the scene has a plane, so each sample with a lifted or tilted hand, separately "
                "moved bodies or foci, or different air must be solved. Pass "
                "solver=BoundaryElement(), or set these deviations to 0.",
                code="not_converged",
            )
        medium = replace(scene.medium, sound_speed=scene.medium.sound_speed / draw.slower)
        moved, foci = self._moved(draw, replace(scene, medium=medium, planes=planes))
        return self.solver.radiate(moved, Monopoles(foci, self.field.sources.strengths))

    # --- one discretisation for all hands in front of a plane ---

    @cached_property
    def _open_air(self) -> RadiatedField:
        assert self.solver is not None
        scene = replace(self.field.scene, planes=())
        return multipole_expansion(self.solver.radiate(scene, self.field.sources))

    @cached_property
    def _bodies(self) -> BodiesBeforePlane:
        assert isinstance(self.solver, BoundaryElement)
        return BodiesBeforePlane.of(self.solver, self.field.scene, self.field.sources)

    def _before_plane(self, draw: Draw) -> FociRows:
        """Return the matrix of a hand that moves rigidly in front of a plane.

        The field without images is evaluated at the elements and at their images. The part in
        open air is averaged exactly over each face. For the rest, the bodies are divided into
        parts: the pressure of each part at the centre of the face is multiplied by the
        directivity toward that part.
        """
        (fixed_plane,) = self.field.scene.planes
        plane = _plane_seen(fixed_plane, draw.hand)
        scene = replace(self.field.scene, planes=[plane])
        array = self.array.seen_from(draw.hand)
        self._check(draw.hand, self.field.sources.positions, scene)
        monopoles = self._bodies.reflected(scene)
        parts = np.array_split(np.arange(len(monopoles.positions)), 16)
        middles = np.array([monopoles.positions[part].mean(axis=0) for part in parts])
        means = np.zeros_like(self.remainder)
        for image in (False, True):
            faces = array.face_points
            centres = array.positions
            axes = array.normals
            if image:
                faces = plane.image(faces.reshape(-1, 3)).reshape(faces.shape)
                centres = plane.image(centres)
                axes = axes - 2.0 * (axes @ plane.normal)[:, None] * plane.normal
            received = self._open_air.at(faces.reshape(-1, 3)).reshape(*faces.shape[:2], -1)
            means += np.einsum("eqf,q->fe", received, array.element.weights)
            away = centres - middles[:, None]
            cosines = np.einsum("ped,ed->pe", away, axes) / np.linalg.norm(away, axis=2)
            patterns = array.element.directivity(cosines, scene.wavenumber.real)
            for part, pattern in zip(parts, patterns, strict=True):
                positions = monopoles.positions[part]
                pressure = monopole_pressure(
                    centres, positions, monopoles.strengths[part], scene.wavenumber, "float32"
                )
                means += pressure.T * pattern
        return strength_in(scene, array) * array.element.sensitivity * means * array.gains

    def _at_array(self, field: RadiatedField, draw: Draw) -> FociRows:
        return transfer_matrix(field, self.array.seen_from(draw.hand)).matrix

    def _check(
        self, pose: Pose, foci: Real[np.ndarray, "group 3"], scene: Scene | None = None
    ) -> None:
        """Check the placement of the array if a body or plane is near enough to matter.

        ``scene`` is the scene in the frame of the hand; by default, that of the field.
        """
        array = self.array
        spheres = pose.apply(foci)
        radii = np.zeros(len(foci))
        suspect = False
        if self.ball is not None:
            centre, radius = self.ball
            spheres = np.vstack([spheres, pose.apply(centre)])
            radii = np.append(radii, radius)
            distances = np.linalg.norm(array.positions - spheres[-1], axis=1)
            suspect = distances.min() <= radius + array.element.reach
            suspect = suspect or distances.max() > MAX_ELEMENT_DISTANCE
        for plane in self.field.scene.planes:  # the images must be in front of the faces, too
            spheres = np.vstack([spheres, plane.image(spheres)])
            radii = np.tile(radii, 2)
        if array.element.directional:
            heights = spheres @ array.normals.T - np.sum(array.positions * array.normals, axis=1)
            suspect = suspect or not (heights > radii[:, None]).all()
        if suspect:
            check_placement(scene or self.field.scene, array.seen_from(pose), foci)


def _expanded(field: RadiatedField) -> RadiatedField:
    return field if isinstance(field, MultipoleField) else multipole_expansion(field)


def _plane_seen(plane: Plane, hand: Pose) -> Plane:
    """Return a plane in the frame of a hand, or the plane itself if the hand has not moved."""
    return plane if plane.kept_by(hand) else plane.moved(hand.inverse())


def _if_possible(make: Callable[[Draw], Made], draw: Draw) -> Made | None:
    """Return the result of a function of a draw, or None if the draw is geometrically impossible.

    Other errors are raised, for example if the hand is metres away.
    """
    try:
        return make(draw)
    except InvalidInput as fault:
        if fault.code not in (
            "bodies_overlap",
            "inside_body",
            "behind_faces",
            "behind_plane",
            "not_in_metres",
        ):
            raise
        return None


def along_skin(
    scene: Scene, foci: Real[np.ndarray, "foci 3"], shifts: Real[np.ndarray, "foci 2"]
) -> Float64[np.ndarray, "foci 3"]:
    """Convert shifts (F, 2) [m] of foci along the surface to vectors (F, 3) [m]."""
    if not shifts.any():
        return np.zeros((len(foci), 3))
    frames = np.stack([np.stack(frame_of(normal)[:2]) for normal in outward(scene.depth, foci)])
    return np.einsum("fi,fid->fd", shifts, frames)


def _groups(
    bodies: Int64[np.ndarray, "foci"], independent: bool, along_skin: bool
) -> tuple[Int64[np.ndarray, "_"], ...]:
    """Group the foci that move together: by body, or each focus alone if there is only one body.

    A single body is treated as a hand whose foci are on different bones.
    """
    if not (independent or along_skin):
        return (np.arange(len(bodies)),)
    different = np.unique(bodies)
    if along_skin or len(different) == 1:
        return tuple(np.arange(len(bodies))[:, None])
    return tuple(np.flatnonzero(bodies == body) for body in different)
