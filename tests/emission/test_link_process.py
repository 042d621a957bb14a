"""The process of a link: what it does when it is lost itself, who may have a board, and what it plays meanwhile."""

import os
import pickle
import signal
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import airtact as at
from airtact.drives.frame import frame_at
from airtact.emission.link import LinkFailed, RecordingLink, lock_boards
from airtact.emission.link_process import Channel
from airtact.emission.serial_link import SerialLink
from airtact.transducers.levels import AmplitudeModulation
from emission.odd_links import Audit
from emission.receivers import SonicSurface, wired
from emission.sounds import VirtualTime, ended, events, moving, playing, strongest, tone
from faults import raises_code

FULL = "frame 1 loudest 1"


@pytest.mark.parametrize("kind", [signal.SIGKILL, signal.SIGSEGV])
def test_another_process_silences_the_boards_when_the_link_process_is_lost(
    kind, tmp_path: Path
) -> None:
    log = tmp_path / "log"

    def work(emission) -> None:
        emission.send(tone())
        os.kill(emission.process, kind)
        emission.hold(60.0)

    with pytest.raises(LinkFailed) as lost:
        playing(Audit(), work, log=log)
    assert lost.value.code == "link_process_lost"
    assert events(log) == ["opened", FULL, "opened", "silence confirmed", "closed"]


def test_a_lost_link_process_is_reported_where_nothing_is_called_any_more() -> None:
    emission = at.Emission(RecordingLink(), cap=1.0, ramp=0.0).__enter__()
    emission.send(tone())
    os.kill(emission.process, signal.SIGKILL)
    with pytest.raises(LinkFailed) as lost:
        emission.__exit__(None, None, None)
    assert lost.value.code == "link_process_lost"
    with pytest.raises(LinkFailed) as over:
        emission.beat()
    assert over.value.code == "emission_over"


def test_a_link_process_that_nobody_can_end_by_asking_stays_until_its_feeder_leaves(
    tmp_path: Path,
) -> None:
    def work(emission) -> None:
        emission.send(tone())
        for kind in (
            signal.SIGINT,
            signal.SIGTERM,
            signal.SIGHUP,
            signal.SIGPIPE,
            signal.SIGALRM,
            signal.SIGUSR1,
        ):
            os.kill(emission.process, kind)
        emission.hold(0.1)

    log = tmp_path / "log"
    playing(RecordingLink(), work, log=log)
    assert events(log) == ["opened", FULL, "silence confirmed", "closed"]


HOLDER = """
import sys, time, numpy as np, airtact as at
from airtact.emission import SerialLink
with at.Emission(SerialLink(sys.argv[1]), cap=1.0) as emission:
    print("open", flush=True)
    sys.stdin.read()
"""


def test_a_board_that_another_process_uses_is_not_opened_and_free_once_that_is_killed() -> None:
    with wired(SonicSurface()) as wire:
        command = [sys.executable, "-c", HOLDER, wire.port]
        with subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        ) as first:
            assert first.stdout is not None
            assert first.stdout.readline() == "open\n"
            with (
                raises_code("link_in_use", wire.port),
                at.Emission(SerialLink(wire.port), cap=1.0),
            ):
                pytest.fail("the block must not begin")
            first.kill()
        playing(SerialLink(wire.port), lambda emission: emission.send(tone(256)))


def test_a_link_that_cannot_be_elsewhere_is_here_and_says_so() -> None:
    class Local(RecordingLink):
        pass

    link = Local()
    emission = at.Emission(link, cap=1.0, ramp=0.0)
    with pytest.warns(UserWarning, match="keep emitting"):
        emission.__enter__()
    assert emission.process is None
    emission.send(tone())
    emission.__exit__(None, None, None)
    assert ended(link)


def test_a_log_that_cannot_be_written_is_rejected(tmp_path: Path) -> None:
    with (
        raises_code("not_writable"),
        at.Emission(RecordingLink(), log=tmp_path / "no" / "log"),
    ):
        pytest.fail("the block must not begin")


def test_a_log_empties_no_file_of_others(tmp_path: Path) -> None:
    notes = tmp_path / "notes.txt"
    notes.write_text("measured on Tuesday")
    with raises_code("would_overwrite", str(notes)), at.Emission(RecordingLink(), log=notes):
        pytest.fail("the block must not begin")
    assert notes.read_text() == "measured on Tuesday"


