"""Ctrl-C, which Netgen takes away."""

import signal
import threading


def heed_interrupts(step: str) -> None:
    """Let Ctrl-C be heard again as ``KeyboardInterrupt``.

    Netgen resets it when it meshes, to what ends a process on the spot, with no word and files half written. This is to
    be told the steps of a solver, the first of which after meshing gives the handler back.

    Parameters
    ----------
    step : what begins; it does not matter.
    """
    if threading.current_thread() is threading.main_thread():
        handler = signal.getsignal(signal.SIGINT)  # what Python believes is set, and what was
        if handler is not None:
            signal.signal(signal.SIGINT, handler)
