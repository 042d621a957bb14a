"""Assert that bad input raises the fault of one kind, with the numbers that are wrong in its sentence."""

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from airtact.errors import InvalidInput, NotConverged


@contextmanager
def raises_code(
    code: str, *numbers: str
) -> Iterator[pytest.ExceptionInfo[InvalidInput | NotConverged]]:
    """Expect ``InvalidInput`` or ``NotConverged`` with a code, and some texts, mostly numbers, in the sentence."""
    with pytest.raises((InvalidInput, NotConverged)) as caught:
        yield caught
    assert caught.value.code == code, str(caught.value)
    assert [text for text in numbers if text not in str(caught.value)] == [], str(caught.value)
