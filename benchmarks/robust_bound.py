"""A bound on any drive over the samples of an ensemble, with a certificate anyone can check."""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from jaxtyping import Complex128, Float64

from airtact.acoustics.target import Target
from airtact.drives.drive import Drive
from airtact.drives.robust_drives import robust, sampled_rows
from airtact.drives.transfer import TransferMatrix
from airtact.errors import InvalidInput, one_line

BoundedGoal = Literal["worst", "mean"]
"""The goals that have a bound."""


@dataclass(frozen=True, eq=False)
class RobustBound:
    """A bound on the worst or mean weakest focus over the samples, for drives of equal energy.

    For multipliers m_sf ≥ 0, λ being the largest eigenvalue of Σ m_sf h_sfᴴ h_sf, every drive of
    energy Σ|d|² = 1 has Σ m_sf |h_sf d|² ≤ λ. With v_s the weakest focus of sample s that is at
    least Σ_s m_s v_s², m_s = Σ_f m_sf, so that min v_s ≤ √(λ / Σ_s m_s) and, by Cauchy and Schwarz,
    mean v_s ≤ √(λ Σ_s 1/m_s) / S.

    Attributes
    ----------
    goal : "worst" or "mean".
    value : the bound for a drive of energy 1, a pressure [Pa] or a share of what the foci ask for.
    multipliers : (S, F) m_sf, for the foci that ask for something.
    """

    goal: BoundedGoal
    value: float
    multipliers: Float64[np.ndarray, "samples foci"]

    def __repr__(self) -> str:
        return one_line(
            self, f"{self.goal} {self.value:.4g} at energy 1", f"{len(self.multipliers)} samples"
        )

    def recomputed(self, ensemble: TransferMatrix, target: Target) -> float:
        """Compute the bound from its multipliers and the matrices alone: the proof."""
        rows = sampled_rows(ensemble, target).reshape(self.multipliers.size, -1)
        half = np.sqrt(self.multipliers.reshape(-1))[:, None] * rows
        return _bound(self.goal, self.multipliers, float(np.linalg.norm(half, 2)) ** 2)

    def reached(self, ensemble: TransferMatrix, target: Target, drive: Drive) -> float:
        """Return the goal under a drive over the bound at its energy; 1 is the best possible."""
        values = np.abs(sampled_rows(ensemble, target) @ drive.amplitudes).min(axis=1)
        # Pressure is linear in the drive, so the bound scales with the root of the energy.
        value = values.min() if self.goal == "worst" else values.mean()
        return float(value / (self.value * np.linalg.norm(drive.amplitudes)))


def robust_upper_bound(
    ensemble: TransferMatrix, target: Target, goal: BoundedGoal = "worst"
) -> RobustBound:
    """Bound the weakest focus under any drive of energy Σ|d|² = 1, in the worst sample or the mean.

    The dual of the semidefinite relaxation of the problem, for the samples given and the nominal
    gains of the elements. Its multipliers are found by descent from those of ``robust``; the bound
    holds wherever that ends.

    Parameters
    ----------
    ensemble : the samples.
    target : the foci and the pressures asked there; suppression points are ignored.
    goal : "worst" or "mean".

    Returns
    -------
    The bound and its certificate.

    Raises
    ------
    InvalidInput
        As ``robust``; "unknown_name": there is no such goal, or it has no bound.
    """
    from scipy.optimize import minimize

    if goal not in get_args(BoundedGoal):
        raise InvalidInput(
            f'"{goal}" has no bound; {" and ".join(get_args(BoundedGoal))} have.',
            code="unknown_name",
        )
    rows = sampled_rows(ensemble, target)
    samples, foci, elements = rows.shape
    flat = rows.reshape(-1, elements)
    # Σ m hᴴ h over the elements has the nonzero eigenvalues of this smaller product of rows.
    products = flat @ flat.conj().T
    # The multipliers that the optimality conditions of ``robust`` suggest are a good start.
    asked = Target(target.points, target.pressures, shares=target.shares)
    drive = robust(ensemble.of_rows(np.arange(len(target.points))), asked, goal)
    pressures = np.abs(rows @ drive.amplitudes)
    weakest = pressures.min(axis=1, keepdims=True)
    weights = np.exp(8.0 * (1.0 - pressures / weakest)) / weakest ** (1 if goal == "mean" else 3)
    logs = np.log(weights / weights.sum()).reshape(-1)
    best = None
    # Trace norms of ever higher powers approach the largest eigenvalue.
    for power in (8, 32, 128):
        logs = minimize(
            _soft_bound,
            logs,
            (products, (samples, foci), goal, power),
            jac=True,
            method="L-BFGS-B",
            options={"maxiter": 60},
        ).x
        multipliers = np.exp(logs - logs.max()).reshape(samples, foci)
        half = np.sqrt(multipliers.reshape(-1))
        largest = float(np.linalg.eigvalsh(half[:, None] * products * half)[-1])
        bound = RobustBound(goal, _bound(goal, multipliers, largest), multipliers)
        if best is None or bound.value < best.value:
            best = bound
    assert best is not None
    return best


def _bound(goal: str, multipliers: Float64[np.ndarray, "samples foci"], largest: float) -> float:
    by_sample = multipliers.sum(axis=1)
    if goal == "worst":
        return float(np.sqrt(largest / by_sample.sum()))
    return float(np.sqrt(largest * np.sum(1.0 / by_sample)) / len(by_sample))


def _soft_bound(
    logs: Float64[np.ndarray, "rows"],
    products: Complex128[np.ndarray, "rows rows"],
    shape: tuple[int, int],
    goal: str,
    power: int,
) -> tuple[float, Float64[np.ndarray, "rows"]]:
    """Logarithm of the squared bound, with a trace norm for the eigenvalue, and its gradient.

    Both are functions of the logarithms of the multipliers.
    """
    multipliers = np.exp(logs - logs.max())
    half = np.sqrt(multipliers)
    values, vectors = np.linalg.eigh(half[:, None] * products * half)
    # Relative to the largest, so that powers up to 128 do not overflow.
    largest = float(values[-1])
    values = np.maximum(values, 0.0) / largest
    powers = values**power
    level = np.log(powers.sum()) / power + np.log(largest)
    # d λ_k / d log m_j = λ_k |v_jk|²
    slope = (np.abs(vectors) ** 2) @ powers / powers.sum()
    by_sample = multipliers.reshape(shape).sum(axis=1)
    within = multipliers.reshape(shape) / by_sample[:, None]
    if goal == "worst":
        shares = within * (by_sample / by_sample.sum())[:, None]
        return level - np.log(by_sample.sum()), slope - shares.reshape(-1)
    inverse = 1.0 / by_sample
    shares = within * (inverse / inverse.sum())[:, None]
    return level + np.log(inverse.sum()), slope - shares.reshape(-1)
