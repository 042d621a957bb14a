"""Alternating projections between elements at full scale and foci with the requested pressures.

The methods choose the phases at the foci. They ignore the target's phases and suppression points.
"""

import numpy as np
from jaxtyping import Complex64, Complex128, Float32, Float64, Int64

from airtact import _kernels
from airtact.acoustics.target import Target
from airtact.drives.drive import Drive
from airtact.drives.transfer import FociRows, TransferMatrix, asked_rows, scaled_to_target
from airtact.errors import InvalidInput

# Complex source s at each focus. The elements emit the phases of Hᴴ s.
Sources = Complex128[np.ndarray, "foci"]


def weighted_gerchberg_saxton(
    transfer: TransferMatrix, target: Target, *, iterations: int = 50
) -> Drive:
    """Compute a phase-only drive by alternating projections that give weaker foci more weight.

    With the transfer matrix H, each iteration computes the drive d = phase(Hᴴ s) from sources s at
    the foci, and then new sources s_f = v_f · phase((H d)_f), where phase(z) = z/|z|. The weights
    v_f start at the requested pressures or shares and grow for weak foci; the best iteration is
    returned (Di Leonardo, Ianni and Ruocco, Opt. Express 15 (2007) 1913; for sound, Marzo and
    Drinkwater, PNAS 116 (2019) 84). The method runs twice, once starting with all foci in phase and
    once with all elements in phase, and returns the better drive. If the weights oscillate, as they
    can between two foci with nearly equal rows of H, the method shortens their steps. It ignores
    requested phases and suppression points.

    Parameters
    ----------
    transfer : the (F, E) transfer matrix of F foci and E elements.
    target : the foci and their requested pressures or shares.
    iterations : number of alternations between elements and foci, at least 1.

    Returns
    -------
    A ``Drive`` of E elements with equal amplitudes: full scale, or less if that is enough for every
    focus to get its requested pressure.

    Raises
    ------
    InvalidInput
        If the transfer matrix was computed for other foci, if there are more foci than elements, if
        two foci are closer than a tenth of a wavelength, if the largest possible pressure at a
        focus is below 5 % of the median of the others, or if ``iterations`` is below 1.
    """
    matrix, requests = asked_rows(transfer, target)
    check_iterations(iterations)
    sources = best_sources(matrix, requests, starting_sources(matrix, requests), iterations)
    return scaled_to_target(transfer, target, phase(matrix.conj().T @ sources))


def gs_pat(transfer: TransferMatrix, target: Target, *, iterations: int = 50) -> Drive:
    """Compute a phase-only drive by iterations on the foci alone, which is fast for many elements.

    Each iteration replaces the sources s at the foci by w · phase(p), with the requested pressures
    w and p = H Hᴴ s, where H is the transfer matrix and H Hᴴ an (F, F) matrix. At the end the
    sources are weighted by w²/|p|, and every element emits the phase of Hᴴ s at full scale
    (Plasencia, Hirayama, Montano-Murillo and Subramanian, ACM Trans. Graph. 39 (2020) 138). This
    last step lowers the pressure at the weakest focus. Ten iterations of
    ``weighted_gerchberg_saxton``, which are our addition to the published method, restore the
    pressure and never lower it. The target's phases and suppression points have no effect.

    Parameters
    ----------
    transfer : the (F, E) transfer matrix of F foci and E elements.
    target : the foci and their requested pressures or shares; if it contains neither, all foci have
        the same weight.
    iterations : number of iterations on the foci, 1 or more; 50 by default.

    Returns
    -------
    A ``Drive`` of E elements with equal amplitudes. All elements are at full scale or, if a weaker
    drive reaches the requested pressures at all foci, at the lowest amplitude that does so.

    Raises
    ------
    InvalidInput
        If the transfer matrix was computed for other foci, if there are more foci than elements, if
        two foci are less than a tenth of a wavelength apart, if a focus is shadowed (its largest
        possible pressure is below 5 % of the median of the others), or if ``iterations`` is below
        1.
    """
    matrix, requests = asked_rows(transfer, target)
    check_iterations(iterations)
    sources = best_sources(
        matrix,
        requests,
        requests[None].astype(np.complex128),
        iterations=10,
        foci_iterations=iterations,
    )
    return scaled_to_target(transfer, target, phase(matrix.conj().T @ sources))


