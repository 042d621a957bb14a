"""What an SVG drawing holds, counted before a reader expands it: parts that are used again count again."""

import io
import re
from xml.etree import ElementTree

from airtact.checks import counted
from airtact.errors import MOST_CURVES, InvalidInput

MOST_LEVELS = 64
"""Elements of a drawing within each other."""

NUMBER = re.compile(r"(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")

NUMBERS_OF_A_CURVE = 6
"""So many numbers, or one element, count as one curve."""

LINKS = ("href", "{http://www.w3.org/1999/xlink}href")
"""Attributes that name what is used again; where both stand the first one counts."""


def check_path(words: str, name: str) -> None:
    """Raise "too_many" where the text of a path has more than ``MOST_CURVES`` curves."""
    _check(len(NUMBER.findall(words)), name)


def check_drawing(raw: bytes, name: str) -> None:
    """Raise "too_many", "file_too_large" or "file_unreadable" for a drawing beyond the limits.

    Parameters
    ----------
    raw : the SVG file.
    name : of the file, for the sentence.
    """
    level, root = 0, None
    try:
        for event, element in ElementTree.iterparse(io.BytesIO(raw), events=("start", "end")):
            level += 1 if event == "start" else -1
            root = element if root is None else root
            if level > MOST_LEVELS:
                sentence = f"{name} has elements more than {MOST_LEVELS} levels deep in each other."
                raise InvalidInput(sentence, code="file_too_large")
    except InvalidInput:
        raise
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise InvalidInput(f"{name} is not SVG: {error}.", code="file_unreadable") from None
    if root is not None:
        by_name = {
            element.attrib["id"]: element for element in root.iter() if "id" in element.attrib
        }
        _check(_numbers(root, by_name, {}, MOST_LEVELS, name), name)


def _check(numbers: int, name: str) -> None:
    curves = numbers // NUMBERS_OF_A_CURVE
    if curves > MOST_CURVES:
        count = counted(curves, "curve", "curves")
        raise InvalidInput(
            f"{name} has some {count}, more than {MOST_CURVES:,}; simplify the drawing.",
            code="too_many",
        )


def _numbers(
    element: ElementTree.Element,
    by_name: dict[str, ElementTree.Element],
    known: dict[ElementTree.Element, int],
    levels: int,
    name: str,
) -> int:
    """Count the numbers in an element and all that it holds and uses, ``levels`` deep at most."""
    if element in known:
        return known[element]
    if levels == 0:
        raise InvalidInput(
            f"{name} uses elements more than {MOST_LEVELS} levels deep.", code="file_too_large"
        )
    inside = list(element)
    if element.tag.rpartition("}")[2] == "use":
        link = next((element.attrib[key] for key in LINKS if key in element.attrib), "")
        inside += [by_name[link[1:]]] if link[1:] in by_name else []
    own = [words for key, words in element.attrib.items() if key not in LINKS]
    found = NUMBERS_OF_A_CURVE + sum(len(NUMBER.findall(words)) for words in own)
    found += sum(_numbers(one, by_name, known, levels - 1, name) for one in inside)
    known[element] = found
    return found
