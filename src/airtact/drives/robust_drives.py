"""Drives for uncertain hands: the best for many sampled transfer matrices at once (``robust``).

The value of a sample is the smallest ratio of pressure to request among its foci. A goal is a
statistic of these values: their mean, the value that 9 of 10 samples exceed ("lowest tenth"), or
the worst. The search maximises a smooth replacement, the power mean of the values. With exponent 1
it is the mean; with large negative exponents it approaches the worst value. The lowest tenth is not
a smooth function of the drive, so the power mean of exponent −2 replaces it. On samples that the
search has not seen, it raises the lowest tenth as much as a smoothed quantile does, without fitting
the few samples at the quantile.

``robust`` takes these steps:

1. Balance the foci of the nominal matrix (``balanced``). If nothing is uncertain, this is the
   result.
2. From there, maximise the power mean by L-BFGS, with exponents ever closer to the goal. At equal
   energy Σ|d|² the best drive is a sum of conjugated rows, so the search has one complex unknown
   per row, however many elements there are (``_climb_at_equal_energy``). With every element at full
   scale, the unknowns are the phases of all elements (``_climb_at_full_scale``).
3. With suppression points, repeat step 2 with a growing penalty on their energy, until the goal has
   lost 15 %.
"""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from jaxtyping import Complex128, Float64
from scipy.linalg import cho_solve, cholesky, solve_triangular

from airtact.acoustics.target import Target
from airtact.drives.drive import Amplitudes, Drive
from airtact.drives.gerchberg_saxton import phase
from airtact.drives.max_min import strongest_sources
from airtact.drives.reach import FociRows, asked_rows, suppression_rows
from airtact.drives.transfer import TransferMatrix
from airtact.drives.transfer_ensemble import TransferEnsemble
from airtact.errors import InvalidInput
from airtact.timing import one_thread

Goal = Literal["lowest tenth", "mean", "worst"]
"""The statistic of the weakest focus over the samples."""

Limit = Literal["energy", "phases"]
"""What limits a drive: its energy Σ|d|², or |d| = 1 ("phases")."""

SampledRows = Complex128[np.ndarray, "samples foci elements"]
"""Rows at the foci in each sample, divided by the request of each focus."""

RowValues = Complex128[np.ndarray, "rows"]
"""One number for each focus of each sample, sample by sample."""


EXPONENTS: dict[str, tuple[tuple[float, ...], ...]] = {
    "mean": ((1.0,),),
    "lowest tenth": ((-2.0,), (1.0, -2.0)),
    "worst": ((-2.0, -8.0, -32.0), (1.0, -2.0, -8.0, -32.0)),
}
"""Sequences of exponents of the power mean, for each goal.

A sequence has one climb per exponent; each climb starts where the last ended. For large
displacements of the hand there are many local optima far apart. Each sequence finds one of them,
and the best is used."""

FOCUS_SHARPNESS = 8.0
"""The weakest focus of a sample is smoothed to a power mean with minus this exponent."""

MAX_STEPS = 60
"""Largest number of L-BFGS steps in one climb."""


