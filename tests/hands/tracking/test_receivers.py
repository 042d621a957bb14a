"""A receiver at a real websocket of this computer, and senders that die.

No stream here falls silent while a test waits, so that no result depends on the machine's load.
"""

import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

import airtact as at
from airtact.hands.tracking.receivers import MAX_MESSAGE, WebSocketReceiver
from airtact.live.applications import ApplicationServer
from faults import raises_code
from references.motions import still

PATIENCE = 120.0
"""Longest wait for something that must happen [s]."""


def until(happens: Callable[[], bool]) -> None:
    end = time.monotonic() + PATIENCE
    while not happens():
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.005)


@pytest.fixture
def stream():
    return at.hands.HandStream(silence=10 * PATIENCE)


@pytest.fixture
def receiver(stream):
    with WebSocketReceiver(stream) as receiver:
        yield receiver


def tracker_of(receiver, **options):
    return connect(f"ws://127.0.0.1:{receiver.port}", **options)


def send(receiver, sequence, **options):
    with tracker_of(receiver, **options) as tracker:
        tracker.send(at.hands.to_json(still(sequence)))
        assert receiver.stream.wait(PATIENCE).sequence == sequence


class Late:
    """A receiver whose threads start late, as on a busy computer."""

    def _receive(self, connection):
        time.sleep(0.1)
        super()._receive(connection)


class LateReceiver(Late, WebSocketReceiver):
    pass


class LateServer(Late, ApplicationServer):
    pass


@pytest.mark.parametrize("kind", [LateReceiver, LateServer])
def test_frames_sent_just_before_the_end_are_used(kind, stream):
    arguments = [stream] if kind is LateReceiver else [stream, at.live.World()]
    with kind(*arguments) as receiver, tracker_of(receiver) as tracker:
        tracker.send(at.hands.to_json(still(0)))
        tracker.close()
    assert stream.health.used == 1


def test_frames_come_by_websocket(receiver):
    with tracker_of(receiver) as tracker:
        tracker.send(at.hands.to_json(still(3)).decode())
        assert receiver.stream.wait(PATIENCE).sequence == 3
        tracker.send(at.hands.to_json(still(4)))
        assert receiver.stream.wait(PATIENCE).sequence == 4
    assert receiver.stream.health.used == 2


def test_nonsense_on_the_wire_is_counted_and_survived(receiver, stream):
    with tracker_of(receiver) as tracker:
        for message in ("rubbish", b"\xff" * 100, "", "[" * 50_000, at.hands.to_json(still(1))):
            tracker.send(message)
        assert stream.wait(PATIENCE).sequence == 1
    assert (stream.health.unreadable, stream.health.used) == (4, 1)


def test_bytes_that_are_no_websocket_do_not_end_it(receiver):
    with socket.create_connection(("127.0.0.1", receiver.port)) as sender:
        sender.sendall(b"\x00\xffGET nothing\r\n\r\n")
    send(receiver, 0)


def test_a_message_that_is_too_long_ends_its_connection_only(receiver):
    with tracker_of(receiver) as tracker, pytest.raises(ConnectionClosed):  # noqa: PT012
        tracker.send(b"x" * (MAX_MESSAGE + 1))
        tracker.recv(timeout=PATIENCE)
    send(receiver, 0)


def test_pages_of_other_sites_may_not_send(receiver):
    with pytest.raises(InvalidStatus, match="403"):
        tracker_of(receiver, origin="https://example.com")
    send(receiver, 0, origin="http://localhost:8000")


SENDER = """
import sys, time
from websockets.sync.client import connect
line = sys.stdin.readline()
with connect(f"ws://127.0.0.1:{sys.argv[1]}") as tracker:
    for index in range(100_000):
        taken = float(sys.argv[2]) + index / 100
        tracker.send(line.replace("12345", str(index)).replace("0.5,", f"{taken},"))
        time.sleep(0.01)
"""


def test_a_sender_that_is_killed_loses_the_hand_and_its_heir_is_followed():
    stream = at.hands.HandStream(silence=1.0)
    with WebSocketReceiver(stream) as receiver:
        for turn, start in enumerate(("100", "10")):
            command = [sys.executable, "-c", SENDER, str(receiver.port), start]
            with subprocess.Popen(command, stdin=subprocess.PIPE) as sender:
                sender.stdin.write(at.hands.to_json(still(12345, 0.5)) + b"\n")
                sender.stdin.close()
                until(lambda: (newest := stream.latest("left")) is not None and not newest.lost)
                sender.kill()
            assert stream.health.restarted == turn
            until(lambda: stream.latest("left").lost)
            until(lambda count=turn + 1: stream.health.interrupted == count)


def test_a_slow_reader_gets_the_latest(receiver, stream):
    with tracker_of(receiver) as tracker:
        for index in range(100):
            tracker.send(at.hands.to_json(still(index)))
    until(lambda: (newest := stream.latest("left")) is not None and newest.sequence == 99)
    health = stream.health
    assert (health.received, health.used, health.skipped) == (100, 100, 0)
    assert health.interrupted == 0  # the connection was closed in order
    assert stream.wait(0.0).sequence == 99
    assert stream.wait(0.0) is None


def test_closing_ends_all_connections_and_threads(stream):
    before = threading.active_count()
    receiver = WebSocketReceiver(stream)
    with tracker_of(receiver) as tracker:
        tracker.send(at.hands.to_json(still(0)))
        assert stream.wait(PATIENCE) is not None
        receiver.close()
        with pytest.raises(ConnectionClosed):
            tracker.recv(timeout=PATIENCE)
    until(lambda: threading.active_count() <= before)


def test_a_port_that_is_taken_is_rejected(receiver):
    with raises_code("link_in_use", str(receiver.port)):
        WebSocketReceiver(port=receiver.port)
    with raises_code("out_of_range", "70000"):
        WebSocketReceiver(port=70000)


def test_idle_connections_keep_no_tracker_out(receiver):
    idle = [tracker_of(receiver) for _ in range(70)]
    send(receiver, 0)
    for connection in idle:
        connection.socket.close()


def test_wrong_connections_print_nothing(receiver, capfd):
    for request in (b"\x00\xff\r\n\r\n", b"GET / HTTP/1.1\r\nHost: x\r\n\r\n", b"GET"):
        with socket.create_connection(("127.0.0.1", receiver.port)) as sender:
            sender.sendall(request)
    with pytest.raises(InvalidStatus):
        tracker_of(receiver, origin="null")
    send(receiver, 0)
    assert capfd.readouterr() == ("", "")
