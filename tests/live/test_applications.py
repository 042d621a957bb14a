"""Applications at real sockets: objects and foci come in, answers go out, and nothing bad has an effect."""

import json
import socket
import time
from contextlib import nullcontext
from dataclasses import replace
from threading import Thread

import numpy as np
import pytest
import trimesh
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

import airtact as at
from airtact.live.messages import MAX_FOCI, read_message
from airtact.live.moment import Moment
from airtact.live.world import SILENCE
from live.live_scenes import VirtualClock, playing
from references.motions import still

PATIENCE = 60.0
"""Longest wait for something that must happen [s]."""


def until(happens):
    end = time.monotonic() + PATIENCE
    while not (value := happens()):
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.003)
    return value


def ball(name="ball", radius=0.02):
    return at.VirtualObject(at.sphere(radius, edge=radius / 3.0), name=name)


def message(kind, **values):
    return json.dumps({"type": kind, "version": 1, **values})


def foci_of(**values):
    return message("foci", foci=[{"id": "a", **values}])


def names(world):
    return [thing.name for thing in world.objects]


@pytest.fixture
def clock():
    return VirtualClock()


@pytest.fixture
def world(clock):
    return at.live.World([ball()], clock.monotonic)


@pytest.fixture(scope="module")
def server():
    with at.live.ReceivedHands(0, world=at.live.World([ball()])) as hands:
        yield hands


def test_the_newest_foci_replace_the_earlier_ones_of_their_application_only(world, clock):
    assert world.take(foci_of(point=[0, 0, 0.2], strength=0.5), "first") is None
    assert world.take(foci_of(place="left.index.pad"), "second") is None
    assert world.take(message("foci", foci=[{"id": "b", "place": "palm"}]), "first") is None
    foci = {focus.name: focus for focus in world.foci(clock.now)}
    assert sorted(foci) == ["a", "b"]
    assert (foci["a"].place, foci["b"].place) == ("left.index.pad", "palm")


def test_silence_ends_foci_and_any_message_keeps_them(world, clock):
    world.take(foci_of(place="palm"), "app")
    clock.now += 0.9 * SILENCE
    world.take(message("objects", move=[{"name": "ball", "pose": {}}]), "app")
    clock.now += 0.9 * SILENCE
    assert len(world.foci(clock.now)) == 1
    world.take("nonsense", "app")
    clock.now += 0.2 * SILENCE
    assert world.foci(clock.now) == ()


def test_objects_stay_until_their_connection_has_ended(world, clock):
    add = message("objects", add=[{"name": "box", "box": {"sides": [0.1, 0.1, 0.1]}}])
    assert world.take(add, "first") is None
    clock.now += 100.0
    world.show(None, None)
    assert names(world) == ["ball", "box"]
    world.close("first")
    world.take(add, "second")  # it reconnects in time, so the object never went
    clock.now += 2.0 * SILENCE
    world.show(None, None)
    assert names(world) == ["ball", "box"]
    world.close("second")
    clock.now += 2.0 * SILENCE
    world.show(None, None)
    assert names(world) == ["ball"]


def test_an_object_that_is_added_again_elsewhere_keeps_its_shape(world):
    def add(**values):
        world.take(message("objects", add=[{"name": "b", **values}]), "app")
        return world.objects[-1]

    first = add(sphere={"radius": 0.02})
    second = add(sphere={"radius": 0.02}, pose={"translation": [0.0, 0.0, 0.1]})
    assert second.shape is first.shape
    np.testing.assert_allclose(second.ball[0], [0.0, 0.0, 0.1])
    assert add(sphere={"radius": 0.03}).ball[1] == pytest.approx(0.03)


def test_moves_turn_and_remove_and_clear_do_what_they_say(world):
    world.take(message("objects", add=[{"name": "box", "box": {"sides": [0.2, 0.1, 0.1]}}]), "app")
    half = np.sqrt(0.5)  # a quarter turn about z
    pose = {"translation": [0.0, 0.0, 0.3], "quaternion": [0.0, 0.0, half, half]}
    world.take(message("objects", move=[{"name": "box", "pose": pose}]), "other")
    along_y = np.array([[0.0, 0.09, 0.3], [0.09, 0.0, 0.3]])
    np.testing.assert_allclose(world.objects[1].depth(along_y), [0.01, -0.04], atol=1e-9)
    world.take(message("objects", remove=["ball"]), "app")
    assert names(world) == ["box"]
    world.take(foci_of(place="palm"), "app")
    world.take(message("clear"), "app")
    assert names(world) == []
    assert world.foci(0.0) == ()


