"""Largest pressure at the weakest focus (``max_min``, ``gradient``), and its upper bound.

Inoue, Makino and Shinoda (IEEE World Haptics 2015) relax the choice of drive to a semidefinite
matrix X = V Vᴴ. Row V_e contains the emission of element e in R equal intervals, divided by √R.
The mean square of the emission is at most 1, so the emission may exceed full scale in single
intervals. The pressure at a focus is its rms over the intervals. Alternating projections as in
weighted Gerchberg-Saxton, with vectors in place of numbers, converge to the optimum. Their weights
converge to the multipliers of the dual problem, which bounds the pressure of every drive.
"""

import warnings
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Complex128, Float64

from airtact.acoustics.target import Target
from airtact.drives.drive import Amplitudes, Drive
from airtact.drives.gerchberg_saxton import (
    Sources,
    best_sources,
    check_iterations,
    phase,
    starting_sources,
)
from airtact.drives.transfer import (
    FociRows,
    TransferMatrix,
    asked_rows,
    scaled_to_target,
    suppression_rows,
)
from airtact.errors import InvalidInput, counted, one_line, positive


@dataclass(frozen=True, eq=False)
class UpperBound:
    """Certified upper bound on the pressure at the weakest focus, as returned by ``upper_bound``.

    The bound holds for every drive d with |d_e| ≤ 1 (full scale). Let h_f be the row of the
    transfer matrix for focus f, divided by the requested pressure or share. Let μ_f ≥ 0 be
    multipliers that add up to 1, and y_e > 0 be such that diag(y) − Σ_f μ_f h_fᴴ h_f is positive
    semidefinite. Then min_f |h_f d|² ≤ Σ_f μ_f |h_f d|² ≤ Σ_e y_e |d_e|² ≤ Σ_e y_e.

    Attributes
    ----------
    worst : √Σ_e y_e, an upper bound on the smallest ratio of pressure to requested pressure. If the
        target requests only relative pressures (shares), or nothing (equal shares), ``worst``
        instead bounds the smallest ratio of pressure to share [Pa].
    relaxed : largest value found for the relaxed problem, in which every element may emit several
        signals in turn, in the unit of ``worst``. No choice of μ and y makes ``worst`` smaller than
        this, so the gap between the two shows how far ``worst`` could still be lowered.
    multipliers : (F,) multipliers μ_f; 0 for foci whose requested pressure or share is 0.
    elements : (E,) values y_e, in the unit of ``worst`` squared.
    """

    worst: float
    relaxed: float
    multipliers: Float64[np.ndarray, "foci"]
    elements: Float64[np.ndarray, "elements"]

    def __repr__(self) -> str:
        return one_line(
            self,
            f"worst focus {self.worst:.4g}",
            counted(len(self.multipliers), "focus", "foci"),
            f"{len(self.elements)} elements",
        )

    def eigenvalue(self, transfer: TransferMatrix, target: Target) -> float:
        """Return the largest eigenvalue of the (F, F) matrix √μ H diag(1/y) Hᴴ √μ.

        The bound holds if this eigenvalue is at most 1. By the Schur complement this is equivalent
        to diag(y) − Hᴴ diag(μ) H being positive semidefinite.
        """
        matrix, requests = asked_rows(transfer, target)
        multipliers = self.multipliers[target.weights > 0.0] / requests**2
        return _largest_eigenvalue(matrix, multipliers, self.elements)

    def reached(self, transfer: TransferMatrix, target: Target, drive: Drive) -> float:
        """Return a drive's pressure at its weakest focus, divided by the bound; at most 1."""
        matrix, requests = asked_rows(transfer, target)
        return float((np.abs(matrix @ drive.amplitudes) / requests).min() / self.worst)