def robust(
    ensemble: TransferMatrix,
    target: Target,
    goal: Goal = "lowest tenth",
    *,
    limit: Limit = "energy",
) -> Drive:
    """Make the drive that is best over all samples of an ensemble, for an uncertain hand.

    The search ignores the random gains of single elements, because fitting them would not help
    with unseen samples; ``goal_value`` includes them. The method chooses the phases at the foci.

    Parameters
    ----------
    ensemble : the samples, from ``ensemble``. A plain transfer matrix is treated as free of
        uncertainty.
    target : the foci and their requested pressures. Suppression points may cost 15 % of the goal.
    goal : "lowest tenth", the pressure that the weakest focus exceeds in 9 of 10 samples; "mean",
        its mean over the samples; or "worst", its smallest value.
    limit : "energy": the goal is maximised at a given energy Σ|d|². "phases": it is maximised with
        every element at full scale.

    Returns
    -------
    The drive. Its largest amplitude is 1, or less if a weaker drive reaches the requested
    pressures. Where nothing is uncertain, it is the drive whose worst focus is strongest at that
    limit; for one focus, that of ``time_reversal`` (``phase_conjugate`` for "phases").

    Raises
    ------
    InvalidInput
        As ``weighted_gerchberg_saxton``; "unknown_name": there is no such goal or limit;
        "data_missing": suppression points without rows.

    Examples
    --------
    >>> import airtact as at
    >>> target = at.Target(np.zeros((1, 3)))
    >>> beacons = at.FreeField().radiate(at.Scene(at.air(), [], frequency=40e3), target.beacons())
    >>> samples = at.ensemble(beacons, at.surrounding_box(), at.Uncertainty(position=2e-3))
    >>> lowest = goal_value(samples, target, robust(samples, target))
    >>> bool(lowest > goal_value(samples, target, at.time_reversal(samples, target)))
    True
    """
    # Goals and limits also come from scene files, as words.
    for word, allowed in ((goal, get_args(Goal)), (limit, get_args(Limit))):
        if word not in allowed:
            raise InvalidInput(
                f'"{word}" is unknown. Give one of {", ".join(allowed)}.', code="unknown_name"
            )
    nominal, requests = asked_rows(ensemble, target)
    search = _Search(
        sampled_rows(ensemble, target), _suppressed_rows(ensemble, target), goal, limit
    )
    with one_thread():  # the products are too small for several threads
        amplitudes = _best(nominal / requests[:, None], search)
    full = Drive(amplitudes / np.abs(amplitudes).max())
    if target.pressures is None:
        return full
    return Drive(full.amplitudes / max(goal_value(ensemble, target, full, goal), 1.0))


def robust_phase_only(
    ensemble: TransferMatrix, target: Target, goal: Goal = "lowest tenth"
) -> Drive:
    """Make the drive of ``robust`` with every element at full scale."""
    return robust(ensemble, target, goal, limit="phases")


def goal_value(
    ensemble: TransferMatrix, target: Target, drive: Drive, goal: Goal = "lowest tenth"
) -> float:
    """Return the goal's value for a drive: the statistic of the weakest focus over the samples.

    The value is a pressure [Pa], or a fraction of the requested pressures.

    Parameters
    ----------
    ensemble, target : as for ``robust``.
    drive : of the elements of the ensemble.
    goal : the statistic of the weakest focus.

    Raises
    ------
    InvalidInput
        If the elements or the foci do not match.
    """
    _, requests = asked_rows(ensemble, target)
    if isinstance(ensemble, TransferEnsemble):
        pressures = ensemble.pressures(drive)
    else:
        pressures = ensemble.pressure(drive)[None]
    asked = np.flatnonzero(target.weights > 0.0)
    return _statistic((np.abs(pressures[:, asked]) / requests).min(axis=1), goal)


def _statistic(values: Float64[np.ndarray, "samples"], goal: str) -> float:
    if goal == "mean":
        return float(values.mean())
    return float(values.min() if goal == "worst" else np.quantile(values, 0.1))


def sampled_rows(ensemble: TransferMatrix, target: Target) -> SampledRows:
    """Return each sample's rows at the foci, divided by the requests; one sample if all agree."""
    nominal, requests = asked_rows(ensemble, target)
    if not isinstance(ensemble, TransferEnsemble):
        return (nominal / requests[:, None])[None]
    rows = ensemble.geometry[:, np.flatnonzero(target.weights > 0.0)]
    # If only the gains are uncertain, one sample replaces all.
    if np.abs(rows - nominal).max() <= 1e-9 * np.abs(nominal).max():
        rows = nominal[None]
    return rows / requests[:, None]


def _suppressed_rows(
    ensemble: TransferMatrix, target: Target
) -> Complex128[np.ndarray, "suppressed elements"]:
    """Return the rows at the suppression points of all samples; energies are means over samples."""
    nominal = suppression_rows(ensemble, target)
    if not len(nominal) or not isinstance(ensemble, TransferEnsemble):
        return nominal
    rows = ensemble.geometry[:, len(target.points) :]
    return rows.reshape(-1, rows.shape[2]) / np.sqrt(len(rows))


