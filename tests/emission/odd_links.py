"""Links that behave badly; in a module of their own, so that a link process finds them."""

import os
import signal
import time

import airtact as at
from airtact.emission.link import RecordingLink


class SignalledLink(RecordingLink):
    """Its feeder gets a SIGTERM while it is being opened."""

    def _begin(self) -> None:
        super()._begin()
        os.kill(self.holder, signal.SIGTERM)


class SlowLink(RecordingLink):
    """Takes 30 ms for a frame."""

    def _transmit(self, frame: at.drives.Frame) -> None:
        time.sleep(0.03)
        super()._transmit(frame)


class Unsilenced:
    """Cannot be silenced at the first try, for a reason that nobody expects."""

    refused = False

    def _silence(self) -> None:
        if not self.refused and not self.last.silent:
            self.refused = True
            raise self.error()
        super()._silence()


class ZeroDivided(Unsilenced, RecordingLink):
    error = ZeroDivisionError


class Interrupted(Unsilenced, RecordingLink):
    error = KeyboardInterrupt


class UnsilencedAudit(Unsilenced, at.AUTD3Link):
    error = ZeroDivisionError

    def _silence(self) -> None:
        if self.last is None:  # opening
            at.AUTD3Link._silence(self)
        else:
            super()._silence()
