"""Drives for hands whose place is not known exactly: the best for many sampled transfer matrices at once.

Each sample has a value, the pressure of its weakest focus over what it asks; a goal is a statistic
of these values. All goals are power means of some exponent: 1 is the mean, an exponent far below
zero the worst. The lowest tenth is no smooth function of the drive; the power mean of exponent −2
serves in its place. It raises the lowest tenth of other samples as much as a smoothed quantile
does, without fitting the few samples at the quantile.

At equal energy Σ|d|² the best drive is a sum of conjugated rows, so that the search needs the
products of the rows alone, however many elements there are.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from jaxtyping import Complex128, Float64
from scipy.linalg import cho_solve, cholesky, solve_triangular

from airtact.acoustics.target import Target
from airtact.drives.drive import Drive
from airtact.drives.reach import asked_rows, suppression_rows
from airtact.drives.sampling.ensemble import TransferEnsemble
from airtact.drives.transfer import TransferMatrix
from airtact.drives.weakest_focus import strongest_sources
from airtact.errors import InvalidInput
from airtact.timing import one_thread

Goal = Literal["lowest tenth", "mean", "worst"]
"""The statistic of the weakest focus over the samples."""

Limit = Literal["energy", "amplitude", "phases"]
"""What drives have in common: their energy Σ|d|², the full scale of each element, or full scale everywhere."""

WAYS = {
    "mean": ((1.0,),),
    "lowest tenth": ((-2.0,), (1.0, -2.0)),
    "worst": ((-2.0, -8.0, -32.0), (1.0, -2.0, -8.0, -32.0)),
}
"""Exponents of the power mean of each goal, one descent after another; the best of several ways there is kept.

Hands that are off by much have many good drives far apart: one way ends at the better one here,
another one there.
"""

SHARPNESS = 8.0
"""Minus the exponent of the power mean over the foci of a sample, which stands for the weakest of them."""

ITERATIONS = 60
"""Largest number of steps of one descent."""

ALIKE = 1e-9
"""Samples that differ from the nominal matrix by less than this share of its largest entry are the same."""

EXPONENT = -2.0
"""Of the power mean that stands for the lowest tenth."""

STEPS, TURN, SLOPE_KEPT, SQUARE_KEPT = 20, 0.1, 0.8, 0.95
"""Steps with momentum, root mean square turn of the phases in each [rad], shares that both means keep of the last."""

BALANCED = 2000
"""Steps that balance the foci of one matrix where that is the result."""

STARTED = 30
"""Steps that balance them where samples go on from there."""

LOSS = 0.15
"""Largest share of the goal that suppression points may cost."""

PENALTIES = tuple(float(10.0 ** (power / 2)) for power in range(-5, 7))
"""Weights of the energy at suppression points over that of the elements, tried in turn."""

RIDGE = 1e-10
"""Share of the mean eigenvalue that is added to products of rows, which may depend on each other."""

Rows = Complex128[np.ndarray, "rows elements"]
Suppressed = Complex128[np.ndarray, "suppressed elements"]
Amplitudes = Complex128[np.ndarray, "elements"]


def robust(
    ensemble: TransferMatrix,
    target: Target,
    goal: Goal = "lowest tenth",
    *,
    limit: Limit = "energy",
) -> Drive:
    """Make the drive that is best over all samples of an ensemble, for a hand whose place is not known exactly.

    The gains of single elements are left to chance: they are as likely for one drive as for
    another, and a drive that fitted those of the samples would be worse for others. Phases at the
    foci are chosen by the method.

    Parameters
    ----------
    ensemble : the samples, from ``ensemble``; a matrix without samples has nothing in doubt.
    target : the foci and what is asked there. Suppression points may cost 15 % of the goal.
    goal : "lowest tenth", what the weakest focus gets 9 of 10 times; its "mean"; or its "worst"
        sample.
    limit : what is held equal. "energy": the goal is best for the energy Σ|d|² that the drive
        emits. "amplitude": it is best with no element over full scale. "phases": with every element
        at full scale.

    Returns
    -------
    The drive. Its largest amplitude is 1, or less where the goal then reaches what the foci ask for. With nothing in
    doubt it is the drive of the strongest worst focus at that limit, and for one focus that of ``time_reversal``
    (``phase_conjugate`` for "amplitude" and "phases").

    Raises
    ------
    InvalidInput
        As ``gerchberg_saxton``; "unknown_name": there is no such goal or limit; "data_missing".

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
    for word, known in ((goal, get_args(Goal)), (limit, get_args(Limit))):
        if word not in known:
            raise InvalidInput(
                f'"{word}" is not known here; there is {", ".join(known)}.', code="unknown_name"
            )
    nominal, wanted = asked_rows(ensemble, target)
    nominal = nominal / wanted[:, None]
    samples = sampled_rows(ensemble, target)
    search = _Search(samples, _suppressed(ensemble, target), goal, limit)
    with one_thread():  # threads would wait for each other, the products being small
        found = _best(nominal, search)
    return _scaled(ensemble, target, found, goal)


