"""Base class of links to AUTD3 boards, and a link through pyautd3 to boards with old firmware."""

import ctypes
import importlib.metadata
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float64, UInt16

from airtact import _kernels
from airtact.drives.frame import Frame
from airtact.emission.link import Link
from airtact.errors import InvalidInput, extra, of_kind
from airtact.geometry.pose import Pose
from airtact.transducers.levels import EIGHT_BITS, check_rate

# Connections to the boards.
THROUGH = ("audit", "ethercrab", "twincat", "remote", "simulator")

# Periods of sound per second; a sequence's rate must divide it.
PERIODS = 40_000

# Default times over which the silencer spreads a change of intensity and of phase [µs].
INTENSITY_FADE = 250
PHASE_FADE = 1000


class AUTD3Boards(Link):
    """Base class of links to a chain of AUTD3 boards.

    The silencer of a board spreads changes of intensity over 0.25 ms and changes of phase over 1
    ms, which avoids audible noise. If the frames of a sequence are shorter, the silencer spreads
    changes over one frame.

    Parameters
    ----------
    poses : pose of each board in the array's frame, in the order of the chain.
    address : where the boards are connected; its meaning depends on the link.
    """

    plays_itself = True

    def __init__(self, poses: Sequence[Pose], address: str | None = None) -> None:
        of_kind(poses, list | tuple, "the value of poses", "a list of Pose, one for each board")
        for index, pose in enumerate(poses):
            of_kind(pose, Pose, f"pose {index}", "Pose(rotation, translation)")
        super().__init__("autd3", len(poses))
        self.poses = poses
        self.address: str | None = address
        # Importing SciPy takes longer than starting a link process, so rotations are converted
        # here.
        from scipy.spatial.transform import Rotation

        self._rotations = [
            np.array(Rotation.from_matrix(pose.rotation).as_quat(scalar_first=True))
            for pose in poses
        ]
        self._envelope: np.ndarray | None = None
        self._divide = 1
        self._modulating = False

    def check_sequence(self, frames: int, rate: float) -> None:
        """Check that the boards can store a sequence and that its rate divides 40 kHz.

        Raises
        ------
        InvalidInput
            If there are fewer than 2 or more than 1024 frames, or the rate is not 40 kHz divided by
            a whole number up to 65535.
        """
        super().check_sequence(frames, rate)
        if not 2 <= frames <= 1024:
            raise InvalidInput(
                f"an AUTD3 board stores 2 to 1024 frames, not {frames}.", code="sizes_differ"
            )
        # The board counts the periods of a frame with 16 bits.
        check_rate(rate, PERIODS, 0xFFFF, "AUTD3")

    def modulate(self, envelope: Float64[np.ndarray, "frames"] | None, rate: float) -> None:
        """Make the boards modulate the amplitude of the current and all later frames.

        Parameters
        ----------
        envelope : factors for the amplitudes over one period, from 0 to 1; None ends the
            modulation.
        rate : number of factors per second; 40 kHz divided by a whole number.
        """
        self._envelope = envelope
        if envelope is not None:
            self._divide = round(PERIODS / rate)
        self._modulating = False

    def _resource(self) -> str | None:
        # Models of the boards run in this process and are not shared.
        if self.name == "audit" or (self.name, self.address) == ("udp", "emulator"):
            return None
        return f"{self.name} at {self.address or 'its usual address'}"


