"""A process that solves the newest hand over and over, while the loop goes on.

The process reads pickles, first the scene and the parts to solve and then hands, and writes
solutions and sentences of faults. It ends when its input does.
"""

import os
import pickle
import subprocess
import sys
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from threading import Condition, Thread, get_native_id
from typing import BinaryIO

import numpy as np
from jaxtyping import Float64

from airtact.errors import InvalidInput, NotConverged
from airtact.hands.joints import joints_of
from airtact.live.drives.bending import BendingHand
from airtact.live.drives.factors import HandFactors, PartSolver
from airtact.live.drives.library import expected_kept
from airtact.live.drives.riding import gap_change, ride
from airtact.live.parts import LiveScene, Rule
from airtact.printing import in_short
from airtact.timing import give_way

NICE: dict[tuple[Rule, ...], int] = {("phalanges",): 5, ("hand",): 15, ("carried",): 5}
"""The parts of a hand that a process solves, one or the other, and how much lower its priority is."""

ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}

AHEAD = 1.5
"""A solution is made for the pose this many solving times ahead: it is ready after one and in use for another."""

SMOOTHING = 0.3
"""Weight of the newest solving time in the usual one."""

FIRST_SECONDS: dict[Rule, float] = {
    "phalanges": 0.015,
    "fingers": 0.06,
    "hand": 0.5,
    "carried": 0.02,
}
"""Solving times that are assumed before any was measured [s]."""

BEHIND = 5
"""How much lower the priority of the thread is that solves what another one carries."""

CARRIED, SOLVED_AHEAD = 0.03, 0.1
"""Least time between two poses that sound is carried to, and how far ahead of it a pose is solved [s]."""

MOST_FOUND = 64
"""Solutions that wait for the loop at most; older ones are dropped."""

FARTHEST = 0.06
"""A hand is not extrapolated farther ahead than this [s]."""

PAUSE = 0.02
"""After a hand that could not be solved the process waits so long for another one [s]."""

PATIENCE = 0.3
"""A hand that was not asked for longer is not solved [s]."""


@dataclass(frozen=True, eq=False)
class Asked:
    """The hand to solve next.

    Attributes
    ----------
    time : at which the hand is as given, of the tracker's clock [s].
    joints : (25, 3) [m].
    velocities : (25, 3) [m/s].
    sent : when it was asked, by ``time.monotonic`` [s].
    """

    time: float
    joints: Float64[np.ndarray, "25 3"]
    velocities: Float64[np.ndarray, "25 3"]
    sent: float

    __repr__ = in_short

    def after(self, ahead: float) -> Float64[np.ndarray, "25 3"]:
        """Carry the joints on for a time [s]; where that is no hand, they stay as they are."""
        carried = self.joints + ahead * self.velocities
        try:
            return joints_of(carried)
        except InvalidInput:
            return self.joints


class Plan:
    """Which part of a hand to solve next, and for when: the part that is expected to keep most while it is in use."""

    def __init__(self, parts: Sequence[Rule]) -> None:
        self._parts = parts
        self.seconds = dict(FIRST_SECONDS)

    def next(self, scene: LiveScene, asked: Asked) -> tuple[Rule, float]:
        """Return the part to solve, and how far ahead [s]; raises ``InvalidInput`` where the joints are no hand's."""
        step = 0.01
        now, soon = (ride(scene, asked.after(ahead)) for ahead in (0.0, step))
        speed = float(gap_change(now.distances, soon.distances)) / step
        still = np.zeros(1)
        usual = {
            part: expected_kept(part, 0.5 * speed * self.seconds[part] + still, still)[0]
            for part in self._parts
        }
        best = max(self._parts, key=lambda part: usual[part])
        return best, AHEAD * self.seconds[best]

    def took(self, part: Rule, seconds: float) -> None:
        """Learn how long a part took [s]."""
        self.seconds[part] += SMOOTHING * (seconds - self.seconds[part])


class ShapeSolver(ABC):
    """What solves hands beside the loop; all methods return at once."""

    @abstractmethod
    def ask(self, asked: Asked) -> None:
        """Hand over the newest hand."""

    @abstractmethod
    def found(self) -> list[HandFactors | str]:
        """Return what came since the last call: solutions, and sentences of what could not be solved."""

    @abstractmethod
    def close(self) -> None:
        """End it."""


