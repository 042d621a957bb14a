"""Well-known arrays by name, taken from simulations in Ultraino (MIT; see ``layouts/LICENSE``)."""

from pathlib import Path

import numpy as np

from airtact.errors import check_choice
from airtact.transducers.element import Element
from airtact.transducers.layout import PhasedArray

KNOWN_ARRAYS = ("tinylev", "biglev", "flat_8x8", "opposed_sonicsurfaces")


def known_array(name: str, element: Element | None = None) -> PhasedArray:
    """Return a well-known array, centred on the origin with its axis along y.

    Parameters
    ----------
    name : "tinylev" or "biglev" for two caps of 36 transducers each; "flat_8x8" for 64
        transducers in the plane y = 0; "opposed_sonicsurfaces" for two boards of 256
        transducers.
    element : kind of transducer; by default, a piston with a radius of 4.5 mm.

    Raises
    ------
    InvalidInput
        If there is no such array.

    Examples
    --------
    >>> known_array("tinylev")
    PhasedArray(72 elements, pistons of 4.5 mm, 60 x 118.2 x 60 mm)
    """
    check_choice(name, "the array", KNOWN_ARRAYS)
    file = Path(__file__).with_name("layouts") / f"{name}.csv"
    table = np.loadtxt(file, delimiter=",", skiprows=1)
    return PhasedArray(table[:, :3], table[:, 3:], element)
