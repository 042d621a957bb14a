"""Conventions of all packages (time sign, units, array axes), the error types and shared limits.

- Phasor p(t) = Re[P e^{-iωt}]; an outgoing wave is e^{+ikr}/r.
- SI units: metre, hertz, pascal, radian. Amplitudes are peak values unless a name ends in ``_rms``.
- Points are (N, 3) float64. Matrices: rows are receivers, columns are sources.
- A monopole of strength s [Pa·m] in open air gives p = s e^{ikr}/r.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Real

Vector = Real[np.ndarray, "3"] | tuple[float | int, float | int, float | int]
"""One point or direction: an array of three numbers or a tuple of three."""

LONGEST_SENTENCE = 450
"""Largest length of a message [characters]; with code and prefix a line of the terminal has 500."""

LARGEST_SCENE_FILE = 4_000_000
"""Largest size of a scene file [bytes]."""

LARGEST_NUMBER = 1e12
"""Largest magnitude of a number in a scene file or table."""

SMALLEST_NUMBER = 1e-60
"""Smallest magnitude of a number in a scene file other than 0."""

MOST_POINTS = 4096
"""Largest number of points of a shape, and of foci and suppression points of a scene by default."""

LARGEST_MESH_FILE = 100_000_000
"""Largest size of a surface's file together with the files that it names [bytes]."""

LARGEST_DATA = 2**28
"""Largest size of a file of numbers, and of its arrays unpacked [bytes]."""


def one_sentence(text: str) -> str:
    r"""Write a message on one line of ``LONGEST_SENTENCE`` printable characters at most.

    Examples
    --------
    >>> one_sentence("two\nlines"), len(one_sentence("x" * 100_000))
    ('two\\nlines', 450)
    """
    escaped = "".join(
        character if character.isprintable() else character.encode("unicode_escape").decode()
        for character in _shortened(text)
    )
    return _shortened(escaped)


def _shortened(text: str) -> str:
    """Leave out the middle of a text that is too long."""
    if len(text) <= LONGEST_SENTENCE:
        return text
    head = 2 * LONGEST_SENTENCE // 3
    tail = LONGEST_SENTENCE - head - 5
    return f"{text[:head]} ... {text[-tail:]}"


class InvalidInput(ValueError):  # noqa: N818 (reads well in a traceback)
    """The input is at fault; the message says what is wrong, where, and what to do.

    Attributes
    ----------
    position : (3,) where the fault is [m], so that it can be drawn; None if it is at no one point.
    code : kind of fault, such as "inside_body". It stays when the message changes;
        ``docs/errors.md`` lists all.
    """

    def __init__(
        self, sentence: str, position: Real[np.ndarray, "3"] | None = None, *, code: str
    ) -> None:
        super().__init__(one_sentence(sentence))
        self.position = position
        self.code = code

    def __reduce__(self) -> Any:
        """Pickle the keyword ``code`` too, so that processes can pass the error on."""
        return partial(type(self), code=self.code), (str(self), self.position)


class NotConverged(RuntimeError):  # noqa: N818
    """A solver stopped before its tolerance; the message has residual, iterations and likely cause.

    Attributes
    ----------
    code : kind of fault, as in ``InvalidInput``.
    """

    def __init__(self, sentence: str, *, code: str) -> None:
        super().__init__(one_sentence(sentence))
        self.code = code


@contextmanager
def about(name: str) -> Iterator[None]:
    """Prefix the message of any ``InvalidInput`` raised inside with the name of a file or table.

    Examples
    --------
    >>> with about("hand.stl"):
    ...     raise InvalidInput("it holds no triangles.", code="empty")
    Traceback (most recent call last):
    ...
    airtact.errors.InvalidInput: hand.stl: it holds no triangles.
    """
    try:
        yield
    except InvalidInput as fault:
        raise InvalidInput(f"{name}: {fault}", fault.position, code=fault.code) from None


@contextmanager
def extra(name: str, need: str) -> Iterator[None]:
    """Raise "extra_missing", with what to install, where an import inside fails.

    Parameters
    ----------
    name : of the extra, as in ``airtact[fem]``.
    need : who needs what, such as "finite elements need NGSolve".
    """
    try:
        yield
    except (ImportError, OSError) as fault:
        raise InvalidInput(
            f"{need}, which does not load ({fault}): pip install 'airtact[{name}]'.",
            code="extra_missing",
        ) from None
