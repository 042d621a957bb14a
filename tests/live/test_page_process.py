"""The page serves those who may ask, and never makes the loop wait: with real sockets and a real process."""

import http.client
import os
import signal
import socket
import time
from dataclasses import replace
from urllib.parse import urlsplit
from urllib.request import urlopen

import msgspec
import numpy as np
import pytest
import viser
from websockets.exceptions import InvalidStatus
from websockets.sync.client import ClientConnection, connect

from airtact.live.moment import silent_moment
from airtact.live.page.process import PageProcess
from airtact.live.page.server import path_within, start_server
from faults import raises_code
from live.live_scenes import Loop, one_board


@pytest.fixture(scope="module")
def address():
    server, address = start_server(0, "127.0.0.1")
    yield address
    server.stop()


@pytest.fixture(scope="module")
def open_address():
    """Address of a page that is served to other computers as well."""
    server, address = start_server(0, "0.0.0.0")
    yield address
    server.stop()


def asked(address: str, path: str, **headers: str) -> int:
    port = urlsplit(address).port
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=120)
    connection.putrequest("GET", path, skip_host=True)
    for name, value in ({"Host": f"127.0.0.1:{port}"} | headers).items():
        connection.putheader(name, value.format(port=port))
    connection.endheaders()
    status = connection.getresponse().status
    connection.close()
    return status


def connected(address: str, path: str = "/", origin: str | None = None) -> bool:
    """Try to open a websocket, which closes by itself, as its version is wrong."""
    port = urlsplit(address).port
    origin = None if origin is None else origin.format(port=port)
    url = f"ws://127.0.0.1:{port}{path}"
    try:
        connect(url, origin=origin, subprotocols=["viser-v0"], proxy=None).close()
    except InvalidStatus as turned_away:
        return turned_away.response.status_code != 403
    return True


def test_pages_of_other_sites_are_turned_away(address) -> None:
    assert asked(address, "/") == 200
    assert asked(address, "/", Host="localhost:{port}") == 200
    assert asked(address, "/", Host="localhost:7000") == 200  # through a tunnel
    assert asked(address, "/", Host="evil.example:{port}") == 403  # a name that leads here
    assert connected(address)
    assert connected(address, origin="http://127.0.0.1:{port}")
    for origin in ("http://evil.example", "http://127.0.0.1:1", "null"):
        assert not connected(address, origin=origin)


def test_pages_of_other_sites_cannot_frame_it(address) -> None:
    with urlopen(address) as answer:
        assert answer.headers["Content-Security-Policy"] == "frame-ancestors 'none'"


def test_other_addresses_need_the_token(open_address) -> None:
    path = urlsplit(open_address).path
    assert len(path) > 32
    assert asked(open_address, path) == 200
    assert asked(open_address, path, Host="lab-computer:{port}") == 200
    for wrong in ("/", "/wrong/", "/index.html", path[:-2] + "/", path.lower() + "x"):
        assert asked(open_address, wrong) == 403
        assert not connected(open_address, wrong)
    assert connected(open_address, path)
    assert not connected(open_address, path, origin="http://evil.example")


def test_only_this_computer_is_served_unless_asked_for(address) -> None:
    assert address.startswith("http://127.0.0.1:")
    found = socket.getaddrinfo(socket.gethostname(), None, socket.AF_INET)
    for host in {info[4][0] for info in found} - {"127.0.0.1"}:
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection((host, urlsplit(address).port), timeout=5)


@pytest.mark.parametrize(
    ("path", "host", "origin", "behind"),
    [
        ("/", "localhost:80", None, "/"),
        ("/", "localhost", "http://localhost", "/"),
        ("/", "[::1]:80", None, None),
        ("/", "", None, None),
        ("/", "localhost:80", "http://localhost:81", None),
    ],
)
def test_the_guard_knows_the_names_of_this_computer(path, host, origin, behind) -> None:
    assert path_within(path, host, origin, token=None) == behind


def test_a_taken_port_is_named() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with raises_code("link_in_use", str(port)):
            start_server(port, "127.0.0.1")


def browser_like(address: str) -> ClientConnection:
    """Connect as a browser does; it counts as a page from its first message on."""
    url, version = address.replace("http", "ws"), f"viser-v{viser.__version__}"
    page = connect(url, subprotocols=[version], compression=None, max_size=None, proxy=None)
    camera = {"wxyz": (1.0, 0.0, 0.0, 0.0), "position": (0.0, 0.0, 1.0), "look_at": (0.0, 0.0, 0.0)}
    lens = {"fov": 0.8, "near": 0.01, "far": 10.0, "image_height": 800, "image_width": 1280}
    up = {"up_direction": (0.0, 0.0, 1.0)}
    page.send(msgspec.msgpack.encode({"type": "ViewerCameraMessage", **camera, **lens, **up}))
    return page


@pytest.mark.slow
def test_a_page_that_reads_nothing_leaves_the_others_in_time() -> None:
    with Loop() as loop:
        pages = [browser_like(loop.page.address) for _ in range(3)]
        stalled, *others = pages
        received = 0
        while received < 20_000_000:  # more than the sockets hold
            received += sum(len(page.recv(timeout=120)) for page in others)
        assert loop.page._worker.process.poll() is None
        for page in [*others, stalled]:
            page.close()


@pytest.mark.skipif(not hasattr(signal, "SIGSTOP"), reason="processes cannot be halted here.")
def test_the_loop_outlives_a_page_that_stalls_and_is_killed() -> None:
    scene = one_board()
    with PageProcess(scene, port=0) as page:
        os.kill(page._worker.process.pid, signal.SIGSTOP)
        # Longer than a pipe holds.
        longer = replace(
            silent_moment(scene, 0.0, 0.0), amplitudes=np.zeros(100_000, dtype=np.complex128)
        )
        for _ in range(100):
            page.show(longer)
            time.sleep(0.001)
        assert page._worker.process.poll() is None
        page._worker.process.kill()
        until = time.monotonic() + 120.0
        while page._worker.process.poll() is None and time.monotonic() < until:
            page.show(longer)
            time.sleep(0.05)
        assert page._worker.process.poll() is not None
        page.show(longer)


def test_the_extra_is_named_where_viser_is_missing(tmp_path, monkeypatch) -> None:
    (tmp_path / "viser.py").write_text("raise ImportError('there is none')", encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    with raises_code("extra_missing", "airtact[live]"):
        PageProcess(one_board(), port=0)