def upper_bound(transfer: TransferMatrix, target: Target, *, tolerance: float = 1e-3) -> UpperBound:
    """Compute an upper bound on the pressure that any drive can produce at the weakest focus.

    The ratio of a drive's pressure to the bound shows how much better another drive could be. The
    bound holds for every drive with amplitudes of at most 1, including phase-only drives and drives
    with discrete levels. The function solves the dual of the semidefinite relaxation of Inoue,
    Makino and Shinoda (IEEE World Haptics 2015). It ignores suppression points.

    Parameters
    ----------
    transfer : the (F, E) transfer matrix of F foci and E elements.
    target : the foci and their requested pressures or shares; foci whose request is 0 are ignored.
    tolerance : relative gap between the bound and the value of the relaxation at which the
        iteration stops, above 0. The iteration also stops after 1000 steps; the bound is then
        looser but still holds.

    Returns
    -------
    An ``UpperBound`` with the bound (``worst``) and the multipliers that certify it. The bound
    applies to the smallest ratio of pressure to requested pressure or, if no pressure is requested,
    to the smallest ratio of pressure to share [Pa].

    Raises
    ------
    InvalidInput
        If the transfer matrix was computed for other foci, if there are more foci than elements, if
        two foci are closer than a tenth of a wavelength, if the largest possible pressure at a
        focus is below 5 % of the median of the others, or if the tolerance is not above zero.
    """
    matrix, requests = asked_rows(transfer, target)
    positive(tolerance, "the tolerance", "of the bound")
    bound, _ = relaxed_bound(matrix / requests[:, None], tolerance)
    multipliers = np.zeros(len(target.points))
    multipliers[target.weights > 0.0] = bound.multipliers
    return replace(bound, multipliers=multipliers)


@dataclass(frozen=True, eq=False)
class Relaxed:
    """State of the alternating projections, in which every focus has a vector of R signals.

    Attributes
    ----------
    signals : for each focus, a complex vector of unit length with one entry (amplitude and phase)
        for each of the R time intervals.
    weights : weights of the foci; they add up to F.
    norms : (E,) norm of Σ_f conj(H_fe) weight_f signal_f, the emission of element e before scaling.
    pressures : pressure at each focus, divided by its requested pressure.
    """

    signals: Complex128[np.ndarray, "foci rank"]
    weights: Float64[np.ndarray, "foci"]
    norms: Float64[np.ndarray, "elements"]
    pressures: Float64[np.ndarray, "foci"]


def relaxed_bound(matrix: FociRows, tolerance: float) -> tuple[UpperBound, Relaxed]:
    """Return the upper bound on the pressure at the weakest focus, and the solved relaxation.

    Each row of ``matrix`` is divided by the requested pressure of its focus.
    """
    foci, count = matrix.shape
    # One time interval for each focus, up to 32. More are unnecessary, because the rank of the
    # optimum stays far below the number of foci (measured).
    signals = np.eye(foci, dtype=np.complex128)
    if foci > 32:
        random = np.random.default_rng(0).normal(size=(2, foci, 32))
        signals = _unit(random[0] + 1j * random[1])
    relaxed = Relaxed(signals, np.ones(foci), np.ones(count), np.zeros(foci))
    bound = None
    reached = 0.0
    for _ in range(100):
        # There are ten iterations between checks. The dual uses the weights before the last
        # iteration and the norms that this iteration computes from them.
        before = _iterated(matrix, relaxed, 9)
        relaxed = _iterated(matrix, before, 1)
        reached = max(reached, float(relaxed.pressures.min()))
        # This is a feasible point of the dual. At the optimum y_e is proportional to these norms,
        # so they are scaled until the eigenvalue is 1. The floor keeps 1/y finite for an element
        # that produces no pressure at any focus.
        multipliers = before.weights / before.weights.sum()
        elements = np.maximum(relaxed.norms, 1e-12 * relaxed.norms.max())
        largest = _largest_eigenvalue(matrix, multipliers, elements)
        elements = elements * (largest * (1.0 + 1e-12))
        candidate = UpperBound(float(np.sqrt(elements.sum())), 0.0, multipliers, elements)
        if bound is None or candidate.worst < bound.worst:
            bound = candidate
        if bound.worst <= (1.0 + tolerance) * reached:
            break
    assert bound is not None  # the loop runs at least once
    return replace(bound, relaxed=reached), relaxed


def _iterated(matrix: FociRows, state: Relaxed, iterations: int) -> Relaxed:
    # A contiguous copy is faster, since every iteration multiplies by it.
    back = np.ascontiguousarray(matrix.conj().T)
    for _ in range(iterations):
        sent = back @ (state.weights[:, None] * state.signals)
        norms = np.linalg.norm(sent, axis=1)
        received = matrix @ (sent / np.maximum(norms, np.finfo(float).tiny)[:, None])
        pressures = np.linalg.norm(received, axis=1)
        weights = state.weights * pressures.mean() / pressures
        # Only ratios of weights matter; a mean of 1 keeps them from drifting out of range.
        weights = weights / weights.mean()
        state = Relaxed(received / pressures[:, None], weights, norms, pressures)
    return state


