"""Assert that bad input raises the fault of one kind, with the values that are wrong in its sentence."""

import re
import resource
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from airtact.errors import InvalidInput, NotConverged


def facts(text: str) -> list[str]:
    """Numbers, keys, names of files and quoted values in a text; its wording may change."""
    words = (word.strip(".,;:()?") for word in text.split())
    return [word for word in words if re.search(r"[\d_\[\]=]|^['\"]|\w\.\w", word)]


@contextmanager
def raises_code(
    code: str, *texts: str
) -> Iterator[pytest.ExceptionInfo[InvalidInput | NotConverged]]:
    """Expect ``InvalidInput`` or ``NotConverged`` with a code, and the facts of some texts in the sentence."""
    with pytest.raises((InvalidInput, NotConverged)) as caught:
        yield caught
    assert caught.value.code == code, str(caught.value)
    sentence = str(caught.value)
    assert [fact for text in texts for fact in facts(text) if fact not in sentence] == [], sentence


@contextmanager
def full_disk(room: int):
    """Let no file grow over a number of bytes, as on a disk with this much room."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