def robust_phase_only(
    ensemble: TransferMatrix, target: Target, goal: Goal = "lowest tenth"
) -> Drive:
    """Make the drive of ``robust`` with every element at full scale; parameters and errors as there."""
    return robust(ensemble, target, goal, limit="phases")


def improved(
    samples: Complex128[np.ndarray, "samples foci elements"],
    start: Complex128[np.ndarray, "elements"],
    limit: Limit,
) -> Complex128[np.ndarray, "elements"]:
    """Raise the lowest tenth over few samples in one descent from a start, in milliseconds.

    Parameters
    ----------
    samples : rows of the foci in each sample.
    start : a drive that is good where nothing is in doubt.
    limit : "energy" by the descent of ``robust``, else every element at full scale by a few steps
        with momentum.

    Returns
    -------
    The drive with the largest magnitude 1; the start where the power mean over the samples does not rise.
    """
    if limit != "energy":
        return _with_momentum(samples, start)
    search = _Search(samples, np.empty((0, len(start)), dtype=np.complex128), "lowest tenth", limit)

    def mean(drive: Amplitudes) -> float:
        reached, _ = _power_mean(
            search.rows @ drive / np.linalg.norm(drive), samples.shape[:2], EXPONENT
        )
        return reached

    with one_thread():
        best = max(start, _by_energy(search, start, 0.0, (EXPONENT,)), key=mean)
    return best / np.abs(best).max()


