"""Ctrl-C after Netgen has meshed, in a process of its own."""

import subprocess
import sys

INTERRUPTED = """
import os, signal, sys, time
import numpy as np
import airtact as at

signal.signal(signal.SIGINT, signal.default_int_handler)  # which a shell's background job would ignore
scene = at.Scene(at.Medium(343.1, 1.293), [at.sound_hard(at.sphere(2e-3, 1e-3))], frequency=40e3)
at.FiniteElement(order=1).factorised(scene)
try:
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(20)  # another thread may get it first
    sys.exit("no interrupt arrived")
except KeyboardInterrupt:
    print("interrupted")
"""


def test_ctrl_c_interrupts_after_netgen_has_meshed() -> None:
    done = subprocess.run(
        [sys.executable, "-c", INTERRUPTED], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout) == (0, "interrupted\n"), done.stderr