def _largest_eigenvalue(
    matrix: FociRows,
    multipliers: Float64[np.ndarray, "foci"],
    elements: Float64[np.ndarray, "elements"],
) -> float:
    # The (F, F) product has the nonzero eigenvalues of the (E, E) product, and F is far below E.
    half = np.sqrt(multipliers)[:, None] * matrix / np.sqrt(elements)
    return float(np.linalg.eigvalsh(half @ half.conj().T)[-1])


def _unit(vectors: Complex128[np.ndarray, "foci rank"]) -> Complex128[np.ndarray, "foci rank"]:
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    return vectors / np.maximum(lengths, np.finfo(float).tiny)


class Stalled(UserWarning):
    """Warning that a drive method stopped before it converged and returned its best drive.

    It is a ``UserWarning``, issued with ``warnings.warn``.

    Attributes
    ----------
    reached : ratio of pressure to requested pressure (or share) at the weakest focus, divided by
        the certified upper bound on this ratio, which no drive exceeds; 0 to 1.
    """

    def __init__(self, sentence: str, reached: float) -> None:
        super().__init__(sentence)
        self.reached = reached


def max_min(transfer: TransferMatrix, target: Target, *, iterations: int = 300) -> Drive:
    """Compute the drive that maximises the pressure at the weakest focus.

    The method first solves the semidefinite relaxation of ``upper_bound`` (Inoue, Makino and
    Shinoda, IEEE World Haptics 2015), in which every element may emit several signals in turn. It
    then drops the weakest signals, a few at a time with iterations in between, until one is left
    (our own scheme). From there it runs ``iterations`` steps of weighted Gerchberg-Saxton. It also
    tries the starting points of ``weighted_gerchberg_saxton``, and returns the best drive. The
    result is deterministic. With dozens of foci close together, the iterations may not converge;
    ``best`` then continues with ``gradient``. The target's phases and suppression points have no
    effect.

    Parameters
    ----------
    transfer : the (F, E) transfer matrix of F foci and E elements.
    target : the F foci and their requested pressures or shares. The weakest focus is the one
        with the smallest ratio of pressure to request.
    iterations : number of weighted Gerchberg-Saxton steps at the end, 1 or more.

    Returns
    -------
    A ``Drive`` of E elements with equal amplitudes. All elements are at full scale or, if a weaker
    drive reaches the requested pressures at all foci, at the lowest amplitude that does so.

    Raises
    ------
    InvalidInput
        If the transfer matrix was computed for other foci, if there are more foci than elements, if
        two foci are less than a tenth of a wavelength apart, if a focus is shadowed (its attainable
        pressure is below 5 % of the median for the other foci), or if ``iterations`` is below 1.

    Warns
    -----
    Stalled
        If another drive with the same phases at the foci could raise the pressure at the weakest
        focus by more than about 3 %. The best drive found is still returned.
    """
    matrix, requests = asked_rows(transfer, target)
    check_iterations(iterations)
    rows = matrix / requests[:, None]
    sources = strongest_sources(rows, iterations)
    # With the phases c_f at the foci fixed, finding the best drive is a convex problem. Its dual
    # bounds the remaining gain: no drive has min_f Re(conj(c_f) h_f d) above
    # Σ_e |Σ_f s_f conj(h_fe)| / Σ_f |s_f| for sources s_f of those phases.
    sent = rows.conj().T @ sources
    lowest = smallest_pressure(rows, phase(sent))
    missing = 1.0 - lowest * np.abs(sources).sum() / np.abs(sent).sum()
    if missing > 0.03:
        warn_stalled(
            "max_min",
            rows,
            lowest,
            f"after {counted(iterations, 'iteration', 'iterations')}, {missing:.1%} below the "
            "limit for its phases",
        )
    return scaled_to_target(transfer, target, phase(matrix.conj().T @ (sources / requests)))


