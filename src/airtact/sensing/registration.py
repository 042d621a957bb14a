"""Where the bodies of a scene are, from the echoes of the array's own transmissions.

The pose is the one whose echoes are nearest to those measured, by Levenberg and Marquardt's damped Gauss-Newton steps
with exact derivatives. Echoes of a pose off by half a wavelength of the way there and back have nothing in common with
those measured, so where the start does not lead to a pose that explains the echoes, others around it are tried.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64, Int64
from scipy.stats import qmc

from airtact.conventions import InvalidInput
from airtact.pose import Pose
from airtact.printing import one_line
from airtact.scene.scene import Scene
from airtact.sensing.array_waves import array_waves
from airtact.sensing.echo_model import EchoModel, Motion, Received, motion_of
from airtact.sensing.echoes import Echoes
from airtact.sensing.scattering import ScatteringMatrix, check_own, scattering_matrix
from airtact.solvers.bem.solver import BoundaryElement
from airtact.solvers.problem import Solver
from airtact.transducers.layout import PhasedArray
from airtact.transducers.placement import check_placement
from airtact.validation import counted, of_kind

EXPLAINED = 0.1
"""Echoes that a pose leaves unexplained beyond noise, as a share of all, up to which it is believed."""

REACH = 6e-3, np.radians(9.0)
"""Translation [m] and turn [rad] around the start within which other starts are tried."""

SPARE_ORDERS = 9
"""Orders beyond those of the bodies that a motion of a few millimetres takes waves from."""

STARTS, FOLLOWED = 128, 8
"""Number of other starts whose echoes are computed, and of those from which steps are taken."""

FEW_RECEIVERS, FEW_TRANSMISSIONS = 160, 8
"""Receivers and transmissions that other starts are compared by."""

MOST_STEPS = 25
MOST_DAMPING = 1e6
SETTLED = 1e-7
"""Length of a step at which a pose is settled [m]."""

UNDETERMINED = 1e-3
"""Least over largest effect of two motions of the same length on the echoes."""

CLIPPED = 0.05
"""Share of pressures of one size, the largest, from which on they were clipped."""

MISSING = 5.0
"""Residual of a receiver over that of the median from which on it is left out."""


@dataclass(frozen=True, eq=False)
class Located:
    """Where the bodies are, as ``locate`` finds it.

    Attributes
    ----------
    pose : of the obstacles in the array's frame, as of ``PhasedArray.seen_from``.
    covariance : (6, 6) of the translation of ``centre`` [m] and of a small turn about it [rad], along the array's axes:
        from all that the pose leaves unexplained, as if it were noise.
    bound : (6, 6) the Cramér-Rao bound: the least covariance that the given noise allows; NaN where it is not known.
    residual : rms of what the pose leaves unexplained over that of the echoes, noise included.
    misfit : the same beyond noise; a wrong model, such as another hand, leaves 0.2 and more.
    converged : whether the steps settled and the misfit is at most 0.1. Believe no other pose.
    steps : number of steps taken from the start that led there.
    centre : (3,) middle of the bodies in the array's frame [m].
    left_out : numbers of receivers whose pressures fit nothing, such as dead ones.
    """

    pose: Pose
    covariance: Float64[np.ndarray, "6 6"]
    bound: Float64[np.ndarray, "6 6"]
    residual: float
    misfit: float
    converged: bool
    steps: int
    centre: Float64[np.ndarray, "3"]
    left_out: Int64[np.ndarray, "missing"]

    def __repr__(self) -> str:
        position, turn = self.deviation
        return one_line(
            self,
            "converged" if self.converged else "NOT converged",
            f"sure to {1e3 * position:.2g} mm and {np.degrees(turn):.2g} degrees",
            f"residual {self.residual:.2g}, misfit {self.misfit:.2g}",
        )

    @property
    def deviation(self) -> tuple[float, float]:
        """Standard deviation of the translation [m] and of the turn [rad], of all three axes together."""
        variances = np.diag(self.covariance)
        return float(np.sqrt(variances[:3].sum())), float(np.sqrt(variances[3:].sum()))


def locate(
    echoes: Echoes,
    scene: Scene,
    array: PhasedArray,
    start: Pose,
    *,
    scattering: ScatteringMatrix | None = None,
    solver: Solver | None = None,
) -> Located:
    """Find the rigid pose of the bodies of a scene from echoes.

    Parameters
    ----------
    echoes : measured, less what the empty array receives.
    scene : the bodies in their own frame.
    array : the transducers in their own frame, in the order of the codes.
    start : where the bodies may be, within about 5 mm and 8 degrees; maps the obstacles' frame to the array's.
    scattering : of the scene; computed by the solver unless given.
    solver : of the scattering matrix; ``BoundaryElement(accuracy=0.02, estimate=False)`` unless given.

    Returns
    -------
    The pose that explains the echoes best, with how sure it is; look at ``converged`` first.

    Raises
    ------
    InvalidInput
        "element_count", "other_frequency", "other_scene": of echoes or scattering matrix; "all_noise", "clipped";
        "array_inside_body", "inside_body", "behind_faces", "array_inside_ball": the start cannot be;
        "pose_undetermined": the echoes do not determine some motion, such as a turn of a ball; or as
        ``scattering_matrix``.

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
    _check(echoes, scene, array, start)
    if scattering is None:
        scattering = scattering_matrix(solver or BoundaryElement(accuracy=0.02, estimate=False), scene)
    check_own(scattering, scene)
    waves = array_waves(scattering, array.seen_from(start), scattering.order + SPARE_ORDERS)
    model = EchoModel.of(scattering, waves, np.asarray(echoes.codes), echoes.receiving)
    fit = _Fit(model, np.asarray(echoes.pressures), echoes.noise or 0.0)
    found = fit.best()
    missing = fit.missing(found)
    if len(missing):
        fit = fit.part(np.setdiff1d(np.arange(len(echoes.receiving)), missing), model.emitted.shape[1])
        found = fit.follow(found.motion)
    return _located(fit, found, start, echoes.receiving[missing])


