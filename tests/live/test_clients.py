"""The documented messages, OSC, and the clients of examples/clients at a real server."""

import json
import re
import runpy
import shutil
import socket
import subprocess
import sys
import time

import numpy as np
import pytest
from pythonosc.osc_message_builder import OscMessageBuilder
from pythonosc.osc_packet import OscPacket

import airtact as at
from airtact.live.messages import message_schema, read_answer, read_message
from live.live_scenes import playing
from paths import ROOT
from references.motions import still

CLIENTS = ROOT / "examples" / "clients"
PATIENCE = 60.0
"""Longest wait for something that must happen [s]."""


def until(happens):
    end = time.monotonic() + PATIENCE
    while not (value := happens()):
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.003)
    return value


@pytest.fixture(autouse=True)
def patient(monkeypatch):
    """Foci stay while a busy machine stops a test for a second."""
    monkeypatch.setattr("airtact.live.world.SILENCE", PATIENCE)


@pytest.fixture
def hands():
    with at.live.ReceivedHands(0, world=at.live.World()) as hands:
        yield hands


def test_every_message_of_the_page_is_understood():
    page = (ROOT / "docs/applications.md").read_text(encoding="utf-8")
    lines = [line for line in page.splitlines() if line.startswith('{"type"')]
    kinds = {json.loads(line)["type"] for line in lines}
    assert kinds == {"hands", "objects", "foci", "clear", "state", "rejected"}
    for line in lines:
        answer = json.loads(line)["type"] in ("state", "rejected")
        assert (read_answer if answer else read_message)(line) is not None


def test_the_schema_beside_the_clients_is_that_of_the_messages():
    assert (CLIENTS / "messages.schema.json").read_text(encoding="utf-8") == message_schema()


@pytest.mark.parametrize(
    "shape",
    [
        at.sphere(0.02, edge=0.01),
        at.capsule((0, 0, 0), (0, 0.05, 0), 0.01, edge=0.005),
        at.touch.Box((0.05, 0.02, 0.03)),
        at.touch.Cylinder((0, 0, 0), (0.04, 0, 0), 0.01),
        at.touch.HalfSpace((0, 0, 0), (0, 1, 1)),
        at.touch.Button((0, 0, 0), 0.01, 0.004),
    ],
    ids=lambda shape: type(shape).__name__,
)
def test_an_object_arrives_as_it_was_sent(hands, shape):
    pose = at.Pose.turn((1, 2, 3), 0.7, (0.01, 0.02, 0.2))
    sent = at.VirtualObject(shape, pose, "it", stiffness=300.0)
    with at.live.Client(hands.words) as client:
        client.objects(sent)
        (came,) = until(lambda: hands.world.objects)
    points = np.random.default_rng(0).uniform(-0.05, 0.05, (20, 3)) + [0.0, 0.0, 0.2]
    np.testing.assert_allclose(came.depth(points), sent.depth(points), atol=1e-9)
    assert (came.name, came.style, came.stiffness) == ("it", "points", 300.0)


def test_the_python_client_sends_all_and_reads_the_answers(hands, board):
    world = hands.world
    with at.live.Client(hands.words) as client:
        client.hands(still(1), still(1, side="right", landmarks=None))
        assert until(lambda: hands.stream.latest("left")).sequence == 1
        assert until(lambda: hands.stream.latest("right")).lost
        client.objects(at.VirtualObject(at.touch.Box((0.1, 0.1, 0.1)), name="box"))
        client.foci(at.live.WantedFocus("a", 0.5, point=np.zeros(3), on="box"))
        until(lambda: world.foci(time.monotonic()))
        client.move("box", at.Pose.shift((0.0, 0.0, 0.1)))
        until(lambda: world.objects[0].ball[0][2] == 0.1)
        client.remove("boxes")
        assert "did you mean box" in until(lambda: client.rejected and client.rejected[-1])
        world.show(playing(board), None)
        until(lambda: client.state is not None and client.state.state == "playing")
        client.clear()
        until(lambda: not world.objects and not world.foci(time.monotonic()))
    with pytest.raises(at.InvalidInput, match="cannot connect") as fault:
        at.live.Client("ws://127.0.0.1:9", timeout=0.1)
    assert fault.value.code == "link_failed"


