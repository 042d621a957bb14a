"""Links that behave badly; in a module of their own, so that a link process finds them."""

import os
import signal
import time

import numpy as np

import airtact as at
from airtact.emission.link import RecordingLink
from airtact.emission.udp_link import UDPLink


class SignalledLink(RecordingLink):
    """Its feeder gets a SIGTERM while it is being opened."""

    def __init__(self) -> None:
        super().__init__()
        self.feeder = os.getpid()

    def _begin(self) -> None:
        super()._begin()
        os.kill(self.feeder, signal.SIGTERM)


class Hanging:
    """Its driver never returns from a frame that sounds after another one."""

    def _transmit(self, frame: at.drives.Frame) -> None:
        if self.last is not None and not frame.silent:
            time.sleep(1e6)
        super()._transmit(frame)


class HangingLink(Hanging, RecordingLink):
    pass


class UDP(UDPLink):
    """One board at an address of the environment."""

    def __init__(self) -> None:
        super().__init__([at.Pose.identity()], os.environ["UDP_BOARDS"])


class HangingUDP(Hanging, UDP):
    pass


class SlowLink(RecordingLink):
    def _transmit(self, frame: at.drives.Frame) -> None:
        time.sleep(0.03)
        super()._transmit(frame)


class Audit(at.AUTD3Link):
    """The firmware's model of one board, whose cable can be cut, and whose modulation can be read."""

    def __init__(self) -> None:
        super().__init__([at.Pose.identity()])

    def cut(self) -> None:
        if self._elsewhere is not None:
            self._elsewhere("cut")
        else:
            self._controller.link().break_down()

    def played_modulation(self) -> np.ndarray:
        if self._elsewhere is not None:
            return self._elsewhere("played_modulation")
        model = self._controller.link()
        return np.array(model.modulation_buffer(0, model.current_mod_segment(0)), dtype=np.uint8)


class Unsilenced:
    """Cannot be silenced at the first five tries, for a reason that nobody expects."""

    refused = 0

    def _silence(self) -> None:
        if self.refused < 5 and not self.last.silent:
            self.refused += 1
            raise self.error()
        super()._silence()


class ZeroDivided(Unsilenced, RecordingLink):
    error = ZeroDivisionError


class Interrupted(Unsilenced, RecordingLink):
    error = KeyboardInterrupt


class UnsilencedAudit(Unsilenced, Audit):
    error = ZeroDivisionError

    def _silence(self) -> None:
        if self.last is None:  # opening
            at.AUTD3Link._silence(self)
        else:
            super()._silence()


class UnsilencedUDP(Unsilenced, UDP):
    error = ZeroDivisionError

    def _silence(self) -> None:
        if self.last is None:  # opening
            UDPLink._silence(self)
        else:
            super()._silence()
