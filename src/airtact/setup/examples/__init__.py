"""The scenes, hands and scan that come with airtact."""

import difflib
from pathlib import Path

from airtact.errors import InvalidInput

ENDINGS = (".csv", ".glb", ".json", ".jsonl", ".ply", ".toml")


def example(name: str, endings: tuple[str, ...] = ENDINGS) -> Path:
    """Return the path of a file that comes with airtact.

    Parameters
    ----------
    name : a scene, such as "pinch", or another file including its ending, such as "relaxed.json".
    endings : accepted file name endings.

    Raises
    ------
    InvalidInput
        If no example has this name; the message lists all names.

    Examples
    --------
    >>> example("pinch").name
    'pinch.toml'
    """
    files = {
        path.stem if path.suffix == ".toml" else path.name: path
        for path in sorted(Path(__file__).parent.rglob("*"))
        if path.suffix in endings
    }
    path = files.get(name.removesuffix(".toml"))
    if path is None:
        close = difflib.get_close_matches(name, files, 1)
        meant = f"; did you mean {close[0]}?" if close else "."
        raise InvalidInput(
            f"{name!r} is not one of the examples: {', '.join(sorted(files))}{meant}",
            code="unknown_name",
        )
    return path


def file_or_example(path: str | Path, endings: tuple[str, ...] = ENDINGS) -> Path:
    """Return a path, or the path of the example with that name if there is no such file.

    A path with a folder is never an example. See ``example`` for the errors.
    """
    file = Path(path)
    if file.exists() or file.name != str(path):
        return file
    try:
        return example(file.name, endings)
    except InvalidInput as fault:
        if file.suffix:
            return file  # the reader reports that it is missing
        raise InvalidInput(f"there is no file {file} here, and {fault}", code=fault.code) from None
