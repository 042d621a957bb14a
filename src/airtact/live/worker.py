"""Worker processes of the loop; each processes its newest message and sends results back."""

import os
import pickle
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from threading import Condition, Lock, Thread
from typing import IO, Any, cast

from airtact.timing import start_python


class Mailbox:
    """Container for the newest message, which replaces the previous one.

    Attributes
    ----------
    newest : newest message; None if none has arrived or ``take`` has removed it.
    ended : whether no more messages will arrive.
    """

    def __init__(self) -> None:
        self.newest: Any = None
        self.ended: bool = False
        self._arrived = 0.0
        self._changed = Condition()

    def put(self, message: object) -> None:
        """Replace the message."""
        with self._changed:
            self.newest = message
            self._arrived = time.monotonic()
            self._changed.notify_all()

    def end(self) -> None:
        """Signal that no more messages will arrive."""
        with self._changed:
            self.ended = True
            self._changed.notify_all()

    def take(self) -> Any:
        """Wait for a message, then remove and return it; return None after ``end`` was called."""
        with self._changed:
            self._changed.wait_for(lambda: self.ended or self.newest is not None)
            message = self.newest
            self.newest = None
            return None if self.ended else message

    def look(self, max_age: float) -> Any:
        """Wait for a message no older than ``max_age`` [s], and return it without removing it.

        Returns
        -------
        The message, or None if no more messages will arrive.
        """
        with self._changed:
            while not self.ended:
                if self.newest is not None and time.monotonic() - self._arrived < max_age:
                    return self.newest
                self.newest = None
                self._changed.wait()
        return None


class Worker:
    """A separate process that answers messages; the methods of this class do not block.

    The process uses a single thread for linear algebra. It ends when this object is closed or the
    parent process ends.

    Parameters
    ----------
    work : module-level function that runs in the process. It is called with a mailbox
        that receives the messages, a function that sends a result back from any thread,
        and ``arguments``.
    arguments : further arguments; they must be picklable.
    receive : function called in a thread with each result, and with None once the process has
        ended.
    pause : shortest time between two messages to the process [s].
    """

    def __init__(
        self,
        work: Callable[..., None],
        arguments: tuple[object, ...],
        receive: Callable[[Any], None],
        pause: float = 0.0,
    ) -> None:
        self.process = start_python(
            "-c",
            "from airtact.live.worker import main; main()",
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
        self._receive = receive
        self._pause = pause
        self._mailbox = Mailbox()
        self._threads = [
            Thread(target=self._send, args=((work, arguments),), daemon=True),
            Thread(target=self._answer, daemon=True),
        ]
        for thread in self._threads:
            thread.start()

    @property
    def ended(self) -> bool:
        """Whether the process has ended."""
        return self.process.poll() is not None

    def put(self, message: object) -> None:
        """Send a message to the process; it replaces a message that is still waiting."""
        self._mailbox.put(message)

    def close(self) -> None:
        """End the process."""
        self._mailbox.end()
        self.process.kill()
        self.process.wait()
        for thread in self._threads:
            thread.join()

    def _send(self, first: object) -> None:
        pipe = cast(IO[bytes], self.process.stdin)
        with suppress(OSError), pipe:
            dump(first, pipe)
            while (message := self._mailbox.take()) is not None:
                dump(message, pipe)
                time.sleep(self._pause)

    def _answer(self) -> None:
        pipe = cast(IO[bytes], self.process.stdout)
        with suppress(EOFError, OSError, pickle.UnpicklingError), pipe:
            while True:
                self._receive(pickle.load(pipe))
        self._receive(None)


def dump(message: object, pipe: IO[bytes]) -> None:
    """Send a message through a pipe."""
    pickle.dump(message, pipe)
    pipe.flush()


def main() -> None:
    """Read a function from standard input and run it; pass all later messages to it."""
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    # Output of libraries must not be mixed with the messages.
    with open(os.devnull, "wb") as nothing:
        os.dup2(nothing.fileno(), sys.stdout.fileno())
    try:
        work, arguments = pickle.load(sys.stdin.buffer)
    except (EOFError, pickle.UnpicklingError):
        return  # the parent process ended before it had sent everything
    mailbox = Mailbox()
    lock = Lock()

    def listen() -> None:
        with suppress(EOFError, OSError, pickle.UnpicklingError):
            while True:
                mailbox.put(pickle.load(sys.stdin.buffer))
        mailbox.end()

    def send(message: object) -> None:
        with lock:
            dump(message, answers)

    Thread(target=listen, daemon=True).start()
    with suppress(BrokenPipeError):
        work(mailbox, send, *arguments)
    # Exit at once: a normal exit aborts if another thread is reading or is in compiled code.
    os._exit(0)
