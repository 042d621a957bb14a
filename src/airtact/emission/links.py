"""Table of the links to boards, and their constructor by name."""

from collections.abc import Sequence
from pathlib import Path

from airtact.emission.autd3_link import THROUGH, AUTD3Link
from airtact.emission.file_link import FileLink
from airtact.emission.link import Link
from airtact.emission.serial_link import SerialLink
from airtact.errors import InvalidInput
from airtact.geometry.pose import Pose
from airtact.transducers.boards import BOARDS

# The boards of each link, in display order.
LINKS: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(THROUGH, ("autd3",)),
    "serial": ("sonicsurface", "nano16"),
    "file": tuple(BOARDS),
}


def links_of(board: str) -> Sequence[str]:
    """Return the names of the links for a kind of board."""
    return [name for name, boards in LINKS.items() if board in boards]


def link_to(
    name: str, board: str, poses: Sequence[Pose], sound_speed: float, **settings: str | Path | None
) -> Link:
    """Build a link by its name, not open yet.

    ``settings`` are the ``address`` of AUTD3 boards (interface, AMS net id or host:port), the
    serial ``port``, or the file, ``out``.

    Raises
    ------
    InvalidInput
        "unknown_name", "key_missing", or "options_clash".
    """
    if name not in links_of(board):
        raise InvalidInput(
            f"{board} has no {name!r} link; it has {', '.join(links_of(board))}.",
            code="unknown_name",
        )
    key = {"serial": "port", "file": "out", "audit": ""}.get(name, "address")
    for setting, value in settings.items():
        if value is not None and setting != key:
            raise InvalidInput(
                f"--{setting} {value} does not go with the {name} link: leave it out.",
                code="options_clash",
            )
    value = settings.get(key)
    if key in ("port", "out") and value is None:
        example = "/dev/ttyUSB0" if key == "port" else "frames.h5"
        raise InvalidInput(f"the {name} link needs --{key}, such as {example}.", code="key_missing")
    if name == "serial":
        return SerialLink(str(value), board, len(poses))
    if name == "file":
        return FileLink(str(value), board, len(poses))
    return AUTD3Link(poses, name, None if value is None else str(value), sound_speed)
