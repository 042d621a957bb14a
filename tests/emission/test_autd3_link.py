"""AUTD3 boards through the real pyautd3: its geometry, and bytes through the firmware's model and back."""

import importlib.metadata
import sys

import jaxtyping
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import airtact as at
from airtact.drives.frame import Frame
from airtact.emission.link import LinkFailed
from airtact.transducers.boards import board_named, poses_of_boards
from airtact.transducers.layout import board_array, surrounding_box
from emission.odd_links import Audit
from faults import raises_code


def random_frame(elements: int, seed: int = 0) -> Frame:
    random = np.random.default_rng(seed)
    return Frame(*(random.integers(0, 256, elements).astype(np.uint8) for _ in range(2)))


def random_poses(count: int) -> list[at.Pose]:
    random = np.random.default_rng(4)
    return [
        at.Pose(turn, random.uniform(-0.3, 0.3, 3))
        for turn in Rotation.random(count, rng=random).as_matrix()
    ]


@pytest.fixture
def link():
    box = surrounding_box(board="autd3")
    link = at.AUTD3Link(poses_of_boards(board_named("autd3"), box.positions, box.normals))
    link.open()
    yield link
    link.close()


def test_our_layout_is_that_of_pyautd3() -> None:
    """Four boards at random poses: positions to 1e-4 mm, directions alike. pyautd3 computes in single precision."""
    poses = random_poses(4)
    array = board_array("autd3", poses)
    link = at.AUTD3Link(poses)
    link.open()
    theirs = np.array([one.position() for board in link._controller for one in board])
    looks = np.array([board.axial_direction() for board in link._controller for _ in range(249)])
    link.close()
    assert np.abs(theirs - 1e3 * array.positions).max() < 1e-4
    np.testing.assert_allclose(looks, array.normals, rtol=0, atol=1e-6)


def test_every_byte_comes_back_from_the_firmware(link: at.AUTD3Link) -> None:
    for seed in range(5):
        frame = random_frame(996, seed)
        link.send(frame)
        played = link.played()
        differ = np.count_nonzero(played.amplitude != frame.amplitude) + np.count_nonzero(
            played.phase != frame.phase
        )
        assert differ == 0


def test_the_firmware_plays_pressure_in_proportion_to_the_level(link: at.AUTD3Link) -> None:
    """Pulses of w of 512 ticks have the first harmonic sin(πw/512), and 8 bits of width leave 0.3 % of full scale."""
    table = np.array(
        [width.pulse_width(512) for width in link._controller.link().pulse_width_encoder_table(0)]
    )
    np.testing.assert_array_equal(table, np.rint(512 / np.pi * np.arcsin(np.arange(256) / 255)))
    np.testing.assert_allclose(
        np.sin(np.pi * table / 512), np.arange(256) / 255, rtol=0, atol=np.pi / 1024
    )


@pytest.mark.parametrize("rate", [100.0, 4000.0, 40_000.0, 40_000 / 3])
def test_a_sequence_lies_in_the_boards_frame_by_frame(link: at.AUTD3Link, rate: float) -> None:
    frames = [random_frame(996, seed) for seed in range(6)]
    link.play(frames, rate)
    assert all(link.played(index).same_as(frame) for index, frame in enumerate(frames))
    model = link._controller.link()
    segment = model.current_stm_segment(0)
    assert model.stm_cycle(0, segment) == 6
    assert model.stm_freqency_divide(0, segment) == round(40_000 / rate)
    assert link.last is frames[-1]
    link.stop()
    assert link.played().silent
    assert model.stm_cycle(3, model.current_stm_segment(3)) == 1
    assert (
        model.silencer_completion_steps_intensity(0),
        model.silencer_completion_steps_phase(0),
    ) == (10, 40)


def test_opening_and_stopping_leave_silence(link: at.AUTD3Link) -> None:
    assert link.played().silent
    link.send(random_frame(996))
    assert not link.played().silent
    link.stop()
    assert link.played().silent
    assert link.last is not None
    assert link.last.silent


def test_a_link_whose_cable_was_cut_can_be_opened_again() -> None:
    link = Audit()
    link.open()
    frame = random_frame(249)
    link.send(frame)
    link.cut()
    for call in (lambda: link.send(random_frame(249, 1)), link.stop, link.close):
        with pytest.raises(LinkFailed, match="the last of 1 frames sent had"):
            call()
    link.open()
    link.send(frame)
    assert link.played().same_as(frame)
    link.close()


@pytest.mark.parametrize(
    ("frames", "rate", "code"),
    [
        (
            8,
            70.0,
            "out_of_range",
        ),
        (8, 50_000.0, "out_of_range"),
        (8, 0.1, "out_of_range"),
        (8, 0.0, "out_of_range"),
        (8, np.nan, "out_of_range"),
        (1025, 100.0, "sizes_differ"),
        (1, 100.0, "sizes_differ"),
        (0, 100.0, "empty"),
    ],
)
def test_sequences_that_the_boards_refuse(
    link: at.AUTD3Link, frames: int, rate: float, code: str
) -> None:
    with raises_code(code):
        link.play([random_frame(996)] * frames, rate)
    assert link.played().silent


@pytest.mark.parametrize(
    ("make", "code"),
    [
        (lambda link: link.send(random_frame(249)), "sizes_differ"),
        (lambda link: link.send(None), "wrong_kind"),
        (lambda link: at.AUTD3Link(at.Pose.identity()), "wrong_kind"),
        (lambda link: at.AUTD3Link([None]), "wrong_kind"),
        (lambda link: at.AUTD3Link([]), "sizes_differ"),
        (lambda link: at.AUTD3Link([at.Pose.identity()], "usb"), "unknown_name"),
        (lambda link: at.AUTD3Link([at.Pose.identity()], "remote"), "key_missing"),
        (
            lambda link: at.AUTD3Link([at.Pose.identity()]).send(random_frame(249)),
            "link_closed",
        ),
        (
            lambda link: at.AUTD3Link([at.Pose.identity()], "remote", "x").played(),
            "not_supported",
        ),
        (
            lambda link: at.AUTD3Link([at.Pose.identity()], "remote", "127.0.0.1:9").open(),
            "link_failed",
        ),
        (
            lambda link: at.AUTD3Link([at.Pose.identity()], "ethercrab", "no0").open(),
            "link_failed",
        ),
        (lambda link: at.AUTD3Link([at.Pose.identity()], "twincat").open(), "link_failed"),
    ],
)
def test_what_cannot_be_is_rejected(link, make, code: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)  # as it is outside the tests
    with raises_code(code):
        make(link)


def test_a_missing_pyautd3_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyautd3", None)
    with raises_code("extra_missing", "airtact[autd3-legacy]"):
        at.AUTD3Link([at.Pose.identity()]).open()


def test_an_unknown_pyautd3_names_the_version(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.metadata, "version", lambda name: "38.0.1")
    with raises_code("unsupported_version", "38.0.1", "36.0.2"):
        at.AUTD3Link([at.Pose.identity()]).open()
