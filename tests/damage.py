"""Random damage to files, the same for the same seed, and what reading them may end in."""

import io
import random
import re
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from airtact.errors import LONGEST_SENTENCE, InvalidInput

NUMBER = re.compile(rb"-?\d[\d.]*(?:e[-+]?\d+)?")
NUMBERS = (
    b"0",
    b"-1",
    b"1e300",
    b"-1e-300",
    b"1e400",
    b"nan",
    b"-inf",
    b"4294967296",
    b"9" * 300,
    b"9" * 5000,
    b"x",
    b"",
)
BYTES = (
    b"",
    b"\x00",
    b"\xff\xff\xff\xff",
    b"\n",
    b",",
    b" ",
    b"[" * 3000,
    b'"',
    b"{",
    b"\x00\x00\x80\x7f",
    b"\r",
    b"<a>",
)


def seeds(fast: int, slow: int, *found: int) -> list:
    """List the seeds of a fuzz test, ten in a test: the first ones and those that found a fault; others are slow."""
    first, others = (
        [*range(fast), *found],
        [seed for seed in range(fast, slow) if seed not in found],
    )
    return [
        *(pytest.param(batch, id=_id(batch)) for batch in batched(first, 10)),
        *(
            pytest.param(batch, id=_id(batch), marks=pytest.mark.slow)
            for batch in batched(others, 100)
        ),
    ]


def batched(seeds: list[int], size: int) -> list[list[int]]:
    return [seeds[start : start + size] for start in range(0, len(seeds), size)]


def _id(batch: list[int]) -> str:
    return f"{batch[0]}-{batch[-1]}"


def damaged(raw: bytes, draw: random.Random) -> bytes:
    """Change one to four numbers, lines or bytes of a file, leave out a part or double one; or inside an archive."""
    if raw.startswith(b"PK") and draw.random() < 0.7:
        return _damaged_archive(raw, draw)
    kinds = 2 if draw.random() < 0.4 else 7  # numbers only keep the form of the file
    for _ in range(draw.randint(1, 4)):
        kind, place = draw.randrange(kinds), draw.randrange(max(len(raw), 1))
        numbers = list(NUMBER.finditer(raw[:200_000])) if kind < 2 else []
        lines = raw.split(b"\n") if kind in (2, 3) else []
        if kind < 2 and numbers:
            one = draw.choice(numbers)
            raw = raw[: one.start()] + draw.choice(NUMBERS) + raw[one.end() :]
        elif kind == 2 and len(lines) > 1:
            lines.insert(draw.randrange(len(lines)), draw.choice(lines))
            raw = b"\n".join(lines)
        elif kind == 3 and len(lines) > 1:
            del lines[draw.randrange(len(lines))]
            raw = b"\n".join(lines)
        elif kind == 4:
            raw = raw[:place] + bytes([draw.randrange(256)]) + raw[place + 1 :]
        elif kind == 5:
            raw = raw[:place] + draw.choice(BYTES) + raw[place + draw.choice((0, 1, 4)) :]
        else:
            raw = draw.choice(
                (raw[:place], raw[:place] + raw[place + draw.randrange(100) :], raw + raw[place:])
            )
    return raw


def _damaged_archive(raw: bytes, draw: random.Random) -> bytes:
    whole = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(raw)) as old, zipfile.ZipFile(whole, "w") as new:
        names = old.namelist()
        chosen = draw.choice(names)
        for name in names:
            part = old.read(name)
            new.writestr(name, damaged(part, draw) if name == chosen else part)
    return whole.getvalue()


def read_or_rejected(read: Callable[[Path], object], path: Path, raw: bytes) -> None:
    """Assert that a file of these bytes is read, or rejected in one short line; warnings are errors in the tests."""
    path.write_bytes(raw)
    try:
        read(path)
    except InvalidInput as fault:
        sentence = str(fault)
    else:
        return
    assert sentence.isprintable()
    assert len(sentence) <= LONGEST_SENTENCE
