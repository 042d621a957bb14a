"""Where bodies are and what shape they have, from the echoes of the array's own transmissions.

Pose and numbers are those that are most probable given the echoes and what was expected of the
numbers, by a trust region (M. A. Branch, T. F. Coleman, Y. Li, SIAM J. Sci. Comput. 21 (1999) 1)
with derivatives by reciprocity: one solve a step, however many numbers there are.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool, Complex, Float64, Int64
from scipy.optimize import least_squares

from airtact.acoustics.scene import Scene
from airtact.acoustics.solvers.bem.solver import BoundaryElement
from airtact.acoustics.solvers.spherical.multipole_field import ball_of
from airtact.checks import of_kind
from airtact.errors import InvalidInput
from airtact.geometry.mesh.quadratic_triangles import area_vectors
from airtact.geometry.pose import Pose
from airtact.printing import one_line
from airtact.sensing.doubt import disagreement, information_of, power
from airtact.sensing.echo_model import Received, motion_of
from airtact.sensing.echoes import Echoes
from airtact.sensing.registration import EXPLAINED, Located, check_start
from airtact.sensing.shapes.derivative import solve_echoes
from airtact.sensing.shapes.unknown import UnknownShape
from airtact.sensing.simulation import simulate_echoes
from airtact.timing import Progress, no_progress
from airtact.transducers.layout import PhasedArray
from airtact.transducers.placement import check_placement

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

NUDGE, SIZE = 1e-5, 0.02
"""Motion by which the shift of surfaces is found by differences, and radius at which turns make it [m]."""

FIRST_STEP = 0.1
"""Longest first step, in standard deviations."""

STARTS, FOLLOWED = 64, 4
"""Other poses whose echoes are computed, and those from which steps are taken, where the first explains nothing."""

AWAY = 0.4
"""Standard deviation of other poses, in those of the start."""


@dataclass(frozen=True, eq=False, kw_only=True)
class LocatedShape(Located):
    """Where bodies are and what shape they have, as ``locate_shape`` finds it.

    A motion of all bodies can be one of the pose or one of the numbers: both together say where the
    surfaces are. ``covariance`` and ``bound`` are (6 + K, 6 + K), of the pose and of the numbers,
    given the echoes and what was expected; ``steps`` counts solves. ``left_out`` is empty.

    Attributes
    ----------
    numbers : (K,) of the ``UnknownShape``.
    scene : the bodies of these numbers, in their own frame.
    surface_deviation : standard deviation of where the surfaces are along their normals, rms over
        them [m].
    """

    numbers: Float64[np.ndarray, "numbers"]
    scene: Scene
    surface_deviation: float

    def __repr__(self) -> str:
        return one_line(
            self,
            "converged" if self.converged else "NOT converged",
            f"surfaces sure to {1e3 * self.surface_deviation:.2g} mm" * self.converged,
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

    The start and what is expected of the numbers count as knowledge with standard deviations (5 mm
    and 9 degrees, and those given), so that what echoes do not determine stays as expected, and its
    doubt as large.

    Parameters
    ----------
    echoes : measured, less what the empty array receives; up to 128 receivers, chosen at random,
        are used.
    bodies : what is known of them, such as ``UnknownShape.of_capsules(scene)``.
    array : the transducers in their own frame, in the order of the codes.
    start : where the bodies may be, within about 3 mm and 5 degrees; maps the bodies' frame to the
        array's.
    solver : of the last steps; ``BoundaryElement(accuracy=0.01)`` unless given. The first are taken
        at 3 %.
    progress : called with the words of each step.

    Returns
    -------
    The most probable pose and shape, with how sure they are; look at ``converged`` first.

    Raises
    ------
    InvalidInput
        "sizes_differ", "does_not_match": of the echoes; "signal_unusable", "clipped"; "inside_body", "behind_faces": the
        start cannot be; or as ``bodies.scene_of`` for the expected numbers.

    Examples
    --------
    >>> import airtact as at
    >>> fingers = at.Scene(at.air(celsius=20.0), [at.sound_hard(one) for one in at.pinch().surfaces], frequency=40e3)
    >>> at.sensing.UnknownShape.of_capsules(fingers, ends=4e-3, radius=1e-3)
    UnknownShape(14 numbers, 2 bodies)
    """
    of_kind(
        bodies,
        UnknownShape,
        "what is known of the bodies",
        "UnknownShape(scene_of, expected, deviations)",
    )
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
        progress(
            f"the start leaves {self.misfit(found):.2f} of the echoes unexplained: trying {STARTS} others"
        )
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
        return (
            np.ones((1, 1), dtype=bool)
            if self.echoes.valid is None
            else np.asarray(self.echoes.valid)[self.rows]
        )

    def place(
        self, x: Float64[np.ndarray, "unknowns"]
    ) -> tuple[Pose, Float64[np.ndarray, "numbers"]]:
        """Pose and numbers of unknowns."""
        motion = motion_of((self.deviations * x)[:6])
        turn = motion[:3, :3]
        moved = self.start @ Pose(turn, self.centre - turn @ self.centre + motion[:3, 3])
        return moved, np.asarray(self.bodies.expected) + (self.deviations * x)[6:]

    def solved(
        self, x: Float64[np.ndarray, "unknowns"]
    ) -> tuple[Received, Complex[np.ndarray, "unknowns receivers transmissions"]]:
        """Echoes (R, M) [Pa] and their derivatives (U, R, M), per standard deviation of the unknowns."""
        pose, numbers = self.place(x)
        scene, receivers = self.bodies.scene_of(numbers), self.echoes.receiving[self.rows]
        seen, codes = self.array.seen_from(pose), np.asarray(self.echoes.codes)
        check_placement(scene, seen)
        made = solve_echoes(self.solver, scene, seen, codes, receivers)
        by = made.derivatives(self._shifts(numbers, made.surface.points))
        return made.echoes * self.valid, by * self.valid

    def _shifts(
        self, numbers: Float64[np.ndarray, "numbers"], points: Float64[np.ndarray, "points 3"]
    ) -> Float64[np.ndarray, "points unknowns"]:
        """How far standard deviations of the unknowns move the surfaces outward at points on them [m]."""
        scene, away = self.bodies.scene_of(numbers), points - self.centre
        axes = np.eye(3)
        motions = [
            *(NUDGE * axis for axis in axes),
            *(NUDGE * np.cross(axis, away) / SIZE for axis in axes),
        ]
        by_motions = [
            (scene.depth(points - by) - scene.depth(points + by)) / (2.0 * NUDGE) for by in motions
        ]
        shifts = np.stack(by_motions, axis=1) * np.repeat([1.0, SIZE], 3)
        return (
            np.concatenate([shifts, self.bodies.shifts(numbers, points)], axis=1) * self.deviations
        )

    def follow(self, x: Float64[np.ndarray, "unknowns"], steps: int = 0) -> _Found:
        """Take steps until the squares of what is left, and of how unexpected the unknowns are, settle."""
        made = _Steps(self, x)
        found = least_squares(
            made.left,
            np.zeros(len(x)),
            made.derivatives,  # pyright: ignore[reportArgumentType]
            x_scale=FIRST_STEP,
            ftol=SETTLED,
            xtol=SHORTEST,
            max_nfev=MOST_STEPS,
        )
        parts = self.doubt * np.concatenate([found.fun[:, None], found.jac], axis=1)[: -len(x)].T
        both = (parts[:, : self.measured.size] + 1j * parts[:, self.measured.size :]).reshape(
            -1, *self.measured.shape
        )
        return _Found(x + found.x, both[0], both[1:], bool(found.status > 0), steps + found.nfev)

    def misfit(self, found: _Found) -> float:
        """Rms of the residual beyond noise over that of the echoes beyond noise."""
        of_noise = (self.echoes.noise or 0.0) ** 2 * np.count_nonzero(self.measured)
        whole = max(power(self.measured) - of_noise, 1e-300)
        return float(np.sqrt(max(power(found.residual) - of_noise, 0.0) / whole))

    @property
    def doubt(self) -> float:
        """Rms of what noise and the solver's error leave unexplained of one pressure [Pa]."""
        rms = np.sqrt(power(self.measured) / max(np.count_nonzero(self.measured), 1))
        return float(np.hypot(self.echoes.noise or 0.0, self.solver.accuracy * rms))

    def _others(self) -> list[Float64[np.ndarray, "unknowns"]]:
        """Other poses, at random around the first, those whose echoes are nearest to the measured ones first."""
        costs, unmoved = [], np.zeros(len(self.bodies.expected))
        quick = BoundaryElement(accuracy=0.1, estimate=False)
        for motion in AWAY * np.random.default_rng(0).normal(size=(STARTS, 6)):
            x = np.concatenate([motion, unmoved])
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
        information = information_of(found.derivatives)
        left = power(found.residual) / count
        inverse = np.linalg.inv(information + 0.5 * left * np.eye(len(information)))
        left *= max(1.0, disagreement(found.derivatives, found.residual, inverse, places))
        left += (
            self.solver.accuracy**2 * power(self.measured) / len(information)
        )  # as alike everywhere as a motion is
        noise = self.echoes.noise or np.nan
        doubt, least = (
            np.linalg.inv(np.eye(len(information)) + 2.0 * information / one)
            for one in (left, noise**2)
        )
        scene, misfit = self.bodies.scene_of(numbers), self.misfit(found)
        corners = np.concatenate([one.surface.corners for one in scene.obstacles])
        areas = np.linalg.norm(area_vectors(corners), axis=1)
        shifts = self._shifts(numbers, corners.mean(axis=1))
        turn = np.eye(len(doubt))
        turn[:6, :6] = np.kron(np.eye(2), pose.rotation)
        to_units = turn * self.deviations
        return LocatedShape(
            pose=pose,
            numbers=numbers,
            scene=scene,
            covariance=to_units @ doubt @ to_units.T,
            bound=to_units @ least @ to_units.T,
            surface_deviation=float(
                np.sqrt(areas @ np.einsum("pu,uv,pv->p", shifts, doubt, shifts) / areas.sum())
            ),
            residual=float(np.sqrt(power(found.residual) / power(self.measured))),
            misfit=misfit,
            converged=bool(found.settled and misfit <= EXPLAINED),
            steps=found.steps,
            centre=pose.apply(self.centre[None])[0],
            left_out=np.zeros(0, dtype=np.int64),
        )