def test_an_object_of_the_scene_that_was_replaced_returns(world, clock):
    (before,) = world.objects
    world.take(message("objects", add=[{"name": "ball", "sphere": {"radius": 0.05}}]), "app")
    assert world.objects[0].ball[1] > 0.04
    world.close("app")
    clock.now += 2.0 * SILENCE
    world.show(None, None)
    assert world.objects == (before,)


def test_a_focus_on_an_object_goes_with_it(world, clock):
    world.take(foci_of(point=[0.0, 0.0, 0.02], on="ball"), "app")
    (focus,) = world.foci(clock.now)
    assert focus.on == "ball"
    world.take(message("objects", remove=["ball"]), "app")
    assert world.foci(clock.now) == ()


def test_modulation_swings_the_strength(world, clock):
    world.take(foci_of(place="palm", strength=0.8, modulation=4.0), "app")
    strengths = [world.foci(clock.now + t)[0].strength for t in np.arange(0.0, 0.25, 0.125 / 4)]
    np.testing.assert_allclose(strengths, 0.4 + 0.4 * np.cos(np.arange(8) * np.pi / 4), atol=1e-6)


OPEN = trimesh.creation.box()
OPEN.update_faces(np.arange(12) != 3)
BALLS = [{"name": f"ball {index}", "sphere": {"radius": 0.01}} for index in range(64)]
BAD = {
    "unknown object": (foci_of(point=[0, 0, 0.02], on="bal"), "unknown_name", "ball"),
    "unknown move": (message("objects", move=[{"name": "b", "pose": {}}]), "unknown_name", "'b'"),
    "unknown place": (foci_of(place="index.pd"), "unknown_name", "index.pad"),
    "open mesh": (
        message(
            "objects",
            add=[
                {
                    "name": "m",
                    "mesh": {
                        "vertices": (0.05 * OPEN.vertices).tolist(),
                        "triangles": OPEN.faces.tolist(),
                    },
                }
            ],
        ),
        "mesh_open",
        "open",
    ),
    "65 objects": (message("objects", add=BALLS), "too_many", "65"),
    "17 foci": (
        message("foci", foci=[{"id": str(index), "place": "palm"} for index in range(17)]),
        "out_of_range",
        "16",
    ),
    "millimetres": (foci_of(point=[0, 20, 200]), "not_in_metres", "millimetres"),
    "large ball": (
        message("objects", add=[{"name": "b", "sphere": {"radius": 20.0}}]),
        "not_in_metres",
        "millimetres",
    ),
    "far ball": (
        message("objects", move=[{"name": "ball", "pose": {"translation": [0, 0, 200]}}]),
        "not_in_metres",
        "millimetres",
    ),
    "huge numbers": (
        message("objects", add=[{"name": "b", "box": {"sides": [1e300, 1, 1e-300]}}]),
        "not_in_metres",
        "metres",
    ),
    "NaN": (foci_of(point=[0, float("nan"), 0.2]), "not_finite", "NaN"),
    "too strong": (foci_of(place="palm", strength=1.5), "out_of_range", "strength"),
    "no place": (foci_of(), "options_clash", "place"),
    "same id": (
        message("foci", foci=2 * [{"id": "a", "place": "palm"}]),
        "given_twice",
        "'a'",
    ),
    "no turn": (
        message("objects", move=[{"name": "ball", "pose": {"quaternion": [0, 0, 0, 0]}}]),
        "out_of_range",
        "quaternion",
    ),
    "no shape": (message("objects", add=[{"name": "b"}]), "options_clash", "sphere"),
    "a file": (
        message("objects", add=[{"name": "b", "surface": "/etc/passwd"}]),
        "options_clash",
        "sphere",
    ),
    "misspelt": (
        message("objects", add=[{"name": "b", "sphere": {"radios": 1}}]),
        "unknown_key",
        "radios",
    ),
    "version": ('{"type": "foci", "version": 2}', "unsupported_version", "2"),
    "no version": ('{"type": "foci"}', "key_missing", "version"),
    "type": ('{"type": "focus", "version": 1}', "unknown_name", "focus"),
    "not JSON": ('{"type": "foci", ', "unknown_format", "JSON"),
    "misspelt type": ('{"type": "objets", "version": 1}', "unknown_name", "objects?"),
    "misspelt type without version": ('{"type": "objets"}', "key_missing", "version"),
    "nothing": ("{}", "unreadable", "the keys type and version"),
    "text": ("rubbish", "unreadable", "JSON"),
    "bytes": (b"\xff\x00\x81", "unreadable", "JSON"),
    "nested": ('{"type": "foci", "version": 1, "x": ' + "[" * 50_000, "unknown_format", "nested"),
    "half a hand": (
        message("hands", hands=[{"time": 1.0, "side": "left", "sequence": 1, "landmarks": []}] * 3),
        "out_of_range",
        "hands",
    ),
    "no hand": (
        message("hands", hands=[{"time": 1, "side": "both", "sequence": 1}]),
        "unreadable",
        "side",
    ),
}


