"""Where the bodies of a scene are, and how far they are open, from the echoes of the array's own transmissions.

The pose is the one whose echoes are nearest to those measured, by Levenberg and Marquardt's damped
Gauss-Newton steps with exact derivatives: first from few receivers and transmissions, which is
quick, then from all. Echoes of a pose off by half a wavelength of the way there and back have
nothing in common with those measured, so where the start does not lead to a pose that explains the
echoes, others around it are tried.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Complex, Float64, Int64
from scipy.stats import qmc

from airtact.acoustics.scene import Scene
from airtact.acoustics.solvers.bem.solver import BoundaryElement
from airtact.acoustics.solvers.problem import Solver
from airtact.checks import counted, of_kind
from airtact.errors import InvalidInput
from airtact.geometry.pose import Pose
from airtact.printing import one_line
from airtact.sensing.array_waves import array_waves
from airtact.sensing.doubt import disagreement, information_of, power
from airtact.sensing.echo_model import EchoModel, Motion, Received, motion_of
from airtact.sensing.echoes import Echoes, check_elements
from airtact.sensing.family import ScatteringFamily
from airtact.sensing.scattering import ScatteringMatrix, check_own, scattering_matrix
from airtact.transducers.layout import PhasedArray
from airtact.transducers.placement import check_placement

EXPLAINED = 0.1
"""Echoes that a pose leaves unexplained beyond noise, as a share of all, up to which it is believed."""

REACH = 6e-3, np.radians(9.0)
"""Translation [m] and turn [rad] around the start within which other starts are tried."""

SPARE_ORDERS = 9
"""Orders beyond those of the bodies that a motion of a few millimetres takes waves from."""

STARTS, FOLLOWED, BEST = 128, 16, 2
"""Number of other starts whose echoes are computed, of those from which steps are taken, and of those that end at the
best poses, which are compared by all receivers."""

FEW_RECEIVERS, FEW_TRANSMISSIONS = 160, 8
"""Receivers and transmissions that the first steps are taken by, and other starts compared."""

MOST_STEPS = 25
MOST_DAMPING = 1e6
SETTLED = 1e-7
"""Length of a step at which a pose is settled [m]."""

KEPT = 3e-5
"""Length of a step after which derivatives are not computed again, as they change by a few per cent [m]."""

UNDETERMINED = 1e-3
"""Least over largest effect of two motions of the same length on the echoes."""

UNDETERMINED_OPENING = 5e-3
"""The same where an opening is sought: its derivative lacks the waves that the matrices leave out."""

OF_ERROR = 10.0
"""The same over the error of a family's interpolation: its derivative is off by more than its matrix is."""

CLIPPED = 0.05
"""Share of pressures of one size, the largest, from which on they were clipped."""

SOLVED = 0.05
"""Part of the echoes that errors of solvers and of interpolation leave unexplained, which is not the shape's."""

SHAPE_FREEDOM = 8
"""Ways in which a wrong shape leaves echoes unexplained: two fingers' ends and radii, less the six of a pose."""

MISSING = 5.0
"""Residual of a receiver over that of the median from which on it is left out."""


