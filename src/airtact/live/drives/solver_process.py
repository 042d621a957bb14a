"""A process that repeatedly solves for the newest hand while the loop runs."""

import os
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from threading import Thread, get_native_id
from typing import Any

from airtact.errors import InvalidInput, NotConverged, in_short
from airtact.live.drives.bending import BendingHand
from airtact.live.drives.factors import PartSolver
from airtact.live.drives.skin_solver import SkinRequest, SkinSolver, extrapolated
from airtact.live.moment import Rule
from airtact.live.scene import Joints, LiveScene
from airtact.live.worker import Mailbox, Worker
from airtact.timing import give_way

# Older requests are skipped [s], because the hand is lost or the loop has stalled.
MAX_REQUEST_AGE = 0.3

# Pause after a hand that could not be solved [s].
RETRY_PAUSE = 0.02


@dataclass(frozen=True, eq=False)
class Request:
    """Request to compute the scattering by a hand.

    Attributes
    ----------
    time : time of the joints, on the tracker's clock [s].
    joints : (25, 3) joints of the hand [m].
    velocities : (25, 3) velocities of the joints [m/s].
    sent : time when the request was sent, as returned by ``time.monotonic`` [s].
    """

    time: float
    joints: Joints
    velocities: Joints
    sent: float

    __repr__ = in_short

    def after(self, ahead: float) -> Joints:
        """Return the joints expected after ``ahead`` [s]; see ``extrapolated``."""
        return extrapolated(self.joints, self.velocities, ahead)


class SolverProcess:
    """Low-priority process that computes the scattering by a part of the newest hand.

    ``ask`` passes the newest hand to the process, and ``solutions`` returns the results so far. All
    methods return at once.

    Parameters
    ----------
    scene : scene of the live loop.
    part : part of the hand to solve, such as "phalanges" or "hand".
    """

    def __init__(self, scene: LiveScene, part: Rule) -> None:
        self._solutions: deque[Any] = deque(maxlen=64)
        self._arguments = (scene, part)
        self._restarts = 0
        self._start()

    def _start(self) -> None:
        self._worker = Worker(solve_hands, self._arguments, self._solutions.append)

    def revive(self) -> int:
        """Restart the process if it has ended; return the number of restarts so far."""
        if self._worker.ended:
            self._worker.close()
            self._start()
            self._restarts += 1
        return self._restarts

    def ask(self, request: Request | SkinRequest) -> None:
        """Pass the newest hand to the process."""
        self._worker.put(request)

    def solutions(self) -> list[Any]:
        """Return all solutions and error messages that have arrived since the last call."""
        answers = [self._solutions.popleft() for _ in range(len(self._solutions))]
        return [answer for answer in answers if answer is not None]

    def close(self) -> None:
        """End the process."""
        self._worker.close()


def solve_hands(
    mailbox: Mailbox, send: Callable[[object], None], scene: LiveScene, part: Rule
) -> None:
    """Repeatedly compute the scattering by part of the newest hand, until no more hands arrive."""
    # Phalanges and carried solutions are urgent, but whole hands are not.
    give_way(15 if part == "hand" else 5)
    if part == "contacts":
        _answer(mailbox, send, SkinSolver(scene).solved)
        return
    if part != "carried":
        solver = PartSolver(scene)
        _answer(mailbox, send, lambda joints, time: solver.solved(joints, part, time))
        return
    # A second thread solves for whole hands. This one moves their solutions to newer poses.
    hand = BendingHand(scene)
    Thread(target=_solve_to_carry, args=(hand, mailbox), daemon=True).start()
    # Moving solutions more often than every 30 ms would slow down solving without any benefit.
    _answer(mailbox, send, hand.carried, 0.03)


def solved_ahead(seconds: float) -> float:
    """Return the time [s] by which to extrapolate a hand if each solution takes ``seconds``."""
    # A solution is ready after one solving time and used for another: aim at the middle of its use.
    return 1.5 * seconds


def _answer(
    mailbox: Mailbox,
    send: Callable[[object], None],
    solve: Callable[[Any, float], object],
    interval: float = 0.0,
) -> None:
    """Repeatedly answer the newest request, at most once per interval [s], until the end."""
    seconds = 0.02  # mean solving time, starting from a guess
    while (request := mailbox.look(MAX_REQUEST_AGE)) is not None:
        begun = time.monotonic()
        try:
            # Add the time that the request spent in the mailbox. Extrapolate a hand by at most
            # 60 ms if its solution is not moved to a newer pose later.
            ahead = min(solved_ahead(seconds) + begun - request.sent, 0.06)
            answer = solve(request.after(ahead), request.time + ahead)
            seconds += 0.3 * (time.monotonic() - begun - seconds)
        except (InvalidInput, NotConverged) as fault:
            answer = str(fault)
            time.sleep(RETRY_PAUSE)
        if answer is not None:
            send(answer)
        time.sleep(max(begun + interval - time.monotonic(), 0.0))


def _solve_to_carry(hand: BendingHand, mailbox: Mailbox) -> None:
    """Solve for whole hands, at a lower priority than the thread that moves their solutions."""
    with suppress(AttributeError, OSError):
        nice = os.getpriority(os.PRIO_PROCESS, 0) + 5
        os.setpriority(os.PRIO_PROCESS, get_native_id(), nice)
    while (request := mailbox.look(MAX_REQUEST_AGE)) is not None:
        # Farther ahead, extrapolated poses are less like those in which the solution is used.
        ahead = 0.03 + time.monotonic() - request.sent
        try:
            hand.keep(hand.solved(request.after(ahead), request.time + ahead))
        except (InvalidInput, NotConverged):
            time.sleep(RETRY_PAUSE)
