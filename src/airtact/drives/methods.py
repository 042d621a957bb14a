"""The registry of drive synthesis methods: name, function, description, and which requests of a target each heeds."""

from collections.abc import Callable
from dataclasses import dataclass

from airtact.acoustics.target import Target
from airtact.drives.conjugation import phase_conjugate, time_reversal
from airtact.drives.default_method import best
from airtact.drives.gerchberg_saxton import gerchberg_saxton, gs_pat, weighted_gerchberg_saxton
from airtact.drives.gradient_descent import gradient
from airtact.drives.least_squares import eigenvector, inverse_filter, iterated_time_reversal
from airtact.drives.peak_limited import least_peak
from airtact.drives.samples.robust import robust, robust_phase_only
from airtact.drives.transfer import Drive, TransferMatrix
from airtact.drives.weakest_focus import max_min


@dataclass(frozen=True)
class Method:
    """One way to make a drive; call it with a transfer matrix and a target, its other settings keep their defaults.

    Attributes
    ----------
    make : the function.
    description : what it does, in one line.
    heeds_phases : whether it gives the foci the phases that the target asks for; else it ignores or
        chooses them.
    heeds_suppression_points : whether it lowers the pressure there; it then needs a transfer matrix
        from ``target.beacons(suppression=True)``.
    """

    make: Callable[[TransferMatrix, Target], Drive]
    description: str
    heeds_phases: bool = False
    heeds_suppression_points: bool = False

    def __call__(self, transfer: TransferMatrix, target: Target) -> Drive:
        """Return the drive for the foci of a target."""
        return self.make(transfer, target)

    @property
    def name(self) -> str:
        """Name of the function, by which ``METHODS`` and scene files know the method."""
        return self.make.__name__


_ALL = (
    Method(best, "the default: the method below that serves the target best", True, True),
    Method(
        time_reversal,
        "the conjugate of the transfer matrix, amplitudes and phases",
        heeds_phases=True,
    ),
    Method(
        phase_conjugate,
        "the phases of time reversal, all elements at one amplitude",
        heeds_phases=True,
    ),
    Method(
        iterated_time_reversal,
        "time reversal of the missing pressure, pass after pass",
        heeds_phases=True,
    ),
    Method(inverse_filter, "regularised least squares for the pressures wanted", True, True),
    Method(
        least_peak,
        "exactly the pressures and phases wanted, the peak amplitude least",
        heeds_phases=True,
    ),
    Method(eigenvector, "least squares with phases at which the foci reinforce each other"),
    Method(gerchberg_saxton, "phases alone, by alternating projections"),
    Method(weighted_gerchberg_saxton, "alternating projections with more weight on foci that lag"),
    Method(gs_pat, "alternating projections between the foci alone"),
    Method(max_min, "the strongest worst focus, from a semidefinite relaxation"),
    Method(
        gradient,
        "max_min improved along the gradient, suppression points silenced",
        heeds_suppression_points=True,
    ),
    Method(
        robust,
        "the best for hands that may be elsewhere, at equal energy",
        heeds_suppression_points=True,
    ),
    Method(
        robust_phase_only,
        "the same with every element at full scale",
        heeds_suppression_points=True,
    ),
)

FOR_SAMPLES = ("robust", "robust_phase_only")
"""Methods whose drives are for all samples of an ensemble; on a matrix without samples nothing is in doubt."""

METHODS: dict[str, Method] = {method.name: method for method in _ALL}
"""All methods by name, the default first."""