@dataclass(frozen=True, eq=False)
class _Found:
    """A pose, as a motion from the start, and what it leaves unexplained."""

    motion: Motion
    residual: Received
    steps: int
    settled: bool

    @property
    def cost(self) -> float:
        """Sum of the squares of the residual [Pa²]."""
        return float(np.sum(np.abs(self.residual) ** 2))


@dataclass(frozen=True, eq=False)
class _Fit:
    """Echoes to be explained, and their model."""

    model: EchoModel
    measured: Received
    noise: float

    def best(self) -> _Found:
        """Follow the start, and where that explains nothing, the other starts."""
        found = self.follow(np.eye(4))
        if self.explained(found):
            return found
        for motion in self.others():
            found = min(found, self.follow(motion), key=lambda one: one.cost)
            if self.explained(found):
                break
        return found

    def follow(self, motion: Motion) -> _Found:
        """Take damped Gauss-Newton steps until they settle."""
        damping, radius = 1e-3, self.model.scattering.radius
        units = np.array([1.0] * 3 + [1.0 / radius] * 3)
        here = self._at(motion, 0)
        for count in range(1, MOST_STEPS + 1):
            by = self.model.derivatives(here.motion).reshape(6, -1) * units[:, None]
            squares, slope = np.real(by.conj() @ by.T), np.real(by.conj() @ here.residual.reshape(-1))
            while True:
                least = np.diag(np.diag(squares) + 1e-12 * squares.max())
                step = -np.linalg.solve(squares + damping * least, slope)
                length = float(np.linalg.norm(step))
                tried = self._at(here.motion @ motion_of(step * units), count)
                if tried.cost < here.cost:
                    break
                if length < SETTLED or damping > MOST_DAMPING:
                    return replace(here, steps=count, settled=length < SETTLED)
                damping *= 6.0
            small = length < SETTLED or tried.cost > (1.0 - 1e-7) * here.cost
            here, damping = tried, 0.2 * damping
            if small:
                return replace(here, settled=True)
        return here

    def _at(self, motion: Motion, steps: int) -> _Found:
        return _Found(motion, self.model.echoes(motion) - self.measured, steps, False)

    def others(self) -> list[Motion]:
        """Return other starts, those whose echoes are nearest to the measured ones first."""
        random = np.random.default_rng(0)
        receivers, transmissions = self.measured.shape
        some = np.sort(random.permutation(receivers)[:FEW_RECEIVERS])
        few = self.part(some, min(transmissions, FEW_TRANSMISSIONS))
        cubes = 2.0 * qmc.Sobol(6, rng=0).random(4 * STARTS) - 1.0
        inside = [one for one in cubes if max(np.linalg.norm(one[:3]), np.linalg.norm(one[3:])) <= 1.0][:STARTS]
        scale = np.repeat(REACH, 3)
        tried = [motion_of(scale * one) for one in inside]
        costs = [float(np.sum(np.abs(few.model.echoes(one) - few.measured) ** 2)) for one in tried]
        best = [few.follow(tried[index]) for index in np.argsort(costs)[:FOLLOWED]]
        return [one.motion for one in sorted(best, key=lambda one: one.cost)]

    def part(self, receivers: Int64[np.ndarray, "some"], transmissions: int) -> "_Fit":
        """Return the fit of some receivers and the first transmissions."""
        return _Fit(self.model.part(receivers, transmissions), self.measured[receivers, :transmissions], self.noise)

    def misfit(self, found: _Found) -> float:
        """Rms of the residual beyond noise over that of the echoes beyond noise."""
        of_noise = self.noise**2 * self.measured.size
        whole = max(float(np.sum(np.abs(self.measured) ** 2)) - of_noise, 1e-300)
        return float(np.sqrt(max(found.cost - of_noise, 0.0) / whole))

    def explained(self, found: _Found) -> bool:
        """Whether a pose is to be believed; receivers that fit nothing do not count."""
        missing = self.missing(found)
        if not len(missing):
            return self.misfit(found) <= EXPLAINED
        kept = np.setdiff1d(np.arange(len(self.measured)), missing)
        alone = _Found(found.motion, found.residual[kept], found.steps, found.settled)
        return _Fit(self.model, self.measured[kept], self.noise).misfit(alone) <= EXPLAINED

    def missing(self, found: _Found) -> Int64[np.ndarray, "missing"]:
        """Rows of receivers that fit nothing while most do: at most one in five."""
        own = np.sqrt(np.mean(np.abs(found.residual) ** 2, axis=1))
        size = np.sqrt(np.mean(np.abs(self.measured) ** 2, axis=1))
        expected = np.sqrt(np.mean(np.abs(found.residual + self.measured) ** 2, axis=1))
        bad = np.flatnonzero((own > MISSING * np.median(own)) & (own > 0.5 * np.maximum(size, expected)))
        return bad if len(bad) <= 0.2 * len(own) else np.zeros(0, dtype=np.int64)