def rejected(connection):
    """The next answer that is not a state."""
    while (answer := json.loads(connection.recv(timeout=PATIENCE)))["type"] == "state":
        pass
    assert answer["type"] == "rejected"
    return answer


def test_each_bad_message_gets_one_sentence_and_has_no_effect(server):
    world = server.world
    objects = world.objects
    with connect(server.words) as application:
        application.send(foci_of(place="palm"))
        until(lambda: world.foci(time.monotonic()))
        for name, (text, code, words) in BAD.items():
            application.send(text)
            answer = rejected(application)
            assert answer["code"] == code, name
            assert words in answer["reason"], name
            assert world.rejection == answer["reason"], name
            assert len(answer["reason"]) <= 450
            assert world.objects is objects, name
            assert all(focus.place == "palm" for focus in world.foci(time.monotonic())), name
    until(lambda: world.foci(time.monotonic()) == ())


def test_a_message_that_is_too_long_closes_its_connection_and_says_why(server):
    with connect(server.words) as application:
        application.send(b"x" * 10_000_000)
        with pytest.raises(ConnectionClosed) as closed:
            application.recv(timeout=PATIENCE)
    assert "4194304 bytes" in closed.value.rcvd.reason
    until(lambda: "longer" in server.world.rejection)


def test_foci_without_a_tracked_hand_get_a_reason(world):
    world.take(foci_of(place="palm"), "one")
    world.show(None, "waiting for a hand")
    (focus,) = world.state.foci
    assert (focus.id, focus.strength, focus.reason) == ("a", 0.0, "waiting for a hand")


def test_foci_of_a_long_contact_have_their_own_names_and_no_pressure_without_a_solution(world):
    names = ("palm at ball", "palm at ball", "a")
    pressures = np.full(3, 900.0)
    moment = Moment(
        0.0, 0.0, None, np.zeros((3, 3)), np.ones(9, complex), pressures=pressures, names=names
    )
    world.show(moment, None)
    unsolved = world.state.foci
    assert [focus.id for focus in unsolved] == ["palm at ball", "palm at ball 2", "a"]
    assert [focus.pressure for focus in unsolved] == [None] * 3
    world.show(replace(moment, rule="contacts"), None)
    assert [focus.pressure for focus in world.state.foci] == [900.0] * 3


def test_unknown_keys_are_ignored_and_unknown_values_are_not():
    read = read_message('{"type": "foci", "version": 1, "new": 1, "foci": [{"id": "a", "x": 1}]}')
    assert read.foci[0].id == "a"


def test_many_names_and_sources_take_no_memory(world, clock):
    for index in range(2000):
        world.take(foci_of(id=f"focus {index}", place="palm"), f"source {index}")
        sphere = {"name": f"ball {index}", "sphere": {"radius": -1.0}}
        world.take(message("objects", add=[sphere]), f"source {index}")
        world.close(f"source {index}")
        clock.now += 0.01
    held = [value for value in vars(world).values() if isinstance(value, dict)]
    assert len(held) == 5
    assert max(map(len, held)) <= 64
    for index in range(100):
        world.take(foci_of(place="palm"), f"source {index}")
    assert "64" in world.rejection
    world.take(message("clear"), "source 0")
    for index in range(100):
        read = read_message(message("foci", foci=[{"id": str(index), "place": "palm"}]))
        with pytest.raises(at.InvalidInput) if index >= MAX_FOCI else nullcontext():
            world.receive(read, "source 0", keep=True)


