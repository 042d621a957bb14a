"""Where bodies are and what shape they have, from the echoes of the array's own transmissions.

Pose and numbers are those that are most probable given the echoes and what was expected of the numbers, by a trust
region (M. A. Branch, T. F. Coleman, Y. Li, SIAM J. Sci. Comput. 21 (1999) 1) with derivatives by reciprocity: one solve
a step, however many numbers there are.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool, Complex, Float64, Int64
from scipy.optimize import least_squares

from airtact.conventions import InvalidInput
from airtact.mesh.quadratic_triangles import area_vectors
from airtact.pose import Pose
from airtact.printing import one_line
from airtact.scene.scene import Scene
from airtact.sensing.doubt import disagreement, information_of, power
from airtact.sensing.echo_model import Received, motion_of
from airtact.sensing.echoes import Echoes
from airtact.sensing.registration import EXPLAINED, check_start
from airtact.sensing.shapes.derivative import solve_echoes
from airtact.sensing.shapes.unknown import UnknownShape
from airtact.sensing.simulation import simulate_echoes
from airtact.solvers.bem.solver import BoundaryElement
from airtact.solvers.spherical.multipole_field import ball_of
from airtact.timing import Progress, no_progress
from airtact.transducers.layout import PhasedArray
from airtact.transducers.placement import check_placement
from airtact.validation import of_kind

FEW_RECEIVERS, USED_RECEIVERS = 64, 128
"""Receivers, chosen at random, that the first and the last steps are taken by."""

FIRST_ACCURACY = 0.03
"""Accuracy of the solver of the first steps."""

MOST_STEPS = 30

SETTLED = 2e-3
"""Relative decrease of the squares at which a shape is settled."""

SHORTEST = 1e-3
"""Length of a step, in standard deviations over the root of their number, at which a shape is settled."""

SPREAD = 5e-3, np.radians(9.0)
"""Standard deviations of the start: each translation [m] and turn [rad]."""

FIRST_STEP = 0.3
"""Longest first step, in standard deviations."""

STARTS, FOLLOWED = 32, 4
"""Other starts whose echoes are computed, and those from which steps are taken, where the first explains nothing."""

AWAY = 0.4
"""Standard deviation of other starts, in those of the unknowns."""


@dataclass(frozen=True, eq=False)
class LocatedShape:
    """Where bodies are and what shape they have, as ``locate_shape`` finds it.

    A motion of all bodies can be one of the pose or one of the numbers: both together say where the surfaces are.

    Attributes
    ----------
    pose : of the bodies in the array's frame, as of ``PhasedArray.seen_from``.
    numbers : (K,) of the ``UnknownShape``.
    scene : the bodies of these numbers, in their own frame.
    covariance : (6 + K, 6 + K) of the translation of ``centre`` [m], of a small turn about it [rad], along the array's
        axes, and of the numbers: from all that is left unexplained, and larger where receivers in different places
        disagree by more than noise would make them.
    surface_deviation : standard deviation of where the surfaces are along their normals, rms over them [m].
    residual : rms of what is left unexplained over that of the echoes, noise included.
    misfit : the same beyond noise.
    converged : whether the steps settled and the misfit is at most 0.1. Believe no other shape.
    steps : number of solves from the start that led there.
    centre : (3,) middle of the expected bodies in the array's frame [m].
    """

    pose: Pose
    numbers: Float64[np.ndarray, "numbers"]
    scene: Scene
    covariance: Float64[np.ndarray, "unknowns unknowns"]
    surface_deviation: float
    residual: float
    misfit: float
    converged: bool
    steps: int
    centre: Float64[np.ndarray, "3"]

    def __repr__(self) -> str:
        return one_line(
            self,
            "converged" if self.converged else "NOT converged",
            f"surfaces sure to {1e3 * self.surface_deviation:.2g} mm",
            f"residual {self.residual:.2g}, misfit {self.misfit:.2g}",
        )


def locate_shape(
    echoes: Echoes,
    bodies: UnknownShape,
    array: PhasedArray,
    start: Pose,
    *,
    solver: BoundaryElement | None = None,
    progress: Progress = no_progress,
) -> LocatedShape:
    """Find pose and shape of bodies from echoes, where ``locate`` finds the pose of bodies whose shape is known.

    The start and what is expected of the numbers count as knowledge with standard deviations (5 mm and 9 degrees, and
    those given), so that what echoes do not determine stays as expected, and its doubt as large.

    Parameters
    ----------
    echoes : measured, less what the empty array receives; up to 128 receivers, chosen at random, are used.
    bodies : what is known of them, such as ``UnknownShape.of_capsules(scene)``.
    array : the transducers in their own frame, in the order of the codes.
    start : where the bodies may be, within about 3 mm and 5 degrees; maps the bodies' frame to the array's.
    solver : of the last steps; ``BoundaryElement(accuracy=0.01)`` unless given. The first are taken at 3 %.
    progress : called with the words of each step.

    Returns
    -------
    The most probable pose and shape, with how sure they are; look at ``converged`` first.

    Raises
    ------
    InvalidInput
        "element_count", "other_frequency": of the echoes; "all_noise", "clipped"; "inside_body", "behind_faces": the
        start cannot be; or as ``bodies.scene_of`` for the expected numbers.

    Examples
    --------
    >>> import airtact as at
    >>> fingers = at.Scene(at.air(celsius=20.0), [at.sound_hard(one) for one in at.pinch().surfaces], frequency=40e3)
    >>> at.sensing.UnknownShape.of_capsules(fingers, ends=4e-3, radius=1e-3)
    UnknownShape(14 numbers, 2 bodies)
    """
    of_kind(bodies, UnknownShape, "what is known of the bodies", "UnknownShape(scene_of, expected, deviations)")
    solver = solver or BoundaryElement(accuracy=0.01)
    of_kind(solver, BoundaryElement, "the solver", "BoundaryElement()")
    scene = bodies.scene
    check_start(echoes, scene, array, start)
    fit = _Fit(echoes, bodies, array, start, ball_of(scene)[0], _some(echoes, FEW_RECEIVERS))
    found = fit.best(progress)
    last = replace(fit, rows=_some(echoes, USED_RECEIVERS), solver=solver)
    progress("fitting the shape by smaller panels")
    return last.located(last.follow(found.x, found.steps))


def _some(echoes: Echoes, count: int) -> Int64[np.ndarray, "some"]:
    """Rows of the pressures of some receivers, chosen at random."""
    return np.sort(np.random.default_rng(0).permutation(len(echoes.receiving))[:count])


@dataclass(frozen=True, eq=False)
class _Found:
    """Unknowns in standard deviations, what is left there, and after how many steps."""

    x: Float64[np.ndarray, "unknowns"]
    residual: Received
    derivatives: Complex[np.ndarray, "unknowns receivers transmissions"]
    settled: bool
    steps: int


@dataclass(frozen=True, eq=False)
class _Fit:
    """Echoes to be explained, by some of the receivers; unknowns are in standard deviations from the start."""

    echoes: Echoes
    bodies: UnknownShape
    array: PhasedArray
    start: Pose
    centre: Float64[np.ndarray, "3"]
    rows: Int64[np.ndarray, "some"]
    solver: BoundaryElement = field(default=BoundaryElement(accuracy=FIRST_ACCURACY))

    def best(self, progress: Progress) -> _Found:
        """Follow the start, and where that explains nothing, other starts, those that explain most first."""
        progress("fitting pose and shape to the echoes")
        found = self.follow(np.zeros(len(self.deviations)))
        if self.misfit(found) <= EXPLAINED:
            return found
        progress(f"the start leaves {self.misfit(found):.2f} of the echoes unexplained: trying {STARTS} others")
        tried = [found]
        for count, x in enumerate(self._others()[:FOLLOWED]):
            progress(f"fitting pose and shape from start {count + 2} of {FOLLOWED + 1}")
            tried.append(self.follow(x))
            if self.misfit(tried[-1]) <= EXPLAINED:
                break
        return min(tried, key=self.misfit)

    @property
    def deviations(self) -> Float64[np.ndarray, "unknowns"]:
        """Standard deviations of translations [m], turns [rad] and numbers before the echoes are heard."""
        return np.concatenate([np.repeat(SPREAD, 3), np.asarray(self.bodies.deviations)])

    @property
    def measured(self) -> Received:
        """Pressures of the receivers that are used."""
        return np.asarray(self.echoes.pressures)[self.rows]

    @property
    def valid(self) -> Bool[np.ndarray, "..."]:
        """Which of these were received."""
        return np.ones((1, 1), dtype=bool) if self.echoes.valid is None else np.asarray(self.echoes.valid)[self.rows]

    def place(self, x: Float64[np.ndarray, "unknowns"]) -> tuple[Pose, Float64[np.ndarray, "numbers"]]:
        """Pose and numbers of unknowns."""
        motion = motion_of((self.deviations * x)[:6])
        turn = motion[:3, :3]
        moved = self.start @ Pose(turn, self.centre - turn @ self.centre + motion[:3, 3])
        return moved, np.asarray(self.bodies.expected) + (self.deviations * x)[6:]

    def solved(self, x: Float64[np.ndarray, "unknowns"]) -> tuple[Received, Received]:
        """Echoes (R, M) [Pa] and their derivatives (U, R, M), per standard deviation of the unknowns."""
        pose, numbers = self.place(x)
        scene, receivers = self.bodies.scene_of(numbers), self.echoes.receiving[self.rows]
        seen, codes = self.array.seen_from(pose), np.asarray(self.echoes.codes)
        check_placement(scene, seen)
        made = solve_echoes(self.solver, scene, seen, codes, receivers)
        by = made.derivatives(self._shifts(numbers, made.surface.points, made.surface.normals))
        return made.echoes * self.valid, by * self.valid

    def _shifts(
        self,
        numbers: Float64[np.ndarray, "numbers"],
        points: Float64[np.ndarray, "points 3"],
        normals: Float64[np.ndarray, "points 3"],
    ) -> Float64[np.ndarray, "points unknowns"]:
        """How far standard deviations of the unknowns move the surfaces outward [m]."""
        turns = np.cross(points - self.centre, normals)
        return np.concatenate([normals, turns, self.bodies.shifts(numbers, points)], axis=1) * self.deviations

    def follow(self, x: Float64[np.ndarray, "unknowns"], steps: int = 0) -> _Found:
        """Take steps until the squares of what is left, and of how unexpected the unknowns are, settle."""
        scale, known = 1.0 / self._doubt, {}

        def left(step: Float64[np.ndarray, "unknowns"]) -> Float64[np.ndarray, "parts"]:
            try:
                echoes, by = self.solved(x + step)
            except InvalidInput:
                if not known:
                    raise
                return np.full(2 * self.measured.size + len(x), np.inf)  # no such bodies: a shorter step is taken
            known.clear()
            known[step.tobytes()] = np.concatenate([_parts(scale * by), np.eye(len(x))])
            return np.concatenate([_parts(scale * (echoes - self.measured)[None])[:, 0], x + step])

        found = least_squares(
            left,
            np.zeros(len(x)),
            lambda step: known[step.tobytes()],
            x_scale=FIRST_STEP,
            ftol=SETTLED,
            xtol=SHORTEST,
            max_nfev=MOST_STEPS,
        )
        count = self.measured.size
        residual = found.fun[: 2 * count].reshape(2, -1)
        return _Found(
            x=x + found.x,
            residual=(residual[0] + 1j * residual[1]).reshape(self.measured.shape) / scale,
            derivatives=(found.jac[:count] + 1j * found.jac[count : 2 * count]).T.reshape(len(x), *self.measured.shape)
            / scale,
            settled=found.status > 0,
            steps=steps + found.nfev,
        )

    def misfit(self, found: _Found) -> float:
        """Rms of the residual beyond noise over that of the echoes beyond noise."""
        of_noise = (self.echoes.noise or 0.0) ** 2 * np.count_nonzero(self.measured)
        whole = max(power(self.measured) - of_noise, 1e-300)
        return float(np.sqrt(max(power(found.residual) - of_noise, 0.0) / whole))

    @property
    def _doubt(self) -> float:
        """Rms of what noise and the solver's error leave unexplained of one pressure [Pa]."""
        rms = np.sqrt(power(self.measured) / max(np.count_nonzero(self.measured), 1))
        return float(np.hypot(self.echoes.noise or 0.0, self.solver.accuracy * rms))

    def _others(self) -> list[Float64[np.ndarray, "unknowns"]]:
        """Other starts, at random around the first, those whose echoes are nearest to the measured ones first."""
        costs = []
        quick = BoundaryElement(accuracy=0.1, estimate=False)
        for x in AWAY * np.random.default_rng(0).normal(size=(STARTS, len(self.deviations))):
            pose, numbers = self.place(x)
            codes, receivers = np.asarray(self.echoes.codes), self.echoes.receiving[self.rows]
            try:
                given = self.bodies.scene_of(numbers), self.array.seen_from(pose), codes
                made = simulate_echoes(quick, *given, receivers=receivers).pressures
            except InvalidInput:
                continue  # no such bodies, or one in an element
            costs.append((power(np.asarray(made) * self.valid - self.measured), x))
        return [x for _, x in sorted(costs, key=lambda one: one[0])]

    def located(self, found: _Found) -> LocatedShape:
        """Say what was found, and how sure it is."""
        pose, numbers = self.place(found.x)
        count = max(np.count_nonzero(self.measured), 1)
        places = self.array.positions[self.echoes.receiving[self.rows]]
        information = information_of(found.derivatives.astype(np.complex64))
        left = power(found.residual) / count
        inverse = np.linalg.inv(information + 0.5 * left * np.eye(len(information)))
        left *= max(1.0, disagreement(found.derivatives, found.residual, inverse, places))
        doubt = np.linalg.inv(np.eye(len(information)) + 2.0 * information / left)
        scene, misfit = self.bodies.scene_of(numbers), self.misfit(found)
        corners = np.concatenate([one.surface.corners for one in scene.obstacles])
        normals = area_vectors(corners)
        areas = np.linalg.norm(normals, axis=1)
        shifts = self._shifts(numbers, corners.mean(axis=1), normals / areas[:, None])
        turn = np.eye(len(doubt))
        turn[:6, :6] = np.kron(np.eye(2), pose.rotation)
        to_units = turn * self.deviations
        return LocatedShape(
            pose=pose,
            numbers=numbers,
            scene=scene,
            covariance=to_units @ doubt @ to_units.T,
            surface_deviation=float(np.sqrt(areas @ np.einsum("pu,uv,pv->p", shifts, doubt, shifts) / areas.sum())),
            residual=float(np.sqrt(power(found.residual) / power(self.measured))),
            misfit=misfit,
            converged=bool(found.settled and misfit <= EXPLAINED),
            steps=found.steps,
            centre=pose.apply(self.centre[None])[0],
        )


def _parts(values: Complex[np.ndarray, "rows receivers transmissions"]) -> Float64[np.ndarray, "parts rows"]:
    """Real parts, then imaginary ones, of each row."""
    rows = values.reshape(len(values), -1)
    return np.concatenate([rows.real, rows.imag], axis=1).T
