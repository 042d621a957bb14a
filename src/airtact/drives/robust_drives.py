"""Drives for a hand with an uncertain position (``robust``).

The hand scatters the sound, so each possible position of the hand has its own transfer matrix,
which is called a sample. The drive is optimised over many samples.

The value of a sample is the smallest ratio of pressure to request among its foci. A goal is a
statistic of these values: their mean, the value that 9 out of 10 samples exceed ("lowest tenth"),
or the worst. The search maximises a smooth replacement, the power mean of the values. With exponent
1 it is the mean; with large negative exponents it approaches the worst value. The lowest tenth is
not a smooth function of the drive, so the power mean of exponent −2 replaces it. For samples that
were not part of the search, this raises the lowest tenth as much as maximising a smoothed quantile,
without overfitting the few samples at the quantile.

``robust`` takes these steps:

1. Balance the foci of the nominal matrix (``balanced``). If nothing is uncertain, this is the
   result.
2. From there, maximise the power mean by L-BFGS, with exponents that approach the goal in steps.
   If only the energy Σ|d|² is limited, the best drive is a weighted sum of the conjugated rows,
   because any other part costs energy without adding pressure. The search then has one complex
   unknown per row, whatever the number of elements (``_climb_at_equal_energy``). With every element
   at full scale, the unknowns are the phases of all elements (``_climb_at_full_scale``).
"""

from typing import Literal, get_args

import numpy as np
from jaxtyping import Complex128, Float64
from scipy.linalg import cholesky, solve_triangular

from airtact.acoustics.target import Target
from airtact.drives.drive import Amplitudes, Drive
from airtact.drives.gerchberg_saxton import phase
from airtact.drives.max_min import strongest_sources
from airtact.drives.transfer import FociRows, TransferMatrix, asked_rows
from airtact.drives.transfer_ensemble import TransferEnsemble
from airtact.errors import check_choice
from airtact.timing import one_thread

# The statistic of the weakest focus over the samples.
Goal = Literal["lowest tenth", "mean", "worst"]

# Limit on a drive: "energy" limits Σ|d|²; "phases" sets |d| = 1 for every element.
Limit = Literal["energy", "phases"]

# Rows at the foci in each sample, divided by the request of each focus.
SampledRows = Complex128[np.ndarray, "samples foci elements"]


# Sequences of exponents of the power mean, for each goal. Each exponent of a sequence corresponds
# to one climb, which starts where the previous one ended. For large displacements of the hand
# there are many distant local optima. Each sequence finds one of them, and the best is used.
EXPONENTS: dict[str, tuple[tuple[float, ...], ...]] = {
    "mean": ((1.0,),),
    "lowest tenth": ((-2.0,), (1.0, -2.0)),
    "worst": ((-2.0, -8.0, -32.0), (1.0, -2.0, -8.0, -32.0)),
}

# Negative exponent of the power mean that approximates the weakest focus of a sample.
FOCUS_SHARPNESS = 8.0

# Largest number of L-BFGS steps in one climb.
MAX_STEPS = 60


