"""Touches that are asked for, found in the frames of a tracker, and written to the scene file."""

import threading
import tomllib

import numpy as np
import pytest
from websockets.sync.client import connect

import airtact as at
from airtact.cli import main
from airtact.hands.tracking.registration import INDEX_TIP
from airtact.live.registering import with_tracker
from faults import raises_code

TRACKER = at.Pose.turn((1.0, 0.2, 0.0), 2.9, translation=(0.02, 0.03, 0.5))


def touching(setup: at.Setup, shifts: dict[int, float], order=None) -> list[at.hands.HandFrame]:
    """Frames of a hand that touches the transducers in turn, some of them too far along x [m]."""
    hand, array = setup.hands[0], setup.array
    elements = at.live.elements_to_touch(array)
    random = np.random.default_rng(0)
    places = []
    for time, number in enumerate(range(6) if order is None else order):
        element = elements[number]
        place = array.positions[element] + hand.radii[INDEX_TIP] * array.normals[element]
        place = place + [shifts.get(time, 0.0), 0.0, 0.0]
        if places:
            way = np.linspace(0.0, 1.0, 30)[1:-1, None]
            places += [*(places[-1] + way * (place - places[-1]) + 0.04 * np.sin(np.pi * way))]
        places += [place] * 63
    frames = []
    for index, place in enumerate(places):
        joints = hand.joints + place - hand.joints[INDEX_TIP]
        seen = TRACKER.inverse().apply(joints + 0.5e-3 * random.normal(size=joints.shape))
        frames.append(at.hands.HandFrame(index / 60, hand.side, index, seen))
    return frames


def assert_found(found: at.live.RegisteredTracker) -> None:
    assert found.fit.repeat is None
    point = np.array([0.1, 0.0, 0.4])
    assert np.linalg.norm(found.fit.tracker.apply(point) - TRACKER.apply(point)) < 1e-3


def test_touches_of_a_recording_give_the_pose_and_a_wrong_one_is_asked_for_again(
    example_setup, tmp_path
):
    path = tmp_path / "touches.jsonl"
    at.hands.save_recording(path, touching(example_setup, {2: 0.02}, [0, 1, 2, 3, 4, 5, 2]))
    steps: list[at.live.TouchStep] = []
    found = at.live.register_tracker(example_setup, str(path), report=steps.append)
    assert_found(found)
    taken = [step.number for step in steps if step.share == 1.0]
    assert taken == [1, 2, 3, 4, 5, 6, 3]
    assert "again, which was off by 20 mm" in str(steps[-1])
    np.testing.assert_array_equal(steps[0].point, example_setup.array.positions[steps[0].element])
    assert tomllib.loads(found.table())["tracker"]["degrees"] == pytest.approx(
        np.degrees(2.9), abs=0.3
    )


def test_touches_by_websocket_give_the_pose(example_setup):
    frames = touching(example_setup, {})
    steps: list[at.live.TouchStep] = []
    sender: list[threading.Thread] = []

    def send(address: str) -> None:
        with connect(address, compression=None) as tracker:
            for frame in frames:
                tracker.send(at.hands.to_json(frame))

    def report(step: at.live.TouchStep) -> None:
        steps.append(step)
        if not sender:  # the first step says where the server listens
            address = step.trouble.rpartition(" ")[2]
            sender.append(threading.Thread(target=send, args=(address,)))
            sender[0].start()

    found = at.live.register_tracker(example_setup, "websocket:0", report=report)
    sender[0].join()
    assert_found(found)


def test_too_few_touches_and_no_such_transducer_are_rejected(example_setup, tmp_path):
    path = tmp_path / "touches.jsonl"
    at.hands.save_recording(path, touching(example_setup, {}, [0, 1]))
    with raises_code("too_few", "2 touches"):
        at.live.register_tracker(example_setup, str(path))
    with raises_code("out_of_range", "9999"):
        at.live.register_tracker(example_setup, str(path), [0, 1, 9999])
    with raises_code("out_of_range"):
        at.live.elements_to_touch(example_setup.array, 2)


def test_the_command_writes_a_copy_and_never_an_example(example_setup, tmp_path, capsys):
    path = str(tmp_path / "touches.jsonl")
    at.hands.save_recording(path, touching(example_setup, {}))
    scene = at.example("live_pinch")
    copy = tmp_path / "scene.toml"
    assert main(["register", str(scene), "--from", path, "--write"]) == 2
    assert "[not_writable]" in capsys.readouterr().err
    command = ["register", str(scene), "--from", path, "--out", str(copy), "--quiet"]
    assert main([*command, "--page", "--page-port", "0"]) == 0
    assert "Page: http://127.0.0.1:" in capsys.readouterr().err
    written = copy.read_text()
    assert written.startswith(scene.read_text().rstrip())
    tracker = tomllib.loads(written)["tracker"]
    np.testing.assert_allclose(tracker["translation"], TRACKER.translation, atol=2e-3)


@pytest.mark.parametrize(
    ("before", "kept"),
    [
        ("a = 1 # one\n", ["a = 1 # one"]),
        (
            "a = 1\n[tracker] # hangs\n# above\ndegrees = 3.0 # turn\naxis = [1, 0, 0]\n[b]\nc = 2 # two\n",
            ["[tracker] # hangs", "# above", "# turn", "[b]", "c = 2 # two"],
        ),
        (
            "[tracker]\nrotation = [\n  [1, 0, 0],\n  [0, 1, 0],\n  [0, 0, 1],\n]\n\n[b]\nc = [\n  [2],\n]\n",
            ["[b]"],
        ),
    ],
)
def test_a_scene_keeps_all_but_its_tracker(before, kept):
    after = with_tracker(before, TRACKER)
    for line in kept:
        assert line in after
    values = tomllib.loads(after)
    tracker = values.pop("tracker")
    assert set(tracker) == {"axis", "degrees", "translation"}
    old = tomllib.loads(before)
    old.pop("tracker", None)
    assert values == old
    pose = at.Pose.turn(np.array(tracker["axis"]), np.radians(tracker["degrees"]))
    np.testing.assert_allclose(pose.rotation, TRACKER.rotation, atol=1e-5)
    # Another time it changes nothing but the numbers.
    assert with_tracker(after, TRACKER) == after


def test_a_tracker_written_otherwise_is_left_to_the_user():
    with raises_code("not_writable"):
        with_tracker("tracker = { translation = [0, 0, 1] }\n", TRACKER)