@dataclass(frozen=True, eq=False)
class _Search:
    """Rows at the foci divided by the requests, rows at the suppression points, and the goal."""

    samples: SampledRows
    suppressed: Complex128[np.ndarray, "suppressed elements"]
    goal: Goal
    limit: Limit

    @property
    def rows(self) -> Complex128[np.ndarray, "rows elements"]:
        """(S F, E) the rows of all samples."""
        return self.samples.reshape(-1, self.samples.shape[2])

    def value(self, amplitudes: Amplitudes) -> float:
        """Return the goal for the drive scaled to its limit."""
        scale = np.linalg.norm(amplitudes) if self.limit == "energy" else np.abs(amplitudes).max()
        return _statistic(np.abs(self.samples @ amplitudes).min(axis=1), self.goal) / float(scale)

    def climbed(self, start: Amplitudes, penalty: float) -> Amplitudes:
        """Climb from a start; the energy at the suppression points is weighted by the penalty."""
        climb = _climb_at_equal_energy if self.limit == "energy" else _climb_at_full_scale
        sequences = EXPONENTS[self.goal]
        if penalty:  # the start already comes from the best sequence
            sequences = sequences[:1]
        ends = [climb(self, start, penalty, exponents) for exponents in sequences]
        return max(ends, key=self.value)


def _best(nominal: FociRows, search: _Search) -> Amplitudes:
    suppressed = search.suppressed
    certain = len(search.samples) == 1
    # Without uncertainty the balanced drive is the result, otherwise only the start of the search.
    steps = 2000 if certain and not len(suppressed) else 30
    best = balanced(nominal, search.limit != "energy", steps)
    if not certain:
        best = max(best, search.climbed(best, 0.0), key=search.value)
    if not len(suppressed):
        return best
    # Suppression points may cost 15 % of the goal.
    lowest = (1.0 - 0.15) * search.value(best)
    # Penalties are relative to the energy at the suppression points, mean over all drives of unit
    # energy.
    elements = suppressed.shape[1]
    energy = float(np.sum(np.abs(suppressed) ** 2))
    for power in range(-5, 7):
        penalty = float(10.0 ** (power / 2))
        candidate = search.climbed(best, penalty * elements / energy)
        # Larger penalties cost the foci even more.
        if search.value(candidate) < lowest:
            break
        best = candidate
    return best


def improved(samples: SampledRows, start: Amplitudes, limit: Limit) -> Amplitudes:
    """Raise the lowest tenth over a few samples in one climb, which takes milliseconds.

    Parameters
    ----------
    samples : rows of the foci in each sample.
    start : a drive that is good without uncertainty.
    limit : "energy" uses the climb of ``robust``; "phases" takes a few steps with momentum, with
        every element at full scale.

    Returns
    -------
    The drive, scaled to a largest amplitude of 1. If the power mean over the samples does not rise,
    it is the start, or the phases of the start at full scale.
    """
    if limit != "energy":
        return _climb_with_momentum(samples, start)
    search = _Search(samples, np.empty((0, len(start)), dtype=np.complex128), "lowest tenth", limit)
    exponents = EXPONENTS["lowest tenth"][0]

    def mean(drive: Amplitudes) -> float:
        received = search.rows @ drive / np.linalg.norm(drive)
        return _log_power_mean(received, search.samples.shape[:2], exponents[-1])[0]

    with one_thread():
        best = max(start, _climb_at_equal_energy(search, start, 0.0, exponents), key=mean)
    return best / np.abs(best).max()


# --- one matrix -------------------------------------------------------------------------------


def balanced(matrix: FociRows, phases: bool, steps: int = 2000) -> Amplitudes:
    """Make the weakest focus of one matrix as strong as possible.

    With ``phases`` every element is at full scale (``strongest_sources``). Otherwise the energy is
    limited, and alternating projections take ``steps`` iterations. The rows of ``matrix`` are
    divided by the requested pressure of each focus.
    """
    if phases:
        return phase(matrix.conj().T @ strongest_sources(matrix, 300))
    foci = len(matrix)
    # For one focus at a given energy, time reversal is optimal (Cauchy-Schwarz).
    if foci == 1:
        return matrix[0].conj()
    products = matrix @ matrix.conj().T
    # Start with the foci in phase, and with phase steps of 1, 2 and 3 quarter turns from one focus
    # to the next.
    starts = [np.exp(2j * np.pi * quarters * np.arange(foci) / 4) for quarters in range(4)]
    ends = [_balanced_sources(products, start, steps) for start in starts]
    strengths = np.array(
        [np.abs(products @ end).min() / np.sqrt(np.vdot(end, products @ end).real) for end in ends]
    )
    # Among ends equal up to rounding take the first, so that the result does not depend on the
    # machine.
    best = int(np.argmax(np.round(strengths / strengths.max(), 9)))
    return matrix.conj().T @ ends[best]


