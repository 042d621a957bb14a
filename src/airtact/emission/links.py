"""Table of the links to boards, and a function that creates a link by its name."""

from collections.abc import Sequence

from airtact.emission.autd3_link import THROUGH, AUTD3Link
from airtact.emission.link import Link
from airtact.emission.serial_link import SerialLink
from airtact.emission.udp_link import UDPLink
from airtact.errors import InvalidInput
from airtact.geometry.pose import Pose

# Links of each board, in display order.
LINKS: dict[str, tuple[str, ...]] = {
    "udp": ("autd3",),
    **dict.fromkeys(THROUGH, ("autd3",)),
    "serial": ("sonicsurface", "nano16"),
}


def links_of(board: str) -> Sequence[str]:
    """Return the names of the links to a kind of board, and "file", which only writes a file."""
    return [*(name for name, boards in LINKS.items() if board in boards), "file"]


def link_to(
    name: str, board: str, poses: Sequence[Pose], sound_speed: float, **settings: str | None
) -> Link:
    """Create a link by its name, without opening it.

    ``settings`` are the ``address`` of AUTD3 boards (interface, AMS net id, host:port or
    "emulator") or the ``port`` of a serial link.

    Raises
    ------
    InvalidInput
        If this kind of board has no such link, or if a setting is missing or does not apply.
    """
    if board not in LINKS.get(name, ()):
        raise InvalidInput(
            f"{board} boards have no {name!r} link; their links are "
            f"{', '.join(links_of(board)[:-1])}. To write their frames to a file, use airtact emit "
            "--link file.",
            code="unknown_name",
        )
    key = {"serial": "port", "audit": ""}.get(name, "address")
    for setting, value in settings.items():
        if value is not None and setting != key:
            raise InvalidInput(
                f"--{setting} {value} cannot be used with the {name} link: omit it.",
                code="options_clash",
            )
    if name == "udp":
        return UDPLink(poses, settings.get(key))
    if name != "serial":
        return AUTD3Link(poses, name, settings.get(key), sound_speed)
    port = settings.get("port")
    if port is None:
        raise InvalidInput(
            "the serial link needs --port, such as /dev/ttyUSB0.", code="key_missing"
        )
    return SerialLink(port, board, len(poses))
