"""Ctrl-C after Netgen has meshed, in a process of its own."""

import subprocess
import sys

INTERRUPTED = """
import os, signal, sys
import numpy as np
import airtact as at

scene = at.Scene(at.Medium(343.1, 1.293), [at.sound_hard(at.sphere(2e-3, 1e-3))], frequency=40e3)
at.FiniteElement(order=1).factorised(scene)
try:
    os.kill(os.getpid(), signal.SIGINT)
    sys.exit("nothing was heard")
except KeyboardInterrupt:
    print("heard")
"""


def test_ctrl_c_is_heard_after_netgen_has_meshed() -> None:
    done = subprocess.run([sys.executable, "-c", INTERRUPTED], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "heard\n"), done.stderr
