"""SonicSurface and Nano16 over a real terminal device, with noise on the line, dead boards and cut cables."""

import sys
import time

import jaxtyping
import numpy as np
import pytest

from airtact.drives.frame import Frame
from airtact.emission.codecs import codec_of
from airtact.emission.link import LinkFailed
from airtact.emission.serial_link import SerialLink
from emission.receivers import Nano16, SonicSurface, TwoSonicSurfaces, first_harmonic, wired
from emission.test_codecs import random_frame
from faults import raises_code

KINDS = [
    ("sonicsurface", 1, SonicSurface),
    ("sonicsurface", 2, TwoSonicSurfaces),
    ("nano16", 1, Nano16),
]


def plays(model, frame: Frame) -> bool:
    return bool(
        np.allclose(first_harmonic(model.pulses()), frame.drive().amplitudes, rtol=0, atol=1e-9)
    )


@pytest.mark.parametrize(("name", "boards", "model"), KINDS)
def test_frames_are_exact_over_a_terminal(name: str, boards: int, model) -> None:
    with wired(model()) as wire:
        link = SerialLink(wire.port, name, boards)
        link.open()
        size = len(link.codec.encode(link.zero()))
        wire.settle(2 * size)
        assert plays(wire.board, link.zero())
        for count in range(3, 8):
            frame = random_frame(name, boards, seed=count)
            link.send(frame)
            wire.settle(count * size)
            assert plays(wire.board, frame)
            assert bytes(wire.written[-size:]) == link.codec.encode(frame)
        link.stop()
        wire.settle(9 * size)
        assert plays(wire.board, link.zero())
        wire.board.hear(
            0xFD if name == "sonicsurface" else 0x00
        )  # a swap too many brings back no sound
        assert plays(wire.board, link.zero())
        link.close()


@pytest.mark.parametrize(("name", "boards", "model"), KINDS)
def test_a_board_that_sounds_from_power_on_is_silenced_by_opening(
    name: str, boards: int, model
) -> None:
    board = model()
    assert first_harmonic(board.pulses()).any()
    with wired(board) as wire:
        link = SerialLink(wire.port, name, boards)
        link.open()
        wire.settle(2 * len(link.codec.encode(link.zero())))
        assert not first_harmonic(wire.board.pulses()).any()
        link.close()


def until_it_fails(link: SerialLink, frame: Frame) -> str:
    for _ in range(50):
        try:
            link.send(frame)
        except LinkFailed as error:
            return error.code
        time.sleep(0.001)
    return "nothing was noticed"


def one_case(case: int) -> None:
    """Noise before a frame, noise from the board, or a cut cable: the frame is played or an error raised."""
    random = np.random.default_rng(case)
    name, boards, model = KINDS[case % 3]
    kind = ("noise to the board", "noise from the board", "cut")[case // 3 % 3]
    noise = random.integers(0, 256, int(random.integers(1, 600))).astype(np.uint8).tobytes()
    frame = random_frame(name, boards, case)
    board = model()
    size = len(codec_of(name).encode(frame))
    if kind == "noise to the board":
        for byte in noise:
            board.hear(byte)
    cut_after = int(random.integers(2 * size + 1, 4 * size)) if kind == "cut" else None
    with wired(
        board, noise=noise if kind == "noise from the board" else b"", cut_after=cut_after
    ) as wire:
        link = SerialLink(wire.port, name, boards)
        link.open()
        if kind == "cut":
            assert until_it_fails(link, frame) == "link_failed"
        else:
            link.send(frame)
            wire.settle(3 * size)
            assert plays(wire.board, frame), f"case {case} ({kind})"
            link.close()


def test_noise_and_cut_cables_end_in_a_frame_or_a_sentence() -> None:
    for case in range(45):
        one_case(case)


def test_a_board_that_does_not_answer_is_said_to_be_silent() -> None:
    with wired(Nano16(mute=True)) as wire:
        link = SerialLink(wire.port, "nano16", boot=0.0)
        with pytest.raises(LinkFailed):
            link.open()


def test_a_board_that_falls_silent_is_told_with_what_was_sent_last() -> None:
    with wired(Nano16()) as wire:
        link = SerialLink(wire.port, "nano16")
        link.open()
        link.send(random_frame("nano16", 1, 1))
        wire.board.mute = True
        with pytest.raises(LinkFailed, match="the last of 1 frames sent had"):
            link.send(random_frame("nano16", 1, 2))
        link.close()


def test_a_board_that_needs_time_to_begin_is_waited_for() -> None:
    """A Nano begins anew when its port is opened and hears nothing while its boot loader runs."""

    class Booting(Nano16):
        deaf_for = 150

        def hear(self, byte: int) -> bytes:
            self.deaf_for -= 1
            return b"" if self.deaf_for > 0 else super().hear(byte)

    with wired(Booting()) as wire:
        link = SerialLink(wire.port, "nano16")
        link.open()
        frame = random_frame("nano16", 1, 3)
        link.send(frame)
        assert plays(wire.board, frame)
        link.close()


def test_a_rate_that_the_line_cannot_carry_is_rejected() -> None:
    for name, boards, rate in (
        ("sonicsurface", 1, 88),
        ("sonicsurface", 2, 44),
        ("nano16", 1, 174),
    ):
        link = SerialLink("nowhere", name, boards)
        link.check_sequence(10, rate)
        with raises_code("out_of_range", f"{rate + 2} frames/s exceed the {rate} frames/s"):
            link.check_sequence(10, rate + 2)


def busy() -> None:
    with wired(SonicSurface()) as wire:
        first = SerialLink(wire.port)
        first.open()
        try:
            SerialLink(wire.port).open()
        finally:
            first.close()


@pytest.mark.parametrize(
    ("make", "code"),
    [
        (
            lambda: SerialLink("/dev/no-such-port").open(),
            "link_failed",
        ),
        pytest.param(busy, "link_in_use", id="busy"),
        (lambda: SerialLink(None), "wrong_kind"),
        (
            lambda: SerialLink("x", boards=1.5),
            "sizes_differ",
        ),
        (lambda: SerialLink("x", "openmpd"), "unknown_name"),
        (
            lambda: SerialLink("x", "sonicsurface", 3),
            "sizes_differ",
        ),
        (lambda: SerialLink("x", "nano16", 2), "sizes_differ"),
        (lambda: SerialLink("x", "nano16").play([], 10), "not_supported"),
    ],
)
def test_ports_that_cannot_be_are_rejected(
    make, code: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)  # as it is outside the tests
    with raises_code(code):
        make()


def test_a_missing_pyserial_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "serial", None)
    with raises_code("extra_missing", "airtact[serial]"):
        SerialLink("x").open()
