"""The scenes, hands and scan that come with airtact."""

import difflib
from pathlib import Path

from airtact.errors import InvalidInput, of_kind, path_of

ENDINGS = (".csv", ".glb", ".json", ".jsonl", ".ply", ".toml")


def example(name: str, endings: tuple[str, ...] = ENDINGS) -> Path:
    """Return the path of an example file that is included in airtact.

    Functions that read files, such as ``read_scene`` and ``load_hand``, accept this path.

    Parameters
    ----------
    name : name of a scene file, with or without ".toml", such as "pinch"; or of another file
        including its ending, such as "relaxed.json".
    endings : endings of the files that are searched; by default, those of all examples.

    Returns
    -------
    The ``Path`` of the installed file.

    Raises
    ------
    InvalidInput
        If no example has this name. The message lists all names.

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
    path = files.get(
        of_kind(name, str, "the name of an example", 'one such as "pinch"').removesuffix(".toml")
    )
    if path is None:
        close = difflib.get_close_matches(name, files, 1)
        meant = f"; did you mean {close[0]}?" if close else "."
        raise InvalidInput(
            f"{name!r} is not one of the examples: {', '.join(sorted(files))}{meant}",
            code="unknown_name",
        )
    return path


def file_or_example(path: str | Path, endings: tuple[str, ...] = ENDINGS) -> Path:
    """Return the path of a file or, if it does not exist, of the example with the same name.

    A path that contains a folder never refers to an example. The function raises ``InvalidInput``
    if neither the file nor the example exists.
    """
    file = path_of(path, "the path")
    if file.exists() or file.name != str(path):
        return file
    try:
        return example(file.name, endings)
    except InvalidInput as fault:
        if file.suffix:
            return file  # whatever reads it reports that it is missing
        raise InvalidInput(f"there is no file {file} here, and {fault}", code=fault.code) from None
