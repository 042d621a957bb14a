"""One table says which links there are, to which boards, and what each needs."""

import pytest

import airtact as at
from airtact.emission.links import LINKS, link_to, links_of
from faults import raises_code

ADDRESS = {"address": "127.0.0.1:8080"}
SETTINGS = {
    "remote": ADDRESS,
    "simulator": ADDRESS,
    "serial": {"port": "/dev/ttyUSB0"},
}


def test_links_are_listed_by_board() -> None:
    assert links_of("autd3") == [
        "udp",
        "audit",
        "ethercrab",
        "twincat",
        "remote",
        "simulator",
        "file",
    ]
    assert links_of("sonicsurface") == links_of("nano16") == ["serial", "file"]
    assert links_of("openmpd") == ["file"]


@pytest.mark.parametrize(
    ("link", "board"), [(link, board) for link, boards in LINKS.items() for board in boards]
)
def test_every_link_is_built_under_its_own_name(link, board) -> None:
    made = link_to(link, board, (at.Pose.identity(),), 343.0, **SETTINGS.get(link, {}))
    assert (made.name, made.codec.board.name, made.boards) == (link, board, 1)


@pytest.mark.parametrize(
    ("name", "board", "setting", "code"),
    [
        ("serial", "autd3", {}, "unknown_name"),
        ("fax", "autd3", {}, "unknown_name"),
        ("audit", "autd3", {"port": "x"}, "options_clash"),
        ("file", "autd3", {}, "unknown_name"),
        ("serial", "nano16", {}, "key_missing"),
        ("remote", "autd3", {}, "key_missing"),
    ],
)
def test_a_link_that_cannot_be_is_rejected(name, board, setting, code) -> None:
    with raises_code(code):
        link_to(name, board, (at.Pose.identity(),), 343.0, **setting)