def _balanced_sources(
    products: Complex128[np.ndarray, "foci foci"],
    sources: Complex128[np.ndarray, "foci"],
    steps: int,
) -> Complex128[np.ndarray, "foci"]:
    weights = np.ones(len(sources))
    for _ in range(steps):
        received = products @ sources
        magnitudes = np.maximum(np.abs(received), np.finfo(float).tiny)
        change = magnitudes.mean() / magnitudes
        # The root halves the step in the logarithm, which keeps two coupled foci from oscillating.
        weights = weights * np.sqrt(change)
        weights = weights / weights.mean()
        sources = weights * received / magnitudes
        if np.abs(change - 1.0).max() < 1e-12:
            break
    return sources


# --- all samples ------------------------------------------------------------------------------


def _climb_at_equal_energy(
    search: _Search, start: Amplitudes, penalty: float, exponents: tuple[float, ...]
) -> Amplitudes:
    """Maximise the power mean at equal energy.

    The energy at the suppression points R counts by the penalty. The best drive has the form
    d = M⁻¹ Aᴴ s, where A holds all rows and M = 1 + penalty Rᴴ R. It gives the pressures P s with
    P = A M⁻¹ Aᴴ = L Lᴴ, at the energy sᴴ P s = ‖Lᴴ s‖². With x = Lᴴ s the pressures are L x and the
    energy is ‖x‖², so the search varies only the direction of x.
    """
    from scipy.optimize import minimize

    solved_rows = search.rows.conj().T
    if penalty:
        suppressed = search.suppressed
        energy = np.eye(len(start)) + penalty * suppressed.conj().T @ suppressed
        solved_rows = cho_solve((cholesky(energy, lower=True), True), solved_rows)
    products = search.rows @ solved_rows
    # Rounding leaves the products slightly non-Hermitian, and the Cholesky factorisation needs
    # them exactly Hermitian.
    products = 0.5 * (products + products.conj().T)
    count = len(products)
    # Samples of nearly the same hand have nearly dependent rows.
    ridge = 1e-10 * np.trace(products).real / count
    lower = cholesky(products + ridge * np.eye(count), lower=True)

    def objective(
        coordinates: Float64[np.ndarray, "coordinates"], exponent: float
    ) -> tuple[float, Float64[np.ndarray, "coordinates"]]:
        x = coordinates[:count] + 1j * coordinates[count:]
        norm = np.linalg.norm(x)
        x_unit = x / norm
        mean, by_pressure = _log_power_mean(lower @ x_unit, search.samples.shape[:2], exponent)
        by_unit = lower.conj().T @ by_pressure
        # Only the part of the gradient perpendicular to x changes its direction.
        slope = (by_unit - x_unit * np.vdot(x_unit, by_unit).real) / norm
        return -mean, -np.concatenate([np.real(slope), np.imag(slope)])

    x = solve_triangular(lower, search.rows @ start, lower=True)
    for exponent in exponents:
        # L-BFGS (Liu and Nocedal, Math. Program. 45, 503 (1989)).
        coordinates = minimize(
            objective,
            np.concatenate([np.real(x), np.imag(x)]) / np.linalg.norm(x),
            (exponent,),
            jac=True,
            method="L-BFGS-B",
            options={"maxiter": MAX_STEPS, "ftol": 1e-5},
        ).x
        x = coordinates[:count] + 1j * coordinates[count:]
    return solved_rows @ solve_triangular(lower.conj().T, x / np.linalg.norm(x), lower=False)


