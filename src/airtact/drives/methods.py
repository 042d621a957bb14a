"""The drive methods by name (``METHODS``), and ``best``, the default that chooses among them."""

import warnings
from dataclasses import dataclass
from importlib import import_module

import numpy as np

from airtact.acoustics.target import Target
from airtact.drives.drive import Drive
from airtact.drives.max_min import Stalled, max_min
from airtact.drives.transfer import FociRows, TransferMatrix, check_foci, foci_rows
from airtact.transducers.levels import FULL_SCALE


def best(transfer: TransferMatrix, target: Target) -> Drive:
    """Compute the drive by the method that makes the weakest focus strongest.

    ================================== ============================================================
    the target requests                method
    ================================== ============================================================
    one focus                          ``phase_conjugate``, which is optimal at full scale
    several foci                       ``max_min``, continued by ``gradient`` if it stalls
    phases at several foci             ``least_peak``
    suppression points                 ``gradient``; the foci lose at most a tenth of their pressure
    suppression points and phases      ``inverse_filter``
    ================================== ============================================================

    If the target has no suppression points and full scale is enough for its requests, each focus
    gets exactly its requested pressure. This adjustment keeps the phases at the foci that the
    method chose. The drive then has the least energy, unless an element would exceed full scale. If
    full scale is not enough, the drive maximises the smallest ratio of pressure to request. If the
    target requests shares, the drive is adjusted to exact shares, unless the pressures already have
    these ratios to within 2 % of the largest, or the adjustment would halve the largest pressure.

    Parameters
    ----------
    transfer : the transfer matrix of F foci and E elements, as returned by ``transfer_matrix``; if
        the target has suppression points, their rows follow those of the foci.
    target : the foci, their requested pressures or shares, and the suppression points.

    Returns
    -------
    A ``Drive`` of E elements. If full scale is not enough for the requests, or if no pressure is
    requested, the largest amplitude is 1. ``achieved_fraction`` returns the ratio of each focus's
    pressure to its request, and ``upper_bound`` the pressure that no drive exceeds.

    Raises
    ------
    InvalidInput
        If an argument has the wrong type, or if the matrix was computed for other foci or has no
        rows for the suppression points. With several foci, the error is also raised if there are
        more foci than elements, if two are less than a tenth of a wavelength apart, or if one is
        shadowed (its largest possible pressure is below 5 % of the median of the others).

    Warns
    -----
    Stalled
        If the method did not converge. The best drive is still returned.

    Examples
    --------
    >>> transfer = TransferMatrix(np.array([[3.0 + 0j, 4j]]), 0.0)
    >>> transfer.pressure(best(transfer, Target(np.zeros((1, 3))))).real.round(9).tolist()
    [7.0]
    """
    check_foci(transfer, target)
    method = method_for(target)
    if method == "max_min":
        with warnings.catch_warnings(record=True) as stalled:
            warnings.simplefilter("always", Stalled)
            drive = max_min(transfer, target)
        # The alternation stalls with many foci close together. The slower descent continues.
        if stalled:
            drive = METHODS["gradient"](transfer, target)
    else:
        drive = METHODS[method](transfer, target)
    if len(target.suppression_points) or (target.pressures is None and target.shares is None):
        return drive
    return _as_asked(foci_rows(transfer, target), target, drive)


def _as_asked(matrix: FociRows, target: Target, drive: Drive) -> Drive:
    """Adjust a drive to the exact request of each focus, including 0, if little pressure is lost.

    The phases at the foci do not change.
    """
    from airtact.drives.linear_methods import exact_amplitudes

    pressures = matrix @ drive.amplitudes
    wanted = target.weights * np.exp(1j * np.angle(pressures))
    if target.pressures is not None:
        amplitudes = exact_amplitudes(matrix, wanted, sufficient_peak=FULL_SCALE)
        return Drive(amplitudes) if np.abs(amplitudes).max() <= FULL_SCALE else drive
    shares = target.weights / target.weights.max()
    # With every element at full scale, the foci get more pressure than with exact shares.
    if np.abs(np.abs(pressures) / np.abs(pressures).max() - shares).max() < 0.02:
        return drive
    amplitudes = exact_amplitudes(matrix, wanted)
    amplitudes = amplitudes / np.abs(amplitudes).max()
    strongest = np.abs(matrix @ amplitudes).max()
    # Foci close together may reach exact shares only at a fraction of the pressure.
    return Drive(amplitudes) if strongest > 0.5 * np.abs(pressures).max() else drive


def method_for(target: Target) -> str:
    """Return the name of the method that ``best`` uses for a target."""
    phases = target.phases is not None
    if len(target.suppression_points):
        return "inverse_filter" if phases else "gradient"
    # A single focus needs no balancing: its pressure is largest if all contributions are in phase.
    if np.count_nonzero(target.weights) == 1:
        return "phase_conjugate"
    return "least_peak" if phases else "max_min"


@dataclass(frozen=True)
class Method:
    """A method that computes a drive; call it with a transfer matrix and a target.

    Attributes
    ----------
    name : name of the function; ``METHODS`` and scene files use it.
    module : module of ``airtact.drives`` that defines the function.
    description : one-line description.
    heeds_phases : whether the foci get the phases that the target requests; otherwise the
        method ignores the requested phases.
    heeds_suppression_points : whether the method lowers the pressure at the suppression points.
        Such a method needs a transfer matrix from ``target.beacons(suppression=True)``.
    """

    name: str
    module: str
    description: str
    heeds_phases: bool = False
    heeds_suppression_points: bool = False

    def __call__(self, transfer: TransferMatrix, target: Target) -> Drive:
        """Return the drive for the foci of a target."""
        # Imported on call: a drive needs only one method, and the robust methods import the
        # solvers for their samples.
        make = getattr(import_module(f"airtact.drives.{self.module}"), self.name)
        return make(transfer, target)


FOR_SAMPLES = ("robust", "robust_phase_only")
"""Methods that compute a drive for all samples of an ensemble."""

METHODS: dict[str, Method] = {
    method.name: method
    for method in (
        Method(
            "best",
            "methods",
            "the default: the method below that suits the target best",
            heeds_phases=True,
            heeds_suppression_points=True,
        ),
        Method(
            "time_reversal",
            "linear_methods",
            "the conjugate of the transfer matrix, with its amplitudes and phases",
            heeds_phases=True,
        ),
        Method(
            "phase_conjugate",
            "linear_methods",
            "the phases of time reversal, all elements at one amplitude",
            heeds_phases=True,
        ),
        Method(
            "inverse_filter",
            "linear_methods",
            "regularised least squares for the requested pressures",
            heeds_phases=True,
            heeds_suppression_points=True,
        ),
        Method(
            "least_peak",
            "linear_methods",
            "exactly the requested pressures and phases, at the lowest peak amplitude",
            heeds_phases=True,
        ),
        Method(
            "weighted_gerchberg_saxton",
            "gerchberg_saxton",
            "alternating projections with more weight on weaker foci",
        ),
        Method("gs_pat", "gerchberg_saxton", "alternating projections between the foci alone"),
        Method(
            "max_min",
            "max_min",
            "the largest pressure at the weakest focus, by semidefinite relaxation",
        ),
        Method(
            "gradient",
            "max_min",
            "max_min improved by gradient descent, which also quiets suppression points",
            heeds_suppression_points=True,
        ),
        Method(
            "robust",
            "robust_drives",
            "the best for an uncertain hand, at equal energy",
        ),
        Method(
            "robust_phase_only",
            "robust_drives",
            "the same with every element at full scale",
        ),
    )
}
"""All methods by name, the default first."""
