"""Shipped scenes with random damage: each is read, or rejected in one short sentence, without a warning."""

import random
import re

import pytest

from airtact.setup.building import read_scene
from damage import read_or_rejected, seeds
from paths import EXAMPLES

TEXTS = [
    (EXAMPLES / f"{name}.toml").read_text(encoding="utf-8")
    for name in ("pinch", "air_letters", "suppressed_pinch")
]
NUMBER = re.compile(r"(?<![\w.\"-])-?\d[\d._]*(?:e-?\d+)?(?![\w\"])")
WORD = re.compile(r'"[^"\n]*"')
NUMBERS = (
    "0",
    "-1",
    "1e-300",
    "1e300",
    "-1e300",
    "1e-40",
    "1e9",
    "inf",
    "-inf",
    "nan",
    "9" * 99,
    "9" * 5000,
    "true",
    "[]",
    '"x"',
    "1e-6",
    "100.0",
    "{}",
    "-0.0",
    "1979-05-27",
)
WORDS = (
    '""',
    '"\\u0000"',
    '"a\\nb"',
    f'"{"w" * 30_000}"',
    '"../x.csv"',
    '"x.csv"',
    '"é"',
    "3",
    "[[]]",
    '"none"',
)
DATE = 411  # a date in place of a number


def damaged(seed: int) -> str:
    """Change a shipped scene one to three times: a number, a word, a line, a character, or nesting."""
    draw = random.Random(seed)
    text = draw.choice(TEXTS)
    for _ in range(draw.randint(1, 3)):
        kind = draw.randrange(7)
        found = list((NUMBER if kind < 3 else WORD).finditer(text))
        lines = text.split("\n")
        if kind < 4 and found:
            one = draw.choice(found)
            text = (
                text[: one.start()]
                + draw.choice(NUMBERS if kind < 3 else WORDS)
                + text[one.end() :]
            )
        elif kind == 4:
            lines.insert(draw.randrange(len(lines)), draw.choice(lines))
            text = "\n".join(lines)
        elif kind == 5:
            del lines[draw.randrange(len(lines))]
            text = "\n".join(lines)
        else:
            place = draw.randrange(len(text))
            new = draw.choice(
                ("", "[" * 500, "]", "{a=", '"', "\t", "\x00", "a." * 40, "#", "\ud7ff", "\u2028")
            )
            text = text[:place] + new + text[place + 1 :]
    return text


@pytest.mark.parametrize("batch", seeds(199, 4000, DATE))
def test_a_damaged_scene_is_read_or_rejected_in_one_short_sentence(batch, tmp_path):
    for seed in batch:
        read_or_rejected(read_scene, tmp_path / "scene.toml", damaged(seed).encode())
