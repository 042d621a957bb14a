"""Pose of the bodies of a scene, and optionally their opening, from echoes of the transmissions.

The pose minimises the difference between modelled and measured echoes by the Levenberg-Marquardt
method with exact derivatives. To save time, the first steps use few receivers and transmissions. If
the initial path to the bodies and back is wrong by half a wavelength, the method may find another
minimum. If the resulting pose does not match the echoes, other initial poses around it are tried.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache

import numpy as np
from jaxtyping import Float64, Int64, Num
from scipy.cluster.vq import kmeans2
from scipy.optimize import OptimizeResult, least_squares
from scipy.stats import qmc

from airtact.acoustics.scene import Scene
from airtact.acoustics.solvers.bem.solver import BoundaryElement
from airtact.acoustics.solvers.problem import Solver
from airtact.errors import InvalidInput, counted, of_kind, one_line
from airtact.geometry.pose import Pose
from airtact.sensing.echo_model import EchoModel, Received, further_motion, motion_of
from airtact.sensing.echoes import Echoes, Receivers, check_elements, check_not_clipped
from airtact.sensing.scattering import (
    ScatteringFamily,
    ScatteringMatrix,
    check_own,
    scattering_matrix,
)
from airtact.timing import one_thread
from airtact.transducers.layout import PhasedArray
from airtact.transducers.placement import check_placement

# Largest misfit of a converged pose: the relative residual in excess of the noise.
MAX_MISFIT = 0.1

# Additional orders of waves, for translations by a few millimetres.
SPARE_ORDERS = 9

# Twist of the bodies from the initial pose [m, rad], and change of a family's opening.
Unknowns = Float64[np.ndarray, "unknowns"]

Squares = Float64[np.ndarray, "unknowns unknowns"]


@dataclass(frozen=True, eq=False)
class Located:
    """Pose of the bodies and its uncertainty, as returned by ``locate``.

    The array's frame is that of the array passed to ``locate``.

    Attributes
    ----------
    pose : pose that maps the bodies' own frame to the array's frame; ``PhasedArray.seen_from``
        takes this pose.
    covariance : (6, 6) covariance of the translation of ``centre`` [m] and of a small rotation
        about it [rad], along the array's axes. For a ``ScatteringFamily``, the seventh row and
        column belong to ``opening``. The covariance follows from the residual. It is increased if
        receivers in different places disagree by more than the noise, or if the residual indicates
        a wrong shape.
    bound : Cramér-Rao lower bound of the covariance, with the same shape and units as
        ``covariance``; NaN if the noise is unknown.
    residual : rms of the difference between modelled and measured echoes, including noise, divided
        by the rms of the measured echoes.
    misfit : ``residual`` without the contribution of noise. A value of 0.2 or more indicates a
        wrong model, such as a different hand.
    converged : whether the iteration converged with a misfit of at most 0.1 and, for a
        ``ScatteringFamily``, an opening inside its range. If False, do not use the pose.
    steps : number of steps in the last refinement of the pose.
    centre : (3,) centre of the ball around the bodies, at ``pose`` in the array's frame [m].
    left_out : element indices of the receivers that were excluded because their signals do not
        match any pose, such as dead receivers.
    opening : best value of the parameter of a ``ScatteringFamily``, such as the gap between fingers
        [m]; None for a scene.
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
        facts = [
            "converged" if self.converged else "NOT converged",
            f"± {1e3 * position:.2g} mm and {np.degrees(turn):.2g} degrees",
        ]
        if self.opening is not None:
            facts.append(f"opening {self.opening:.5g} ± {self.opening_deviation:.2g}")
        return one_line(self, *facts, f"residual {self.residual:.2g}, misfit {self.misfit:.2g}")

    @property
    def deviation(self) -> tuple[float, float]:
        """Standard deviations of the translation [m] and of the rotation [rad].

        Each standard deviation is the square root of the sum of the variances along the three axes.
        """
        variances = np.diag(self.covariance)
        return float(np.sqrt(variances[:3].sum())), float(np.sqrt(variances[3:6].sum()))

    @property
    def opening_deviation(self) -> float:
        """Standard deviation of ``opening``, in its unit; NaN if ``locate`` was given a scene."""
        return float(np.sqrt(self.covariance[6, 6])) if len(self.covariance) > 6 else float("nan")


