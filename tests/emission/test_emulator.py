"""Our bytes in the emulator of AUTD3's makers: the field in open air, and the sense of phase in time."""

import functools
from contextlib import contextmanager

import numpy as np
import pyautd3
import pytest
from pyautd3_emulator import Emulator, InstantRecordOption, RangeXYZ, RmsRecordOption
from scipy.spatial.transform import Rotation

import airtact as at
from airtact.emission import autd3_link

SPEED = 340.0
SENSITIVITY = 275.574246 * 0.2 / (4 * np.pi)
"""Peak pressure of the emulator's transducer at 1 m [Pa·m]: its constant is that of autd3-core, in Pa·mm over 4π."""


@contextmanager
def recorded(devices, frame: at.drives.Frame, milliseconds: int):
    """Play a frame in the emulator. The record is kept while its field is in use: the library frees it otherwise."""
    words = at.AUTD3Link([board for board, _ in devices])._words(frame)
    boards = [board for _, board in devices]
    with Emulator(boards) as emulator:

        def play(controller) -> None:
            controller.send(pyautd3.Silencer.disable())
            controller.send((pyautd3.Static(), autd3_link._gain_of(words)))
            controller.tick(pyautd3.Duration.from_millis(milliseconds))

        yield emulator.record(play)


def as_device(pose):
    turn = np.array(Rotation.from_matrix(pose.rotation).as_quat(scalar_first=True))
    return pose, pyautd3.AUTD3(pos=1e3 * pose.translation, rot=turn)


def test_the_field_in_open_air_is_that_of_the_emulator() -> None:
    array = at.surrounding_box(element=at.monopole(SENSITIVITY), board="autd3")
    scene = at.Scene(at.Medium(SPEED, 1.2), [])
    target = at.Target(np.array([[-8e-3, 0.0, 5e-3], [8e-3, 0.0, 5e-3]]))
    transfer = at.transfer_matrix(at.FreeField().radiate(scene, target.beacons()), array)
    frame = at.quantise(at.time_reversal(transfer, target))
    poses = at.transducers.poses_of_boards(
        at.transducers.board_named("autd3"), array.positions, array.normals
    )
    with recorded([as_device(pose) for pose in poses], frame, 1) as record:
        ranges = RangeXYZ(x=(-20, 20), y=(0, 0), z=(-10, 20), resolution=2.0)
        field = record.sound_field(ranges, RmsRecordOption(sound_speed=1e3 * SPEED))
        points = 1e-3 * field.observe_points().to_numpy().astype(float)
        theirs = field.next(pyautd3.Duration.from_millis(1)).to_numpy()[:, -1]
        np.testing.assert_array_equal(record.phase().to_numpy()[:, -1], frame.phase)
    ours = np.abs(
        at.field_map(scene, array, frame.drive(), points, solver=at.FreeField())
    ) / np.sqrt(2.0)
    # Pulse widths of 9 bits give each amplitude to 0.3 % of full scale; over 996 transducers that
    # averages out.
    assert np.abs(theirs - ours).max() < 1e-3 * ours.max()
    foci = np.abs(at.field_map(scene, array, frame.drive(), target.points, solver=at.FreeField()))
    np.testing.assert_allclose(foci, np.abs(transfer.pressure(frame.drive())), rtol=1e-9)


@functools.cache
def trace(level: int) -> np.ndarray:
    """Pressure at 100 mm before one transducer over 1 ms in steps of 1 µs, once all transients are over."""
    amplitude = np.zeros(249, dtype=np.uint8)
    phase = np.full(249, level, dtype=np.uint8)
    amplitude[0] = 255
    with recorded([as_device(at.Pose.identity())], at.drives.Frame(amplitude, phase), 4) as record:
        here = RangeXYZ(x=(0, 0), y=(0, 0), z=(100, 100), resolution=1.0)
        option = InstantRecordOption(
            sound_speed=1e3 * SPEED, time_step=pyautd3.Duration.from_micros(1)
        )
        sound = record.sound_field(here, option)
        return (
            sound.skip(pyautd3.Duration.from_millis(3))
            .next(pyautd3.Duration.from_millis(1))
            .to_numpy()[0]
        )


@pytest.mark.parametrize(("level", "later"), [(64, 0.25), (160, 0.625)])
def test_a_larger_phase_arrives_later(level: int, later: float) -> None:
    """In time: the trace of level 64 is that of level 0 shifted by a quarter of 25 µs, and its phasor turned by +i."""
    times = 1e-6 * np.arange(1000)
    phasors = [np.sum(trace(one) * np.exp(2j * np.pi * 40e3 * times)) for one in (0, level)]
    turn = np.angle(phasors[1] / phasors[0] * np.exp(-2j * np.pi * later))
    assert abs(turn) < 1e-2
    drive = at.drives.Frame(np.full(1, 255, np.uint8), np.full(1, level, np.uint8)).drive()
    np.testing.assert_allclose(drive.amplitudes, np.exp(2j * np.pi * later), rtol=1e-12)
