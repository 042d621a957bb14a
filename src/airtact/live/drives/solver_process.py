"""A process that solves the newest hand over and over, while the loop goes on.

The process reads pickles, first the scene and the parts to solve and then hands, and writes
solutions and messages of what could not be solved. It ends when its input does.
"""

import os
import pickle
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from threading import Condition, Thread, get_native_id
from typing import BinaryIO

import numpy as np

from airtact.errors import InvalidInput, NotConverged
from airtact.hands.joints import joints_of
from airtact.live.drives.bending import BendingHand
from airtact.live.drives.factors import HandFactors, PartSolver
from airtact.live.drives.library import expected_kept
from airtact.live.moment import Rule
from airtact.live.scene import Joints, LiveScene, gap_change, pose_hand
from airtact.printing import in_short
from airtact.timing import give_way

ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
"""Environment of a process that must leave the other cores to the loop."""

MAX_REQUEST_AGE = 0.3
"""Older requests are not solved [s]."""

RETRY_PAUSE = 0.02
"""Pause after a hand that could not be solved [s]."""


@dataclass(frozen=True, eq=False)
class Request:
    """The hand to solve next.

    Attributes
    ----------
    time : of the hand as given, on the tracker's clock [s].
    joints : (25, 3) [m].
    velocities : (25, 3) [m/s].
    sent : when it was sent, by ``time.monotonic`` [s].
    """

    time: float
    joints: Joints
    velocities: Joints
    sent: float

    __repr__ = in_short

    def after(self, ahead: float) -> Joints:
        """Extrapolate the joints by a time [s]; where that is no hand, they stay as they are."""
        try:
            return joints_of(self.joints + ahead * self.velocities)
        except InvalidInput:
            return self.joints


class Plan:
    """Decides which part of a hand to solve next, and for which time."""

    def __init__(self, parts: Sequence[Rule]) -> None:
        self._parts = parts
        # Mean solving time of each part [s]: a guess before any was measured.
        self.seconds: dict[Rule, float] = {
            "phalanges": 0.015,
            "fingers": 0.06,
            "hand": 0.5,
            "carried": 0.02,
        }

    def next(self, scene: LiveScene, request: Request) -> tuple[Rule, float]:
        """Return the part to solve, and how far ahead [s]; raises ``InvalidInput`` for no hand."""
        step = 0.01
        now = pose_hand(scene, request.after(0.0))
        soon = pose_hand(scene, request.after(step))
        speed = float(gap_change(now.distances, soon.distances)) / step

        def usual_share(part: Rule) -> float:
            # While a solution is in use its pose is off by half a solving time on average.
            gap = np.full(1, 0.5 * speed * self.seconds[part])
            return float(expected_kept(part, gap, np.zeros(1))[0])

        best = max(self._parts, key=usual_share)
        # A solution is ready after one solving time and in use for another: the middle is best.
        return best, 1.5 * self.seconds[best]

    def took(self, part: Rule, seconds: float) -> None:
        """Update the mean solving time of a part [s]."""
        self.seconds[part] += 0.3 * (seconds - self.seconds[part])


class SolverProcess:
    """Solves the newest hand in a process of its own, of low priority and with one thread.

    All methods return at once.

    Parameters
    ----------
    scene : of the live loop.
    parts : of the hand; the one that is expected to help most is solved.
    """

    def __init__(self, scene: LiveScene, parts: tuple[Rule, ...]) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-c", "from airtact.live.drives.solver_process import main; main()"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={**os.environ, **ONE_THREAD},
            start_new_session=True,  # Ctrl-C reaches the loop alone, which ends this process
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._newest = _Newest()
        self._solutions: deque[HandFactors | str] = deque(maxlen=64)
        Thread(target=self._send, args=(self._process.stdin, (scene, parts)), daemon=True).start()
        Thread(target=self._receive, args=(self._process.stdout,), daemon=True).start()

    def ask(self, request: Request) -> None:
        """Hand over the newest hand."""
        self._newest.put(request)

    def solutions(self) -> list[HandFactors | str]:
        """Return solutions since the last call, and messages of what could not be solved."""
        return [self._solutions.popleft() for _ in range(len(self._solutions))]

    @property
    def alive(self) -> bool:
        """Whether the process runs."""
        return self._process.poll() is None

    def close(self) -> None:
        """End the process."""
        self._newest.end()
        self._process.kill()
        self._process.wait()

    def _send(self, pipe: BinaryIO, first: tuple[LiveScene, tuple[Rule, ...]]) -> None:
        with suppress(OSError), pipe:
            _dump(first, pipe)
            while (request := self._newest.take()) is not None:
                _dump(request, pipe)

    def _receive(self, pipe: BinaryIO) -> None:
        with suppress(EOFError, OSError, pickle.UnpicklingError), pipe:
            while True:
                self._solutions.append(pickle.load(pipe))