# A scene and its matrix cannot change, so further calls with the same scene need no solve.
_last_matrix = lru_cache(maxsize=1)(scattering_matrix)


@lru_cache(maxsize=1)
def _last_view(array: PhasedArray, start: bytes) -> PhasedArray:
    # Further calls with the same array and start need not expand the waves of the array again.
    rows = np.frombuffer(start).reshape(4, 3)
    return array.seen_from(Pose(rows[:3], rows[3]))


# Two threads would take twice as long, because the products are small.
@one_thread()
def locate(
    echoes: Echoes,
    scene: Scene | ScatteringFamily,
    array: PhasedArray,
    start: Pose,
    *,
    scattering: ScatteringMatrix | None = None,
    solver: Solver | None = None,
) -> Located:
    """Find the rigid pose of bodies from echoes, and optionally the value of a shape parameter.

    The echoes of the bodies are modelled for a pose, which is adjusted by least squares until the
    modelled echoes match the measured echoes.

    Parameters
    ----------
    echoes : coded transmissions, and the received pressures minus the pressures without bodies.
    scene : the bodies in their own frame, the air and the frequency; or a ``ScatteringFamily`` of
        bodies with one unknown parameter, such as the gap between fingers.
    array : the transducers in their own frame, in the same order as the codes.
    start : initial pose of the bodies in the array's frame, accurate to within about 5 mm and 8
        degrees.
    scattering : scattering matrix of the scene. By default the solver computes it in the first call
        with the scene, and later calls reuse it. Omit it for a ``ScatteringFamily``, which contains
        its own matrices.
    solver : solver that computes the scattering matrix; by default
        ``BoundaryElement(accuracy=0.015, estimate=False)``.

    Returns
    -------
    A ``Located`` with the pose that matches the echoes best, and its uncertainty. The pose maps the
    frame of the bodies to that of the array. Use the result only if its attribute ``converged`` is
    True; a search that fails raises no error.

    Raises
    ------
    InvalidInput
        If the echoes and the scene have different frequencies, or the echoes and the array have
        different numbers of elements. If the echoes are too weak or clipped. If transducers overlap
        bodies in the initial pose. If the scattering matrix belongs to another scene, or is given
        in addition to a family. If the scene has no bodies, or the solver does not support them. If
        the echoes do not determine the pose or the parameter; for example, the echoes of a ball do
        not determine its rotation.
    NotConverged
        If the solver stops before it converges.

    Examples
    --------
    >>> import airtact as at
    >>> places = ((-7e-3, 0, 0), (7e-3, 2e-3, 0), (0, 8e-3, 0))
    >>> bodies = [at.sound_hard(at.sphere(4e-3, 1.5e-3, place)) for place in places]
    >>> scene = at.Scene(at.air(celsius=20.0), bodies, frequency=40e3)
    >>> array = at.surrounding_box()
    >>> true = at.Pose.turn((0, 0, 1), 0.3, (1e-3, 0, 2e-3))
    >>> scattering = at.scattering_matrix(at.BoundaryElement(accuracy=0.05, estimate=False), scene)
    >>> codes = at.sensing.random_codes(996, 4)
    >>> echoes = at.simulate_echoes(scattering, scene, array.seen_from(true), codes, noise=30.0)
    >>> near = at.Pose.turn((0, 0, 1), 0.29, (1.5e-3, 0, 2e-3))
    >>> located = locate(echoes, scene, array, near, scattering=scattering)
    >>> shift = located.pose.translation - true.translation
    >>> located.converged, bool(np.abs(shift).max() < 2e-5)
    (True, True)
    """
    family = None
    if isinstance(scene, ScatteringFamily):
        if scattering is not None or solver is not None:
            raise InvalidInput(
                f"a family already contains {len(scene.matrices)} scattering matrices; omit "
                "scattering and solver.",
                code="given_twice",
            )
        family = scene
        scene = family.scene
    seen = _checked_array(echoes, scene, array, start)
    if family is not None:
        scattering = family.at(family.start)
    else:
        # A solver at 0.25 % moves the pose by less than 0.001 mm.
        solver = solver or BoundaryElement(accuracy=0.015, estimate=False)
        scattering = scattering or _last_matrix(solver, scene)
        check_own(scattering, scene)
    model = EchoModel.of(
        scattering, seen, np.asarray(echoes.codes), echoes.receiving, echoes.valid, SPARE_ORDERS
    )
    fit = _Fit(model, np.asarray(echoes.pressures), echoes.noise or 0.0, family)
    # A motion without any effect, such as rotating a ball, would lead the search far away.
    for part in (fit.few, fit):
        derivatives = part.derivatives(np.zeros(len(fit.units)))
        information = derivatives.T @ derivatives
        effects = np.linalg.eigvalsh(fit.units[:, None] * information * fit.units)
        if effects[0] > 1e-12 * effects[-1]:  # a few echoes determine it, so all do
            break
    else:
        _check_determined(information, fit.units, 1e-6, start, *fit.measured.shape)
    best = fit.best()
    # The last steps exclude receivers that disagree with every pose.
    missing = fit.missing(best)
    rows = np.setdiff1d(np.arange(len(fit.measured)), missing)
    if len(missing):
        fit = fit.part(rows, fit.measured.shape[1])
        best = fit.follow(best.x)
    centre = scattering.centre
    motion = motion_of(best.x[:6])
    pose = start @ Pose(motion.rotation, centre - motion.rotation @ centre + motion.translation)
    opening = None
    # Interpolation and truncated waves make the derivatives with respect to the opening less exact.
    smallest = 1e-3
    inside = True
    if family is not None:
        opening = family.start + float(best.x[6])
        smallest = max(5e-3, 10.0 * family.error)
        inside = family.low < opening < family.high
    # The Jacobian refers to the twist from the initial pose, not to further motions.
    derivatives = best.jac.copy()
    derivatives[:, :6] = derivatives[:, :6] @ np.linalg.inv(further_motion(best.x[:6]))
    information = derivatives.T @ derivatives
    _check_determined(information, fit.units, smallest, pose, *fit.measured.shape)
    to_array = np.eye(len(information))
    to_array[:6, :6] = np.kron(np.eye(2), pose.rotation)
    inverse = np.linalg.inv(information)
    unit = to_array @ inverse @ to_array.T / 2.0
    cost = 2.0 * best.cost
    variance = cost / max(np.count_nonzero(fit.measured) - len(information) / 2, 1)
    places = array.positions[echoes.receiving[rows]]
    variance *= max(1.0, disagreement(derivatives, best.fun, inverse, places))
    misfit = fit.misfit(best)
    # The residual of a wrong shape has about 8 degrees of freedom (ends and radii of two fingers,
    # minus the six of a pose), whatever the number of pressures. Each unknown of the pose is
    # assumed to have absorbed as much power as one degree of freedom, so the power is divided by 8
    # and not by the number of pressures. A misfit of 5 % is attributed to errors of the solvers and
    # the interpolation.
    of_shape = 2.0 * max(misfit**2 - 0.05**2, 0.0) * power(fit.measured) / 8
    return Located(
        pose=pose,
        covariance=(variance + of_shape) * unit,
        bound=(fit.noise**2 if fit.noise else np.nan) * unit,
        residual=float(np.sqrt(cost / power(fit.measured))),
        misfit=misfit,
        converged=bool(best.success and misfit <= MAX_MISFIT and inside),
        steps=best.njev,
        centre=pose.apply(centre[None])[0],
        left_out=echoes.receiving[missing],
        opening=opening,
    )


