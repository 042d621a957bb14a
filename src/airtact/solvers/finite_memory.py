"""How much memory a factorisation takes, told before it is taken."""

from airtact.conventions import InvalidInput
from airtact.solvers.finite_volume import Box
from airtact.solvers.free_memory import available_memory

TETRAHEDRA = 8.0
"""Tetrahedra that Netgen fills a cube with whose edge is that of the tetrahedra."""

FILL = 14.0
"""Entries of a factor over the 4/3 power of the unknowns: nested dissection of a mesh in space."""

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


def refuse_too_large(box: Box, wavelength: float, order: int, elements_per_wavelength: float) -> float:
    """Bytes that a factorisation is expected to take.

    Raises
    ------
    InvalidInput
        When the machine does not have them.
    """
    unknowns = expected_unknowns(box, wavelength, order, elements_per_wavelength)
    size, free = OVERHEAD * 16 * FILL * unknowns ** (4 / 3), available_memory()
    if size > 0.9 * free:
        raise InvalidInput(
            f"finite elements of order {order} need some {unknowns:.2g} unknowns and {size / 2**30:.1f} GiB for a box "
            f"of {(box.high - box.low).prod() / wavelength**3:.0f} cubic wavelengths, but {free / 2**30:.1f} GiB of "
            "memory are free; take BoundaryElement, a lower order for a preview, or fewer bodies."
        )
    return size
