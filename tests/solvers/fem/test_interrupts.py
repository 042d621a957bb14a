"""Ctrl-C after Netgen has meshed, in a process of its own, and threads of the linear algebra."""

import subprocess
import sys

from threadpoolctl import threadpool_info, threadpool_limits

from airtact.solvers.threads import one_thread_each

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
    sys.exit("nothing was heard")
except KeyboardInterrupt:
    print("heard")
"""


def test_ctrl_c_is_heard_after_netgen_has_meshed() -> None:
    done = subprocess.run([sys.executable, "-c", INTERRUPTED], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "heard\n"), done.stderr


def test_threads_that_overlap_leave_as_many_as_there_were():
    with threadpool_limits(limits=2, user_api="blas"):
        before = blas_threads()
        assert max(before) == 2
        first, second = one_thread_each(), one_thread_each()
        first.__enter__()
        second.__enter__()
        assert set(blas_threads()) == {1}
        first.__exit__(None, None, None)
        assert set(blas_threads()) == {1}
        second.__exit__(None, None, None)
        assert blas_threads() == before


def blas_threads():
    return [one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas"]
