"""The ways to boards, in one table: the name of each link, the boards that it goes to, what it needs, how it opens."""

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

Setting = Literal["address", "port", "out"]
"""What a command can give a link: a network address (interface, AMS net id or host:port), a serial port, a file."""


@dataclass(frozen=True)
class LinkKind:
    """One way to boards.

    Attributes
    ----------
    name : what commands call it.
    boards : names of the kinds of boards that it goes to.
    make : builds the link, not open yet, for a kind of board, their poses, the speed of sound [m/s]
        and its setting.
    takes : the setting that it takes, if any.
    example : a value of that setting where the link needs one; empty where it is optional.
    """

    name: str
    boards: tuple[str, ...]
    make: Callable[[str, Sequence[Pose], float, str | None], Link]
    takes: Setting | None = None
    example: str = ""


def _autd3(name: str) -> LinkKind:
    def make(_board: str, poses: Sequence[Pose], sound_speed: float, address: str | None) -> Link:
        return AUTD3Link(poses, name, address, sound_speed)

    example = "127.0.0.1:8080" if name in ("remote", "simulator") else ""
    return LinkKind(name, ("autd3",), make, None if name == "audit" else "address", example)


def _serial(board: str, poses: Sequence[Pose], _sound_speed: float, port: str | None) -> Link:
    return SerialLink(str(port), board, len(poses))


def _file(board: str, poses: Sequence[Pose], _sound_speed: float, out: str | None) -> Link:
    return FileLink(str(out), board, len(poses))


LINKS = (
    *(_autd3(name) for name in THROUGH),
    LinkKind("serial", ("sonicsurface", "nano16"), _serial, "port", "/dev/ttyUSB0"),
    LinkKind("file", tuple(BOARDS), _file, "out", "frames.npz"),
)
"""All links, in the order in which they are listed."""


def links_of(board: str) -> Sequence[str]:
    """Return the names of the links that go to a kind of board."""
    return [link.name for link in LINKS if board in link.boards]


def link_to(
    name: str, board: str, poses: Sequence[Pose], sound_speed: float, **settings: str | Path | None
) -> Link:
    """Build a link by its name, which is not open yet; of ``settings``, by the names in ``Setting``, it takes one.

    Raises
    ------
    InvalidInput
        "unknown_name", "key_missing", or "options_clash".
    """
    kind = next((link for link in LINKS if link.name == name and board in link.boards), None)
    if kind is None:
        there = links_of(board)
        raise InvalidInput(
            f"{board} has no {name!r} link, it has {len(there)}: {', '.join(there)}.",
            code="unknown_name",
        )
    for setting, value in settings.items():
        if value is not None and setting != kind.takes:
            raise InvalidInput(
                f"--{setting} {value} does not go with the {name} link: leave it out.",
                code="options_clash",
            )
    given = settings.get(kind.takes or "")
    if kind.example and given is None:
        raise InvalidInput(
            f"the {name} link needs --{kind.takes}, such as {kind.example}; 0 are given.",
            code="key_missing",
        )
    return kind.make(board, poses, sound_speed, None if given is None else str(given))
