"""The conventions that every room shares: time sign, units, axis order, array types, limits, errors.

- Phasor p(t) = Re[P e^{-iωt}]; an outgoing wave is e^{+ikr}/r.
- SI units: metre, hertz, pascal, radian. Amplitudes are peak values unless a name ends in ``_rms``.
- Points are (N, 3) float64. Matrices: the first axis is the receiver, the second axis the source.
- A monopole of strength s [Pa·m] alone in open air gives p = s e^{ikr}/r.
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
"""Largest length of the sentence of a fault or a warning [characters]; the middle of a longer one is left out.

With its code and what stands before it a line of the command line has 500 at most.
"""

LARGEST_SCENE_FILE = 4_000_000
"""Largest size of a scene file [bytes]."""

MOST_LEVELS = 32
"""Largest number of lists and tables in each other in a scene file, and of parts of a key between dots."""

MOST_DIGITS = 100
"""Largest length of a number in a scene file [characters]."""

LARGEST_NUMBER, SMALLEST_NUMBER = 1e12, 1e-60
"""Largest and smallest magnitude of a number in a scene file; 0 is allowed too."""

MOST_POINTS = 4096
"""Largest number of points of a shape, and of foci and suppression points of a scene unless ``most_points`` is given.

With more, a unit is probably wrong.
"""

MOST_BODIES = 256
"""Largest number of obstacles in a scene file."""

MOST_TRIANGLES = 2_000_000
"""Largest number of triangles of a sphere or a capsule; with more, a unit is probably wrong."""

LARGEST_MESH_FILE = 100_000_000
"""Largest size of a file of a surface with all that it names [bytes]."""

MOST_FILE_TRIANGLES = 250_000
"""Largest number of triangles of a surface from a file: reading and checking so many takes some 10 s and 0.9 GB."""

MOST_MESH_LINES = 2_500_000
"""Largest number of lines of a file of a surface in text: an STL of ``MOST_FILE_TRIANGLES`` has 1,750,000."""

MOST_NODES = 2048
"""Largest number of nodes, meshes, or pieces of a surface in a file; a node has fewer than 256 above it."""

LARGEST_DATA = 2**28
"""Largest size of a file of numbers, such as a recording, a drive or a cloud, and of its arrays unpacked [bytes]."""

LARGEST_TEXT = 2**26
"""Largest size of a file of text, such as a table or a drawing [bytes]."""

LARGEST_POSE = 1_000_000
"""Largest size of a JSON file of a pose [bytes]."""

MOST_COLUMNS, MOST_CELLS = 1024, 4_000_000
"""Largest number of columns and of cells of a table."""

LARGEST_DRAWING = 4_000_000
"""Largest size of an SVG drawing [bytes]."""

MOST_CURVES = 5_000
"""Largest number of straight and curved parts of a drawing, each as often as it is used."""

MOST_PIXELS = 16_777_216
"""Largest number of pixels of a picture, counted before it is decoded."""


def one_sentence(words: str) -> str:
    r"""Write words on one line of ``LONGEST_SENTENCE`` characters at most, without characters that no screen shows.

    Examples
    --------
    >>> one_sentence("two\nlines"), len(one_sentence("x" * 100_000))
    ('two\\nlines', 450)
    """
    short = _cut(words)  # so that no more than this is escaped
    return _cut(
        "".join(
            one if one.isprintable() else one.encode("unicode_escape").decode() for one in short
        )
    )


def _cut(words: str) -> str:
    if len(words) <= LONGEST_SENTENCE:
        return words
    gap = " ... "
    first = 2 * LONGEST_SENTENCE // 3
    return words[:first] + gap + words[len(words) - (LONGEST_SENTENCE - first - len(gap)) :]


class InvalidInput(ValueError):  # noqa: N818 (reads as what it is in a traceback)
    """The input is at fault; the message is one sentence with the number that is wrong and what to change.

    Attributes
    ----------
    position : (3,) where the fault is [m], as far as one point can say, so that it can be drawn; or
        None.
    code : a short name of the kind of fault, such as "inside_body", which stays when the
        sentence changes.
    """

    def __init__(
        self, sentence: str, position: Real[np.ndarray, "3"] | None = None, *, code: str
    ) -> None:
        super().__init__(one_sentence(sentence))
        self.position = position
        self.code = code

    def __reduce__(self) -> Any:
        return partial(type(self), code=self.code), (
            str(self),
            self.position,
        )  # so that processes can pass it on


@contextmanager
def about(what: str) -> Iterator[None]:
    """Put the name of a file or a table in front of the sentence of any fault inside; keep its position and code.

    Examples
    --------
    >>> with about("hand.stl"):
    ...     raise InvalidInput("0 triangles were read.", code="empty")
    Traceback (most recent call last):
    ...
    airtact.errors.InvalidInput: hand.stl: 0 triangles were read.
    """
    try:
        yield
    except InvalidInput as fault:
        raise InvalidInput(f"{what}: {fault}", fault.position, code=fault.code) from None


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
        how = f"and that does not load ({fault}): pip install 'airtact[{name}]'."
        raise InvalidInput(f"{need}, {how}", code="extra_missing") from None


class NotConverged(RuntimeError):  # noqa: N818
    """A solver stopped before its tolerance; the message has the residual, the iterations and the likely cause.

    Attributes
    ----------
    code : a short name of the kind of fault, such as "not_converged", which stays when the sentence
        changes.
    """

    def __init__(self, sentence: str, *, code: str) -> None:
        super().__init__(one_sentence(sentence))
        self.code = code
