"""The eigenvector method: phases at which the foci reinforce each other, then weighted least squares."""

import numpy as np

from airtact.scene.target import Target
from airtact.synthesis.reach import check_solvable, foci_rows, scaled_to_target
from airtact.transfer import Drive, TransferMatrix
from airtact.validation import number


def eigenvector(transfer: TransferMatrix, target: Target, *, evenness: float = 1.0) -> Drive:
    """Choose the phases of the foci by an eigenvector, and solve least squares for the pressures with those phases.

    Long, Seah, Carter and Subramanian, ACM Trans. Graph. 33 (2014) 181. R_fg is the pressure at focus f when the array
    focuses on focus g alone, at the pressure that g asks for. The eigenvector of R with the largest eigenvalue gives
    phases under which the foci reinforce each other. The drive is least squares for those pressures with Tikhonov
    weights σ_e^γ, σ_e² = Σ_f |H_fe| w_f / E, which limit the largest amplitudes (their section 4.3). The method ignores
    the phases that the target asks for, and its suppression points.

    Parameters
    ----------
    transfer : the (F, E) transfer matrix of F foci and E elements.
    target : the foci and the pressures asked there.
    evenness : γ, from 0 (all elements weigh alike) to 1.

    Returns
    -------
    The drive, scaled as ``time_reversal`` scales it.

    Raises
    ------
    InvalidInput
        If the foci of the target are not those of the matrix, there are more foci than elements, two foci are too
        close together, a focus is shadowed, or ``evenness`` is no number.
    """
    check_solvable(transfer, target)
    matrix = foci_rows(transfer, target)
    power = number(evenness, "the evenness", "1")
    wanted = target.weights
    # Where no pressure is asked, about what each focus can have: the weights below compare pascals with pascals.
    if target.pressures is None:
        wanted = wanted / wanted.max() * np.abs(matrix).sum(axis=1).mean() / np.sqrt(len(matrix))
    energy = np.sum(np.abs(matrix) ** 2, axis=1)
    focused = matrix.conj().T * (wanted / np.where(energy > 0.0, energy, 1.0))
    values, vectors = np.linalg.eig(matrix @ focused)
    asked = wanted * np.exp(1j * np.angle(vectors[:, np.argmax(np.real(values))]))
    spread = (np.abs(matrix).T @ wanted / matrix.shape[1]) ** power
    evened = matrix / np.where(spread > 0.0, spread, 1.0)
    inverse = np.linalg.solve(evened @ matrix.conj().T + np.eye(len(matrix)), asked)
    return scaled_to_target(transfer, target, evened.conj().T @ inverse)