def slowly(frames):
    """Yield frames slowly enough for an answer to arrive."""
    for frame in frames:
        time.sleep(0.01)
        yield frame


def test_the_example_follows_a_hand_with_a_ball(hands, monkeypatch, capsys):
    monkeypatch.setattr(at.hands, "replay", slowly)
    monkeypatch.setattr(sys, "argv", ["ball.py", hands.words])
    hands.world.show(None, "waiting for a hand")
    runpy.run_path(str(CLIENTS / "ball.py"))
    until(lambda: hands.stream.health.used == 60)
    assert "silent" in capsys.readouterr().out


class Osc:
    """A sender of OSC that reads the answers."""

    def __init__(self, port):
        self.port = port
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(PATIENCE)

    def send(self, address, *values):
        builder = OscMessageBuilder(f"/airtact/{address}")
        for value in values:
            builder.add_arg(value)
        self.raw(builder.build().dgram)

    def raw(self, packet):
        self.socket.sendto(packet, ("127.0.0.1", self.port))

    def answer(self, address):
        """The arguments of the next answer with this address."""
        while True:
            for timed in OscPacket(self.socket.recv(65536)).messages:
                if timed.message.address == f"/airtact/{address}":
                    return timed.message.params


@pytest.fixture
def osc():
    with at.live.ReceivedHands(0, world=at.live.World(), kind="osc") as hands:
        sender = Osc(hands.port)
        sender.hands, sender.world = hands, hands.world
        yield sender
        sender.socket.close()


def test_hands_objects_and_foci_come_by_osc(osc, board):
    osc.send("hand", "left", 1.5, 3, *map(float, still(3).landmarks.ravel()))
    until(lambda: osc.hands.stream.latest("left"))
    np.testing.assert_allclose(
        osc.hands.stream.latest("left").landmarks, still(3).landmarks, atol=1e-6
    )
    osc.send("object/sphere", "ball", 0.0, 0.0, 0.2, 0.02)
    osc.send("object/box", "box", 0.0, 0.0, 0.1, 0.02, 0.02, 0.02)
    osc.send("object/move", "ball", 0.0, 0.1, 0.2, 0.0, 0.0, 0.0, 1.0)
    osc.send("object/remove", "box")
    osc.send("focus", "a", 0.0, 0.0, 0.2, 0.5)
    osc.send("focus/place", "b", "palm")
    foci = until(lambda: len(foci := osc.world.foci(time.monotonic())) == 2 and foci)
    assert [(focus.name, focus.strength, focus.place) for focus in foci] == [
        ("a", 0.5, None),
        ("b", 1.0, "palm"),
    ]
    (ball,) = osc.world.objects
    np.testing.assert_allclose(ball.ball[0], [0.0, 0.1, 0.2], atol=1e-6)
    osc.send("focus", "a", 0.0, 0.0, 0.2, 0.0)
    until(lambda: [focus.name for focus in osc.world.foci(time.monotonic())] == ["b"])
    moment = playing(board)
    osc.world.show(moment, None)
    while osc.answer("state")[0] != "playing":
        pass
    osc.world.show(moment, None)
    assert osc.answer("state/focus")[1:4] == pytest.approx(moment.foci[0], abs=1e-5)
    osc.send("json", '{"type": "clear", "version": 1}')
    until(lambda: not osc.world.objects and not osc.world.foci(time.monotonic()))


