"""Which keys of a table may stand together."""

from airtact.conventions import InvalidInput
from airtact.scene_file.tables import Table


def one_of(table: Table, names: tuple[str, ...]) -> str:
    """Return the one key that is given of some that exclude each other.

    Parameters
    ----------
    table : of the file.
    names : the keys.

    Raises
    ------
    InvalidInput
        If none or several are given (how many).
    """
    given = [name for name in names if getattr(table, name) is not None]
    if len(given) != 1:
        raise InvalidInput(f"give exactly one of {', '.join(names)}; {len(given)} given.")
    return given[0]


def goes_with(table: Table, key: str, owner: str, fits: bool) -> None:
    """Refuse a key that makes no sense without another (``InvalidInput``: which it goes with).

    Parameters
    ----------
    table : of the file.
    key : that is given or not.
    owner : what it goes with, for the sentence.
    fits : whether that is there.
    """
    if getattr(table, key) is not None and not fits:
        raise InvalidInput(f"{key} goes only with {owner}.")