class AUTD3Link(AUTD3Boards):
    """EtherCAT link to a chain of AUTD3 boards with firmware older than 0.10, for an ``Emission``.

    The link is closed at first; ``Emission`` opens it. Opening requires the package pyautd3
    (``pip install 'airtact[autd3-legacy]'``), and fails with the code "link_failed" if the boards
    do not answer. For boards with firmware 0.12, use ``UDPLink``.

    Parameters
    ----------
    poses : list with the pose of each board in the array's frame, in the order of the chain, as
        returned by ``poses_of_boards``.
    through : connection to the boards: "audit" (the default: no device, but a model of the firmware
        in this process), "ethercrab" (boards on an Ethernet port of this computer), "twincat"
        (Beckhoff's TwinCAT, on this or another computer), "remote" (an AUTD server) or "simulator"
        (AUTD's simulator).
    address : network interface for "ethercrab" (by default the first one with boards), AMS net id
        for TwinCAT on another computer (by default, this one), or host:port for "remote" and
        "simulator", which require it. Ignored for "audit".
    sound_speed : speed of sound in the medium [m/s], which only simulators use, because drives
        already contain all phases; by default, that of pyautd3.

    Raises
    ------
    InvalidInput
        If there are no poses, the connection is unknown, or a required address is missing.
    """

    def __init__(
        self,
        poses: Sequence[Pose],
        through: str = "audit",
        address: str | None = None,
        sound_speed: float | None = None,
    ) -> None:
        super().__init__(poses, address)
        if through not in THROUGH:
            raise InvalidInput(
                f"{through!r} is not an AUTD3 connection: use one of {', '.join(THROUGH)}.",
                code="unknown_name",
            )
        if through in ("remote", "simulator") and address is None:
            raise InvalidInput(
                f"the {through} link needs an address, such as 127.0.0.1:8080.",
                code="key_missing",
            )
        self.name = through
        self.sound_speed: float | None = sound_speed
        self._lost: str | None = None
        self._smoothed: int | None = None
        self._controller: Any = None
        self._library: Any = None

    def played(self, index: int = 0) -> Frame:
        """Read frame ``index`` of the current sequence back from the firmware model.

        Raises
        ------
        InvalidInput
            If the link is not "audit", because the frames of real boards cannot be read back.
        """
        if self._elsewhere is not None:
            return self._elsewhere("played", index)
        if self.name != "audit":
            raise InvalidInput(
                f"frames cannot be read back from {self.name}; only audit supports that.",
                code="not_supported",
            )
        model = self._controller.link()
        segments = [
            self._library.Segment(int(model.current_stm_segment(board)))
            for board in range(self.boards)
        ]
        played = np.hstack(
            [model.drives_at(board, segment, index) for board, segment in enumerate(segments)]
        )
        intensity, phase = played.astype(np.uint8)
        return Frame(intensity, phase, EIGHT_BITS)

    def _begin(self) -> None:
        self._modulating = False
        self._library = pyautd3 = tested_library(
            "pyautd3", "36.0.2", "autd3-legacy", "AUTD3 boards with older firmware need pyautd3"
        )
        devices = [
            pyautd3.AUTD3(pos=1e3 * pose.translation, rot=rotation)
            for pose, rotation in zip(self.poses or (), self._rotations, strict=True)
        ]
        self._lost = None
        try:
            self._controller = pyautd3.Controller.open(devices, self._way())
        except Exception as error:  # an error of pyautd3 or a standard one
            raise InvalidInput(
                f"{self.boards} AUTD3 boards cannot be opened through {self.name}: "
                f"{str(error).rstrip('.')}.",
                code="link_failed",
            ) from None
        if self.sound_speed is not None:
            self._controller.environment.sound_speed = 1e3 * self.sound_speed
        self._check_firmware()
        # Looking up a table takes less time than starting threads does.
        option = pyautd3.SenderOption(parallel=pyautd3.ParallelMode.Off)
        self._sender = self._controller.sender(option, pyautd3.FixedSchedule())
        self._silence()

    def _check_firmware(self) -> None:
        from pyautd3.driver.firmware_version import FirmwareInfo

        latest = FirmwareInfo.latest_version()
        for index, info in enumerate(self._controller.firmware_version()):
            text = str(info)
            # A board has two firmware versions, one for its CPU and one for its FPGA.
            if text.count(latest) < 2:
                self._controller.close()
                raise InvalidInput(
                    f"board {index} runs firmware {text}, but pyautd3 "
                    f"{self._library.__version__} needs {latest}: update the board's firmware.",
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
        address = str(self.address)
        if self.name == "twincat":
            return twincat.RemoteTwinCAT(address, twincat.RemoteTwinCATOption())
        return remote.Remote(address) if self.name == "remote" else simulator.Simulator(address)

    def _note(self, board: int, status: object) -> None:
        """Store a board's EtherCAT report until the next frame is sent; runs in another thread."""
        self._lost = f"board {board}: {status}"

    def _transmit(self, frame: Frame) -> None:
        if self._lost is not None:
            raise self._failed("sending", self._lost)
        gain = _gain_of(self._words(frame))
        if self._envelope is None:
            self._sender.send((self._library.Static(), gain))
        elif self._modulating:
            # The modulation on the boards continues while the gain changes.
            self._sender.send(gain)
        else:
            from pyautd3.modulation import Custom

            self._smooth(self._divide)
            factors = np.rint(255 * self._envelope).astype(np.uint8)
            modulation = Custom(factors, self._library.SamplingConfig(self._divide))
            self._sender.send((modulation, gain))
            self._modulating = True

    def _look(self) -> None:
        if self._lost is not None:
            raise self._failed("looking for the boards", self._lost)
        # Reading from the boards fails if the cable is unplugged.
        self._controller.fpga_state()

    def _upload(self, frames: Sequence[Frame], rate: float) -> None:
        divide = round(PERIODS / rate)
        self._smooth(divide)
        gains = [_gain_of(self._words(frame)) for frame in frames]
        pyautd3 = self._library
        sequence = pyautd3.GainSTM(gains, pyautd3.SamplingConfig(divide), pyautd3.GainSTMOption())
        self._sender.send((pyautd3.Static(), sequence))

    def _silence(self) -> None:
        self._modulating = False
        self._smoothed = None
        # Wait until the boards acknowledge silence, and only then make the silencer slower again.
        self._sender.send((self._library.Static(), self._library.Null()))
        self._sender.send(self._silencer(INTENSITY_FADE, PHASE_FADE))

    def _smooth(self, divide: int) -> None:
        """Make the boards spread changes over at most one frame of ``divide`` periods."""
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
        """Return words with the phase in the low byte and the intensity in the high byte."""
        words = frame.phase.astype(np.uint16) | frame.amplitude.astype(np.uint16) << 8
        return words.reshape(self.boards, -1)


def tested_library(name: str, tested: str, group: str, need: str) -> Any:
    """Import a library of the manufacturer, of the version that the tests use.

    Parameters
    ----------
    name : name of the package.
    tested : first numbers of the version, after which messages to the boards may change.
    group, need : name of the extra that installs the package, and beginning of the message if it is
        missing; see ``extra``.
    """
    with extra(group, need):
        library = importlib.import_module(name)
    version = importlib.metadata.version(name)
    if not f"{version}.".startswith(f"{tested}."):
        raise InvalidInput(
            f"{name} {version} is not the tested version {tested}: run pip install "
            f"'airtact[{group}]'.",
            code="unsupported_version",
        )
    return library


def _gain_of(words: UInt16[np.ndarray, "boards elements"]) -> Any:
    """Return a gain for pyautd3's ``Custom`` that looks up its values in a compiled table."""
    # 996 calls of a Python function would take 0.3 ms.
    from pyautd3.driver.datagram.gain import Gain
    from pyautd3.native_methods.autd3capi import NativeMethods

    entry_point: Any = NativeMethods().gain_custom

    class TableGain(Gain):
        """Gain that reads the words of a table."""

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
    _fields_ = (("words", ctypes.c_void_p), ("elements_of_a_board", ctypes.c_int64))