def robust(
    ensemble: TransferMatrix,
    target: Target,
    goal: Goal = "lowest tenth",
    *,
    limit: Limit = "energy",
) -> Drive:
    """Compute the drive that performs best over all sampled positions of an uncertain hand.

    The samples are random poses of the hand and random gains of the elements (see ``ensemble``).
    The search ignores the gains, because adapting to them would not help with new samples;
    ``goal_value`` includes them. It starts from the best drive for the expected pose and climbs to
    a local maximum of the goal. The method chooses the phases at the foci and ignores suppression
    points and requested phases.

    Parameters
    ----------
    ensemble : transfer matrices (F, E) of the samples, as returned by ``at.ensemble``. A plain
        ``TransferMatrix`` is treated as a single sample without uncertainty.
    target : the F foci and their requested pressures or shares. In each sample, the weakest focus
        is the one with the smallest ratio of pressure to request.
    goal : quantity to maximise: "lowest tenth" is the pressure that the weakest focus exceeds in 9
        out of 10 samples; "mean" is the mean of its pressure over the samples; "worst" is its
        pressure in the worst sample.
    limit : constraint: "energy" maximises the goal at a given energy Σ|d|²; "phases" maximises the
        goal with every element at full scale.

    Returns
    -------
    A ``Drive`` of E elements. Its largest amplitude is 1 or, if the target requests pressures that
    the goal would exceed, the amplitude at which the goal equals the request. Without uncertainty,
    the drive maximises the pressure at the weakest focus under the same limit. For one focus, this
    is the drive of ``time_reversal`` or, with "phases", of ``phase_conjugate``.

    Raises
    ------
    InvalidInput
        If the matrices were computed for other foci, if there are more foci than elements, if two
        foci are less than a tenth of a wavelength apart, if a focus is shadowed (its attainable
        pressure is below 5 % of the median for the other foci), or if the goal or limit is unknown.

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
    # Scene files also state goals and limits, as words.
    check_choice(goal, "the goal", get_args(Goal))
    check_choice(limit, "the limit", get_args(Limit))
    nominal, requests = asked_rows(ensemble, target)
    samples = sampled_rows(ensemble, target)
    certain = len(samples) == 1

    def reached(amplitudes: Amplitudes) -> float:
        """Return the statistic ``goal`` for amplitudes scaled to unit energy or unit peak."""
        scale = np.linalg.norm(amplitudes) if limit == "energy" else np.abs(amplitudes).max()
        return _statistic(np.abs(samples @ amplitudes).min(axis=1), goal) / float(scale)

    climb = _climb_at_equal_energy if limit == "energy" else _climb_at_full_scale
    with one_thread():  # the products are too small for several threads
        # Without uncertainty the balanced drive is the result; otherwise the search starts there.
        start = balanced(nominal / requests[:, None], limit == "phases", 2000 if certain else 30)
        ends = [] if certain else [climb(samples, start, powers) for powers in EXPONENTS[goal]]
    amplitudes = max((start, *ends), key=reached)
    full = Drive(amplitudes / np.abs(amplitudes).max())
    if target.pressures is None:
        return full
    return Drive(full.amplitudes / max(goal_value(ensemble, target, full, goal), 1.0))


def robust_phase_only(
    ensemble: TransferMatrix, target: Target, goal: Goal = "lowest tenth"
) -> Drive:
    """Compute the phase-only drive that performs best over all samples of an uncertain hand.

    The function is the same as ``robust`` with ``limit="phases"``; use it for boards that only
    switch elements on and off. It ignores requested phases and suppression points.

    Parameters
    ----------
    ensemble : transfer matrices of the samples, as returned by ``at.ensemble``. A plain transfer
        matrix is treated as a single sample without uncertainty.
    target : the foci, and their requested pressures or shares, by which pressures are divided.
    goal : quantity to maximise: "lowest tenth" is the pressure that the weakest focus exceeds in 9
        out of 10 samples; "mean" is the mean of its pressure over the samples; "worst" is its
        pressure in the worst sample.

    Returns
    -------
    A ``Drive`` of E elements with equal amplitudes: full scale, or less if that is enough for the
    goal to reach the requested pressures.

    Raises
    ------
    InvalidInput
        If the matrices were computed for other foci, if there are more foci than elements, if two
        foci are closer than a tenth of a wavelength, if the largest possible pressure at a focus is
        below 5 % of the median of the others, or if the goal is unknown.
    """
    return robust(ensemble, target, goal, limit="phases")


def goal_value(
    ensemble: TransferMatrix, target: Target, drive: Drive, goal: Goal = "lowest tenth"
) -> float:
    """Return the pressure that a drive produces at the weakest focus, as a statistic over samples.

    The function evaluates the quantity that ``robust`` maximises, for example to compare a robust
    drive with another one. The weakest focus of a sample has the smallest ratio of pressure to
    request.

    Parameters
    ----------
    ensemble : transfer matrices of the samples, as returned by ``at.ensemble``; a plain
        ``TransferMatrix`` counts as a single sample.
    target : the foci and their requested pressures; foci whose request is 0 are ignored.
    drive : the drive to evaluate.
    goal : "lowest tenth" (the default) for the pressure that the weakest focus exceeds in 9 out of
        10 samples; "mean" or "worst" for the mean or the smallest pressure at the weakest focus
        over the samples.

    Returns
    -------
    The peak pressure [Pa] as a float, divided by the share of the focus if the target has shares.
    If the target requests pressures, the result is the ratio of pressure to request instead.

    Raises
    ------
    InvalidInput
        If the drive does not have as many elements as the matrices, the matrices were computed for
        other foci, or the goal is unknown.
    """
    check_choice(goal, "the goal", get_args(Goal))
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
    """Return the transfer-matrix rows of the foci in all samples, divided by the requests.

    If all samples are equal, only one is returned.
    """
    nominal, requests = asked_rows(ensemble, target)
    if not isinstance(ensemble, TransferEnsemble):
        return (nominal / requests[:, None])[None]
    rows = ensemble.geometry[:, np.flatnonzero(target.weights > 0.0)]
    # If only the gains are uncertain, a single sample represents all.
    if np.abs(rows - nominal).max() <= 1e-9 * np.abs(nominal).max():
        rows = nominal[None]
    return rows / requests[:, None]


# --- one matrix -------------------------------------------------------------------------------


def balanced(matrix: FociRows, phases: bool, steps: int = 2000) -> Amplitudes:
    """Return the amplitudes that maximise the pressure at the weakest focus for a single matrix.

    If ``phases`` is True, every element is at full scale (``strongest_sources``). Otherwise the
    energy is limited, and the function runs ``steps`` alternating projections. Each row of
    ``matrix`` must already be divided by the requested pressure of its focus.
    """
    if phases:
        return phase(matrix.conj().T @ strongest_sources(matrix, 300))
    foci = len(matrix)
    # For one focus at a given energy, time reversal is optimal (Cauchy-Schwarz inequality).
    if foci == 1:
        return matrix[0].conj()
    products = matrix @ matrix.conj().T
    # The starts are the foci in phase, and phase steps of 1, 2 and 3 quarter turns from one focus
    # to the next.
    starts = [np.exp(2j * np.pi * quarters * np.arange(foci) / 4) for quarters in range(4)]
    ends = [_balanced_sources(products, start, steps) for start in starts]
    strengths = np.array(
        [np.abs(products @ end).min() / np.sqrt(np.vdot(end, products @ end).real) for end in ends]
    )
    # Among results that are equal up to rounding, the first is chosen, so that the choice does not
    # depend on the machine.
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
    samples: SampledRows, start: Amplitudes, exponents: tuple[float, ...]
) -> Amplitudes:
    """Maximise the power mean at equal energy.

    The best drive has the form d = Aᴴ s, where A contains all rows. Its pressures are P s with
    P = A Aᴴ = L Lᴴ, and its energy is sᴴ P s = ‖Lᴴ s‖². With x = Lᴴ s the pressures are L x and the
    energy is ‖x‖², so the search varies only the direction of x.
    """
    from scipy.optimize import minimize

    rows = samples.reshape(-1, len(start))
    products = rows @ rows.conj().T
    # Rounding leaves the products slightly non-Hermitian, and the Cholesky factorisation needs
    # them exactly Hermitian.
    products = 0.5 * (products + products.conj().T)
    count = len(products)
    # Similar hands have nearly dependent rows, so the products may be singular to rounding. A small
    # diagonal term lets the factorisation succeed.
    regularisation = 1e-10 * np.trace(products).real / count
    lower = cholesky(products + regularisation * np.eye(count), lower=True)

    def objective(
        coordinates: Float64[np.ndarray, "coordinates"], exponent: float
    ) -> tuple[float, Float64[np.ndarray, "coordinates"]]:
        x = coordinates[:count] + 1j * coordinates[count:]
        norm = np.linalg.norm(x)
        x_unit = x / norm
        mean, by_pressure = _log_power_mean(lower @ x_unit, samples.shape[:2], exponent)
        by_unit = lower.conj().T @ by_pressure
        # Only the part of the gradient that is perpendicular to x changes the direction of x.
        slope = (by_unit - x_unit * np.vdot(x_unit, by_unit).real) / norm
        return -mean, -np.concatenate([np.real(slope), np.imag(slope)])

    x = solve_triangular(lower, rows @ start, lower=True)
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
    return rows.conj().T @ solve_triangular(lower.conj().T, x / np.linalg.norm(x), lower=False)


def _climb_at_full_scale(
    samples: SampledRows, start: Amplitudes, exponents: tuple[float, ...]
) -> Amplitudes:
    from scipy.optimize import minimize

    rows = samples.reshape(-1, len(start))

    def objective(
        phases: Float64[np.ndarray, "elements"], exponent: float
    ) -> tuple[float, Float64[np.ndarray, "elements"]]:
        amplitudes = np.exp(1j * phases)
        mean, by_pressure = _log_power_mean(rows @ amplitudes, samples.shape[:2], exponent)
        return -mean, np.imag((by_pressure.conj() @ rows) * amplitudes)

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


def _log_power_mean(
    pressures: Complex128[np.ndarray, "rows"], shape: tuple[int, int], exponent: float
) -> tuple[float, Complex128[np.ndarray, "rows"]]:
    """Return the log of the power mean of the weakest focus over the samples, and its gradient.

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
    # The ratios are relative to the smallest or largest value, so that no power overflows.
    lowest = logs.min(axis=1, keepdims=True)
    focus_weights = np.exp(FOCUS_SHARPNESS * (lowest - logs))
    log_values = lowest[:, 0] - np.log(focus_weights.mean(axis=1)) / FOCUS_SHARPNESS
    peak = (exponent * log_values).max()
    sample_weights = np.exp(exponent * log_values - peak)
    log_mean = (peak + np.log(sample_weights.mean())) / exponent
    shares = (sample_weights / sample_weights.sum())[:, None] * focus_weights
    shares = shares / focus_weights.sum(axis=1, keepdims=True)
    return float(log_mean), (shares / np.exp(2.0 * logs)).reshape(-1) * pressures