@dataclass(frozen=True, eq=False)
class _Fit:
    """Measured echoes and their model, for fixed bodies or for a family.

    ``known`` caches the results for each vector of unknowns, because SciPy evaluates the first
    and the last vector twice.
    """

    model: EchoModel
    measured: Received
    noise: float
    family: ScatteringFamily | None = None
    known: dict[tuple[str, bytes], np.ndarray] = field(default_factory=dict)

    @cached_property
    def few(self) -> "_Fit":
        """The fit of 160 receivers, chosen at random, and 8 transmissions."""
        receivers, transmissions = self.measured.shape
        chosen = np.random.default_rng(0).permutation(receivers)[:160]
        return self.part(np.sort(chosen), min(transmissions, 8))

    def best(self) -> OptimizeResult:
        """Minimise the residual from the initial pose or, if this fails, from other poses."""
        few = self.few
        start = few.follow(np.zeros(len(self.units)), 1e-3)
        if few.explained(start):
            # A few echoes put the bodies so close to the result that the derivatives stay the same.
            pose = self.follow(start.x, derivatives=self.derivatives(start.x))
            if self.explained(pose):
                return pose
        tried = sorted([start, *few.other_starts()], key=lambda pose: pose.cost)
        ends = []
        for pose in tried[:2]:
            ends.append(self.follow(pose.x))
            if self.explained(ends[-1]):
                break
        return min(ends, key=lambda pose: pose.cost)

    def residual(self, unknowns: Unknowns) -> Float64[np.ndarray, "parts"]:
        """Real and imaginary parts of modelled minus measured echoes [Pa]."""
        key = "residual", unknowns.tobytes()
        if key not in self.known:
            model = self.model
            if self.family is not None:
                model = replace(model, scattering=self.family.at(self.family.start + unknowns[6]))
            self.known[key] = _parts(model.echoes(unknowns[:6]) - self.measured)
        return self.known[key]

    def derivatives(self, unknowns: Unknowns) -> Float64[np.ndarray, "parts unknowns"]:
        """Differentiate the residual with respect to motions [Pa/m], [Pa/rad] and opening."""
        key = "derivatives", unknowns.tobytes()
        if key in self.known:
            return self.known[key]
        twist = unknowns[:6]
        if self.family is None:
            by = self.model.derivatives(twist)
        else:
            opening = self.family.start + float(unknowns[6])
            model = replace(self.model, scattering=self.family.at(opening))
            changed = replace(self.model, scattering=self.family.derivative(opening))
            by = np.concatenate([model.derivatives(twist), changed.echoes(twist)[None]])
        self.known[key] = np.stack([_parts(part) for part in by], axis=1)
        return self.known[key]

    def follow(
        self,
        unknowns: Unknowns,
        flat: float = 1e-7,
        derivatives: Float64[np.ndarray, "parts unknowns"] | None = None,
    ) -> OptimizeResult:
        """Minimise the residual from a pose and an opening, to a relative tolerance ``flat``.

        ``derivatives`` are used in all steps; by default, each step computes its own.
        """

        def jacobian(unknowns: Unknowns) -> Float64[np.ndarray, "parts unknowns"]:
            by = (self.derivatives(unknowns) if derivatives is None else derivatives).copy()
            by[:, :6] = by[:, :6] @ further_motion(unknowns[:6])
            return by

        return least_squares(
            self.residual,
            unknowns,
            jacobian,  # pyright: ignore[reportArgumentType]
            method="lm",
            x_scale=self.units,
            ftol=flat,
            xtol=1e-5,
            max_nfev=30,
        )

    @property
    def units(self) -> Unknowns:
        """Steps of motion [m], [rad] and of opening that change the echoes by similar amounts."""
        of_opening = [] if self.family is None else [1.0 / self.family.effect]
        return np.array([1.0] * 3 + [1.0 / self.model.scattering.radius] * 3 + of_opening)

    def other_starts(self) -> Iterator[OptimizeResult]:
        """Minimise the residual from other start poses, by increasing cost, until one matches."""
        reach = np.repeat([6e-3, np.radians(9.0)], 3)
        middle = np.zeros(6)
        if self.family is not None:
            span = self.family.high - self.family.low
            reach = np.append(reach, 0.5 * span)
            middle = np.append(middle, self.family.low + 0.5 * span - self.family.start)
        starts = 2.0 * qmc.Sobol(len(reach), rng=0).random(512) - 1.0
        # These are 128 points inside the unit balls of translation and rotation.
        lengths = np.linalg.norm(starts[:, :6].reshape(-1, 2, 3), axis=2).max(axis=1)
        tried = middle + reach * starts[lengths <= 1.0][:128]
        for start in sorted(tried, key=lambda start: power(self.residual(start)))[:16]:
            pose = self.follow(start, 1e-3)
            yield pose
            if self.explained(pose):
                return

    def part(self, receivers: Receivers, transmissions: int) -> "_Fit":
        """Return the fit of selected receivers and the first transmissions."""
        measured = self.measured[receivers, :transmissions]
        return _Fit(self.model.part(receivers, transmissions), measured, self.noise, self.family)

    def left(self, pose: OptimizeResult) -> Received:
        """Return the residual of a pose [Pa]."""
        return pose.fun.view(np.complex128).reshape(self.measured.shape)

    def misfit(
        self, pose: OptimizeResult, without: Int64[np.ndarray, "rows"] | None = None
    ) -> float:
        """Return the rms of the residual relative to that of the echoes, both without the noise."""
        rows = np.delete(np.arange(len(self.measured)), [] if without is None else without)
        measured = self.measured[rows]
        of_noise = self.noise**2 * np.count_nonzero(measured)  # invalid pressures are 0
        of_echoes = max(power(measured) - of_noise, 1e-300)
        return float(np.sqrt(max(power(self.left(pose)[rows]) - of_noise, 0.0) / of_echoes))

    def explained(self, pose: OptimizeResult) -> bool:
        """Return whether a pose matches the echoes, except at receivers that no pose matches."""
        return self.misfit(pose, self.missing(pose)) <= MAX_MISFIT

    def missing(self, pose: OptimizeResult) -> Receivers:
        """Return the rows of the receivers, at most a fifth, that disagree with every pose."""
        left = self.left(pose)
        residual, measured, expected = (
            np.sqrt(np.mean(np.abs(pressures) ** 2, axis=1))
            for pressures in (left, self.measured, left + self.measured)
        )
        bad = (residual > 5.0 * np.median(residual)) & (
            residual > 0.5 * np.maximum(measured, expected)
        )
        return np.flatnonzero(bad & (np.mean(bad) <= 0.2))