def strongest_sources(matrix: FociRows, iterations: int) -> Sources:
    """Return the sources s whose drive phase(Hᴴ s) produces the most pressure at the weakest focus.

    Each row of ``matrix`` is divided by the requested pressure of its focus.
    """
    equal_requests = np.ones(len(matrix))
    # A tolerance below 1e-2 makes no difference after the rank is reduced.
    _, relaxed = relaxed_bound(matrix, 1e-2)
    # Drop the weakest signals, a few at a time with iterations in between, until one is left.
    rank = relaxed.signals.shape[1]
    while rank > 1:
        rank = max(1, min(rank - 1, int(0.7 * rank)))
        # These are the principal components of the signals, with each focus weighted.
        left, strengths, _ = np.linalg.svd(
            np.sqrt(relaxed.weights)[:, None] * relaxed.signals, full_matrices=False
        )
        strongest = _unit(left[:, :rank] * strengths[:rank])
        relaxed = _iterated(matrix, replace(relaxed, signals=strongest), 10)
    reduced = relaxed.weights * relaxed.signals[:, 0]
    # The relaxation need not be tight, so the plain starts are tried as well.
    starts = np.concatenate([reduced[None], starting_sources(matrix, equal_requests)])
    return best_sources(matrix, equal_requests, starts, iterations)


def warn_stalled(method: str, matrix: FociRows, worst: float, where: str) -> None:
    """Warn that a method stopped early, and state how close it came to the certified bound.

    Each row of ``matrix`` is divided by the requested pressure of its focus. ``worst`` is the
    smallest ratio of pressure to request; ``where`` states at which iteration the method stopped.
    """
    reached = worst / relaxed_bound(matrix, 1e-2)[0].worst
    instead = "" if method == "gradient" else ", or use gradient"
    warnings.warn(
        Stalled(
            f"{method} stalled {where}. At the weakest focus, its best drive reaches "
            f"{reached:.1%} of the certified bound. Allow more iterations{instead}.",
            reached,
        ),
        stacklevel=3,  # the caller of the method
    )


def smallest_pressure(matrix: FociRows, amplitudes: Amplitudes) -> float:
    """Return the smallest |h_f d| over all rows h_f of a matrix."""
    return float(np.abs(matrix @ amplitudes).min())


# Negative exponent of the power mean that approximates the smallest pressure. With 16 foci, the
# mean exceeds the smallest pressure by at most 1.4 %.
SHARPNESS = 200.0


def gradient(
    transfer: TransferMatrix, target: Target, *, loss: float = 0.1, iterations: int = 500
) -> Drive:
    """Improve the drive from ``max_min``, and reduce the pressure at the suppression points.

    The pressure of each focus is divided by its requested pressure, its share, or 1. Without
    suppression points, the method maximises the power mean of these ratios with exponent −200,
    which is close to the smallest ratio. It returns the drive at the start or at the end of the
    descent, whichever is better. With suppression points, the method minimises the mean squared
    pressure at these points, with a penalty if the power mean falls below 1 − ``loss`` times its
    initial value. The descent is L-BFGS-B (Byrd, Lu, Nocedal and Zhu, SIAM J. Sci. Comput. 16
    (1995) 1190) on phases and on amplitudes between 0 and 1. The method ignores requested phases.

    Parameters
    ----------
    transfer : the transfer matrix of the foci, and of the suppression points if the target has
        some.
    target : the foci, their requested pressures or shares, and the suppression points.
    loss : fraction of the initial pressure at the foci that may be lost in favour of the
        suppression points, at least 0 and below 1. The actual loss may be slightly larger. This
        limit has no effect without suppression points.
    iterations : largest number of steps of one descent, at least 1. The method runs four descents
        with suppression points, and otherwise one.

    Returns
    -------
    A ``Drive`` of E elements, scaled so that the focus with the smallest ratio of pressure to
    request gets its requested pressure. If this requires more than full scale, or if no pressure is
    requested, the largest amplitude is 1.

    Raises
    ------
    InvalidInput
        If the transfer matrix was computed for other foci or has no rows for the suppression
        points, if there are more foci than elements, if two foci are closer than a tenth of a
        wavelength, if the largest possible pressure at a focus is below 5 % of the median of the
        others, or if ``iterations`` or ``loss`` is outside its range.

    Warns
    -----
    Stalled
        If the descent did not converge within ``iterations`` steps. The best drive is still
        returned.
    """
    matrix, requests = asked_rows(transfer, target)
    suppressed = suppression_rows(transfer, target)
    check_iterations(iterations)
    if not 0.0 <= loss < 1.0:
        raise InvalidInput(
            f"the loss at the foci is {loss:g}, but it must be at least 0 and less than 1.",
            code="out_of_range",
        )
    matrix = matrix / requests[:, None]
    # The descent is local, so it starts from the best known drive.
    start = phase(matrix.conj().T @ strongest_sources(matrix, 300))
    if len(suppressed):
        # Suppression points 60 dB below the weakest focus are quiet enough. The penalty grows from
        # one descent to the next, so the first descents may exceed the allowed loss.
        silenced = suppressed / (1e-3 * smallest_pressure(matrix * requests[:, None], start))
        lowest = _soft_smallest(matrix, start)[0] + np.log1p(-loss)
        drive = start
        converged = True
        for penalty in (1e2, 1e3, 1e4, 1e5):
            drive, converged = _descend(matrix, silenced, lowest, penalty, drive, iterations)
    else:
        drive, converged = _descend(matrix, suppressed, 0.0, 0.0, start, iterations)
        # The power mean may rise while the smallest pressure falls.
        if smallest_pressure(matrix, drive) < smallest_pressure(matrix, start):
            drive = start
    if not converged:
        warn_stalled(
            "gradient",
            matrix,
            smallest_pressure(matrix, drive),
            f"after {counted(iterations, 'step', 'steps')}, still improving",
        )
    return scaled_to_target(transfer, target, drive)