@dataclass(frozen=True, eq=False)
class Located:
    """Where the bodies are, as ``locate`` finds it.

    Attributes
    ----------
    pose : of the obstacles in the array's frame, as of ``PhasedArray.seen_from``.
    covariance : (6, 6) of the translation of ``centre`` [m] and of a small turn about it [rad],
        along the array's axes, with a seventh row and column for ``opening`` where that is found,
        too: from all that is left unexplained, and larger where receivers in different places
        disagree by more than noise would make them, or where so much is left beyond noise that the
        shape must be wrong.
    bound : the Cramér-Rao bound, as large: the least covariance that the given noise allows; NaN
        where it is not known.
    residual : rms of what the pose leaves unexplained over that of the echoes, noise included.
    misfit : the same beyond noise; a wrong model, such as another hand, leaves 0.2 and more.
    converged : whether the steps settled and the misfit is at most 0.1. Believe no other pose.
    steps : number of steps taken from the start that led there.
    centre : (3,) middle of the bodies in the array's frame [m].
    left_out : numbers of receivers whose pressures fit nothing, such as dead ones.
    opening : number of the ``ScatteringFamily`` that fits best, such as the gap of two fingers [m];
        None for a scene.
    """

    pose: Pose
    covariance: Float64[np.ndarray, "unknowns unknowns"]
    bound: Float64[np.ndarray, "unknowns unknowns"]
    residual: float
    misfit: float
    converged: bool
    steps: int
    centre: Float64[np.ndarray, "3"]
    left_out: Int64[np.ndarray, "missing"]
    opening: float | None = None

    def __repr__(self) -> str:
        position, turn = self.deviation
        opened = (
            ()
            if self.opening is None
            else (f"opening {self.opening:.5g} ± {self.opening_deviation:.2g}",)
        )
        return one_line(
            self,
            "converged" if self.converged else "NOT converged",
            f"sure to {1e3 * position:.2g} mm and {np.degrees(turn):.2g} degrees",
            *opened,
            f"residual {self.residual:.2g}, misfit {self.misfit:.2g}",
        )

    @property
    def deviation(self) -> tuple[float, float]:
        """Standard deviation of the translation [m] and of the turn [rad], of all three axes together."""
        variances = np.diag(self.covariance)
        return float(np.sqrt(variances[:3].sum())), float(np.sqrt(variances[3:6].sum()))

    @property
    def opening_deviation(self) -> float:
        """Standard deviation of the opening, in its unit; NaN where it was not sought."""
        return float(np.sqrt(self.covariance[6, 6])) if len(self.covariance) > 6 else float("nan")


def locate(
    echoes: Echoes,
    scene: Scene | ScatteringFamily,
    array: PhasedArray,
    start: Pose,
    *,
    scattering: ScatteringMatrix | None = None,
    solver: Solver | None = None,
) -> Located:
    """Find the rigid pose of the bodies of a scene from echoes, and how far they are open where that is not known.

    Parameters
    ----------
    echoes : measured, less what the empty array receives.
    scene : the bodies in their own frame; or a ``ScatteringFamily`` of bodies that change with one
        number, such as the gap of two fingers, which is found, too.
    array : the transducers in their own frame, in the order of the codes.
    start : where the bodies may be, within about 5 mm and 8 degrees; maps the obstacles' frame to
        the array's.
    scattering : of the scene; computed by the solver unless given. A family has its own.
    solver : of the scattering matrix; ``BoundaryElement(accuracy=0.005, estimate=False)`` unless
        given.

    Returns
    -------
    The pose that explains the echoes best, with how sure it is; look at ``converged`` first.

    Raises
    ------
    InvalidInput
        "sizes_differ", "does_not_match", "does_not_match": of echoes or scattering matrix; "signal_unusable", "clipped";
        "bodies_overlap", "inside_body", "behind_faces", "bodies_overlap": the start cannot be;
        "pose_not_found": the echoes do not determine some motion, such as a turn of a ball, or the opening;
        "given_twice": a family and a scattering matrix; or as ``scattering_matrix``.

    Examples
    --------
    >>> import airtact as at
    >>> bodies = [at.sphere(4e-3, 1.5e-3, (x, y, 0)) for x, y in ((-7e-3, 0), (7e-3, 2e-3), (0, 8e-3))]
    >>> scene = at.Scene(at.air(celsius=20.0), [at.sound_hard(body) for body in bodies], frequency=40e3)
    >>> array, true = at.surrounding_box(), at.Pose.turn((0, 0, 1), 0.3, (1e-3, 0, 2e-3))
    >>> scattering = at.scattering_matrix(at.BoundaryElement(accuracy=0.05, estimate=False), scene)
    >>> seen, codes = array.seen_from(true), at.sensing.random_codes(996, 4)
    >>> echoes = at.simulate_echoes(scattering, scene, seen, codes, noise=30.0)
    >>> found = locate(echoes, scene, array, at.Pose.turn((0, 0, 1), 0.29, (1.5e-3, 0, 2e-3)), scattering=scattering)
    >>> bool(found.converged and np.abs(found.pose.translation - true.translation).max() < 2e-5)
    True
    """
    family = scene if isinstance(scene, ScatteringFamily) else None
    scene = scene.scene if isinstance(scene, ScatteringFamily) else scene
    seen = check_start(echoes, scene, array, start)
    scattering = _scattering(family, scene, scattering, solver)
    waves = array_waves(scattering, seen, scattering.order + SPARE_ORDERS, single=True)
    model = EchoModel.of(
        scattering, waves, np.asarray(echoes.codes), echoes.receiving, echoes.valid
    )
    fit = _Fit(
        model, np.asarray(echoes.pressures).astype(np.complex64), echoes.noise or 0.0, family
    )
    found = fit.best()
    missing = fit.missing(found)
    if len(missing):
        fit = fit.part(
            np.setdiff1d(np.arange(len(echoes.receiving)), missing), model.emitted.shape[1]
        )
        found = fit.follow(*found.place)
    places = array.positions[
        np.setdiff1d(echoes.receiving, echoes.receiving[missing], assume_unique=True)
    ]
    return _located(fit, found, start, echoes.receiving[missing], places)