# Factor that reduces single-precision magnitudes near 1 to at most 1.
SINGLE = np.float32(1.0 - 2e-7)


def alternating_projections(
    matrix: Complex128[np.ndarray, "points elements"],
    sets: Int64[np.ndarray, "sets foci"],
    requests: Float64[np.ndarray, "sets foci"],
    sources: Complex128[np.ndarray, "sets foci"],
    iterations: int,
    foci_iterations: int = 0,
) -> tuple[
    Complex64[np.ndarray, "sets foci"],
    Float32[np.ndarray, "sets"],
    Complex64[np.ndarray, "sets elements"],
]:
    """Run phase-only alternating projections for many sets of foci in single precision.

    Parameters
    ----------
    matrix : pressure at all points per unit drive.
    sets : indices of the matrix rows that belong to the foci of each set.
    requests : requested pressures; only their ratios matter.
    sources : initial sources; their magnitudes are the initial weights.
    iterations : number of weighted Gerchberg-Saxton iterations; the best one is returned.
    foci_iterations : number of GS-PAT iterations that precede the weighted ones.

    Returns
    -------
    For each set of foci: the sources at the foci, the smallest ratio of pressure to request [Pa],
    and the phasors of the elements. For the ratio, requests are scaled so that the largest is 1.
    """
    # Single precision is enough: only phases matter, and their error is below 1e-6.
    single = matrix.astype(np.complex64)
    return _kernels.gerchberg_saxton(
        single.real,
        single.imag,
        sets,
        (requests / requests.max(axis=1, keepdims=True)).astype(np.float32),
        foci_iterations,
        iterations,
        True,  # weighted
        sources.astype(np.complex64),
    )


def best_sources(
    matrix: FociRows,
    requests: Float64[np.ndarray, "foci"],
    starts: Complex128[np.ndarray, "starts foci"],
    iterations: int,
    foci_iterations: int = 0,
) -> Sources:
    """Run alternating projections from several starts, and return the sources of the best result.

    The best result has the highest pressure at the weakest focus.
    """
    rows = np.tile(np.arange(len(requests)), (len(starts), 1))
    sources, worst, _ = alternating_projections(
        matrix, rows, np.tile(requests, (len(starts), 1)), starts, iterations, foci_iterations
    )
    return sources[worst.argmax()].astype(np.complex128)


def starting_sources(
    matrix: FociRows, requests: Float64[np.ndarray, "foci"]
) -> Complex128[np.ndarray, "2 foci"]:
    """Return two sets of initial sources: for all foci in phase and for all elements in phase."""
    in_phase = requests.astype(np.complex128)
    # The pressure when all elements emit in phase.
    pressure = matrix.sum(axis=1)
    # Without the floor, foci that receive little pressure from elements in phase would get all the
    # weight.
    floor = 1e-3 * max(float(np.abs(pressure).max()), np.finfo(float).tiny)
    from_elements = requests**2 * phase(pressure) / np.maximum(np.abs(pressure), floor)
    # A focus where this pressure is exactly zero has no phase to start from.
    if not from_elements.all():
        from_elements = in_phase
    return np.stack([in_phase, from_elements / np.abs(from_elements).max()])


def phase(numbers: Complex128[np.ndarray, "*shape"]) -> Complex128[np.ndarray, "*shape"]:
    """Return numbers of magnitude 1 with the same phases; 0 stays 0."""
    # The smallest normal number avoids 0 / 0 without changing any other quotient.
    return numbers / np.maximum(np.abs(numbers), np.finfo(float).tiny)


def check_iterations(iterations: int) -> None:
    """Raise ``InvalidInput`` for fewer than one iteration."""
    if iterations < 1:
        raise InvalidInput(f"there must be at least 1 iteration, not {iterations}.", code="too_few")
