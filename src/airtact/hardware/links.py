"""The ways to boards, in one table: the name of each link, the boards that it goes to, what it needs, how it opens."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from airtact.conventions import InvalidInput
from airtact.hardware.autd3_link import AUTD3Link
from airtact.hardware.file_link import FileLink
from airtact.hardware.link import Link
from airtact.hardware.serial_link import SerialLink
from airtact.pose import Pose
from airtact.transducers.boards import BOARDS

Setting = Literal["address", "port", "out"]
"""What a command can give a link: a network address, a serial port, a file."""


@dataclass(frozen=True)
class Connection:
    """What a link is opened with.

    Attributes
    ----------
    board : name of the kind of board.
    poses : pose of each board, from the board's frame to the array's.
    sound_speed : of the medium [m/s].
    address : interface, AMS net id or host:port, for AUTD3.
    port : serial port.
    out : file.
    """

    board: str
    poses: tuple[Pose, ...]
    sound_speed: float
    address: str | None = None
    port: str | None = None
    out: Path | None = None


@dataclass(frozen=True)
class LinkKind:
    """One way to boards.

    Attributes
    ----------
    name : what commands call it.
    boards : names of the kinds of boards that it goes to.
    make : builds the link, which is not open yet.
    takes : the setting that it takes, if any.
    example : a value of that setting where the link needs one; empty where it is optional.
    extra : what pip installs for it, as in ``airtact[autd3]``; None where nothing is needed.
    """

    name: str
    boards: tuple[str, ...]
    make: Callable[[Connection], Link]
    takes: Setting | None = None
    example: str = ""
    extra: str | None = None


def _autd3(name: str, takes: Setting | None = None, example: str = "") -> LinkKind:
    def make(to: Connection) -> Link:
        return AUTD3Link(to.poses, name, to.address, to.sound_speed)

    return LinkKind(name, ("autd3",), make, takes, example, extra="autd3")


LINKS = (
    _autd3("audit"),
    _autd3("ethercrab", "address"),
    _autd3("twincat", "address"),
    _autd3("remote", "address", "127.0.0.1:8080"),
    _autd3("simulator", "address", "127.0.0.1:8080"),
    LinkKind(
        "serial",
        ("sonicsurface", "nano16"),
        lambda to: SerialLink(str(to.port), to.board, len(to.poses)),
        "port",
        "/dev/ttyUSB0",
        extra="serial",
    ),
    LinkKind("file", tuple(BOARDS), lambda to: FileLink(to.out or "", to.board, len(to.poses)), "out", "frames.npz"),
)
"""All links, in the order in which they are listed."""


def links_of(board: str) -> Sequence[str]:
    """Return the names of the links that go to a kind of board."""
    return [link.name for link in LINKS if board in link.boards]


def link_to(name: str, to: Connection) -> Link:
    """Build a link by its name; it is not open yet.

    Raises
    ------
    InvalidInput
        No link of that name goes to the boards, a setting that it needs is missing, or one is given that it does not
        take.
    """
    found = [link for link in LINKS if link.name == name and to.board in link.boards]
    if not found:
        there = links_of(to.board)
        raise InvalidInput(
            f"{to.board} has no {name!r} link, it has {len(there)}: {', '.join(there)}.", code="unknown_link"
        )
    kind = found[0]
    given = {"address": to.address, "port": to.port, "out": to.out}
    for setting, value in given.items():
        if value is not None and setting != kind.takes:
            raise InvalidInput(
                f"--{setting} {value} does not go with the {name} link: leave it out.", code="setting_not_taken"
            )
    if kind.takes and kind.example and given[kind.takes] is None:
        raise InvalidInput(
            f"the {name} link needs --{kind.takes}, such as {kind.example}; 0 are given.", code="setting_missing"
        )
    return kind.make(to)
