"""The scripts of examples/trackers, as far as they go without the device."""

import importlib
import json
import os
import runpy
import subprocess
import sys
import threading
from types import SimpleNamespace

import numpy as np
import pytest
from websockets.sync.server import serve

import airtact as at
from paths import ROOT
from references.hand_pictures import facing, pictured
from references.hand_poses import example
from references.seen_by_mediapipe import MEDIAPIPE, seen_by_mediapipe

JOINTS, RADII = example("relaxed")
ADAPTERS = ROOT / "examples" / "trackers"
leap = SimpleNamespace(**runpy.run_path(str(ADAPTERS / "leap.py")))
PATIENCE = 120.0
"""Longest wait for a process [s]."""


def run(name, *arguments, **options):
    command = [sys.executable, ADAPTERS / name, *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, **options)


def leap_message(identity: int, *sides: str) -> str:
    """A frame as the Leap service tells it, in millimetres, of the relaxed hand or its mirror image."""
    hands, pointables = [], []
    for number, side in enumerate(sides):
        joints = (1e3 * JOINTS * ([1, 1, 1] if side == "left" else [-1, 1, 1])).tolist()
        hands.append({"id": number, "type": side, "wrist": joints[0], "palmPosition": joints[10]})
        for kind in range(5):
            chain = [1, 1, 2, 3, 4] if kind == 0 else list(range(5 * kind, 5 * kind + 5))
            places = dict(zip(leap.JOINTS, [joints[joint] for joint in chain], strict=True))
            pointables.append({"handId": number, "type": kind, "tool": False} | places)
    return json.dumps(
        {"id": identity, "timestamp": 33333 * identity, "hands": hands, "pointables": pointables}
    )


def test_what_leap_tells_is_read():
    greeting = json.dumps({"serviceVersion": "2.3.1+33747", "version": 6})
    messages = [greeting, leap_message(7, "left", "right"), leap_message(8, "right")]
    frames = [at.hands.from_json(json.dumps(frame)) for frame in leap.hands_in(iter(messages))]
    assert [(one.side, one.sequence, one.lost) for one in frames] == [
        ("left", 7, False),
        ("right", 7, False),
        ("left", 8, True),
        ("right", 8, False),
    ]
    np.testing.assert_allclose(frames[0].landmarks, JOINTS, atol=1e-6)
    assert frames[0].time == pytest.approx(7 * 0.033333)
    message = json.loads(leap_message(0, "left"))
    del message["pointables"][2]["dipPosition"]
    (incomplete,) = leap.hands_in(iter([json.dumps(message)]))
    with pytest.raises(at.hands.FaultyFrame) as caught:
        at.hands.from_json(json.dumps(incomplete))
    assert caught.value.fault == "half_lost"


def test_leap_is_received_through_its_own_process():
    def service(connection):
        assert json.loads(connection.recv(timeout=PATIENCE)) == {"background": True}
        for identity in range(5):
            connection.send(leap_message(identity, "left"))

    stream = at.hands.HandStream(silence=PATIENCE)
    with serve(service, "127.0.0.1", 0) as server, at.hands.WebSocketReceiver(stream) as receiver:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        service_address = f"ws://127.0.0.1:{server.socket.getsockname()[1]}"
        to = f"ws://127.0.0.1:{receiver.port}"
        done = run("leap.py", "--service", service_address, "--to", to)
        server.shutdown()
        thread.join()
        assert done.returncode == 0, done.stderr
        while (frame := stream.wait(PATIENCE)).sequence < 4:
            pass
    np.testing.assert_allclose(frame.landmarks, JOINTS, atol=1e-6)
    assert stream.health.received - stream.health.used == 0


def _realsense_loads() -> bool:
    try:
        importlib.import_module("pyrealsense2")
    except ImportError:
        return False
    return True


needs_realsense = pytest.mark.skipif(
    not _realsense_loads(), reason="pyrealsense2 does not load, as without libusb"
)


@pytest.fixture(scope="module")
def depths(tmp_path_factory):
    hand = at.hand_from_joints(JOINTS, RADII)
    pose = facing(hand, np.radians([10.0, -15.0, 5.0]), (0.02, 0.01, 0.4))
    folder = tmp_path_factory.mktemp("depths")
    seen = pictured(hand, pose, forearm=False)
    np.save(folder / "0.npy", seen.depth)
    np.save(folder / "1.npy", np.full_like(seen.depth, np.inf))
    return folder, hand, pose


@needs_realsense
def test_a_software_device_of_realsense_gives_the_cloud_of_the_skin(depths):
    folder, hand, pose = depths
    done = run("realsense.py", "--side", "left", "--depths", folder)
    assert done.returncode == 0, done.stderr
    first, second = (at.hands.from_json(line) for line in done.stdout.splitlines())
    assert second.lost
    assert 1000 < len(first.cloud) <= 4000
    off = np.abs(hand.shape.depth(first.moved(pose.inverse()).cloud))
    assert off.mean() < 0.5e-3  # pixels of 0.67 mm, triangles of 6 mm
    assert np.quantile(off, 0.99) < 2e-3


@needs_realsense
def test_realsense_without_a_camera_or_pictures_says_so(tmp_path):
    done = run("realsense.py", "--side", "left", "--depths", tmp_path)
    assert done.returncode == 1
    assert str(tmp_path) in done.stderr


def test_a_library_of_realsense_that_does_not_load_says_what_it_needs(tmp_path):
    fault = 'raise ImportError("libusb-1.0.so.0: cannot open shared object file")'
    (tmp_path / "pyrealsense2.py").write_text(fault, encoding="utf-8")
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    done = run("realsense.py", "--side", "left", "--depths", tmp_path, env=environment)
    assert done.returncode == 1
    assert done.stderr.startswith("pyrealsense2 does not load (libusb-1.0.so.0")
    assert "libusb-1.0-0" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.slow
@pytest.mark.skipif(
    MEDIAPIPE is None, reason="AIRTACT_MEDIAPIPE names no Python that has mediapipe"
)
def test_mediapipe_finds_our_hands_in_pictures_and_gives_their_landmarks_back(tmp_path):
    found = seen_by_mediapipe(tmp_path, MEDIAPIPE)
    assert len(found.shape_errors) >= 18
    assert found.shape_errors.mean() < 12e-3
    assert np.median(found.placed_errors) < 60e-3
    assert found.health.received - found.health.used <= 2


def test_the_adapter_of_mediapipe_needs_nothing_of_airtact():
    """It says how it is used by a Python that sees neither airtact nor mediapipe."""
    command = [sys.executable, "-I", "-S", ADAPTERS / "mediapipe_camera.py", "--help"]
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=PATIENCE, env={"PATH": os.environ["PATH"]}
    )
    assert done.returncode == 0, done.stderr
    assert "--hand-length" in done.stdout