def _climb_at_full_scale(
    search: _Search, start: Amplitudes, penalty: float, exponents: tuple[float, ...]
) -> Amplitudes:
    """Maximise the power mean over the phases, with every element at full scale."""
    from scipy.optimize import minimize

    rows = search.rows
    rows_adjoint = rows.conj().T
    suppressed = search.suppressed

    def objective(
        phases: Float64[np.ndarray, "elements"], exponent: float
    ) -> tuple[float, Float64[np.ndarray, "elements"]]:
        amplitudes = np.exp(1j * phases)
        mean, by_pressure = _log_power_mean(rows @ amplitudes, search.samples.shape[:2], exponent)
        slope = rows_adjoint @ by_pressure
        if penalty:
            pressure = suppressed @ amplitudes
            energy = len(start) + penalty * float(np.vdot(pressure, pressure).real)
            mean -= 0.5 * np.log(energy)
            slope = slope - penalty * suppressed.conj().T @ pressure / energy
        return -mean, -np.real(np.conj(slope) * 1j * amplitudes)

    phases = np.angle(start)
    for exponent in exponents:
        phases = minimize(
            objective,
            phases,
            (exponent,),
            jac=True,
            method="L-BFGS-B",
            options={"maxiter": MAX_STEPS},
        ).x
    return np.exp(1j * phases)


def _climb_with_momentum(samples: SampledRows, start: Amplitudes) -> Amplitudes:
    """Maximise the power mean over all phases in steps of equal size; keep the best.

    This is Adam (D. P. Kingma, J. Ba, "Adam: a method for stochastic optimization", ICLR 2015,
    algorithm 1) with one second moment for all phases.
    """
    # Single precision for speed, since this runs for each frame of a moving hand.
    rows = samples.reshape(-1, len(start)).astype(np.complex64)
    exponent = EXPONENTS["lowest tenth"][0][-1]
    phases = np.angle(start)
    slope = np.zeros(len(start))
    square = 0.0
    best = start
    largest = -np.inf
    for step in range(1, 22):
        drive = np.exp(1j * phases)
        received = (rows @ drive.astype(np.complex64)).astype(np.complex128)
        mean, by_pressure = _log_power_mean(received, samples.shape[:2], exponent)
        if mean > largest:
            best = drive
            largest = mean
        by_phase = -np.imag((by_pressure.conj().astype(np.complex64) @ rows) * drive)
        slope = 0.8 * slope + (1.0 - 0.8) * by_phase
        square = 0.95 * square + (1.0 - 0.95) * float(np.mean(by_phase**2))
        # The running means start at 0; the powers correct this bias.
        size = np.sqrt(square / (1.0 - 0.95**step)) + np.finfo(float).tiny
        # Steps of about 0.1 rad rms.
        phases = phases + 0.1 / size * slope / (1.0 - 0.8**step)
    return best


def _log_power_mean(
    pressures: RowValues, shape: tuple[int, int], exponent: float
) -> tuple[float, RowValues]:
    """Logarithm of the power mean of the weakest focus over the samples, and its gradient.

    Parameters
    ----------
    pressures : pressure at each focus of each sample.
    shape : number of samples and number of foci.
    exponent : exponent of the mean over the samples.

    Returns
    -------
    The logarithm and its gradient g; the logarithm changes by Re Σ conj(g) δp.
    """
    logs = np.log(np.maximum(np.abs(pressures), np.finfo(float).tiny)).reshape(shape)
    # Values relative to the smallest or largest, so that no power overflows.
    lowest = logs.min(axis=1, keepdims=True)
    focus_weights = np.exp(FOCUS_SHARPNESS * (lowest - logs))
    log_values = lowest[:, 0] - np.log(focus_weights.mean(axis=1)) / FOCUS_SHARPNESS
    peak = (exponent * log_values).max()
    sample_weights = np.exp(exponent * log_values - peak)
    log_mean = (peak + np.log(sample_weights.mean())) / exponent
    shares = (sample_weights / sample_weights.sum())[:, None] * focus_weights
    shares = shares / focus_weights.sum(axis=1, keepdims=True)
    return float(log_mean), (shares / np.exp(2.0 * logs)).reshape(-1) * pressures