@pytest.mark.parametrize(
    ("address", "values", "code"),
    [
        ("fokus", (), "unknown_name"),
        ("focus", ("a", 0.0), "sizes_differ"),
        ("focus", ("a", 0.0, 0.0, 200.0), "not_in_metres"),
        ("focus", ("a", 0.0, float("nan"), 0.2), "not_finite"),
        ("focus", (3, 0.0, 0.0, 0.2), "out_of_range"),
        ("object/move", ("bal", 0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 1.0), "unknown_name"),
        ("object/sphere", ("b", 0.0, 0.0, 0.1, float("nan")), "out_of_range"),
        ("json", ("rubbish",), "unknown_format"),
        ("reply", (0,), "out_of_range"),
        ("hand", ("left", 1.0, 1, 0.5), "unreadable"),
        ("hand", ("both", 1.0, 1), "unreadable"),
    ],
)
def test_bad_osc_gets_one_sentence(osc, address, values, code):
    osc.send(address, *values)
    assert osc.answer("rejected") == [code, osc.world.rejection]


def test_garbage_by_osc_is_rejected_and_replies_go_to_the_wanted_port(osc):
    osc.raw(b"\xff\x00garbage")
    assert osc.answer("rejected")[0] == "unknown_format"
    other = Osc(osc.port)
    osc.send("reply", other.socket.getsockname()[1])
    osc.send("fokus")
    assert other.answer("rejected")[0] == "unknown_name"
    other.socket.close()


def test_the_javascript_client_runs_in_node(hands):
    node = shutil.which("node")
    if node is None:
        pytest.skip("Node is not installed here.")
    version = int(re.match(r"v(\d+)", subprocess.check_output([node, "-v"], text=True))[1])
    if version < 20:
        pytest.skip("this Node has no websockets.")
    options = ["--experimental-websocket"] if version < 22 else []
    command = [node, *options, str(CLIENTS / "airtact.mjs"), hands.words]
    _check(subprocess.Popen(command, stdout=subprocess.PIPE, text=True), hands.world)


def _check(client, world):
    """Check that a client puts a ball at 0.2 m and a focus on the index finger, and prints the state."""
    with client:
        until(lambda: world.objects and world.objects[0].ball[0][2] == 0.2)
        (focus,) = until(lambda: world.foci(time.monotonic()))
        assert (focus.place, focus.strength) == ("index.pad", 0.5)
        world.show(None, "waiting for a hand")
        assert "silent waiting for a hand" in client.stdout.read()
    assert client.returncode == 0


PROGRAM = """
using System;
using System.Threading;

static class Program
{
    static void Main(string[] arguments)
    {
        using (var client = new Airtact.Client(arguments[0]))
        {
            client.AddSphere("ball", 0.02);
            client.Move("ball", new[] { 0.0, 0.0, 0.2 }, new[] { 0.0, 0.0, 0.0, 1.0 });
            client.Move("bal", new[] { 0.0, 0.0, 0.2 }, new[] { 0.0, 0.0, 0.0, 1.0 });
            while (client.State == null || client.State.reason != "waiting for a hand")
            {
                client.Foci(new Airtact.Focus { id = "tip", place = "index.pad", strength = 0.5 });
                Thread.Sleep(50);
            }
            Console.WriteLine(client.Rejected);
            Console.WriteLine(client.State.state + " " + client.State.reason);
        }
    }
}
"""


@pytest.mark.slow
def test_the_client_for_unity_is_compiled_and_runs(hands, tmp_path):
    compiler, mono = shutil.which("mcs"), shutil.which("mono")
    if compiler is None or mono is None:
        pytest.skip("Mono's compiler is not installed here (apt-get install mono-devel).")
    (tmp_path / "Program.cs").write_text(PROGRAM, encoding="utf-8")
    program = tmp_path / "program.exe"
    command = [compiler, f"-out:{program}", "-r:System.Runtime.Serialization.dll"]
    command += [str(tmp_path / "Program.cs"), str(CLIENTS / "Airtact.cs")]
    subprocess.run(command, check=True, timeout=PATIENCE)
    client = subprocess.Popen([mono, str(program), hands.words], stdout=subprocess.PIPE, text=True)
    _check(client, hands.world)