def _located(fit: _Fit, found: _Found, start: Pose, left_out: Int64[np.ndarray, "missing"]) -> Located:
    """Say what was found, and how sure it is."""
    scattering, size = fit.model.scattering, float(np.sum(np.abs(fit.measured) ** 2))
    centre, turn = scattering.centre, found.motion[:3, :3]
    pose = start @ Pose(turn, centre - turn @ centre + found.motion[:3, 3])
    by = fit.model.derivatives(found.motion).reshape(6, -1)
    information = np.real(by.conj() @ by.T)
    _check_determined(information, scattering.radius, pose, len(fit.measured), fit.measured.shape[1])
    to_array = np.kron(np.eye(2), pose.rotation)
    unit = to_array @ np.linalg.inv(information) @ to_array.T / 2.0
    unexplained = found.cost / max(fit.measured.size - 3, 1)
    misfit = fit.misfit(found)
    return Located(
        pose=pose,
        covariance=unexplained * unit,
        bound=(fit.noise**2 if fit.noise else np.nan) * unit,
        residual=float(np.sqrt(found.cost / size)),
        misfit=misfit,
        converged=bool(found.settled and misfit <= EXPLAINED),
        steps=found.steps,
        centre=pose.apply(centre[None])[0],
        left_out=left_out,
    )


