"""What echoes focus on by themselves: eigenvectors of the time-reversal operator (DORT), iterations towards one.

With K the echo matrix of an array whose elements emit and receive, the echo of a code c is K c, and
playing back its time reverse, conj(K c), returns sound to what scattered it. Done again and again
it leads to the code whose echoes are strongest, the first singular vector of K. A body much smaller
than the wavelength has one such vector, which focuses on it; for several of them, well apart, each
vector focuses on one (C. Prada, M. Fink, Wave Motion 20 (1994) 151). A larger body has as many as
its surface has places that the wavelength resolves.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Complex128, Float64

from airtact.checks import complex_numbers, counted
from airtact.errors import InvalidInput
from airtact.printing import one_line
from airtact.sensing.echoes import Echoes


@dataclass(frozen=True, eq=False)
class TimeReversal:
    """Codes that return the strongest echoes, by ``dort``.

    Attributes
    ----------
    codes : (E, N) singular vectors, the strongest first; the strongest element of each is at full
        scale.
    values : (min(R, M),) singular values of the echoes, over the largest.
    """

    codes: Complex128[np.ndarray, "elements vectors"]
    values: Float64[np.ndarray, "values"]

    def __repr__(self) -> str:
        elements, vectors = self.codes.shape
        return one_line(
            self, counted(elements, "element", "elements"), counted(vectors, "vector", "vectors")
        )


def dort(echoes: Echoes, vectors: int = 1) -> TimeReversal:
    """Find the codes of the strongest echoes, without any knowledge of the bodies.

    They are the conjugates of the left singular vectors of the echoes, since elements receive as
    they emit. With Hadamard codes of all elements they are those of the echo matrix itself; M
    random codes find the few strongest where these stand out. Elements that do not receive are
    silent.

    Parameters
    ----------
    echoes : (R, M) all valid, less what the empty array receives.
    vectors : number of codes, 1 to min(R, M).

    Raises
    ------
    InvalidInput
        "out_of_range": of vectors; "link_failed": some pressures are not valid.

    Examples
    --------
    >>> import airtact as at
    >>> scene = at.Scene(at.air(celsius=20.0), [at.sound_hard(at.sphere(radius=1e-3, edge=1e-3))])
    >>> array = at.autd3_board(at.Pose(np.eye(3), np.array([-0.09, -0.07, -0.15])))
    >>> echoes = at.simulate_echoes(at.SphereSeries(), scene, array, at.sensing.random_codes(249, 4))
    >>> dort(echoes).codes.shape
    (249, 1)
    """
    most = min(echoes.pressures.shape)
    if (
        isinstance(vectors, bool)
        or not isinstance(vectors, int | np.integer)
        or not 1 <= vectors <= most
    ):
        raise InvalidInput(
            f"{vectors!r} singular vectors are asked for, but these echoes have 1 to {most}.",
            code="out_of_range",
        )
    if echoes.valid is not None and not echoes.valid.all():
        raise InvalidInput(
            f"{int((~echoes.valid).sum())} of {echoes.valid.size} pressures are not valid: leave their receivers out.",
            code="link_failed",
        )
    left, values, _ = np.linalg.svd(np.asarray(echoes.pressures), full_matrices=False)
    codes = np.zeros((len(echoes.codes), int(vectors)), dtype=np.complex128)
    codes[echoes.receiving] = left[:, :vectors].conj()
    return TimeReversal(codes / np.abs(codes).max(axis=0), values / max(float(values[0]), 1e-300))


def iterate_time_reversal(
    transmit: Callable[[Complex128[np.ndarray, "elements 1"]], Complex[np.ndarray, "elements 1"]],
    start: Complex[np.ndarray, "elements"],
    iterations: int = 10,
) -> Complex128[np.ndarray, "elements"]:
    """Play the time-reversed echo of a code back, again and again: it tends to the code of the strongest echo.

    Parameters
    ----------
    transmit : emits a code (E, 1) and returns the echo at all elements, (E, 1), less what the empty
        array receives.
    start : (E,) code to begin with.
    iterations : number of transmissions, 1 to 1000.

    Returns
    -------
    (E,) code whose strongest element is at full scale.

    Raises
    ------
    InvalidInput
        "out_of_range": of iterations; "signal_unusable": no echo returns.
    """
    if (
        isinstance(iterations, bool)
        or not isinstance(iterations, int | np.integer)
        or not 1 <= iterations <= 1000
    ):
        raise InvalidInput(
            f"{iterations!r} iterations are asked for; give 1 to 1000.", code="out_of_range"
        )
    code = complex_numbers(start, "the code")
    for _ in range(iterations):
        echo = np.asarray(transmit(code[:, None]), dtype=np.complex128).reshape(-1)
        strongest = float(np.abs(echo).max())
        if not 0.0 < strongest < np.inf:
            raise InvalidInput(
                f"the strongest echo has {strongest:g} Pa, so there is nothing to play back.",
                code="signal_unusable",
            )
        code = echo.conj() / strongest
    return code
