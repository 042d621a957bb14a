"""Receivers by real sockets: a websocket and OSC over UDP at this computer, and senders that die."""

import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack

import pytest
from pythonosc.osc_message import OscMessage
from pythonosc.udp_client import UDPClient
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from airtact.hands.tracking.messages import to_json, to_osc
from airtact.hands.tracking.receivers import (
    LARGEST_MESSAGE,
    MOST_CONNECTIONS,
    OscReceiver,
    WebSocketReceiver,
)
from airtact.hands.tracking.stream import HandStream
from faults import raises_code
from references.motions import still

PATIENCE = 120.0
"""Longest wait for something that must happen [s]."""


def until(happens: Callable[[], bool]) -> None:
    end = time.monotonic() + PATIENCE
    while not happens():
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.005)


def test_frames_come_by_websocket():
    with WebSocketReceiver() as receiver, connect(f"ws://127.0.0.1:{receiver.port}") as tracker:
        tracker.send(to_json(still(3)).decode())
        assert receiver.stream.wait(PATIENCE).sequence == 3
        tracker.send(to_json(still(4)))
        assert receiver.stream.wait(PATIENCE).sequence == 4
        assert receiver.stream.health.used == 2


def test_frames_come_by_osc():
    stream = HandStream(silence=PATIENCE)
    with OscReceiver(stream) as receiver:
        client = UDPClient("127.0.0.1", receiver.port)
        client.send(OscMessage(to_osc(still(3))))
        client._sock.close()
        assert stream.wait(PATIENCE).sequence == 3


def test_nonsense_on_the_wire_is_counted_and_survived():
    stream = HandStream(silence=PATIENCE)
    with WebSocketReceiver(stream) as web, OscReceiver(stream) as osc:
        with connect(f"ws://127.0.0.1:{web.port}") as tracker:
            for message in ("rubbish", b"\xff" * 100, "", "[" * 50_000, to_json(still(1))):
                tracker.send(message)
            assert stream.wait(PATIENCE).sequence == 1
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            for packet in (
                b"",
                b"rubbish",
                b"#bundle\0" + b"\xff" * 40,
                to_osc(still(2))[:50],
                to_osc(still(2)),
            ):
                sender.sendto(packet, ("127.0.0.1", osc.port))
            assert stream.wait(PATIENCE).sequence == 2
    assert stream.health.unreadable == 8
    assert stream.health.used == 2


def test_bytes_that_are_no_websocket_do_not_end_it():
    with WebSocketReceiver() as receiver:
        with socket.create_connection(("127.0.0.1", receiver.port)) as rude:
            rude.sendall(b"\x00\xffGET nothing\r\n\r\n")
        with connect(f"ws://127.0.0.1:{receiver.port}") as tracker:
            tracker.send(to_json(still(0)))
            assert receiver.stream.wait(PATIENCE).sequence == 0


def test_a_message_that_is_too_long_ends_its_connection_only():
    with WebSocketReceiver() as receiver:
        address = f"ws://127.0.0.1:{receiver.port}"
        with connect(address) as tracker, pytest.raises(ConnectionClosed):  # noqa: PT012
            tracker.send(b"x" * (LARGEST_MESSAGE + 1))
            tracker.recv(timeout=PATIENCE)
        with connect(f"ws://127.0.0.1:{receiver.port}") as tracker:
            tracker.send(to_json(still(0)))
            assert receiver.stream.wait(PATIENCE).sequence == 0


def test_pages_of_other_sites_may_not_send():
    with WebSocketReceiver() as receiver:
        address = f"ws://127.0.0.1:{receiver.port}"
        with pytest.raises(InvalidStatus, match="403"):
            connect(address, origin="https://example.com")
        with connect(address, origin="http://localhost:8000") as page:
            page.send(to_json(still(0)))
            assert receiver.stream.wait(PATIENCE).sequence == 0


def test_of_two_hundred_connections_those_beyond_the_limit_are_turned_away():
    with WebSocketReceiver(HandStream(silence=PATIENCE)) as receiver, ExitStack() as all_of_them:
        address = f"ws://127.0.0.1:{receiver.port}"
        held = [all_of_them.enter_context(connect(address)) for _ in range(MOST_CONNECTIONS)]
        until(lambda: len(receiver._connections) == MOST_CONNECTIONS)
        for _ in range(200 - MOST_CONNECTIONS):
            with connect(address) as late, pytest.raises(ConnectionClosed) as caught:
                late.recv(timeout=PATIENCE)
            assert caught.value.rcvd.code == 1013
        for index, tracker in enumerate(held):
            tracker.send(to_json(still(index)))
            until(lambda count=index + 1: receiver.stream.health.used == count)
        held[0].close()
        until(lambda: len(receiver._connections) < MOST_CONNECTIONS)
        with connect(address) as heir:
            heir.send(to_json(still(1000)))
            until(lambda: receiver.stream.latest("left").sequence == 1000)


