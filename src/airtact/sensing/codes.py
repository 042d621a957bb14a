"""Codes: what the elements of an array emit in each transmission, so that echoes can be told apart."""

import numpy as np
from jaxtyping import Complex128, Integer
from scipy.linalg import hadamard

from airtact.checks import check_seed
from airtact.errors import InvalidInput

MOST_CODES = 4096
"""Largest number of elements or transmissions of a code."""


def single_codes(elements: int) -> Complex128[np.ndarray, "elements transmissions"]:
    """One element alone in each of E transmissions, (E, E): the identity.

    Raises
    ------
    InvalidInput
        "out_of_range": of elements.
    """
    return np.eye(_checked(elements, "elements"), dtype=np.complex128)


def hadamard_codes(
    elements: int, transmissions: int | None = None
) -> Complex128[np.ndarray, "elements transmissions"]:
    """Signs from the rows of a Hadamard matrix by Sylvester's construction: all elements emit in every transmission.

    Parameters
    ----------
    elements : E.
    transmissions : M, from 1 to the next power of 2 at or above E, which is taken unless given;
        with that many, each element's part can be separated, at the noise of E transmissions of it
        alone.

    Returns
    -------
    (E, M) codes of 1 and −1.

    Raises
    ------
    InvalidInput
        "out_of_range": of elements or transmissions.
    """
    size = 1 << (_checked(elements, "elements") - 1).bit_length()
    count = size if transmissions is None else _checked(transmissions, "transmissions", size)
    return hadamard(size)[:elements, :count].astype(np.complex128)


def random_codes(
    elements: int,
    transmissions: int,
    seed: int = 0,
    parts: Integer[np.ndarray, "elements"] | None = None,
) -> Complex128[np.ndarray, "elements transmissions"]:
    """All elements at full scale with random phases, the same for the same seed: a field of speckles everywhere.

    Parameters
    ----------
    elements, transmissions : E and M.
    seed : of the random numbers, 0 or more.
    parts : (E,) number of the part that each element belongs to, such as its board: the parts emit
        in turn, one in each transmission, and the others can receive while it rings. All emit
        together unless given.

    Returns
    -------
    (E, M) codes of magnitude 1, or 0 where a part is silent.

    Raises
    ------
    InvalidInput
        "out_of_range": of elements, transmissions or seed; "sizes_differ": not one part for each element.

    Examples
    --------
    >>> random_codes(996, 16).shape
    (996, 16)
    """
    shape = _checked(elements, "elements"), _checked(transmissions, "transmissions")
    check_seed(seed)
    codes = np.exp(2j * np.pi * np.random.default_rng(seed).random(shape))
    if parts is None:
        return codes
    if len(parts) != elements:
        raise InvalidInput(
            f"{len(parts)} parts are given for {elements} elements; give one each.",
            code="sizes_differ",
        )
    names = np.unique(parts)
    return np.where(
        np.asarray(parts)[:, None] == names[np.arange(transmissions) % len(names)], codes, 0.0
    )


def _checked(count: int, what: str, most: int = MOST_CODES) -> int:
    if not isinstance(count, int | np.integer) or not 1 <= count <= most:
        raise InvalidInput(
            f"codes need a whole number of {what} from 1 to {most}, not {count!r}.",
            code="out_of_range",
        )
    return int(count)
