"""Table of the links to boards: name, boards, setting and constructor of each link."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from airtact.emission.autd3_link import THROUGH, AUTD3Link
from airtact.emission.file_link import FileLink
from airtact.emission.link import Link
from airtact.emission.serial_link import SerialLink
from airtact.errors import InvalidInput
from airtact.geometry.pose import Pose
from airtact.transducers.boards import BOARDS

# Setting of a link: network address (interface, AMS net id or host:port), serial port or file.
Setting = Literal["address", "port", "out"]


@dataclass(frozen=True)
class LinkKind:
    """A kind of link to boards.

    Attributes
    ----------
    name : name in commands.
    boards : names of the supported kinds of boards.
    make : builds the link, not open yet, from the kind of board, the poses, the speed of sound
        [m/s] and the setting.
    takes : its setting, if any.
    example : example of a required setting; empty if the setting is optional.
    """

    name: str
    boards: tuple[str, ...]
    make: Callable[[str, Sequence[Pose], float, str | None], Link]
    takes: Setting | None = None
    example: str = ""


def _autd3(name: str) -> LinkKind:
    return LinkKind(
        name,
        ("autd3",),
        lambda _board, poses, sound_speed, address: AUTD3Link(poses, name, address, sound_speed),
        None if name == "audit" else "address",
        "127.0.0.1:8080" if name in ("remote", "simulator") else "",
    )


# All links, in display order.
LINKS = (
    *(_autd3(name) for name in THROUGH),
    LinkKind(
        "serial",
        ("sonicsurface", "nano16"),
        lambda board, poses, _sound_speed, port: SerialLink(str(port), board, len(poses)),
        "port",
        "/dev/ttyUSB0",
    ),
    LinkKind(
        "file",
        tuple(BOARDS),
        lambda board, poses, _sound_speed, out: FileLink(str(out), board, len(poses)),
        "out",
        "frames.npz",
    ),
)


def links_of(board: str) -> Sequence[str]:
    """Return the names of the links for a kind of board."""
    return [link.name for link in LINKS if board in link.boards]


def link_to(
    name: str, board: str, poses: Sequence[Pose], sound_speed: float, **settings: str | Path | None
) -> Link:
    """Build a link by its name, not open yet; the names of ``settings`` are those of ``Setting``.

    Raises
    ------
    InvalidInput
        "unknown_name", "key_missing", or "options_clash".
    """
    kind = next((link for link in LINKS if link.name == name and board in link.boards), None)
    if kind is None:
        raise InvalidInput(
            f"{board} has no {name!r} link; it has {', '.join(links_of(board))}.",
            code="unknown_name",
        )
    for setting, value in settings.items():
        if value is not None and setting != kind.takes:
            raise InvalidInput(
                f"--{setting} {value} does not go with the {name} link: leave it out.",
                code="options_clash",
            )
    value = settings.get(kind.takes or "")
    if kind.example and value is None:
        raise InvalidInput(
            f"the {name} link needs --{kind.takes}, such as {kind.example}.", code="key_missing"
        )
    return kind.make(board, poses, sound_speed, None if value is None else str(value))
