"""Pose of the bodies of a scene, and their opening, from echoes of the array's transmissions.

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
from scipy.cluster.vq import kmeans2
from scipy.stats import qmc

from airtact.acoustics.scene import Scene
from airtact.acoustics.solvers.bem.solver import BoundaryElement
from airtact.acoustics.solvers.problem import Solver
from airtact.checks import counted, of_kind
from airtact.errors import InvalidInput
from airtact.geometry.pose import Pose
from airtact.printing import one_line
from airtact.sensing.echo_model import EchoModel, Motion, Received, array_waves, motion_of
from airtact.sensing.echoes import Echoes, check_elements, check_not_clipped
from airtact.sensing.scattering import (
    ScatteringFamily,
    ScatteringMatrix,
    check_own,
    scattering_matrix,
)
from airtact.transducers.layout import PhasedArray
from airtact.transducers.placement import check_placement

MAX_MISFIT = 0.1
"""Largest share of the echoes that a believed pose leaves unexplained beyond noise."""

SPARE_ORDERS = 9
"""Orders beyond those of the bodies that a motion of a few millimetres takes waves from."""


@dataclass(frozen=True)
class Settings:
    """Search for a pose, tuned together on pinches 2 to 5 mm and 3 to 8 degrees off the start.

    Attributes
    ----------
    shift, turn : largest translation [m] and turn [rad] of other starts.
    starts, followed, compared : other starts that are tried, those from which steps are taken, and
        the best poses that are compared by all receivers.
    receivers, transmissions : used for the first steps and to compare starts.
    settled : length of a step at which a pose is settled [m].
    kept : length of a step after which derivatives, which change by a few per cent, are kept [m].
    """

    shift: float = 6e-3
    turn: float = float(np.radians(9.0))
    starts: int = 128
    followed: int = 16
    compared: int = 2
    receivers: int = 160
    transmissions: int = 8
    steps: int = 25
    settled: float = 1e-7
    kept: float = 3e-5


SETTINGS = Settings()


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
        """Standard deviation of the translation [m] and of the turn [rad], over all axes."""
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
    """Find the rigid pose of the bodies of a scene from echoes, and an unknown opening.

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
        "sizes_differ", "does_not_match": echoes or scattering matrix; "signal_unusable";
        "bodies_overlap", "inside_body", "behind_faces": the start is impossible; "pose_not_found":
        the echoes do not determine some motion, such as a turn of a ball, or the opening;
        "given_twice": a family and a scattering matrix; or as ``scattering_matrix``.

    Examples
    --------
    >>> import airtact as at
    >>> places = ((-7e-3, 0, 0), (7e-3, 2e-3, 0), (0, 8e-3, 0))
    >>> bodies = [at.sound_hard(at.sphere(4e-3, 1.5e-3, place)) for place in places]
    >>> scene = at.Scene(at.air(celsius=20.0), bodies, frequency=40e3)
    >>> array, true = at.surrounding_box(), at.Pose.turn((0, 0, 1), 0.3, (1e-3, 0, 2e-3))
    >>> scattering = at.scattering_matrix(at.BoundaryElement(accuracy=0.05, estimate=False), scene)
    >>> seen, codes = array.seen_from(true), at.sensing.random_codes(996, 4)
    >>> echoes = at.simulate_echoes(scattering, scene, seen, codes, noise=30.0)
    >>> near = at.Pose.turn((0, 0, 1), 0.29, (1.5e-3, 0, 2e-3))
    >>> found = locate(echoes, scene, array, near, scattering=scattering)
    >>> bool(found.converged and np.abs(found.pose.translation - true.translation).max() < 2e-5)
    True
    """
    family = None
    if isinstance(scene, ScatteringFamily):
        family = scene
        scene = family.scene
        if scattering is not None or solver is not None:
            raise InvalidInput(
                f"a family has {len(family.matrices)} scattering matrices of its own: leave "
                "scattering and solver out.",
                code="given_twice",
            )
    seen = check_start(echoes, scene, array, start)
    if family is not None:
        scattering = family.at(family.start)
    else:
        solver = solver or BoundaryElement(accuracy=0.005, estimate=False)
        scattering = scattering or scattering_matrix(solver, scene)
        check_own(scattering, scene)
        _ = scattering.patterns  # found once, as every pose that is tried uses them
    waves = array_waves(scattering, seen, scattering.order + SPARE_ORDERS, single=True)
    codes = np.asarray(echoes.codes)
    model = EchoModel.of(scattering, waves, codes, echoes.receiving, echoes.valid)
    measured = np.asarray(echoes.pressures).astype(np.complex64)
    fit = _Fit(model, measured, echoes.noise or 0.0, family)
    best = fit.best()
    receivers = np.arange(len(echoes.receiving))
    missing = fit.missing(best)
    if len(missing):
        fit = fit.part(np.setdiff1d(receivers, missing), model.emitted.shape[1])
        best = fit.follow(best.motion, best.opening, best.steps)
    counted_receivers = echoes.receiving[np.setdiff1d(receivers, missing)]
    places = array.positions[counted_receivers]
    return _located(fit, best, start, echoes.receiving[missing], places)


@dataclass(frozen=True, eq=False)
class _Found:
    """A pose, as a motion from the start, the opening there, and what both leave unexplained."""

    motion: Motion
    residual: Received
    steps: int
    settled: bool
    opening: float | None = None
    derivatives: Complex[np.ndarray, "unknowns receivers transmissions"] | None = None
    """Of the echoes, per metre, radian and unit of the opening, within ``Settings.kept``."""

    @property
    def cost(self) -> float:
        """Sum of the squares of the residual [Pa²]."""
        return power(self.residual)


@dataclass(frozen=True, eq=False)
class _Fit:
    """Measured echoes and their model: of bodies, or of a family of them."""

    model: EchoModel
    measured: Received
    noise: float
    family: ScatteringFamily | None = None

    def best(self) -> _Found:
        """Follow the start, and other starts if it fails, by few receivers and then by all."""
        few = self.few()
        start = few.follow(np.eye(4), None if self.family is None else self.family.start)
        if few.explained(start):
            pose = self.follow(start.motion, start.opening, start.steps)
            if self.explained(pose):
                return pose
        tried = sorted([start, *few.others()], key=lambda pose: pose.cost)[: SETTINGS.compared]
        poses = [self.follow(pose.motion, pose.opening, pose.steps) for pose in tried]
        return min(poses, key=lambda pose: pose.cost)

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
        for count in range(steps + 1, steps + SETTINGS.steps + 1):
            assert by is not None  # of the start
            information = information_of(by)
            squares = units[:, None] * information * units
            slope = units * np.real(by.reshape(len(by), -1).conj() @ here.residual.reshape(-1))
            while True:
                least = np.diag(np.diag(squares) + 1e-12 * squares.max())
                step = -np.linalg.solve(squares + damping * least, slope)
                length = float(np.linalg.norm(step))
                if length < SETTINGS.settled:
                    return replace(here, steps=count, settled=True, derivatives=by)
                tried = self._moved(here, step * units, count, derive=length > SETTINGS.kept)
                if tried.cost < here.cost:
                    break
                if damping > 1e6:
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
        """Factors from steps in metres to metres, radians and units of the opening."""
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
        some = np.sort(np.random.default_rng(0).permutation(receivers)[: SETTINGS.receivers])
        return self.part(some, min(transmissions, SETTINGS.transmissions))

    def others(self) -> Iterator[_Found]:
        """Follow other starts, in order of their cost, until one explains the echoes."""
        family = self.family
        starts = (
            2.0 * qmc.Sobol(6 if family is None else 7, rng=0).random(4 * SETTINGS.starts) - 1.0
        )
        lengths = np.linalg.norm(starts[:, :6].reshape(-1, 2, 3), axis=2).max(axis=1)
        reach = np.repeat([SETTINGS.shift, SETTINGS.turn], 3)
        tried = []
        for start in starts[lengths <= 1.0][: SETTINGS.starts]:
            opening = None
            if family is not None:
                opening = 0.5 * (family.low + family.high + start[6] * (family.high - family.low))
            tried.append(self.start(motion_of(reach * start[:6]), opening))
        for start in sorted(tried, key=lambda start: start.cost)[: SETTINGS.followed]:
            pose = self.follow(start.motion, start.opening, start.steps)
            yield pose
            if self.explained(pose):
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
        """Twice the power that a wrong shape leaves unexplained, per degree of freedom [Pa²].

        Such a residual is one of few degrees of freedom, however many pressures there are. What a
        pose has taken up of it is about as much for each of its own, so that it is divided by these
        and not by the number of pressures.
        """
        # Solvers and interpolation leave 5 % unexplained. A wrong shape has about 8 degrees of
        # freedom: two fingers' ends and radii, less the six of a pose.
        excess = max(self.misfit(found) ** 2 - 0.05**2, 0.0)
        return 2.0 * excess * power(self.measured) / 8

    def explained(self, found: _Found) -> bool:
        """Whether a pose is to be believed; receivers that fit nothing do not count."""
        missing = self.missing(found)
        if not len(missing):
            return self.misfit(found) <= MAX_MISFIT
        kept = np.setdiff1d(np.arange(len(self.measured)), missing)
        alone = replace(found, residual=found.residual[kept], derivatives=None)
        return _Fit(self.model, self.measured[kept], self.noise).misfit(alone) <= MAX_MISFIT

    def missing(self, found: _Found) -> Int64[np.ndarray, "missing"]:
        """Rows of receivers that fit nothing while most do: at most one in five."""
        own = np.sqrt(np.mean(np.abs(found.residual) ** 2, axis=1))
        size = np.sqrt(np.mean(np.abs(self.measured) ** 2, axis=1))
        expected = np.sqrt(np.mean(np.abs(found.residual + self.measured) ** 2, axis=1))
        bad = np.flatnonzero(
            (own > 5.0 * np.median(own)) & (own > 0.5 * np.maximum(size, expected))
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
    least = 1e-3
    if fit.family is not None:
        # The derivative by the opening lacks the waves that the matrices leave out, and is off by
        # more than the interpolated matrix is.
        least = max(5e-3, 10.0 * fit.family.error)
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
        converged=bool(found.settled and misfit <= MAX_MISFIT and inside),
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
    """Raise "pose_not_found" where a motion or the opening hardly changes the echoes."""
    values, vectors = np.linalg.eigh(units[:, None] * information * units)
    if values[0] > least**2 * values[-1]:
        return
    effect, motion = np.sqrt(max(values[0], 0.0) / values[-1]), vectors[:, 0]
    shift = float(np.linalg.norm(motion[:3]))
    turn = float(np.linalg.norm(motion[3:6]))
    opening = float(np.linalg.norm(motion[6:]))
    x, y, z = pose.rotate(motion[3:6] if turn > shift else motion[:3]) / max(shift, turn, 1e-12)
    kind = "a turn about" if turn > shift else "a translation along"
    parts = [f"{kind} ({x:.2f}, {y:.2f}, {z:.2f})"]
    if opening > 0.1:
        parts = ["a change of the opening", *(parts if max(shift, turn) > 0.1 else [])]
    raise InvalidInput(
        f"{counted(receivers, 'receiver', 'receivers')} and "
        f"{counted(transmissions, 'transmission', 'transmissions')} "
        f"do not determine the {'pose and the opening' if opening > 0.1 else 'pose'}: "
        f"{' together with '.join(parts)} "
        f"changes the echoes by {effect:.1g} of what other motions do. Give more of them, or "
        "bodies without that "
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
            f"the echoes are at {echoes.frequency:g} Hz, and the scene at {scene.frequency:g} Hz: "
            "give the scene the "
            "frequency of the echoes.",
            code="does_not_match",
        )
    seen = array.seen_from(start)
    check_placement(scene, seen)
    pressures = np.asarray(echoes.pressures)
    if echoes.valid is not None:
        pressures = pressures[np.asarray(echoes.valid)]
    rms = float(np.sqrt(np.mean(np.abs(pressures) ** 2)))
    if rms == 0.0 or (echoes.noise is not None and rms < 1.05 * echoes.noise):
        raise InvalidInput(
            f"the echoes have {rms:.3g} Pa rms, hardly more than the noise of "
            f"{echoes.noise or 0.0:.3g} Pa: they say nothing about the bodies.",
            code="signal_unusable",
        )
    for values in (np.abs(pressures), np.abs(np.real(pressures)), np.abs(np.imag(pressures))):
        check_not_clipped(values.reshape(-1))
    return seen


def power(pressures: Received) -> float:
    """Sum of squares [Pa²]."""
    return float(np.sum(np.abs(pressures) ** 2, dtype=np.float64))


def information_of(
    by: Complex[np.ndarray, "unknowns receivers transmissions"],
) -> Float64[np.ndarray, "unknowns unknowns"]:
    """Real part of the products of derivatives."""
    parts = np.ascontiguousarray(by).reshape(len(by), -1).view(np.real(by).dtype)
    return (parts @ parts.T).astype(np.float64)


def disagreement(
    by: Complex[np.ndarray, "unknowns receivers transmissions"],
    residual: Received,
    inverse: Float64[np.ndarray, "unknowns unknowns"],
    places: Float64[np.ndarray, "receivers 3"],
) -> float:
    """Variance of the pose by groups of receivers over that by independent ones; 1 for noise.

    What a wrong shape leaves unexplained is alike at neighbouring receivers, so that many of them
    make the pose no surer. Groups of neighbours are taken as the independent data, as in K.-Y.
    Liang and S. L. Zeger, Biometrika 73, 13 (1986): the mean over all unknowns of the variance by
    groups over that of independent receivers.
    """
    count = min(16, len(places) // 4)
    if count < 2:
        return 1.0
    groups = kmeans2(places, count, rng=0, minit="++")[1]
    scores = np.real(by.conj() * residual).sum(axis=2, dtype=np.float64)
    summed = np.stack([np.bincount(groups, one, count) for one in scores])
    mean = power(residual) / max(np.count_nonzero(residual), 1) / 2.0
    return float(np.sum(summed * (inverse @ summed))) * count / (count - 1) / (mean * len(by))


def unexplained(
    echoes: Echoes, scattering: ScatteringMatrix, array: PhasedArray, pose: Pose
) -> Float64[np.ndarray, "receivers"]:
    """Residual of the model at each receiver, noise included, over the rms of all echoes.

    Parameters
    ----------
    echoes : measured, less what the empty array receives.
    scattering : of the bodies.
    array : the transducers in their own frame, in the order of the codes.
    pose : of the bodies, from their frame to the array's, such as ``Located.pose``.

    Returns
    -------
    (R,) root mean square over the transmissions; NaN where a receiver received none. About 1.4
    everywhere for a pose
    that explains nothing, and the share of noise for one that explains all.

    Raises
    ------
    InvalidInput
        "sizes_differ": echoes of another array; "bodies_overlap": an element stands among the
        bodies.

    Examples
    --------
    >>> import airtact as at
    >>> scene = at.Scene(at.air(celsius=20.0), [at.sound_hard(at.sphere(radius=5e-3, edge=2e-3))])
    >>> array, codes = at.surrounding_box(), at.sensing.random_codes(996, 4)
    >>> scattering = at.scattering_matrix(at.SphereSeries(), scene)
    >>> echoes = at.simulate_echoes(scattering, scene, array, codes, noise=40.0)
    >>> bool(unexplained(echoes, scattering, array, at.Pose.identity()).max() < 0.03)
    True
    """
    check_elements(echoes, array, "echoes")
    waves = array_waves(scattering, array.seen_from(pose), scattering.order)
    expected = waves.echo(scattering, np.asarray(echoes.codes))[echoes.receiving]
    received = (
        np.ones(expected.shape, dtype=bool) if echoes.valid is None else np.asarray(echoes.valid)
    )
    pressures = np.asarray(echoes.pressures)
    off = np.sum(np.abs(np.where(received, pressures - expected, 0.0)) ** 2, axis=1)
    count = received.sum(axis=1)
    mean = np.divide(off, count, out=np.full(len(off), np.nan), where=count > 0)
    return np.sqrt(mean / np.mean(np.abs(pressures[received]) ** 2))