def _descend(
    matrix: FociRows,
    suppressed: Complex128[np.ndarray, "suppressed elements"],
    lowest: float,
    penalty: float,
    start: Amplitudes,
    iterations: int,
) -> tuple[Amplitudes, bool]:
    """Minimise −smallest, or level + penalty · max(lowest − smallest, 0)² with suppression points.

    ``smallest`` is the logarithm of the smallest pressure, and ``level`` is the logarithm of the
    pressure at the suppression points. Return the amplitudes and whether the descent converged.
    """
    from scipy.optimize import minimize

    count = len(start)

    def by_coordinates(
        coordinates: Float64[np.ndarray, "coordinates"],
    ) -> tuple[float, Float64[np.ndarray, "coordinates"]]:
        """Return the loss, and its gradient with respect to the phases and then the magnitudes."""
        turns = np.exp(1j * coordinates[:count])
        amplitudes = coordinates[count:] * turns
        # The value changes by Re Σ conj(g_e) δd_e with the gradient g.
        smallest, slope = _soft_smallest(matrix, amplitudes)
        value = -smallest
        gradient = -slope
        if len(suppressed):
            # The level is log √(1 + mean squared pressure). The 1 under the root removes any
            # reward for suppression beyond 60 dB.
            pressure = suppressed @ amplitudes
            energy = float(np.vdot(pressure, pressure).real) + len(suppressed)
            missing = max(lowest - smallest, 0.0)
            value = 0.5 * np.log(energy / len(suppressed)) + penalty * missing**2
            gradient = suppressed.conj().T @ pressure / energy - 2.0 * penalty * missing * slope
        # The chain rule for d = r e^{iφ}: ∂d/∂φ = i d, ∂d/∂r = e^{iφ}.
        by_phase = np.real(np.conj(gradient) * 1j * amplitudes)
        return value, np.concatenate([by_phase, np.real(np.conj(gradient) * turns)])

    end = minimize(
        by_coordinates,
        np.concatenate([np.angle(start), np.abs(start)]),
        jac=True,
        method="L-BFGS-B",
        bounds=[(None, None)] * count + [(0.0, 1.0)] * count,
        options={"maxiter": iterations, "maxfun": 2 * iterations, "ftol": 1e-4},
    )
    return end.x[count:] * np.exp(1j * end.x[:count]), end.status == 0


def _soft_smallest(matrix: FociRows, amplitudes: Amplitudes) -> tuple[float, Amplitudes]:
    """Return the log of the power mean of the ratios of pressure to request, and its gradient."""
    pressure = matrix @ amplitudes
    logs = np.log(np.maximum(np.abs(pressure), np.finfo(float).tiny))
    # The logarithms are taken relative to the smallest one, so that no power overflows.
    weights = np.exp(SHARPNESS * (logs.min() - logs))
    smallest = logs.min() - np.log(weights.mean()) / SHARPNESS
    # ∂ log|p| / ∂ conj(p) has the direction p / |p|².
    shares = weights / weights.sum()
    return float(smallest), matrix.conj().T @ (shares * pressure / np.exp(2.0 * logs))