def _parts(pressures: Received) -> Float64[np.ndarray, "parts"]:
    return pressures.astype(np.complex128, order="C").reshape(-1).view(np.float64)


def _check_determined(
    information: Squares,
    units: Unknowns,
    smallest: float,
    pose: Pose,
    receivers: int,
    transmissions: int,
) -> None:
    values, vectors = np.linalg.eigh(units[:, None] * information * units)
    if values[0] > smallest**2 * values[-1]:
        return
    effect = np.sqrt(max(values[0], 0.0) / values[-1])
    motion = vectors[:, 0]
    shift, turn = np.linalg.norm(motion[:6].reshape(2, 3), axis=1)
    x, y, z = pose.rotate(motion[3:6] if turn > shift else motion[:3]) / max(shift, turn, 1e-12)
    kind = "a rotation about" if turn > shift else "a translation along"
    opening = " together with a change of the opening" if np.abs(motion[6:]).sum() > 0.1 else ""
    raise InvalidInput(
        f"{counted(receivers, 'receiver', 'receivers')} and "
        f"{counted(transmissions, 'transmission', 'transmissions')} do not determine the pose: "
        f"{kind} ({x:z.2f}, {y:z.2f}, {z:z.2f}){opening} has only {effect:.1g} times the effect of "
        "other motions on the echoes. Use more receivers or transmissions, or bodies without that "
        "symmetry.",
        code="pose_not_found",
    )