SENDER = """
import sys, time
from websockets.sync.client import connect
line = sys.stdin.readline()
with connect(f"ws://127.0.0.1:{sys.argv[1]}") as tracker:
    for index in range(100_000):
        tracker.send(line.replace("12345", str(index)).replace("0.5,", f"{float(sys.argv[2]) + index / 100},"))
        time.sleep(0.01)
"""


def test_a_sender_that_is_killed_loses_the_hand_and_its_heir_is_followed():
    line = to_json(still(12345, 0.5)).decode() + "\n"
    stream = HandStream(silence=1.0)
    with WebSocketReceiver(stream) as receiver:
        for turn in range(2):
            command = [sys.executable, "-c", SENDER, str(receiver.port), str(100.0 - 90.0 * turn)]
            sender = subprocess.Popen(command, stdin=subprocess.PIPE, text=True)
            try:
                assert sender.stdin is not None
                sender.stdin.write(line)
                sender.stdin.close()
                until(lambda: (newest := stream.latest("left")) is not None and not newest.lost)
            finally:
                sender.kill()
                sender.wait()
            assert stream.health.restarted == turn
            until(lambda: stream.latest("left").lost)
            until(lambda count=turn + 1: stream.health.interrupted == count)


def test_a_slow_reader_gets_the_latest():
    with WebSocketReceiver(HandStream(silence=PATIENCE)) as receiver:
        with connect(f"ws://127.0.0.1:{receiver.port}") as tracker:
            for index in range(100):
                tracker.send(to_json(still(index)))
        until(
            lambda: (
                receiver.stream.latest("left") is not None
                and receiver.stream.latest("left").sequence == 99
            )
        )
        health = receiver.stream.health
        assert (health.received, health.used + health.overtaken, health.skipped) == (100, 100, 0)
        assert health.interrupted == 0  # this one says farewell
        assert receiver.stream.wait(0.0).sequence == 99
        assert receiver.stream.wait(0.0) is None


def test_packets_of_osc_that_wait_are_read_from_the_newest():
    got, begun, held = [], threading.Event(), threading.Event()

    def note(frame):
        got.append(frame.sequence)
        begun.set()
        assert held.wait(PATIENCE)

    stream = HandStream(silence=PATIENCE, on_frame=note)
    with (
        OscReceiver(stream) as receiver,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender,
    ):
        try:
            for index in range(20):
                sender.sendto(to_osc(still(index)), ("127.0.0.1", receiver.port))
                assert begun.wait(PATIENCE)
        finally:
            held.set()
        until(lambda: stream.health.received == 20)
    assert got == [0, 19]
    assert stream.health.overtaken == 18


def test_every_frame_is_used_where_they_are_recorded():
    got = []
    with WebSocketReceiver(
        HandStream(silence=PATIENCE, on_frame=got.append, every=True)
    ) as receiver:
        with connect(f"ws://127.0.0.1:{receiver.port}") as tracker:
            for index in range(300):
                tracker.send(to_json(still(index)))
        until(lambda: receiver.stream.health.used == 300)
    assert [frame.sequence for frame in got] == list(range(300))


def test_closing_ends_all_connections_and_threads():
    before = threading.active_count()
    receiver = WebSocketReceiver()
    with connect(f"ws://127.0.0.1:{receiver.port}") as tracker:
        tracker.send(to_json(still(0)))
        assert receiver.stream.wait(PATIENCE) is not None
        receiver.close()
        with pytest.raises(ConnectionClosed):
            tracker.recv(timeout=PATIENCE)
    until(lambda: threading.active_count() <= before)


@pytest.mark.parametrize("kind", [WebSocketReceiver, OscReceiver])
def test_a_port_that_is_taken_is_rejected(kind):
    with kind() as first, raises_code("link_in_use", f"127.0.0.1, port {first.port}"):
        kind(port=first.port)
    with raises_code("out_of_range", "70000"):
        kind(port=70000)