def _scattering(
    family: ScatteringFamily | None,
    scene: Scene,
    given: ScatteringMatrix | None,
    solver: Solver | None,
) -> ScatteringMatrix:
    """Return the scattering matrix that was given, or of the start of a family, or solve for it."""
    if family is None:
        scattering = given or scattering_matrix(
            solver or BoundaryElement(accuracy=0.005, estimate=False), scene
        )
        check_own(scattering, scene)
        _ = scattering.patterns  # every pose that is tried uses them
        return scattering
    if given is not None or solver is not None:
        raise InvalidInput(
            f"a family has {len(family.matrices)} scattering matrices of its own: leave scattering and solver out.",
            code="given_twice",
        )
    return family.at(family.start)


@dataclass(frozen=True, eq=False)
class _Found:
    """A pose, as a motion from the start, the opening there, and what both leave unexplained."""

    motion: Motion
    residual: Received
    steps: int
    settled: bool
    opening: float | None = None
    derivatives: Complex[np.ndarray, "unknowns receivers transmissions"] | None = None
    """Of the echoes, per metre, radian and unit of the opening, not farther away than ``KEPT``."""

    @property
    def place(self) -> tuple[Motion, float | None, int]:
        """Where to go on from, and after how many steps."""
        return self.motion, self.opening, self.steps

    @property
    def cost(self) -> float:
        """Sum of the squares of the residual [Pa²]."""
        return power(self.residual)


