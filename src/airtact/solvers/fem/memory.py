"""How much memory a factorisation takes, told before it is taken."""

from airtact.conventions import InvalidInput
from airtact.solvers.fem.meshing.volume import Box
from airtact.solvers.memory import available_memory

TETRAHEDRA = 8.0
"""Tetrahedra that Netgen fills a cube with whose edge is that of the tetrahedra."""

FILL = {"multifrontal": (8, 10.0), "pardiso": (8, 10.0), "sparsecholesky": (16, 14.0)}
"""Bytes of an entry of a factor, and entries over the 4/3 power of the unknowns, as nested dissection leaves them."""

OVERHEAD = 1.5
"""Memory in all over that of the factor's entries."""


def expected_unknowns(box: Box, wavelength: float, order: int, elements_per_wavelength: float) -> float:
    """Unknowns that tetrahedra of a size have in a box with its layer.

    Parameters
    ----------
    box : what is meshed.
    wavelength : [m].
    order, elements_per_wavelength : as of ``FiniteElement``.
    """
    volume = float((box.outer_high - box.outer_low).prod()) / wavelength**3
    return TETRAHEDRA * volume * elements_per_wavelength**3 * order**3 / 6


def check_memory(box: Box, wavelength: float, order: int, elements_per_wavelength: float, method: str) -> float:
    """Bytes that a factorisation is expected to take.

    Parameters
    ----------
    box, wavelength, order, elements_per_wavelength : as of ``expected_unknowns``.
    method : how it is factorised.

    Raises
    ------
    InvalidInput
        When the machine does not have them.
    """
    unknowns = expected_unknowns(box, wavelength, order, elements_per_wavelength)
    each, fill = FILL[method]
    size, free = OVERHEAD * each * fill * unknowns ** (4 / 3), available_memory()
    if size > 0.9 * free:
        raise InvalidInput(
            f"finite elements of order {order} need some {unknowns:.2g} unknowns and {size / 2**30:.1f} GiB for a box "
            f"of {(box.high - box.low).prod() / wavelength**3:.0f} cubic wavelengths, but {free / 2**30:.1f} GiB of "
            "memory are free; take BoundaryElement, a lower order for a preview, or fewer bodies."
        )
    return size