def _checked_array(echoes: Echoes, scene: Scene, array: PhasedArray, start: Pose) -> PhasedArray:
    of_kind(start, Pose, "the start", "Pose(rotation, translation)")
    of_kind(echoes, Echoes, "the echoes", "Echoes(codes, pressures)")
    of_kind(scene, Scene, "the scene", "Scene(medium, obstacles)")
    of_kind(array, PhasedArray, "the array", "one such as surrounding_box()")
    check_elements(echoes, array, "echoes")
    if abs(echoes.frequency - scene.frequency) > 1e-6 * scene.frequency:
        raise InvalidInput(
            f"the echoes are at {echoes.frequency:g} Hz, but the scene is at {scene.frequency:g} "
            "Hz; use the same frequency.",
            code="does_not_match",
        )
    seen = _last_view(array, np.vstack([start.rotation, start.translation]).tobytes())
    check_placement(scene, seen)
    pressures = np.asarray(echoes.pressures)
    if echoes.valid is not None:
        pressures = pressures[np.asarray(echoes.valid)]
    if pressures.size < 4:  # two real numbers each, for up to seven unknowns
        raise InvalidInput(
            f"{counted(pressures.size, 'pressure does', 'pressures do')} not determine the pose; "
            "use four or more.",
            code="pose_not_found",
        )
    rms = float(np.sqrt(np.mean(np.abs(pressures) ** 2)))
    if rms == 0.0 or (echoes.noise is not None and rms < 1.05 * echoes.noise):
        raise InvalidInput(
            f"the echoes have an rms of {rms:.3g} Pa, hardly more than the noise of "
            f"{echoes.noise or 0.0:.3g} Pa. Use more transmissions, or move the array closer to "
            "the bodies.",
            code="signal_unusable",
        )
    # Clipping shows in the magnitudes or, with two converters, in the quadratures.
    for values in (np.abs(pressures), np.abs(np.real(pressures)), np.abs(np.imag(pressures))):
        check_not_clipped(values.reshape(-1))
    return seen