@dataclass(frozen=True, eq=False)
class _Fit:
    """Echoes to be explained, and their model: of bodies, or of a family of them about the same centre."""

    model: EchoModel
    measured: Received
    noise: float
    family: ScatteringFamily | None = None

    def best(self) -> _Found:
        """Follow the start, and where that explains nothing, the other starts: by few receivers, then by all."""
        few = self.few()
        near = few.follow(np.eye(4), None if self.family is None else self.family.start)
        if few.explained(near) and self.explained(found := self.follow(*near.place)):
            return found
        tried = sorted([near, *few.others()], key=lambda one: one.cost)
        return min((self.follow(*one.place) for one in tried[:BEST]), key=lambda one: one.cost)

    def start(
        self, motion: Motion, opening: float | None, steps: int = 0, *, derive: bool = False
    ) -> _Found:
        """Return what a pose and an opening leave unexplained, with the derivatives if wanted."""
        model = self._opened(opening)
        if not derive:
            return _Found(motion, model.echoes(motion) - self.measured, steps, False, opening)
        both = model.with_derivatives(motion)
        residual, by = both[0] - self.measured, both[1:]
        if self.family is not None and opening is not None:
            changed = replace(self.model, scattering=self.family.derivative(opening))
            by = np.concatenate([by, changed.echoes(motion)[None]])
        return _Found(motion, residual, steps, False, opening, by)

    def follow(self, motion: Motion, opening: float | None, steps: int = 0) -> _Found:
        """Take damped Gauss-Newton steps from a pose and an opening until they settle."""
        damping, units = 1e-3, self.units
        here = self.start(motion, opening, steps, derive=True)
        by = here.derivatives
        for count in range(steps + 1, steps + MOST_STEPS + 1):
            assert by is not None  # of the start
            information = information_of(by)
            squares = units[:, None] * information * units
            slope = units * np.real(by.reshape(len(by), -1).conj() @ here.residual.reshape(-1))
            while True:
                least = np.diag(np.diag(squares) + 1e-12 * squares.max())
                step = -np.linalg.solve(squares + damping * least, slope)
                length = float(np.linalg.norm(step))
                if length < SETTLED:
                    return replace(here, steps=count, settled=True, derivatives=by)
                tried = self._moved(here, step * units, count, derive=length > KEPT)
                if tried.cost < here.cost:
                    break
                if damping > MOST_DAMPING:
                    return replace(here, steps=count, derivatives=by)
                damping *= 6.0
            small = tried.cost > (1.0 - 1e-7) * here.cost
            here, damping = tried, 0.2 * damping
            by = by if here.derivatives is None else here.derivatives
            if small:
                return replace(here, settled=True, derivatives=by)
        return replace(here, derivatives=by)

    @property
    def units(self) -> Float64[np.ndarray, "unknowns"]:
        """By which a step in metres becomes one in metres, radians and units of the opening of about as much effect."""
        of_opening = [] if self.family is None else [1.0 / self.family.effect]
        return np.array([1.0] * 3 + [1.0 / self.model.scattering.radius] * 3 + of_opening)

    def _opened(self, opening: float | None) -> EchoModel:
        if self.family is None or opening is None:
            return self.model
        return replace(self.model, scattering=self.family.at(opening))

    def _moved(
        self, here: _Found, step: Float64[np.ndarray, "unknowns"], count: int, *, derive: bool
    ) -> _Found:
        opening = here.opening
        if self.family is not None and opening is not None:
            opening = float(np.clip(opening + step[6], self.family.low, self.family.high))
        return self.start(here.motion @ motion_of(step[:6]), opening, count, derive=derive)

    def few(self) -> "_Fit":
        """Return the fit of few receivers, chosen at random, and of the first transmissions."""
        receivers, transmissions = self.measured.shape
        some = np.sort(np.random.default_rng(0).permutation(receivers)[:FEW_RECEIVERS])
        return self.part(some, min(transmissions, FEW_TRANSMISSIONS))

    def others(self) -> Iterator[_Found]:
        """Follow other starts, those whose echoes are nearest to the measured ones first, until one explains them."""
        family = self.family
        cubes = 2.0 * qmc.Sobol(6 if family is None else 7, rng=0).random(4 * STARTS) - 1.0
        inside = [
            one for one in cubes if max(np.linalg.norm(one[:3]), np.linalg.norm(one[3:6])) <= 1.0
        ][:STARTS]
        tried = []
        for one in inside:
            opening = (
                None
                if family is None
                else 0.5 * (family.low + family.high + one[6] * (family.high - family.low))
            )
            tried.append(self.start(motion_of(np.repeat(REACH, 3) * one[:6]), opening))
        for one in sorted(tried, key=lambda one: one.cost)[:FOLLOWED]:
            found = self.follow(*one.place)
            yield found
            if self.explained(found):
                return

    def part(self, receivers: Int64[np.ndarray, "some"], transmissions: int) -> "_Fit":
        """Return the fit of some receivers and the first transmissions."""
        measured = self.measured[receivers, :transmissions]
        return _Fit(self.model.part(receivers, transmissions), measured, self.noise, self.family)

    def misfit(self, found: _Found) -> float:
        """Rms of the residual beyond noise over that of the echoes beyond noise."""
        of_noise = self.noise**2 * np.count_nonzero(self.measured)  # those that are not valid are 0
        whole = max(power(self.measured) - of_noise, 1e-300)
        return float(np.sqrt(max(found.cost - of_noise, 0.0) / whole))

    def of_shape(self, found: _Found) -> float:
        """Twice the power that a wrong shape leaves unexplained, for each way in which it can be wrong [Pa²].

        Such a residual is one of few degrees of freedom, however many pressures there are. What a
        pose has taken up of it is about as much for each of its own, so that it is divided by these
        and not by the number of pressures.
        """
        whole = power(self.measured)
        return 2.0 * max(self.misfit(found) ** 2 - SOLVED**2, 0.0) * whole / SHAPE_FREEDOM

    def explained(self, found: _Found) -> bool:
        """Whether a pose is to be believed; receivers that fit nothing do not count."""
        missing = self.missing(found)
        if not len(missing):
            return self.misfit(found) <= EXPLAINED
        kept = np.setdiff1d(np.arange(len(self.measured)), missing)
        alone = replace(found, residual=found.residual[kept], derivatives=None)
        return _Fit(self.model, self.measured[kept], self.noise).misfit(alone) <= EXPLAINED

    def missing(self, found: _Found) -> Int64[np.ndarray, "missing"]:
        """Rows of receivers that fit nothing while most do: at most one in five."""
        own = np.sqrt(np.mean(np.abs(found.residual) ** 2, axis=1))
        size = np.sqrt(np.mean(np.abs(self.measured) ** 2, axis=1))
        expected = np.sqrt(np.mean(np.abs(found.residual + self.measured) ** 2, axis=1))
        bad = np.flatnonzero(
            (own > MISSING * np.median(own)) & (own > 0.5 * np.maximum(size, expected))
        )
        return bad if len(bad) <= 0.2 * len(own) else np.zeros(0, dtype=np.int64)