@dataclass(frozen=True, eq=False)
class _Steps:
    """What ``least_squares`` asks for, by steps from some unknowns: both of its questions are one solve."""

    fit: _Fit
    x: Float64[np.ndarray, "unknowns"]
    known: dict[bytes, Float64[np.ndarray, "parts unknowns"]] = field(default_factory=dict)

    def left(self, step: Float64[np.ndarray, "unknowns"]) -> Float64[np.ndarray, "parts"]:
        """Return what is left over its doubt, then the unknowns; infinite where no such bodies can be."""
        fit, x = self.fit, self.x + step
        try:
            echoes, by = fit.solved(x)
        except InvalidInput:
            if not self.known:
                raise
            return np.full(2 * fit.measured.size + len(x), np.inf)
        self.known.clear()
        self.known[step.tobytes()] = np.concatenate([_parts(by / fit.doubt), np.eye(len(x))])
        return np.concatenate([_parts((echoes - fit.measured)[None] / fit.doubt)[:, 0], x])

    def derivatives(
        self, step: Float64[np.ndarray, "unknowns"]
    ) -> Float64[np.ndarray, "parts unknowns"]:
        """Differentiate it where it was asked for last."""
        return self.known[step.tobytes()]


def _parts(
    values: Complex[np.ndarray, "rows receivers transmissions"],
) -> Float64[np.ndarray, "parts rows"]:
    """Real parts, then imaginary ones, of each row."""
    rows = values.reshape(len(values), -1)
    return np.concatenate([np.real(rows), np.imag(rows)], axis=1).T.astype(np.float64)