def goal_value(
    ensemble: TransferMatrix, target: Target, drive: Drive, goal: Goal = "lowest tenth"
) -> float:
    """Return what a drive reaches of a goal over the samples: a pressure [Pa], or a share of what the foci ask for.

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
    return _statistic(weakest(ensemble, target, drive), goal)


def weakest(
    ensemble: TransferMatrix, target: Target, drive: Drive
) -> Float64[np.ndarray, "samples"]:
    """Return the pressure of the weakest focus in each sample (S,), over what it asks where pressures are asked [Pa].

    Raises
    ------
    InvalidInput
        If the elements or the foci do not match.
    """
    _, wanted = asked_rows(ensemble, target)
    asked = np.flatnonzero(target.weights > 0.0)
    pressures = (
        ensemble.pressures(drive)
        if isinstance(ensemble, TransferEnsemble)
        else ensemble.pressure(drive)[None]
    )
    return (np.abs(pressures[:, asked]) / wanted).min(axis=1)


def sampled_rows(
    ensemble: TransferMatrix, target: Target
) -> Complex128[np.ndarray, "samples asked elements"]:
    """Return the rows of each sample at the foci, over what they ask; one sample where all are alike."""
    nominal, wanted = asked_rows(ensemble, target)
    if not isinstance(ensemble, TransferEnsemble):
        return (nominal / wanted[:, None])[None]
    rows = ensemble.geometry[:, np.flatnonzero(target.weights > 0.0)]
    if np.abs(rows - nominal).max() <= ALIKE * np.abs(nominal).max():
        rows = nominal[None]
    return rows / wanted[:, None]


def _suppressed(ensemble: TransferMatrix, target: Target) -> Suppressed:
    nominal = suppression_rows(ensemble, target)
    if not len(nominal) or not isinstance(ensemble, TransferEnsemble):
        return nominal
    rows = ensemble.geometry[:, len(target.points) :]
    return rows.reshape(-1, rows.shape[2]) / np.sqrt(len(rows))


def _statistic(values: Float64[np.ndarray, "samples"], goal: str) -> float:
    """Return what a goal means: a statistic of the weakest focus over the samples."""
    if goal == "mean":
        return float(values.mean())
    return float(values.min() if goal == "worst" else np.quantile(values, 0.1))


def _scaled(ensemble: TransferMatrix, target: Target, amplitudes: Amplitudes, goal: Goal) -> Drive:
    full = Drive(amplitudes / np.abs(amplitudes).max())
    if target.pressures is None:
        return full
    return Drive(full.amplitudes / max(goal_value(ensemble, target, full, goal), 1.0))


@dataclass(frozen=True, eq=False)
class _Search:
    """What is searched for: ``samples`` are rows over what each focus asks, ``suppressed`` those of other points."""

    samples: Complex128[np.ndarray, "samples foci elements"]
    suppressed: Suppressed
    goal: Goal
    limit: Limit

    @property
    def rows(self) -> Rows:
        """(S F, E) the rows of all samples."""
        return self.samples.reshape(-1, self.samples.shape[2])

    def value(self, amplitudes: Amplitudes) -> float:
        """Return the goal where the limit is reached."""
        scale = np.linalg.norm(amplitudes) if self.limit == "energy" else np.abs(amplitudes).max()
        return _statistic(np.abs(self.samples @ amplitudes).min(axis=1), self.goal) / float(scale)

    def found(self, start: Amplitudes, weight: float) -> Amplitudes:
        """Search from a start; energy at the suppressed points counts by a weight."""
        by_limit = _by_energy if self.limit == "energy" else _by_element
        ways = WAYS[self.goal][: 1 if weight else None]
        return max((by_limit(self, start, weight, exponents) for exponents in ways), key=self.value)


def _best(nominal: Complex128[np.ndarray, "foci elements"], search: _Search) -> Amplitudes:
    """Find the amplitudes; with suppression points, by growing penalties until the goal has lost ``LOSS``."""
    samples, suppressed = search.samples, search.suppressed
    alone = len(samples) == 1 and not len(suppressed)
    start = balanced(nominal, search.limit != "energy", BALANCED if alone else STARTED)
    if alone:
        return start
    best = start if len(samples) == 1 else max([start, search.found(start, 0.0)], key=search.value)
    least = (1.0 - LOSS) * search.value(best)
    for penalty in PENALTIES if len(suppressed) else ():
        found = search.found(
            best, penalty * suppressed.shape[1] / float(np.sum(np.abs(suppressed) ** 2))
        )
        if search.value(found) < least:
            break
        best = found
    return best


def balanced(
    matrix: Complex128[np.ndarray, "foci elements"], phases: bool, steps: int = BALANCED
) -> Amplitudes:
    """Make the weakest focus of one matrix strongest, by alternating projections that give weak foci more weight.

    With ``phases`` every element is at full scale, else the energy is what is limited; ``matrix``
    has rows over what each focus asks.
    """
    if phases:
        sent = matrix.conj().T @ strongest_sources(matrix, 300)
        return sent / np.maximum(np.abs(sent), np.finfo(float).tiny)
    if len(matrix) == 1:
        return matrix[0].conj()
    products = matrix @ matrix.conj().T
    starts = [np.ones(len(matrix), dtype=np.complex128)]
    starts += [np.exp(2j * np.pi * turn * np.arange(len(matrix)) / 4) for turn in (1, 2, 3)]
    ends = [_balanced_sources(products, start, steps) for start in starts]
    strengths = [
        np.abs(products @ end).min() / np.sqrt(np.vdot(end, products @ end).real) for end in ends
    ]
    return matrix.conj().T @ ends[int(np.argmax(np.round(strengths / max(strengths), 9)))]


def _balanced_sources(
    products: Complex128[np.ndarray, "foci foci"], start: Complex128[np.ndarray, "foci"], steps: int
) -> Complex128[np.ndarray, "foci"]:
    weights, sources = np.ones(len(start)), start
    for _ in range(steps):
        received = products @ sources
        size = np.maximum(np.abs(received), np.finfo(float).tiny)
        change = size.mean() / size
        weights = weights * np.sqrt(change)
        weights = weights / weights.mean()
        sources = weights * received / size
        if np.abs(change - 1.0).max() < 1e-12:
            break
    return sources


# --- descents -------------------------------------------------------------------------------------------------------


def _by_energy(
    search: _Search, start: Amplitudes, weight: float, exponents: tuple[float, ...]
) -> Amplitudes:
    """Find the best drive of unit energy, that at suppression points included: d = M⁻¹ Aᴴ s, M = 1 + weight Rᴴ R."""
    rows, suppressed, shape = search.rows, search.suppressed, search.samples.shape[:2]
    back = rows.conj().T
    if weight:
        energy = np.eye(rows.shape[1]) + weight * suppressed.conj().T @ suppressed
        back = cho_solve((cholesky(energy, lower=True), True), back)
    products = rows @ back
    products = 0.5 * (products + products.conj().T)
    ridge = RIDGE * np.trace(products).real / len(products)
    lower = cholesky(products + ridge * np.eye(len(products)), lower=True)

    def received(
        numbers: Complex128[np.ndarray, "rows"],
    ) -> tuple[Complex128[np.ndarray, "rows"], Callable]:
        norm = np.linalg.norm(numbers)
        unit = numbers / norm

        def pull(by_pressure: Complex128[np.ndarray, "rows"]) -> Complex128[np.ndarray, "rows"]:
            by_unit = lower.conj().T @ by_pressure
            return (by_unit - unit * np.vdot(unit, by_unit).real) / norm

        return lower @ unit, pull

    numbers = solve_triangular(lower, rows @ start, lower=True)
    for exponent in exponents:
        numbers = _climbed(numbers, received, shape, exponent)
    return back @ solve_triangular(lower.conj().T, numbers / np.linalg.norm(numbers), lower=False)


def _by_element(
    search: _Search, start: Amplitudes, weight: float, exponents: tuple[float, ...]
) -> Amplitudes:
    """Find the best drive with each element at most, or exactly, at full scale.

    Amplitudes are sines of angles, which keeps them within full scale without bounds.
    """
    rows, suppressed, shape = search.rows, search.suppressed, search.samples.shape[:2]
    full = search.limit == "phases"
    count, back = len(start), rows.conj().T

    def drive_of(numbers: Float64[np.ndarray, "numbers"]) -> Amplitudes:
        size = np.ones(count) if full else np.sin(numbers[count:])
        return size * np.exp(1j * numbers[:count])

    def value(
        numbers: Float64[np.ndarray, "numbers"], exponent: float
    ) -> tuple[float, Float64[np.ndarray, "numbers"]]:
        amplitudes = drive_of(numbers)
        reached, by_pressure = _power_mean(rows @ amplitudes, shape, exponent)
        slope = back @ by_pressure
        if weight:
            there = suppressed @ amplitudes
            energy = count + weight * float(np.vdot(there, there).real)
            reached -= 0.5 * np.log(energy)
            slope = slope - weight * suppressed.conj().T @ there / energy
        by_phase = np.real(np.conj(slope) * 1j * amplitudes)
        if full:
            return -reached, -by_phase
        by_angle = np.real(np.conj(slope) * np.exp(1j * numbers[:count])) * np.cos(numbers[count:])
        return -reached, -np.concatenate([by_phase, by_angle])

    from scipy.optimize import minimize

    numbers = (
        np.angle(start) if full else np.concatenate([np.angle(start), np.full(count, 0.45 * np.pi)])
    )
    for exponent in exponents:
        numbers = minimize(
            value,
            numbers,
            (exponent,),
            jac=True,
            method="L-BFGS-B",
            options={"maxiter": ITERATIONS},
        ).x
    return drive_of(numbers)


def _with_momentum(
    samples: Complex128[np.ndarray, "samples foci elements"], start: Amplitudes
) -> Amplitudes:
    """Raise the power mean over the phases of all elements, each step of one size: Adam with one second moment.

    Source: D. P. Kingma, J. Ba, "Adam: a method for stochastic optimization", ICLR 2015, algorithm
    1.
    """
    rows, shape = samples.reshape(-1, len(start)).astype(np.complex64), samples.shape[:2]
    phases, slope, square, found = np.angle(start), np.zeros(len(start)), 0.0, (-np.inf, start)
    for step in range(1, STEPS + 2):
        drive = np.exp(1j * phases)
        reached, by_pressure = _power_mean(
            (rows @ drive.astype(np.complex64)).astype(np.complex128), shape, EXPONENT
        )
        found = max(found, (reached, drive), key=lambda one: one[0])
        by_phase = -np.imag((by_pressure.conj().astype(np.complex64) @ rows) * drive)
        slope = SLOPE_KEPT * slope + (1.0 - SLOPE_KEPT) * by_phase
        square = SQUARE_KEPT * square + (1.0 - SQUARE_KEPT) * float(np.mean(by_phase**2))
        size = np.sqrt(square / (1.0 - SQUARE_KEPT**step)) + np.finfo(float).tiny
        phases = phases + TURN / size * slope / (1.0 - SLOPE_KEPT**step)
    return found[1]


def _climbed(
    start: Complex128[np.ndarray, "rows"],
    received: Callable,
    shape: tuple[int, int],
    exponent: float,
) -> Complex128[np.ndarray, "rows"]:
    """Raise the power mean by L-BFGS (Liu and Nocedal, Math. Program. 45, 503 (1989)) over complex numbers."""
    from scipy.optimize import minimize

    count = len(start)

    def value(
        numbers: Float64[np.ndarray, "numbers"],
    ) -> tuple[float, Float64[np.ndarray, "numbers"]]:
        pressures, pull = received(numbers[:count] + 1j * numbers[count:])
        reached, by_pressure = _power_mean(pressures, shape, exponent)
        slope = pull(by_pressure)
        return -reached, -np.concatenate([np.real(slope), np.imag(slope)])

    numbers = np.concatenate([np.real(start), np.imag(start)]) / np.linalg.norm(start)
    options = {"maxiter": ITERATIONS, "ftol": 1e-5}
    found = minimize(value, numbers, jac=True, method="L-BFGS-B", options=options).x
    return found[:count] + 1j * found[count:]


def _power_mean(
    pressures: Complex128[np.ndarray, "rows"], shape: tuple[int, int], exponent: float
) -> tuple[float, Complex128[np.ndarray, "rows"]]:
    """Logarithm of the power mean over the samples of the weakest focus, and its gradient by the pressures."""
    logs = np.log(np.maximum(np.abs(pressures), np.finfo(float).tiny)).reshape(shape)
    low = logs.min(axis=1, keepdims=True)
    foci = np.exp(SHARPNESS * (low - logs))
    values = low[:, 0] - np.log(foci.mean(axis=1)) / SHARPNESS
    peak = (exponent * values).max()
    samples = np.exp(exponent * values - peak)
    mean = (peak + np.log(samples.mean())) / exponent
    shares = (samples / samples.sum())[:, None] * foci / foci.sum(axis=1, keepdims=True)
    return float(mean), (shares / np.exp(2.0 * logs)).reshape(-1) * pressures