def power(pressures: Num[np.ndarray, "..."]) -> float:
    """Return the sum of the squared magnitudes of pressures [Pa²]."""
    return float(np.sum(np.abs(pressures) ** 2))


def disagreement(
    derivatives: Float64[np.ndarray, "parts unknowns"],
    residual: Float64[np.ndarray, "parts"],
    inverse: Squares,
    places: Float64[np.ndarray, "receivers 3"],
) -> float:
    """Compare the pose variance estimated from groups of receivers with that from single receivers.

    The function returns the ratio of the two estimates of the variance, averaged over all unknowns.
    The ratio is 1 if the residual is noise. If the shape is wrong, the residuals of neighbouring
    receivers are correlated, so more receivers do not improve the pose. Therefore only groups of
    neighbours are treated as independent (K.-Y. Liang, S. L. Zeger, Biometrika 73, 13 (1986)).
    """
    count = min(16, len(places) // 4)
    if count < 2:
        return 1.0
    # Fewer groups would estimate the variance poorly, and smaller groups are correlated.
    groups = kmeans2(places, count, rng=0, minit="++")[1]
    scores = derivatives * residual[:, None]
    scores = scores.reshape(len(places), -1, len(inverse)).sum(axis=1)
    summed = np.stack([np.bincount(groups, score, count) for score in scores.T])
    mean = power(residual) / max(np.count_nonzero(residual), 1)
    return float(np.sum(summed * (inverse @ summed))) * count / (count - 1) / (mean * len(inverse))


def unexplained(
    echoes: Echoes, scattering: ScatteringMatrix, array: PhasedArray, pose: Pose
) -> Float64[np.ndarray, "receivers"]:
    """Compare measured echoes with those modelled for a pose, separately for each receiver.

    Use it to find receivers whose echoes do not agree with a located pose. The difference between
    measured and modelled pressures includes the noise.

    Parameters
    ----------
    echoes : ``Echoes`` of R receivers: measured pressures minus the pressures without bodies.
    scattering : scattering matrix of the bodies.
    array : the transducers in their own frame, in the same order as the codes.
    pose : pose of the bodies in the array's frame, such as ``Located.pose``.

    Returns
    -------
    (R,) rms of the difference over the transmissions, divided by the rms of all echoes; NaN for
    receivers without valid pressures. The result is about 1.4 for an unrelated pose, and equals the
    relative noise for the correct pose.

    Raises
    ------
    InvalidInput
        If the array and the echoes have different numbers of elements, or an element is inside the
        ball around the bodies.

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
    of_kind(scattering, ScatteringMatrix, "the scattering", "scattering_matrix(solver, scene)")
    of_kind(pose, Pose, "the pose", "Pose(rotation, translation)")
    expected = EchoModel.of(
        scattering, array.seen_from(pose), np.asarray(echoes.codes), echoes.receiving
    ).echoes(np.zeros(6))
    pressures = np.asarray(echoes.pressures)
    received = np.ones(pressures.shape, bool) if echoes.valid is None else np.asarray(echoes.valid)
    squares = np.sum(np.abs(np.where(received, pressures - expected, 0.0)) ** 2, axis=1)
    count = received.sum(axis=1)
    mean = np.divide(squares, count, out=np.full(len(squares), np.nan), where=count > 0)
    return np.sqrt(mean / np.mean(np.abs(pressures[received]) ** 2))
