"""A process that emits and then ends in some way; run as ``python feeder.py LINK FOLDER TRIALS WAY...``.

Everything is imported once; each trial is a process of its own, which writes FOLDER/WAY-TRIAL.log.
"""

import contextlib
import ctypes
import os
import resource
import signal
import sys
import threading
import time
from pathlib import Path

import numpy as np

import airtact as at
from emission.odd_links import (
    UDP,
    Audit,
    HangingLink,
    HangingUDP,
    Interrupted,
    UnsilencedAudit,
    UnsilencedUDP,
    ZeroDivided,
)

DRIVE = at.Drive(np.exp(2j * np.pi * np.arange(249) / 7))
PLAIN = {
    "recording": at.emission.RecordingLink,
    "audit": Audit,
    "udp": UDP,
}
ODD = {"recording": ZeroDivided, "audit": UnsilencedAudit, "udp": UnsilencedUDP}
LONG = 30.0
KEPT: list = []
SIGNALS = (
    "SIGKILL",
    "SIGSEGV",
    "SIGABRT",
    "SIGQUIT",
    "SIGPIPE",
    "SIGALRM",
    "SIGUSR1",
    "SIGUSR2",
    "SIGXCPU",
    "SIGBUS",
)


def in_thread(emission: at.Emission, daemon: bool) -> None:
    """Emit from a thread; return while it does."""
    emits = threading.Event()

    def work() -> None:
        with emission:
            emission.send(DRIVE)
            emits.set()
            emission.hold(LONG)

    threading.Thread(target=work, daemon=daemon).start()
    emits.wait()


def killed_in_thread(kind: signal.Signals):
    def way(emission: at.Emission) -> None:
        in_thread(emission, daemon=False)
        os.kill(os.getpid(), kind)
        time.sleep(LONG)

    return way


def killed(kind: signal.Signals):
    def way(emission: at.Emission) -> None:
        with emission:
            emission.send(DRIVE)
            if kind not in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGKILL):
                signal.signal(kind, signal.SIG_DFL)
            threading.Timer(0.05, os.kill, (os.getpid(), kind)).start()
            emission.hold(LONG)

    return way


def exited(emission: at.Emission) -> None:
    with emission:
        emission.send(DRIVE)
        os._exit(3)


def daemon_and_main_ends(emission: at.Emission) -> None:
    in_thread(emission, daemon=True)


def daemon_and_main_raises(emission: at.Emission) -> None:
    in_thread(emission, daemon=True)
    raise ZeroDivisionError


def never_left(emission: at.Emission) -> None:
    emission.__enter__()
    emission.send(DRIVE)


def stack_never_closed(emission: at.Emission) -> None:
    KEPT.append(stack := contextlib.ExitStack())
    stack.enter_context(emission).send(DRIVE)


def generator_never_resumed(emission: at.Emission) -> None:
    def steps():
        with emission:
            emission.send(DRIVE)
            yield

    KEPT.append(steps())
    next(KEPT[-1])


def lock_held_and_killed(emission: at.Emission) -> None:
    """A C call holds the interpreter's lock for longer than the patience; then the process is killed."""
    with emission:
        emission.send(DRIVE)
        signal.setitimer(signal.ITIMER_REAL, 0.8)
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        ctypes.PyDLL(None).sleep(int(LONG))


def link_stopped_and_killed(emission: at.Emission) -> None:
    """The link process stands still, as with a driver that blocks, when this one is killed."""
    with emission:
        emission.send(DRIVE)
        os.kill(emission.process, signal.SIGSTOP)
        os.kill(os.getpid(), signal.SIGKILL)


def link_killed_and_killed(emission: at.Emission) -> None:
    with emission:
        emission.send(DRIVE)
        os.kill(emission.process, signal.SIGKILL)
        os.kill(os.getpid(), signal.SIGKILL)


def link_hangs(kind: signal.Signals):
    def way(emission: at.Emission) -> None:
        with emission:
            emission.send(DRIVE)
            threading.Timer(0.1, os.kill, (os.getpid(), kind)).start()
            emission.send(DRIVE)

    return way


def out_of_seconds(emission: at.Emission) -> None:
    """The system kills a process whose computing time is over."""
    with emission:
        used = int(time.process_time()) + 1
        resource.setrlimit(resource.RLIMIT_CPU, (used, used))
        while True:
            emission.send(DRIVE)


def copied(emission: at.Emission) -> None:
    """A copy of the process keeps the connection open when this one is killed."""
    with emission:
        emission.send(DRIVE)
        if os.fork() == 0:
            time.sleep(2.0)
            os._exit(0)
        os.kill(os.getpid(), signal.SIGKILL)


def stopped(emission: at.Emission) -> None:
    """The process stands still for longer than the patience."""
    with emission:
        emission.send(DRIVE)
        me = os.getpid()
        if os.fork() == 0:
            time.sleep(1.0)
            os.kill(me, signal.SIGKILL)
            os._exit(0)
        os.kill(me, signal.SIGSTOP)


WAYS = {
    "thread-SIGTERM": killed_in_thread(signal.SIGTERM),
    "thread-SIGHUP": killed_in_thread(signal.SIGHUP),
    "daemon-main-ends": daemon_and_main_ends,
    "daemon-main-raises": daemon_and_main_raises,
    "never-left": never_left,
    "stack-never-closed": stack_never_closed,
    "generator-never-resumed": generator_never_resumed,
    "lock-held-and-killed": lock_held_and_killed,
    "exit": exited,
    "out-of-seconds": out_of_seconds,
    "copied": copied,
    "stopped": stopped,
    "link-stopped-and-killed": link_stopped_and_killed,
    "link-killed-and-killed": link_killed_and_killed,
    "hangs-SIGINT": link_hangs(signal.SIGINT),
    "hangs-SIGKILL": link_hangs(signal.SIGKILL),
    "silence-raises": killed(signal.SIGTERM),
    "silence-raises-and-killed": killed(signal.SIGKILL),
    **{name: killed(getattr(signal, name)) for name in ("SIGINT", "SIGTERM", "SIGHUP", *SIGNALS)},
}


def main() -> None:
    name, folder, trials, *ways = sys.argv[1:]
    # UDP boards belong to one link process at a time. Other links run beside each other, because
    # most of their time is spent waiting.
    together = 1 if name == "udp" else 4
    processes: list[int] = []
    for trial in range(int(trials)):
        for way in ways:
            log = Path(folder) / f"{way}-{trial}.log"
            process = os.fork()
            if process == 0:
                os.setsid()
                signal.signal(
                    signal.SIGHUP, signal.SIG_DFL
                )  # a run of the tests may outlive its terminal
                made = (ODD if way.startswith("silence") else PLAIN)[name]
                if way.startswith("hangs"):
                    made = HangingUDP if name == "udp" else HangingLink
                link = (
                    Interrupted()
                    if way.startswith("silence") and name == "recording" and trial % 2
                    else made()
                )
                resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
                os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
                WAYS[way](at.Emission(link, cap=1.0, ramp=0.0, log=log))
                return  # as a script that ends
            processes.append(process)
            if len(processes) == together:
                os.waitpid(processes.pop(0), 0)
            end = time.monotonic() + 20.0
            while name == "udp" and time.monotonic() < end:
                if log.exists() and log.read_text().endswith("closed\n"):
                    break
                time.sleep(0.02)
    for process in processes:
        os.waitpid(process, 0)


if __name__ == "__main__":
    main()
