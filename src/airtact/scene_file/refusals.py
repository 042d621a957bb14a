"""What a refusal is about, put in front of its sentence."""

from collections.abc import Iterator
from contextlib import contextmanager

from airtact.conventions import InvalidInput


@contextmanager
def about(what: str) -> Iterator[None]:
    """Put what a refusal is about in front of any sentence from inside, and keep the place of the fault.

    Parameters
    ----------
    what : the name of a file or a table.

    Examples
    --------
    >>> with about("hand.stl"):
    ...     raise InvalidInput("0 triangles were read.")
    Traceback (most recent call last):
    ...
    airtact.conventions.InvalidInput: hand.stl: 0 triangles were read.
    """
    try:
        yield
    except InvalidInput as fault:
        raise InvalidInput(f"{what}: {fault}", fault.place) from None
