"""The page serves those who may ask, and never makes the loop wait: with real sockets and a real process."""

import http.client
import json
import os
import signal
import socket
import ssl
import time
from dataclasses import replace
from pathlib import Path
from threading import Event
from urllib.parse import urlsplit
from urllib.request import urlopen

import numpy as np
import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import ClientConnection, connect

import airtact as at
from airtact.live.moment import silent_moment
from airtact.live.page.process import PageProcess
from airtact.live.page.server import path_within, start_server
from airtact.live.world import World
from faults import raises_code
from live.live_scenes import Loop, one_board


@pytest.fixture(scope="module")
def address():
    server, address = start_server(0, "127.0.0.1", "<p>page</p>", lambda connection: None)
    yield address
    server.shutdown()


@pytest.fixture(scope="module")
def open_address():
    """Address of a page that is served to other computers as well."""
    server, address = start_server(0, "0.0.0.0", "<p>page</p>", lambda connection: None)
    yield address
    server.shutdown()


def until(true) -> None:
    end = time.monotonic() + 120.0
    while not true():
        assert time.monotonic() < end
        time.sleep(0.02)


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
    """Try to open a websocket."""
    port = urlsplit(address).port
    origin = None if origin is None else origin.format(port=port)
    url = f"ws://127.0.0.1:{port}{path}"
    try:
        connect(url, origin=origin, proxy=None).close()
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
            start_server(port, "127.0.0.1", "", lambda connection: None)


def browser_like(page: PageProcess) -> ClientConnection:
    """Connect as a browser does."""
    url = page.address.replace("http", "ws")
    return connect(url, compression=None, max_size=None, proxy=None)


def picture_of(connection: ClientConnection) -> tuple[dict, dict]:
    """Receive a picture, its facts and its arrays, and ask for another."""
    data = connection.recv(timeout=120)
    end = 4 + int.from_bytes(data[:4], "little")
    facts = json.loads(data[4:end])
    arrays = {
        name: np.frombuffer(data, kind, count, end + start)
        for name, (kind, start, count) in facts["arrays"].items()
    }
    connection.send('{"drawn": true}')
    return facts, arrays


@pytest.mark.slow
def test_a_page_that_reads_nothing_leaves_the_others_in_time() -> None:
    with Loop() as loop:
        pages = [browser_like(loop.page) for _ in range(3)]
        stalled, *others = pages
        for _ in range(1000):  # a stalled page is asked for more than the sockets hold
            stalled.send('{"drawn": true}')
        for _ in range(200):
            for page in others:
                picture_of(page)
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


def test_the_extra_is_named_where_websockets_is_missing(tmp_path, monkeypatch) -> None:
    (tmp_path / "websockets.py").write_text("raise ImportError('there is none')", encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    with raises_code("extra_missing", "airtact[live]"):
        PageProcess(one_board(), port=0)


def test_values_that_no_browser_sends_change_nothing() -> None:
    pressed = Event()
    with PageProcess(one_board(), port=0, on_emergency=pressed.set) as page:
        first = page.controls
        raw = browser_like(page)
        values = (
            *('{"cap": 1.01}', '{"cap": "1"}', '{"cap": null}', '{"offset": -1}'),
            *(
                '{"playing": 1}',
                '{"levels": {"a": 2}}',
                '{"levels": [1]}',
                '{"method": "no"}',
                "[]",
            ),
        )
        for bad in (
            *(f'{{"controls": {one}}}' for one in values),
            '{"levels": {"a": 2}}',
            '{"hand": {"position": [0, 0, 9]}}',
            '{"hand": {"position": [0, 0, 0], "turn": [0, 0, 0, 0]}}',
            '{"offset": 7}',
            "[" * 10_000,
            "nonsense",
            b"\x00\xff",
        ):
            raw.send(bad)
        raw.send('{"controls": {"cap": 0.5}, "levels": {"index.pad": 0.2}}')
        until(lambda: page.controls.cap == 0.5)
        assert page.controls == replace(first, cap=0.5, levels={"index.pad": 0.2})
        assert not pressed.is_set()
        raw.send('{"emergency": true}')
        assert pressed.wait(120)
        raw.send('{"controls": {"cap": 1.0}}')
        facts, _ = picture_of(raw)
        while not facts["stopped"]:
            facts, _ = picture_of(raw)
        assert facts["controls"]["cap"] == 0.5
        raw.close()


def test_a_shape_is_sent_once_and_its_pose_always() -> None:
    scene = one_board()
    ball = at.VirtualObject(at.sphere(0.012, edge=0.006), at.Pose.shift((0, 0, 0.1)), "ball")
    world = World([ball])
    with PageProcess(scene, port=0, world=world) as page:
        raw = browser_like(page)
        page.tell("begun")
        facts, arrays = picture_of(raw)
        while not facts["objects"]:
            facts, arrays = picture_of(raw)
        (drawn,) = facts["objects"]
        vertices = arrays[f"{drawn['key']} vertices"].reshape(-1, 3)
        np.testing.assert_allclose(np.linalg.norm(vertices, axis=1), 0.012, rtol=1e-5)
        assert drawn["position"] == [0.0, 0.0, 0.1]
        until(lambda: page._known)
        move = {"name": "ball", "pose": {"translation": [0.02, 0, 0.1]}}
        raw.send(json.dumps({"object": {"type": "objects", "version": 1, "move": [move]}}))
        while facts["objects"][0]["position"] == drawn["position"]:
            facts, arrays = picture_of(raw)
            assert not any(name.startswith("object") for name in arrays)
        assert facts["objects"] == [{**drawn, "position": [0.02, 0.0, 0.1]}]
        np.testing.assert_allclose(world.objects[0].pose.translation, [0.02, 0.0, 0.1])
        raw.close()


def test_a_page_with_a_certificate_is_served_by_https() -> None:
    file = Path(__file__).with_name("localhost.pem")
    server, address = start_server(0, "127.0.0.1", "<p>page</p>", lambda connection: None, file)
    trusted = ssl.create_default_context(cafile=file)
    with urlopen(address, context=trusted) as answer:
        assert answer.read() == b"<p>page</p>"
    connect(address.replace("http", "ws"), ssl=trusted, proxy=None).close()
    server.shutdown()
    with raises_code("file_unreadable", "PEM"):
        start_server(0, "127.0.0.1", "", lambda connection: None, Path(__file__))
