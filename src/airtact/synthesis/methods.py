"""All ways to make a drive, by name."""

from collections.abc import Callable

from airtact.scene.target import Target
from airtact.synthesis.eigenvector import eigenvector
from airtact.synthesis.gerchberg_saxton import gerchberg_saxton, gs_pat, weighted_gerchberg_saxton
from airtact.synthesis.gradient import gradient
from airtact.synthesis.inverse_filter import inverse_filter, iterated_time_reversal
from airtact.synthesis.max_min import max_min
from airtact.synthesis.time_reversal import phase_conjugate, time_reversal
from airtact.transfer import Drive, TransferMatrix

METHODS: dict[str, Callable[[TransferMatrix, Target], Drive]] = {
    "time_reversal": time_reversal,
    "phase_conjugate": phase_conjugate,
    "iterated_time_reversal": iterated_time_reversal,
    "inverse_filter": inverse_filter,
    "eigenvector": eigenvector,
    "gerchberg_saxton": gerchberg_saxton,
    "weighted_gerchberg_saxton": weighted_gerchberg_saxton,
    "gs_pat": gs_pat,
    "max_min": max_min,
    "gradient": gradient,
}
"""Each is a function of the transfer matrix and the target; its other settings have defaults."""

HEED_QUIET = ("inverse_filter", "gradient")
"""Methods that heed suppression points; they need the beacons of ``target.beacons(suppression=True)``."""