def test_the_lock_of_a_board_follows_no_link(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    os.close(lock_boards("the port") or 0)
    (lock,) = tmp_path.iterdir()
    notes = tmp_path / "notes.txt"
    notes.write_text("mine")
    lock.unlink()
    lock.symlink_to(notes)
    with raises_code("link_in_use", "the port"):
        lock_boards("the port")
    assert notes.read_text() == "mine"


# --- what it plays --------------------------------------------------------------------------------------------------


def test_boards_that_modulate_themselves_go_on_while_drives_change() -> None:
    """The firmware's model holds the envelope; new drives change the gains alone, and silence ends it."""
    modulation = AmplitudeModulation(200.0, depth=0.8)
    drives = [tone(), tone(loudness=0.5)]
    with at.Emission(Audit(), cap=1.0, ramp=0.0) as emission:
        emission.set_modulation(modulation)
        for drive in drives:
            emission.send(drive)
            assert emission.link.played().same_as(at.quantise(drive))
            np.testing.assert_array_equal(
                emission.link.played_modulation(),
                np.rint(255 * modulation.envelope(20)).astype(np.uint8),
            )
        emission.silence(fade=0.05)
        assert emission.link.played().silent
        assert set(emission.link.played_modulation()) == {255}
        emission.send(drives[0])
        assert len(emission.link.played_modulation()) == 20
        emission.set_modulation(None)
        assert set(emission.link.played_modulation()) == {255}
        assert emission.link.played().same_as(at.quantise(drives[0]))


def test_other_boards_are_sent_the_newest_drive_at_each_time_of_the_modulation(monkeypatch) -> None:
    """20 Hz in 4 frames at 80 frames/s: a frame is the newest drive times the envelope of a clock that goes on."""
    clock = VirtualTime(monkeypatch)
    link = RecordingLink("sonicsurface")
    player = clock.player(link)
    drives = moving(12, 256)
    envelope = AmplitudeModulation(20.0).envelope(4)
    player.modulate(envelope, 80.0)
    for millisecond in range(360):
        clock.now = 1e-3 * millisecond
        if millisecond % 30 == 0:
            clock.send(player, drives[millisecond // 30])
        player.step()
    # A frame is due every 12.5 ms, and sent at the first millisecond after.
    np.testing.assert_allclose(link.seconds, np.ceil(12.5 * np.arange(29)) / 1e3, atol=1.1e-3)
    for seconds, frame in zip(link.seconds, link.frames, strict=True):
        share = envelope[int(seconds * 80.0 + 1e-6) % 4]
        newest = drives[int(seconds / 0.03 + 1e-6)]
        assert frame.same_as(frame_at(newest, link.levels, share))
        assert abs(np.count_nonzero(frame.amplitude) - 256 * share) <= 2


def test_silence_fades_and_the_next_drive_rises_again(monkeypatch) -> None:
    clock = VirtualTime(monkeypatch)
    link = RecordingLink()
    player = clock.player(link, ramp=0.2)
    clock.send(player, tone().amplitudes)
    clock.run(player, 0.3)
    player.silence(0.1)
    clock.run(player, 0.3)
    clock.send(player, tone().amplitudes)
    clock.run(player, 0.3)
    rise = [round(255 * step / 8) for step in range(1, 9)]
    np.testing.assert_allclose(strongest(link), [*rise, 191, 128, 64, 0, *rise], rtol=0, atol=1)


def test_the_newest_drive_rises_where_nothing_waits_for_the_ramp(monkeypatch) -> None:
    clock = VirtualTime(monkeypatch)
    link = RecordingLink()
    player = clock.player(link, ramp=0.2)
    for drive in (tone(), tone(loudness=0.5)):
        clock.send(player, drive.amplitudes)
    clock.run(player, 0.4)
    assert strongest(link)[0] == 32
    assert strongest(link)[-1] == 128
    assert np.all(np.diff(strongest(link)[1:]) >= 0)


def test_stop_is_silence_at_once_and_for_good() -> None:
    link = RecordingLink()
    with at.Emission(link, cap=1.0, ramp=0.0) as emission:
        emission.send(tone())
        emission.stop()
        assert link.frames[-1].silent
        with pytest.raises(LinkFailed) as over:
            emission.send(tone())
        assert over.value.code == "emission_over"
    assert len(link.frames) == 2


# --- messages -------------------------------------------------------------------------------------------------------


def test_a_message_in_part_is_waited_for_and_an_end_is_noticed() -> None:
    ours, theirs = socket.socketpair()
    data = pickle.dumps(("frame", np.arange(5)))
    whole = len(data).to_bytes(8, "little") + data
    channel = Channel(theirs)
    for part in (whole[:3], whole[3:20]):
        ours.sendall(part)
        assert channel.receive(0.01) is None
    ours.sendall(whole[20:] + whole)
    for _ in range(2):
        message = channel.receive(1.0)
        assert message is not None
        assert message[1].tolist() == [0, 1, 2, 3, 4]
    ours.close()
    with pytest.raises(EOFError):
        channel.receive(1.0)
    channel.close()


def test_faults_pass_between_processes_with_their_codes() -> None:
    fault = pickle.loads(
        pickle.dumps(at.InvalidInput("1 is too many.", np.ones(3), code="too_many"))
    )
    assert (str(fault), fault.code) == ("1 is too many.", "too_many")
    np.testing.assert_array_equal(fault.position, np.ones(3))
    failed = pickle.loads(pickle.dumps(LinkFailed("lost.", code="link_failed")))
    assert (str(failed), failed.code) == ("lost.", "link_failed")