class SolverProcess(ShapeSolver):
    """Solves the newest hand in a process of its own, of low priority and with one thread.

    Parameters
    ----------
    scene : of the live loop.
    parts : of the hand, of which it solves the one that is worth most.
    """

    def __init__(self, scene: LiveScene, parts: tuple[Rule, ...]) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-c", "from airtact.live.drives.solver_process import run; run()"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={**os.environ, **ONE_THREAD},
            start_new_session=True,  # Ctrl-C reaches the loop alone, which ends this process
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._newest, self._found = _Newest(), deque[HandFactors | str](maxlen=MOST_FOUND)
        Thread(target=self._send, args=(self._process.stdin, (scene, parts)), daemon=True).start()
        Thread(target=self._receive, args=(self._process.stdout,), daemon=True).start()

    def ask(self, asked: Asked) -> None:
        """Hand over the newest hand."""
        self._newest.put(asked)

    def found(self) -> list[HandFactors | str]:
        """Return what came since the last call: solutions, and sentences of what could not be solved."""
        return [self._found.popleft() for _ in range(len(self._found))]

    @property
    def alive(self) -> bool:
        """Whether the process runs."""
        return self._process.poll() is None

    def close(self) -> None:
        """End the process."""
        self._newest.end()
        self._process.kill()
        self._process.wait()

    def _send(self, to: BinaryIO, first: tuple[LiveScene, tuple[Rule, ...]]) -> None:
        with suppress(OSError), to:
            pickle.dump(first, to)
            to.flush()
            while (asked := self._newest.take()) is not None:
                pickle.dump(asked, to)
                to.flush()

    def _receive(self, source: BinaryIO) -> None:
        with suppress(EOFError, OSError, pickle.UnpicklingError), source:
            while True:
                self._found.append(pickle.load(source))


class _Newest:
    """The newest hand that was put in, for a thread that waits for one."""

    def __init__(self) -> None:
        self._changed = Condition()
        self._asked: Asked | None = None
        self._ended = False

    def put(self, asked: Asked) -> None:
        """Put in a hand in place of the one before."""
        with self._changed:
            self._asked = asked
            self._changed.notify()

    def end(self) -> None:
        """Put in no more."""
        with self._changed:
            self._ended = True
            self._changed.notify()

    def take(self, patience: float = 0.0) -> Asked | None:
        """Wait for a hand and take it, or only look while it is newer than ``patience`` [s]; None at the end."""
        with self._changed:
            while not self._ended:
                asked = self._asked
                if asked is None or time.monotonic() - asked.sent >= patience:
                    self._asked = None
                if asked is not None and (not patience or self._asked is not None):
                    return asked
                self._changed.wait()
        return None


def _solve(scene: LiveScene, parts: tuple[Rule, ...], newest: _Newest, to: BinaryIO) -> None:
    """Solve hands until there are no more."""
    plan, solver = Plan(parts), PartSolver(scene)
    while (asked := newest.take(PATIENCE)) is not None:
        begun = time.monotonic()
        try:
            part, ahead = plan.next(scene, asked)
            ahead = min(ahead + begun - asked.sent, FARTHEST)
            joints, then = asked.after(ahead), asked.time + ahead
            answer = solver.solved(joints, part, then)
            plan.took(part, time.monotonic() - begun)
        except (InvalidInput, NotConverged) as fault:
            answer = str(fault)
            time.sleep(PAUSE)
        pickle.dump(answer, to)
        to.flush()


def _carry(scene: LiveScene, newest: _Newest, to: BinaryIO) -> None:
    """Solve whole hands in a thread beside this one, and carry what it found to new hands until there are no more."""
    hand, to_solve, plan = BendingHand(scene), _Newest(), Plan(("carried",))
    beside = Thread(target=_solve_to_carry, args=(hand, to_solve))
    beside.start()
    try:
        while (asked := newest.take(PATIENCE)) is not None:
            to_solve.put(asked)
            begun = time.monotonic()
            try:
                part, ahead = plan.next(scene, asked)
                ahead = min(ahead + begun - asked.sent, FARTHEST)
                answer = hand.carried(asked.after(ahead), asked.time + ahead)
                plan.took(part, time.monotonic() - begun)
            except InvalidInput as fault:
                answer = str(fault)
            if answer is not None:
                pickle.dump(answer, to)
                to.flush()
            time.sleep(max(begun + CARRIED - time.monotonic(), 0.0))
    finally:
        to_solve.end()
        beside.join()  # an interpreter that ends while a thread computes in a kernel is aborted


def _solve_to_carry(hand: BendingHand, newest: _Newest) -> None:
    with suppress(AttributeError, OSError):
        os.setpriority(
            os.PRIO_PROCESS, get_native_id(), os.getpriority(os.PRIO_PROCESS, 0) + BEHIND
        )
    while (asked := newest.take(PATIENCE)) is not None:
        ahead = SOLVED_AHEAD + time.monotonic() - asked.sent
        try:
            hand.keep(hand.solved(asked.after(ahead), asked.time + ahead))
        except (InvalidInput, NotConverged):
            time.sleep(PAUSE)


def _read(source: BinaryIO, newest: _Newest) -> None:
    with suppress(EOFError, OSError):
        while True:
            newest.put(pickle.load(source))
    newest.end()


def run() -> None:
    """Solve hands in a process of its own: a scene and parts, then hands from the input, answers to the output."""
    source, to = sys.stdin.buffer, os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(
        sys.stderr.fileno(), sys.stdout.fileno()
    )  # what is printed must not get among the solutions
    scene, parts = pickle.load(source)
    give_way(NICE[parts])
    newest = _Newest()
    Thread(target=_read, args=(source, newest), daemon=True).start()
    with suppress(BrokenPipeError):
        if parts == ("carried",):
            _carry(scene, newest, to)
        else:
            _solve(scene, parts, newest, to)
