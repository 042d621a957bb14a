"""Messages of boards, heard by models of their firmware: exact, and with our sense of phase."""

from dataclasses import replace

import numpy as np
import pytest

import airtact as at
from airtact.drives.frame import Frame
from airtact.drives.transfer import TransferMatrix, rounding_error
from airtact.emission.codecs import codec_of
from airtact.transducers.boards import board_named
from airtact.transducers.layout import surrounding_box
from airtact.transducers.levels import Levels
from emission.receivers import Nano16, OpenMPD, SonicSurface, TwoSonicSurfaces, first_harmonic
from faults import raises_code

RECEIVERS = {"sonicsurface": SonicSurface, "nano16": Nano16, "openmpd": OpenMPD}


def random_drive(elements: int, seed: int = 0) -> at.Drive:
    random = np.random.default_rng(seed)
    amplitudes = random.uniform(0, 1, elements) * np.exp(2j * np.pi * random.uniform(size=elements))
    amplitudes[random.integers(0, elements, max(elements // 20, 1))] = 0.0
    return at.Drive(amplitudes)


def random_frame(name: str, boards: int, seed: int) -> Frame:
    levels = codec_of(name).levels
    random = np.random.default_rng(seed)
    elements = boards * len(board_named(name))
    amplitude = random.integers(0, len(levels.amplitudes), elements).astype(np.uint8)
    phase = random.integers(0, levels.phases, elements).astype(np.uint8)
    return Frame(amplitude, np.where(amplitude > 0, phase, 0).astype(np.uint8), levels)


def heard_by(model, message: bytes) -> np.ndarray:
    for byte in message:
        model.hear(byte)
    return model.pulses()


@pytest.mark.parametrize("name", RECEIVERS)
def test_what_a_board_plays_is_the_drive_rounded(name: str) -> None:
    """The pulses of the firmware's model, as phasors, are the drive that the frame stands for, element by element."""
    codec = codec_of(name)
    board = board_named(name)
    drive = random_drive(len(board))
    frame = at.quantise(drive, codec.levels)
    played = first_harmonic(heard_by(RECEIVERS[name](), codec.encode(frame)))
    channels = board.channels if name == "openmpd" else np.arange(len(board))
    # An odd number of ticks less than half a period cannot keep the middle of a pulse: half a tick
    # of 128 remains.
    half_tick = np.pi / 128 if name == "openmpd" else 0.0
    np.testing.assert_allclose(
        played[channels], frame.drive().amplitudes, rtol=0, atol=1e-9 + half_tick
    )
    loud = np.abs(frame.drive().amplitudes) > 0.2
    turns = np.angle(played[channels][loud] / drive.amplitudes[loud]) / (2 * np.pi)
    assert np.abs(turns).max() <= 0.5 / codec.levels.phases + half_tick / (2 * np.pi) + 1e-12


@pytest.mark.parametrize("name", RECEIVERS)
def test_a_quarter_turn_arrives_a_quarter_of_a_period_later(name: str) -> None:
    codec = codec_of(name)
    board = board_named(name)
    drive = np.ones(len(board), dtype=complex)
    drive[1] = 1j
    pulses = heard_by(RECEIVERS[name](), codec.encode(at.quantise(at.Drive(drive), codec.levels)))
    channels = board.channels if name == "openmpd" else np.arange(len(board))
    first = pulses[:, channels[0]]
    later = pulses[:, channels[1]]
    np.testing.assert_array_equal(later, np.roll(first, len(pulses) // 4))
    assert not np.array_equal(later, first)


def test_two_sonicsurfaces_swap_together() -> None:
    codec = codec_of("sonicsurface")
    frame = random_frame("sonicsurface", 2, 3)
    message = codec.encode(frame)
    assert message.count(0xFD) == 1
    assert 0xFB not in message
    pair = TwoSonicSurfaces()
    np.testing.assert_allclose(
        first_harmonic(heard_by(pair, message)), frame.drive().amplitudes, atol=1e-12
    )


def test_lengths_and_marks_are_those_of_the_firmware() -> None:
    sizes = {"autd3": 498, "sonicsurface": 259, "nano16": 66, "openmpd": 512}
    for name, size in sizes.items():
        assert len(codec_of(name).encode(random_frame(name, 1, 1))) == size
    sonic = codec_of("sonicsurface").encode(random_frame("sonicsurface", 2, 1))
    assert (sonic[0], sonic[1], sonic[258], sonic[259], sonic[-1]) == (0xC0, 0xFE, 0xC1, 0xFE, 0xFD)
    nano = codec_of("nano16").encode(random_frame("nano16", 1, 1))
    assert (nano[0], nano[-1]) == (0x10, 0x00)
    assert all(byte & 0x0F == 1 for byte in nano[1:-1])
    openmpd = codec_of("openmpd").encode(random_frame("openmpd", 2, 1))
    assert [index for index, byte in enumerate(openmpd) if byte & 128] == [0, 512]


def focus() -> tuple[TransferMatrix, at.Drive]:
    box = surrounding_box(board="autd3")
    k = 2 * np.pi * 40e3 / 343.1
    points = np.array([[-0.008, 0.0, 0.005], [0.008, 0.0, 0.005]])
    distance = np.linalg.norm(box.positions[None] - points[:, None], axis=2)
    transfer = TransferMatrix(np.exp(1j * k * distance) / distance, 0.0)
    return transfer, at.time_reversal(transfer, at.Target(points))


def test_rounding_costs_what_it_may() -> None:
    transfer, drive = focus()
    eight_bits = rounding_error(transfer, drive, at.quantise(drive))
    assert 0.0 < np.abs(eight_bits).max() < 1e-3
    five_bits = Levels(np.array([0.0, 1.0]), phases=32)
    every = drive.phase_only()
    # Rounding phases to N levels leaves sinc(1/N) of a focus in the mean: 0.9984 for 32.
    phases_alone = rounding_error(transfer, every, at.quantise(every, five_bits))
    np.testing.assert_allclose(phases_alone, np.sinc(1 / 32) - 1.0, rtol=0, atol=2e-3)
    # Playing all as loud as the loudest loses what time reversal knew of distances: never more than
    # it had.
    assert np.all(rounding_error(transfer, drive, at.quantise(drive, five_bits)) < 0.0)


def test_a_board_without_messages_is_refused():
    board = replace(board_named("nano16"), name="own")
    with raises_code("not_supported"):
        codec_of(board)