def _dump(message: object, pipe: BinaryIO) -> None:
    pickle.dump(message, pipe)
    pipe.flush()


class _Newest:
    """Mailbox for the newest request, for the threads that wait for one."""

    def __init__(self) -> None:
        self._changed = Condition()
        self._request: Request | None = None
        self._ended = False

    def put(self, request: Request) -> None:
        """Put in a request in place of the previous one."""
        with self._changed:
            self._request = request
            self._changed.notify_all()

    def end(self) -> None:
        """Accept no more requests."""
        with self._changed:
            self._ended = True
            self._changed.notify_all()

    def take(self) -> Request | None:
        """Wait for a request and remove it; None at the end."""
        with self._changed:
            self._changed.wait_for(lambda: self._ended or self._request is not None)
            request = self._request
            self._request = None
            return None if self._ended else request

    def look(self, max_age: float) -> Request | None:
        """Wait for a request younger than ``max_age`` [s] and leave it; None at the end."""
        with self._changed:
            while not self._ended:
                request = self._request
                if request is not None and time.monotonic() - request.sent < max_age:
                    return request
                self._request = None  # too old: the hand is lost, or the loop stalls
                self._changed.wait()
        return None


def _answer(
    scene: LiveScene,
    parts: Sequence[Rule],
    solve: Callable[[Joints, Rule, float], HandFactors | None],
    newest: _Newest,
    pipe: BinaryIO,
    interval: float = 0.0,
) -> None:
    """Answer the newest request over and over, at least an interval apart [s], until the end."""
    plan = Plan(parts)
    while (request := newest.look(MAX_REQUEST_AGE)) is not None:
        begun = time.monotonic()
        try:
            part, ahead = plan.next(scene, request)
            # The request has aged in the mailbox, and that time is added. A hand is extrapolated
            # by 60 ms at most, for its solution to be used as it is.
            ahead = min(ahead + begun - request.sent, 0.06)
            answer = solve(request.after(ahead), part, request.time + ahead)
            plan.took(part, time.monotonic() - begun)
        except (InvalidInput, NotConverged) as fault:
            answer = str(fault)
            time.sleep(RETRY_PAUSE)
        if answer is not None:
            _dump(answer, pipe)
        time.sleep(max(begun + interval - time.monotonic(), 0.0))


def _solve_to_carry(hand: BendingHand, newest: _Newest) -> None:
    """Solve whole hands, at a priority below that of the thread that carries their solutions."""
    with suppress(AttributeError, OSError):
        nice = os.getpriority(os.PRIO_PROCESS, 0) + 5
        os.setpriority(os.PRIO_PROCESS, get_native_id(), nice)
    while (request := newest.look(MAX_REQUEST_AGE)) is not None:
        # The pose of 0.1 s from now: a solution comes late, and serves for a while.
        ahead = 0.1 + time.monotonic() - request.sent
        try:
            hand.keep(hand.solved(request.after(ahead), request.time + ahead))
        except (InvalidInput, NotConverged):
            time.sleep(RETRY_PAUSE)


def main() -> None:
    """Run the process: a scene and parts, then hands from its input, answers to its output."""
    source = sys.stdin.buffer
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    # Other output goes to the standard error, not among the solutions.
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    scene, parts = pickle.load(source)
    # Phalanges and carried sound are needed at once; a whole hand takes its time.
    give_way(15 if parts == ("hand",) else 5)
    newest = _Newest()

    def read() -> None:
        with suppress(EOFError, OSError):
            while True:
                newest.put(pickle.load(source))
        newest.end()

    Thread(target=read, daemon=True).start()
    with suppress(BrokenPipeError):
        if parts != ("carried",):
            _answer(scene, parts, PartSolver(scene).solved, newest, answers)
            return
        # A second thread solves whole hands; this one carries their solutions to new hands.
        hand = BendingHand(scene)

        def carried(joints: Joints, _: Rule, time: float) -> HandFactors | None:
            return hand.carried(joints, time)

        solving = Thread(target=_solve_to_carry, args=(hand, newest))
        solving.start()
        try:
            # More often than every 30 ms would take time from solving for no benefit.
            _answer(scene, parts, carried, newest, answers, 0.03)
        finally:
            newest.end()
            solving.join()  # an interpreter that ends while a thread is in a kernel is aborted