def _located(
    fit: _Fit,
    found: _Found,
    start: Pose,
    left_out: Int64[np.ndarray, "missing"],
    places: Float64[np.ndarray, "receivers 3"],
) -> Located:
    """Say what was found, and how sure it is; ``places`` are those of the receivers that count."""
    scattering, size = fit.model.scattering, power(fit.measured)
    centre, turn = scattering.centre, found.motion[:3, :3]
    pose = start @ Pose(turn, centre - turn @ centre + found.motion[:3, 3])
    by = found.derivatives
    assert by is not None  # the last pose of steps has them
    information = information_of(by)
    least = (
        UNDETERMINED
        if fit.family is None
        else max(UNDETERMINED_OPENING, OF_ERROR * fit.family.error)
    )
    _check_determined(information, fit.units, least, pose, *fit.measured.shape)
    to_array = np.eye(len(information))
    to_array[:6, :6] = np.kron(np.eye(2), pose.rotation)
    inverse = np.linalg.inv(information)
    unit = to_array @ inverse @ to_array.T / 2.0
    unexplained = found.cost / max(np.count_nonzero(fit.measured) - len(information) / 2, 1)
    unexplained *= max(1.0, disagreement(by, found.residual, inverse, places))
    misfit, family = fit.misfit(found), fit.family
    inside = family is None or found.opening is None or family.low < found.opening < family.high
    return Located(
        pose=pose,
        covariance=(unexplained + fit.of_shape(found)) * unit,
        bound=(fit.noise**2 if fit.noise else np.nan) * unit,
        residual=float(np.sqrt(found.cost / size)),
        misfit=misfit,
        converged=bool(found.settled and misfit <= EXPLAINED and inside),
        steps=found.steps,
        centre=pose.apply(centre[None])[0],
        left_out=left_out,
        opening=found.opening,
    )


