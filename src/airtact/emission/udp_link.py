"""UDP link to AUTD3 boards with firmware 0.12, through the manufacturer's package autd3."""

import asyncio
import importlib.metadata
import time
from collections.abc import Awaitable, Callable, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float64, UInt8

from airtact.drives.frame import Frame
from airtact.emission.autd3_link import (
    INTENSITY_FADE,
    PERIODS,
    PHASE_FADE,
    AUTD3Boards,
    tested_library,
)
from airtact.errors import InvalidInput, extra
from airtact.geometry.pose import Pose


class UDPLink(AUTD3Boards):
    """UDP link to a chain of AUTD3 boards with firmware 0.12, for an ``Emission``.

    The link is closed at first, and ``Emission`` opens it. Opening it requires the package autd3
    (``pip install 'airtact[autd3]'``), and raises ``InvalidInput`` with the code "link_failed" if
    the boards do not answer. The boards silence themselves half a second after the last call of
    ``send``, ``play`` or ``probe``; an ``Emission`` calls ``probe`` often enough. A frame can be
    sent up to 50 ms before the time at which it takes effect (see ``send``).

    Parameters
    ----------
    poses : list with the pose of each board in the array's frame, in the order of the chain, as
        returned by ``poses_of_boards``.
    address : name of the network interface of the boards (by default the first one with boards),
        [::1]:PORT of a simulator, or "emulator" for the manufacturer's model of the boards in the
        link process.

    Raises
    ------
    InvalidInput
        If there is no pose, or there are more than 128 poses.

    Examples
    --------
    >>> link = UDPLink([Pose.identity()], "emulator")
    >>> link.devices, link.lead
    ('1 autd3 board', 0.05)
    """

    name = "udp"
    # The boards accept frames up to 100 ms ahead. Silence waits for the frames before it.
    lead = 0.05

    def __init__(self, poses: Sequence[Pose], address: str | None = None) -> None:
        super().__init__(poses, address)
        if self.boards > 128:
            raise InvalidInput(
                f"the udp link drives at most 128 AUTD3 boards, not {self.boards}.",
                code="sizes_differ",
            )
        self._smoothed = PHASE_FADE
        self._bank = 0
        self._modulated = False  # whether the boards play a modulation
        self._answer: Any = None  # answer to the last frame that was sent ahead
        self._sdk: Any = None
        self._loop: Any = None
        self._client: Any = None
        self._emulator: Any = None

    def _begin(self) -> None:
        need = "AUTD3 boards that use UDP need autd3"
        # Before version 1, a change of the second number changes the messages.
        self._sdk = sdk = tested_library("autd3", "0.12", "autd3", need)
        with extra("autd3", need):
            import autd3_modulation  # noqa: F401
            import autd3_pattern  # noqa: F401
        milliseconds = sdk.Duration.from_millis
        self._geometry = sdk.geometry.Geometry(
            [
                sdk.geometry.Autd3(1e3 * pose.translation, rotation)
                for pose, rotation in zip(self.poses or (), self._rotations, strict=True)
            ]
        )
        # The library's own thread must not keep boards playing after the player has lost them.
        # Therefore it sends no heartbeats and does not release boards that silenced themselves. A
        # board counts as lost only after all tries.
        config = sdk.ClientConfig(
            ack_timeout=milliseconds(50),
            release_failsafe_on_recovery=None,
            resynchronize_on_recovery=None,
        )
        self._answer = None
        self._loop = asyncio.new_event_loop()
        try:
            option = sdk.UdpOption(
                iface=self._interface(),
                heartbeat=None,
                lost_timeout=milliseconds(400),
                enumeration_timeout=milliseconds(3000),
            )
            self._client = self._done(lambda: sdk.Client.open(self._geometry, option, config))
            self._check_firmware()
        except BaseException as error:
            self._loop.close()
            if not isinstance(error, sdk.Autd3Error | ValueError):
                raise
            raise InvalidInput(
                f"{self.boards} AUTD3 boards cannot be opened through udp: "
                f"{str(error).rstrip('.')}. Boards with firmware older than 0.10 need "
                "another link, such as ethercrab.",
                code="link_failed",
            ) from None
        self._silence()

    def _interface(self) -> Any:
        interfaces = self._sdk.Interface
        if self.address == "emulator":
            self._emulator = self._sdk.UdpEmulator(self.boards)
            return self._emulator.option().iface
        if self.address is None:
            return interfaces.Auto
        if self.address.startswith("["):
            return interfaces.Addr(self.address)
        return interfaces.Name(self.address)

    def _check_firmware(self) -> None:
        for index, version in enumerate(self._done(self._client.read_firmware_version)):
            if not version.is_supported():
                cpu = version.cpu
                series = ".".join(map(str, self._sdk.FirmwareVersion.SUPPORTED_SERIES))
                self._done(self._client.close)
                raise InvalidInput(
                    f"board {index} runs firmware {cpu.major}.{cpu.minor}.{cpu.patch}, but "
                    f"autd3 {importlib.metadata.version('autd3')} needs {series}: update the "
                    "board's firmware.",
                    code="unsupported_version",
                )

    def _transmit(self, frame: Frame) -> None:
        self._prepare()
        self._deliver(self._pattern(frame))

    def _transmit_at(self, frame: Frame, at: float) -> None:
        self._prepare()
        sdk = self._sdk
        (frames,) = sdk.Frames.encode(self._geometry, self._pattern(frame))
        before, device_time, after = 0, sdk.value.SysTime.ZERO, 0
        # Both clocks are read again if this process was interrupted in between.
        for _ in range(10):
            before = time.monotonic_ns()
            device_time = self._client.device_time_now()
            after = time.monotonic_ns()
            if after - before < 10_000:
                break
        ahead = round(1e9 * at) - (before + after) // 2
        if ahead > 1e9 * self.lead:
            raise InvalidInput(
                f"a frame is scheduled {1e-6 * ahead:.0f} ms ahead, but AUTD3 boards accept "
                f"frames up to {1e3 * self.lead:.0f} ms ahead.",
                code="out_of_range",
            )
        acts = device_time + sdk.Duration.from_nanos(max(ahead, 0))
        self._answer = self._done(lambda: self._client.send_frame_at(frames, sdk.ExecAt.At(acts)))

    def _prepare(self) -> None:
        """Make the boards play the current modulation, and check the last frame sent in advance."""
        answer = self._answer
        if answer is not None:
            self._answer = None
            self._done(lambda: answer).check()
        if self.last is None or self.last.silent:
            # The boards have silenced themselves if nothing was sent for half a second.
            self._deliver(self._sdk.commands.ReleaseFailsafe())
        if self._envelope is not None and not self._modulating:
            self._smooth(self._divide)
            self._modulate(self._envelope, self._divide)
            self._modulating = True
        elif self._envelope is None and self._modulated:
            self._modulate(np.ones(2), 0xFFFF)
            self._modulated = False

    def _modulate(self, envelope: Float64[np.ndarray, "frames"], divide: int) -> None:
        from autd3_modulation import ModulationBuffer

        factors = ModulationBuffer.from_array(np.rint(255 * envelope).astype(np.uint8))
        sampling = self._sdk.value.SamplingConfig(divide)
        self._deliver(self._sdk.commands.Modulation(sampling, factors))
        self._modulated = True

    def _look(self) -> None:
        self._check_lost()
        for index, state in enumerate(self._done(self._client.read_fpga_state)):
            if state.is_failsafe_active():
                raise self._failed(
                    "looking for the boards",
                    f"board {index} received nothing for half a second and silenced itself",
                )

    def _check_lost(self) -> None:
        """Raise an error if a board is lost, because the library then sends only to the others."""
        for index, state in enumerate(self._client.state_checker().check().devices):
            if state == self._sdk.DeviceState.Lost:
                raise self._failed("sending", f"board {index} did not answer")

    def _upload(self, frames: Sequence[Frame], rate: float) -> None:
        divide = round(PERIODS / rate)
        self._envelope = None
        self._prepare()
        self._smooth(divide)
        commands = self._sdk.commands
        buffers = [self._buffers(frame) for frame in frames]
        phases, intensities = map(list, zip(*buffers, strict=True))
        option = commands.PatternStmOption(bank=self._next_bank())
        sampling = self._sdk.value.SamplingConfig(divide)
        self._deliver(commands.PatternStm(sampling, phases, intensities, option))

    def _silence(self) -> None:
        commands = self._sdk.commands
        self._answer = None
        # Both banks are cleared, so that no earlier frame is left that could be played again.
        for _ in range(2):
            self._deliver(self._pattern(self.zero()))
        self._modulate(np.ones(2), 0xFFFF)
        self._modulated = False
        self._modulating = False
        self._smoothed = PHASE_FADE
        self._deliver(self._silencer(INTENSITY_FADE, PHASE_FADE))
        self._deliver(commands.ReleaseFailsafe())

    def _smooth(self, divide: int) -> None:
        """Make the boards spread changes over at most one frame of ``divide`` periods."""
        period = divide * (1_000_000 // PERIODS)
        # The time is only shortened until the boards are silent, because they reject times that are
        # longer than a frame of the sequence they still play.
        if period < self._smoothed:
            self._smoothed = period
            self._deliver(self._silencer(min(INTENSITY_FADE, period), period))

    def _silencer(self, intensity: int, phase: int) -> Any:
        commands = self._sdk.commands
        micros = self._sdk.Duration.from_micros
        times = commands.FixedCompletionTime(intensity=micros(intensity), phase=micros(phase))
        return commands.SetSilencer(times)

    def _end(self) -> None:
        try:
            self._repeated(self._client.close)
        finally:
            self._loop.close()
            self._emulator = None

    def _pattern(self, frame: Frame) -> Any:
        phases, intensities = self._buffers(frame)
        return self._sdk.commands.Pattern(phases, intensities, bank=self._next_bank())

    def _buffers(self, frame: Frame) -> tuple[Any, Any]:
        from autd3_pattern import IntensityBuffer, PhaseBuffer

        def of_boards(values: UInt8[np.ndarray, "elements"]) -> UInt8[np.ndarray, "boards 249"]:
            return np.ascontiguousarray(values.reshape(self.boards, -1), dtype=np.uint8)

        phases = PhaseBuffer.from_array(of_boards(frame.phase))
        return phases, IntensityBuffer.from_array(of_boards(frame.amplitude))

    def _next_bank(self) -> Any:
        """Return the bank that is not playing, so that no incomplete frame is played."""
        banks = self._sdk.value.PatternBank
        self._bank = 1 - self._bank
        return (banks.B0, banks.B1)[self._bank]

    def _deliver(self, command: Any) -> None:
        self._repeated(lambda: self._client.send(command))
        self._check_lost()

    def _repeated(self, start: Callable[[], Awaitable[Any]]) -> None:
        for left in reversed(range(3)):  # a message is sent up to 3 times if a board does not reply
            try:
                self._done(start)
                return
            except self._sdk.Autd3Error as error:
                # UDP loses packets. A command that the boards reject is not sent again.
                lost = error.code in (error.TIMEOUT, error.NETWORK)
                if not lost or left == 0:
                    raise

    def _done(self, start: Callable[[], Awaitable[Any]]) -> Any:
        async def work() -> Any:
            return await start()

        return self._loop.run_until_complete(work())