def test_an_application_gets_the_state_and_a_tracker_does_not(server, board):
    moment = playing(board)
    with connect(server.words) as tracker, at.live.Client(server.words) as client:
        tracker.send(at.hands.to_json(still(1)))
        client.clear()
        server.world.show(moment, None, 0.5)
        state = until(lambda: (s := client.state) is not None and s.state == "playing" and s)
        assert [focus.pressure for focus in state.foci] == pytest.approx(
            0.5 * moment.pressures, abs=0.06
        )
        np.testing.assert_allclose([focus.point for focus in state.foci], moment.foci, atol=1e-6)
        server.world.show(None, "lost")
        until(lambda: client.state.state == "silent" and client.state.reason == "lost")
        with pytest.raises(TimeoutError):
            tracker.recv(timeout=0.05)


def raw(text):
    """A frame of a websocket with this text, masked with zeros."""
    data = text.encode()
    return bytes([0x81, 0xFE]) + len(data).to_bytes(2, "big") + bytes(4) + data


def test_an_application_that_does_not_read_delays_nobody(server):
    with socket.create_connection(("127.0.0.1", server.port)) as slow:
        lines = ["GET / HTTP/1.1", "Host: x", "Upgrade: websocket", "Connection: Upgrade"]
        lines += ["Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==", "Sec-WebSocket-Version: 13"]
        slow.sendall("\r\n".join([*lines, "", ""]).encode())
        slow.sendall(600 * raw(foci_of(place=400 * "x")))  # 0.3 MB of answers
        slow.sendall(raw(message("objects", add=[{"name": "box", "box": {"sides": [0.1] * 3}}])))
        until(lambda: "box" in names(server.world))
        with at.live.Client(server.words) as client:
            client.clear()
            server.world.show(None, "lost")
            assert client.next_state(PATIENCE) is not None


@pytest.mark.slow
def test_a_client_feels_a_ball_through_the_real_loop(tmp_path):
    """A recorded hand grasps the client's ball; a focus inside the hand gets a reason instead."""
    setup = at.read_scene("touch_ball", moving=True)
    scene = at.live.live_scene(setup)
    frames = at.hands.load_recording(at.example("grasping.jsonl")).frames
    hands = at.live.hands_from(setup, "websocket:0", tmp_path)
    maker = at.live.TouchAware(scene, solvers=[])
    statuses = []
    settings = {"seconds": PATIENCE, "world": hands.world, "report": statuses.append}
    output = at.live.Output()
    ended = []

    def run():
        ended.append(at.live.follow(scene, hands, maker, output=output, **settings))

    loop = Thread(target=run)
    loop.start()
    felt = inside = bad = False
    with at.live.Client(hands.words) as client:
        client.objects(at.VirtualObject(at.sphere(0.012, edge=0.004), name="mine"))
        client.remove("ball")
        end = time.monotonic() + PATIENCE / 2.0
        sequence = 0
        while not (felt and inside and bad) and time.monotonic() < end:
            # The frame in the middle holds the ball.
            frame = frames[min(sequence, len(frames) // 2)]
            client.hands(replace(frame, time=time.monotonic(), sequence=sequence))
            client.foci(at.live.WantedFocus("in", point=np.array(frame.landmarks[12])))
            sequence += 1
            if sequence % 30 == 0:
                client.remove("nothing")
            time.sleep(1.0 / 60.0)
            state = client.state
            if state is None:
                continue
            touched = {contact.part for contact in state.contacts if contact.object == "mine"}
            loud = {focus.id for focus in state.foci if (focus.pressure or 0.0) > 100.0}
            if {f"{part} at mine" for part in touched} & loud:
                felt = True
            reasons = [focus.reason for focus in state.foci if focus.id == "in"]
            inside |= any("inside" in (reason or "") for reason in reasons)
            bad |= any("'nothing'" in str(status) for status in statuses)
        output.stop()
        until(lambda: "stopped" in (client.state.reason or ""))
        client.foci(at.live.WantedFocus("in", point=np.zeros(3)))
        time.sleep(0.1)
        assert client.state.state == "silent"
    hands.ended = True  # the silent loop ends
    loop.join()
    assert ended[0].stopped
    assert (felt, inside, bad) == (True, True, True)