def _check_determined(
    information: Float64[np.ndarray, "unknowns unknowns"],
    units: Float64[np.ndarray, "unknowns"],
    least: float,
    pose: Pose,
    receivers: int,
    transmissions: int,
) -> None:
    """Raise "pose_not_found" where a motion of the bodies, or the opening, hardly changes the echoes."""
    values, vectors = np.linalg.eigh(units[:, None] * information * units)
    if values[0] > least**2 * values[-1]:
        return
    effect, motion = np.sqrt(max(values[0], 0.0) / values[-1]), vectors[:, 0]
    shift, turn, opening = (
        float(np.linalg.norm(motion[some])) for some in (slice(3), slice(3, 6), slice(6, 7))
    )
    x, y, z = pose.rotate(motion[3:6] if turn > shift else motion[:3]) / max(shift, turn, 1e-12)
    parts = [
        f"{'a turn about' if turn > shift else 'a translation along'} ({x:.2f}, {y:.2f}, {z:.2f})"
    ]
    if opening > 0.1:
        parts = ["a change of the opening", *(parts if max(shift, turn) > 0.1 else [])]
    raise InvalidInput(
        f"{counted(receivers, 'receiver', 'receivers')} and {counted(transmissions, 'transmission', 'transmissions')} "
        f"do not determine the {'pose and the opening' if opening > 0.1 else 'pose'}: {' together with '.join(parts)} "
        f"changes the echoes by {effect:.1g} of what other motions do. Give more of them, or bodies without that "
        "symmetry.",
        code="pose_not_found",
    )


def check_start(echoes: Echoes, scene: Scene, array: PhasedArray, start: Pose) -> PhasedArray:
    """Return the array in the frame of the bodies.

    Raise for echoes that are not of this scene and array, or hold nothing, and for a start that
    cannot be.
    """
    of_kind(start, Pose, "the start", "Pose(rotation, translation)")
    of_kind(echoes, Echoes, "the echoes", "Echoes(codes, pressures)")
    of_kind(scene, Scene, "the scene", "Scene(medium, obstacles)")
    of_kind(array, PhasedArray, "the array", "one such as surrounding_box()")
    check_elements(echoes, array, "echoes")
    if abs(echoes.frequency - scene.frequency) > 1e-6 * scene.frequency:
        raise InvalidInput(
            f"the echoes are at {echoes.frequency:g} Hz, and the scene at {scene.frequency:g} Hz: give the scene the "
            "frequency of the echoes.",
            code="does_not_match",
        )
    seen = array.seen_from(start)
    check_placement(scene, seen)
    _check_pressures(echoes)
    return seen


def _check_pressures(echoes: Echoes) -> None:
    """Raise "signal_unusable" or "clipped"."""
    pressures = np.asarray(echoes.pressures)[
        () if echoes.valid is None else np.asarray(echoes.valid)
    ]
    size = np.abs(pressures)
    rms = float(np.sqrt(np.mean(size**2)))
    if rms == 0.0 or (echoes.noise is not None and rms < 1.05 * echoes.noise):
        raise InvalidInput(
            f"the echoes have {rms:.3g} Pa rms, hardly more than the noise of {echoes.noise or 0.0:.3g} Pa: they hold "
            "nothing of the bodies.",
            code="signal_unusable",
        )
    parts = np.abs(np.stack([np.real(pressures), np.imag(pressures)]))
    for values in (size, *parts):
        equal = int(np.sum(values > (1.0 - 1e-6) * values.max()))
        if equal > max(CLIPPED * values.size, 8):
            raise InvalidInput(
                f"{equal} of {values.size} pressures have the same largest value of {values.max():.4g} Pa: they were "
                "clipped; measure again with less gain.",
                code="signal_unusable",
            )