def _check_determined(
    information: Float64[np.ndarray, "6 6"], radius: float, pose: Pose, receivers: int, transmissions: int
) -> None:
    """Raise "pose_undetermined" where a motion of the bodies hardly changes the echoes."""
    units = np.array([1.0] * 3 + [1.0 / radius] * 3)
    values, vectors = np.linalg.eigh(units[:, None] * information * units)
    if values[0] > UNDETERMINED**2 * values[-1]:
        return
    effect, motion = np.sqrt(max(values[0], 0.0) / values[-1]), vectors[:, 0]
    turning = bool(np.linalg.norm(motion[3:]) > np.linalg.norm(motion[:3]))
    axis = pose.rotate(motion[3:] if turning else motion[:3])
    x, y, z = axis / np.linalg.norm(axis)
    what = f"{'a turn about' if turning else 'a translation along'} ({x:.2f}, {y:.2f}, {z:.2f})"
    raise InvalidInput(
        f"{counted(receivers, 'receiver', 'receivers')} and {counted(transmissions, 'transmission', 'transmissions')} "
        f"do not determine the pose: {what} changes the echoes by {effect:.1g} of what other motions do. Give more of "
        "them, or bodies without that symmetry.",
        code="pose_undetermined",
    )


def _check(echoes: Echoes, scene: Scene, array: PhasedArray, start: Pose) -> None:
    """Raise for echoes that are not of this scene and array, or hold nothing, and for a start that cannot be."""
    of_kind(start, Pose, "the start", "Pose(rotation, translation)")
    of_kind(echoes, Echoes, "the echoes", "Echoes(codes, pressures)")
    of_kind(scene, Scene, "the scene", "Scene(medium, obstacles)")
    of_kind(array, PhasedArray, "the array", "one such as surrounding_box()")
    if len(echoes.codes) != len(array):
        raise InvalidInput(
            f"the echoes are of an array of {counted(len(echoes.codes), 'element', 'elements')}, and this one has "
            f"{len(array)}: give the one that they were measured with.",
            code="element_count",
        )
    if abs(echoes.frequency - scene.frequency) > 1e-6 * scene.frequency:
        raise InvalidInput(
            f"the echoes are at {echoes.frequency:g} Hz, and the scene at {scene.frequency:g} Hz: give the scene the "
            "frequency of the echoes.",
            code="other_frequency",
        )
    check_placement(scene, array.seen_from(start))
    _check_pressures(echoes)


def _check_pressures(echoes: Echoes) -> None:
    """Raise "all_noise" or "clipped"."""
    size = np.abs(np.asarray(echoes.pressures))
    rms = float(np.sqrt(np.mean(size**2)))
    if rms == 0.0 or (echoes.noise is not None and rms < 1.05 * echoes.noise):
        raise InvalidInput(
            f"the echoes have {rms:.3g} Pa rms, hardly more than the noise of {echoes.noise or 0.0:.3g} Pa: they hold "
            "nothing of the bodies.",
            code="all_noise",
        )
    parts = np.abs(np.stack([np.real(echoes.pressures), np.imag(echoes.pressures)]))
    for values in (size, *parts):
        equal = int(np.sum(values > (1.0 - 1e-6) * values.max()))
        if equal > max(CLIPPED * values.size, 8):
            raise InvalidInput(
                f"{equal} of {values.size} pressures have the same largest value of {values.max():.4g} Pa: they were "
                "clipped; measure again with less gain.",
                code="clipped",
            )
