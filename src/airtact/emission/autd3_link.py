"""AUTD3 boards through pyautd3: EtherCrab, TwinCAT, Remote, Simulator, and Audit, a model of the firmware for proof."""

import ctypes
import importlib.metadata
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from jaxtyping import Float64, UInt8, UInt16

from airtact import _kernels
from airtact.checks import of_kind
from airtact.drives.frame import Frame
from airtact.emission.link import Link, LinkFailed
from airtact.errors import InvalidInput, extra
from airtact.geometry.pose import Pose
from airtact.transducers.levels import EIGHT_BITS
from airtact.transducers.modulation import check_rate

KNOWN_VERSIONS = ("36.0.2",)
"""Versions of pyautd3 that the tests are run with."""

THROUGH = ("audit", "ethercrab", "twincat", "remote", "simulator")
"""Ways to the boards."""

PERIODS = 40_000
"""Periods of sound a second; a sequence's rate must divide it."""

SHORTEST = 2
LONGEST = 1024
"""Frames that the boards keep."""


INTENSITY_FADE = 250
PHASE_FADE = 1000
"""How long the silencer spreads a change of intensity and of phase over [µs], its default."""


Envelope = Float64[np.ndarray, "frames"]


class AUTD3Link(Link):
    """AUTD3 boards, in the order in which they are chained.

    The board's silencer spreads changes of intensity over 0.25 ms and of phase over 1 ms, so that
    they make no audible noise; a sequence with shorter frames shortens that to a frame. Drives
    already hold all phases, so what is sent does not depend on pyautd3's speed of sound; it is set
    for simulators that show a field of their own.

    Parameters
    ----------
    poses : where each board stands: from the board's frame to the array's, as ``poses_of_boards``
        finds them.
    through : "audit" (no device: the firmware's model in this process), "ethercrab" (boards on an
        Ethernet port of this computer), "twincat" (Beckhoff's, here or elsewhere), "remote" (an
        AUTD server) or "simulator".
    address : network interface for ethercrab (the first with boards if not given), AMS net id for a
        TwinCAT elsewhere, or host:port for remote and simulator.
    sound_speed : of the medium [m/s], for simulators.
    """

    plays_itself = modulates_itself = True
    poses: list[Pose]
    address: str | None
    sound_speed: float | None

    def __init__(
        self,
        poses: Sequence[Pose],
        through: str = "audit",
        address: str | None = None,
        sound_speed: float | None = None,
    ) -> None:
        of_kind(poses, list | tuple, "where the boards stand", "a list of Pose, one for each board")
        for index, pose in enumerate(poses):
            of_kind(pose, Pose, f"pose {index}", "Pose(rotation, translation)")
        super().__init__("autd3", len(poses))
        if through not in THROUGH:
            raise InvalidInput(
                f"{through!r} is none of the {len(THROUGH)} ways to AUTD3: {', '.join(THROUGH)}.",
                code="unknown_name",
            )
        if through in ("remote", "simulator") and address is None:
            raise InvalidInput(
                f"the {through} link needs 1 address, such as 127.0.0.1:8080; 0 given.",
                code="key_missing",
            )
        self.name = through
        self.poses = list(poses)
        self.address = address
        self.sound_speed = sound_speed
        self._rotations = _quaternions(poses)
        self._lost: str | None = None
        self._envelope: tuple[Envelope, int] | None = None
        self._swinging = False
        self._smoothed: int | None = None
        self._controller: Any = None
        self._library: Any = None

    def check_sequence(self, frames: int, rate: float) -> None:
        """Check that the boards can hold a sequence and that its rate divides 40 kHz.

        Raises
        ------
        InvalidInput
            If there are fewer than 2 or more than 1024 frames, or the rate is not 40 kHz divided by a whole number up
            to 65535.
        """
        super().check_sequence(frames, rate)
        if not SHORTEST <= frames <= LONGEST:
            nearest = min(max(frames, SHORTEST), LONGEST)
            raise InvalidInput(
                f"an AUTD3 board keeps {SHORTEST} to {LONGEST} frames, not {frames}: the nearest that it plays is "
                f"{nearest}.",
                code="sizes_differ",
            )
        # 0xFFFF: most periods that one frame of a sequence can last.
        check_rate(rate, PERIODS, 0xFFFF, "AUTD3")

    def played(self, index: int = 0) -> Frame:
        """Read back what the boards play, frame ``index`` of a sequence, from the firmware's model.

        Raises
        ------
        InvalidInput
            If the link is not "audit": real boards cannot be read.
        """
        if self._elsewhere is not None:
            return self._elsewhere("played", index)
        self._check_audit("cannot be read: only audit can")
        pairs = []
        for board in range(self.boards):
            segment = self._controller.link().current_stm_segment(board)
            pairs.append(
                self._controller.link().drives_at(board, self._library.Segment(int(segment)), index)
            )
        intensity, phase = (
            np.concatenate(values).astype(np.uint8) for values in zip(*pairs, strict=True)
        )
        return Frame(intensity, phase, EIGHT_BITS)

    def cut(self) -> None:
        """Cut the cable of an "audit" link, to test what follows; opening the link again restores it.

        Raises
        ------
        InvalidInput
            If the link is not "audit".
        """
        if self._elsewhere is not None:
            self._elsewhere("cut")
            return
        self._check_audit("have a cable that you can pull yourself")
        self._controller.link().break_down()

    def played_modulation(self, board: int = 0) -> UInt8[np.ndarray, "frames"]:
        """Read back the factors by which a board varies the amplitudes, 255 for 1, from the firmware's model.

        Raises
        ------
        InvalidInput
            If the link is not "audit": real boards cannot be read.
        """
        if self._elsewhere is not None:
            return self._elsewhere("played_modulation", board)
        self._check_audit("cannot be read: only audit can")
        model = self._controller.link()
        return np.array(
            model.modulation_buffer(board, model.current_mod_segment(board)), dtype=np.uint8
        )

    def modulate(self, envelope: Float64[np.ndarray, "frames"] | None, rate: float) -> None:
        """Have the boards vary the amplitude of all frames that are sent from now on, over and over.

        Parameters
        ----------
        envelope : factors on the amplitudes, from 0 to 1, over one period; None for none.
        rate : factors a second: 40 kHz over a whole number.
        """
        self._envelope = None if envelope is None else (envelope, round(PERIODS / rate))
        self._swinging = False

    def _resource(self) -> str | None:
        return (
            None
            if self.name == "audit"
            else f"{self.name} at {self.address or 'its usual address'}"
        )

    def _check_audit(self, why: str) -> None:
        if self.name != "audit":
            raise InvalidInput(
                f"the {self.boards} boards behind {self.name} {why}.", code="not_supported"
            )

    def _begin(self) -> None:
        self._swinging = False
        self._library = pyautd3 = _library()
        devices = [
            pyautd3.AUTD3(pos=1e3 * pose.translation, rot=rotation)
            for pose, rotation in zip(self.poses, self._rotations, strict=True)
        ]
        self._lost = None
        self._controller = pyautd3.Controller.open(devices, self._way())
        if self.sound_speed is not None:
            self._controller.environment.sound_speed = 1e3 * self.sound_speed
        self._check_other_firmware()
        # Looking up a table is quicker than starting threads.
        option = pyautd3.SenderOption(parallel=pyautd3.ParallelMode.Off)
        self._sender = self._controller.sender(option, pyautd3.FixedSchedule())
        self._silence()

    def _check_other_firmware(self) -> None:
        from pyautd3.driver.firmware_version import FirmwareInfo

        latest = FirmwareInfo.latest_version()
        for index, info in enumerate(self._controller.firmware_version()):
            text = str(info)
            if text.count(latest) < 2:
                self._controller.close()
                raise InvalidInput(
                    f"board {index} has the firmware {text}, and pyautd3 {self._library.__version__} needs {latest}: "
                    "update the board's firmware.",
                    code="unsupported_version",
                )

    def _way(self) -> Any:
        from pyautd3.link import audit, ethercrab, remote, simulator, twincat

        if self.name == "audit":
            return audit.Audit()
        if self.name == "ethercrab":
            return ethercrab.EtherCrab(self._note, ethercrab.EtherCrabOption(ifname=self.address))
        if self.name == "twincat" and self.address is None:
            return twincat.TwinCAT()
        if self.name == "twincat":
            return twincat.RemoteTwinCAT(str(self.address), twincat.RemoteTwinCATOption())
        return (remote.Remote if self.name == "remote" else simulator.Simulator)(str(self.address))

    def _note(self, board: int, status: object) -> None:
        """Remember what EtherCAT reports of a board until the next frame; it calls from its own thread."""
        self._lost = f"board {board}: {status}"

    def _transmit(self, frame: Frame) -> None:
        if self._lost is not None:
            raise self._failed("sending", self._lost)
        gain = _gain_of(self._words(frame))
        if self._envelope is None:
            self._sender.send((self._library.Static(), gain))
        elif self._swinging:
            self._sender.send(gain)
        else:
            self._swing(*self._envelope, gain)

    def _swing(self, envelope: Float64[np.ndarray, "frames"], divide: int, gain: Any) -> None:
        """Begin a modulation, which then goes on while other gains are sent."""
        from pyautd3.modulation import Custom

        self._smooth(divide)
        factors = np.rint(255 * envelope).astype(np.uint8)
        pyautd3 = self._library
        self._sender.send((Custom(factors, pyautd3.SamplingConfig(divide)), gain))
        self._swinging = True

    def _look(self) -> None:
        if self._lost is not None:
            raise self._failed("looking for the boards", self._lost)
        self._controller.fpga_state()

    def _upload(self, frames: Sequence[Frame], rate: float) -> None:
        divide = round(PERIODS / rate)
        self._smooth(divide)
        gains = [_gain_of(self._words(frame)) for frame in frames]
        pyautd3 = self._library
        sequence = pyautd3.GainSTM(gains, pyautd3.SamplingConfig(divide), pyautd3.GainSTMOption())
        self._sender.send((pyautd3.Static(), sequence))

    def _silence(self) -> None:
        self._swinging = False
        self._smoothed = None
        # First silence, which the boards acknowledge; only then may the silencer be slow again.
        self._sender.send((self._library.Static(), self._library.Null()))
        self._sender.send(self._silencer(INTENSITY_FADE, PHASE_FADE))

    def _smooth(self, divide: int) -> None:
        """Have the boards spread changes over a frame of so many periods at most, if they do not already."""
        period = divide * (1_000_000 // PERIODS)
        if period != self._smoothed:
            self._sender.send(self._silencer(min(INTENSITY_FADE, period), min(PHASE_FADE, period)))
            self._smoothed = period

    def _silencer(self, intensity: int, phase: int) -> Any:
        micros = self._library.Duration.from_micros
        times = self._library.FixedCompletionTime(intensity=micros(intensity), phase=micros(phase))
        return self._library.Silencer(times)

    def _end(self) -> None:
        self._controller.close()

    def _words(self, frame: Frame) -> UInt16[np.ndarray, "boards elements"]:
        """(boards, 249) phase in the low byte, intensity in the high one, as the boards hold them."""
        return (frame.phase.astype(np.uint16) | frame.amplitude.astype(np.uint16) << 8).reshape(
            self.boards, -1
        )

    @contextmanager
    def _reporting(self, doing: str) -> Iterator[None]:
        try:
            with super()._reporting(doing):
                yield
        except (InvalidInput, LinkFailed):
            raise
        except Exception as error:
            # pyautd3 raises its own error from its C side and plain ones from its Python side.
            if not type(error).__module__.startswith("pyautd3"):
                raise
            if doing == "opening":
                raise InvalidInput(
                    f"{self.boards} AUTD3 boards cannot be opened through {self.name}: {str(error).rstrip('.')}.",
                    code="link_failed",
                ) from None
            raise self._failed(doing, str(error).rstrip(".")) from error


def _quaternions(poses: Sequence[Pose]) -> list[Float64[np.ndarray, "4"]]:
    """Return rotations as unit quaternions, the real part first."""
    from scipy.spatial.transform import (
        Rotation,  # its import takes longer than a link process takes to start
    )

    return [
        np.array(Rotation.from_matrix(pose.rotation).as_quat(scalar_first=True)) for pose in poses
    ]


def _library() -> Any:
    """Import pyautd3; raise "extra_missing" or "unsupported_version" with what to install."""
    with extra("autd3", "AUTD3 boards need pyautd3"):
        import pyautd3
    version = importlib.metadata.version("pyautd3")
    if version not in KNOWN_VERSIONS:
        raise InvalidInput(
            f"pyautd3 {version} is not one that the tests run with ({', '.join(KNOWN_VERSIONS)}): "
            "pip install 'airtact[autd3]'.",
            code="unsupported_version",
        )
    return pyautd3


def _gain_of(words: UInt16[np.ndarray, "boards elements"]) -> Any:
    """Return a gain of pyautd3 that plays a table, by its own ``Custom`` where the fast entry has changed."""
    try:
        return _table_gain(words)
    except (ImportError, AttributeError):
        return _custom_gain(words)


def _table_gain(words: UInt16[np.ndarray, "boards elements"]) -> Any:
    """Give the entry of ``Custom`` a compiled function that only looks up a table: 996 calls of Python take 0.3 ms."""
    from pyautd3.driver.datagram.gain import Gain
    from pyautd3.native_methods.autd3 import Drive
    from pyautd3.native_methods.autd3capi import NativeMethods

    entry_point: Any = NativeMethods().gain_custom
    if ctypes.sizeof(Drive) != 2:
        raise AttributeError("a drive of pyautd3 is not two bytes")

    class TableGain(Gain):
        """A gain that looks up."""

        def __init__(self) -> None:
            self.words = np.ascontiguousarray(words)
            self.table = _Words(self.words.ctypes.data, words.shape[1])

        def _gain_ptr(self, geometry: Any) -> Any:
            return entry_point(
                ctypes.c_void_p(_kernels.word_of_element),
                ctypes.byref(self.table),
                geometry._geometry_ptr,
            )

    return TableGain()


class _Words(ctypes.Structure):
    """The context of ``word_of_element``: a table, and how many elements a board has."""

    _fields_ = (("words", ctypes.c_void_p), ("elements_of_a_board", ctypes.c_int64))


def _custom_gain(words: UInt16[np.ndarray, "boards elements"]) -> Any:
    """Return the same gain through pyautd3's public ``Custom``, which builds a device and a transducer a call."""
    from pyautd3 import Drive, Intensity, Phase
    from pyautd3.gain import Custom

    table = words.tolist()

    def drive(transducer: Any) -> Any:
        word = table[transducer.dev_idx()][transducer.idx()]
        return Drive(phase=Phase(word & 0xFF), intensity=Intensity(word >> 8))

    return Custom(lambda _device: drive)
