"""The process that holds a link, and the owner's code that starts it and replaces it if lost.

The link process plays for its owner, and silences the boards when the owner ends. Whatever ends the
owner does not end the link process before the boards are silent: it has its own session, ignores
every signal that it can, and notices at once when the owner or its connection ends.
"""

import copy
import os
import pickle
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
import warnings
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from airtact.emission.link import Link, LinkFailed
from airtact.emission.player import Player, Settings
from airtact.errors import InvalidInput

# Time that a link process may take to answer before it is killed [s].
ANSWER_TIMEOUT = 30.0

# Time that a link process may take to open its link before it is killed [s].
OPENING_TIMEOUT = 120.0

# Time that a link process may take to exit after its link is closed [s].
ENDING_TIMEOUT = 5.0


class Channel:
    """One end of a connection that carries Python objects; an incomplete message never blocks.

    Parameters
    ----------
    end : one of a pair of connected sockets.
    patience : time that the other side may take to accept a message [s].
    """

    # Header of each message: its length in bytes.
    LENGTH = struct.Struct("<Q")

    def __init__(self, end: socket.socket, patience: float = 10.0) -> None:
        self._socket = end
        self._patience = patience
        self._received = bytearray()

    def send(self, message: tuple[object, ...]) -> None:
        """Send picklable objects; raise OSError if the other side does not accept them."""
        data = pickle.dumps(message, protocol=pickle.HIGHEST_PROTOCOL)
        # An owner that does not read must not block the player's watchdog.
        self._socket.settimeout(self._patience)
        self._socket.sendall(self.LENGTH.pack(len(data)) + data)

    def receive(self, seconds: float) -> tuple[Any, ...] | None:
        """Return the next message, or None after the timeout; raise EOFError at the end."""
        end = time.monotonic() + seconds
        while (message := self._complete()) is None:
            self._socket.settimeout(max(end - time.monotonic(), 0.0))
            try:
                part = self._socket.recv(1 << 20)
            except (BlockingIOError, TimeoutError):
                return None
            except OSError:
                part = b""
            if not part:
                raise EOFError
            self._received += part
        return message

    def close(self) -> None:
        """Close this end, which the other side notices at once."""
        self._socket.close()

    def _complete(self) -> tuple[Any, ...] | None:
        if len(self._received) < self.LENGTH.size:
            return None
        end = self.LENGTH.size + self.LENGTH.unpack_from(self._received)[0]
        if len(self._received) < end:
            return None
        message = pickle.loads(self._received[self.LENGTH.size : end])
        del self._received[:end]
        return message


class LinkProcess:
    """A link that is open in its own process, or in a thread of this process if necessary.

    Parameters
    ----------
    link : link, not open yet.
    settings : settings of the playback.

    Attributes
    ----------
    process : id of the process that holds the link; None if it is this one.
    """

    def __init__(self, link: Link, settings: Settings) -> None:
        self.process: int | None = None
        self._link = link
        self._settings = settings
        self._lock = threading.Lock()
        self._number = 0
        self._closing = False
        self._lost: str | None = None
        self._rescue: LinkFailed | None = None
        self._watcher: threading.Thread | None = None
        self._child: subprocess.Popen[bytes] | None = None
        reason = why_here(link)
        if reason is not None:
            warnings.warn(
                f"the {link.name} link is open in this process, because {reason}; if the process "
                f"is killed, its {link.elements} elements go on emitting.",
                stacklevel=4,
            )
        # A socket instead of a pipe, because both sides notice its end.
        ours, theirs = socket.socketpair()
        self._channel = Channel(ours)
        if reason is None:
            with theirs:
                self._child = _start(theirs)
            self.process = self._child.pid
        else:
            thread = threading.Thread(
                target=serve,
                args=(Channel(theirs),),
                kwargs={"here": link},
                name="link",
                daemon=True,
            )
            thread.start()
        sent_link = link if reason is None else None
        try:
            self.ask("open", sent_link, settings, seconds=OPENING_TIMEOUT)
        except BaseException:
            self.end()
            raise
        if self._child is not None:
            # A thread, because the boards must fall silent even while the owner computes.
            self._watcher = threading.Thread(target=self._watch, name="link watcher", daemon=True)
            self._watcher.start()

    def ask(self, name: str, *arguments: object, seconds: float | None = None) -> Any:
        """Call a method of the link's player and return its answer, within a time [s].

        The time is ``ANSWER_TIMEOUT`` unless given.

        Raises
        ------
        InvalidInput, LinkFailed
            The errors of the link, or "link_process_lost" if its process has ended.
        """
        seconds = ANSWER_TIMEOUT if seconds is None else seconds
        with self._lock:
            if self._lost is not None:
                raise self._lost_error()
            self._number += 1
            try:
                self._channel.send((self._number, name, arguments))
                answer = self._answer(seconds)
            except (EOFError, OSError):
                self._lose("ended")
                raise self._lost_error() from None
            if answer is None:
                self._lose(f"did not answer for {seconds:g} s")
                raise self._lost_error()
        _, value, fault, sent = answer
        self._link.sent = sent
        if fault is not None:
            raise fault
        return value

    def _answer(self, seconds: float) -> Any:
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0.0:
            answer = self._channel.receive(left)
            # Older answers belong to calls that were interrupted.
            if answer is not None and answer[0] == self._number:
                return answer
        return None

    def _lose(self, event: str) -> None:
        """Note why the link process is lost; kill it if it does not answer."""
        if self._child is not None:
            if event != "ended":
                self._child.kill()
            with suppress(subprocess.TimeoutExpired):
                code = self._child.wait(ENDING_TIMEOUT)
                if code < 0:
                    event += f" by {signal.Signals(-code).name}"
        self._lost = self._lost or event

    def _lost_error(self) -> LinkFailed:
        who = "thread" if self._child is None else f"process {self._child.pid}"
        then = "it had not opened" if self._watcher is None else "another one silences the boards"
        return LinkFailed(
            f"the link's {who} {self._lost}, after {self._link.sent} frames; {then}.",
            code="link_process_lost",
        )

    def _watch(self) -> None:
        """Have another process silence the boards as soon as the link process has ended."""
        assert self._child is not None
        # Polled, because a thread that waits for the process blocks other threads that do so.
        while self._child.poll() is None:
            time.sleep(0.01)
        if self._child.returncode == 0 and self._closing:
            return
        self._lose("ended")
        try:
            successor = LinkProcess(copy.copy(self._link), self._settings)
            successor.ask("finish", "another link process was lost")
            successor.close()
        except Exception as error:
            self._rescue = LinkFailed(
                f"{str(self._lost_error()).split(';')[0]}, and no other could silence the boards: "
                f"{str(error).rstrip('.')}; the boards may still emit: cut their power.",
                code="silence_failed",
            )

    def close(self) -> str | None:
        """Close the link; return why the emission ended.

        Raises
        ------
        LinkFailed
            "link_process_lost" or "silence_failed", if the process was lost.
        """
        try:
            self._closing = True
            return self.ask("close")
        except LinkFailed as error:
            # The watcher has another process silence the boards: wait for its result.
            if error.code == "link_process_lost" and self._watcher is not None:
                self._watcher.join(OPENING_TIMEOUT)
                raise (self._rescue or error) from None
            raise
        finally:
            self.end()

    def end(self) -> None:
        """Close the connection, which ends the process, and wait for its end."""
        self._closing = True
        self._channel.close()
        if self._child is not None:
            try:
                self._child.wait(ENDING_TIMEOUT)
            except subprocess.TimeoutExpired:
                self._child.kill()
                self._child.wait()


def why_here(link: Link) -> str | None:
    """Return why a link cannot be opened in another process, or None if it can."""
    if os.name != "posix":
        return f"link processes need a POSIX system, and this is {sys.platform}"
    if not sys.executable:
        return "the path of the Python interpreter is not known"
    if type(link).__module__ == "__main__":
        return f"{type(link).__name__} is defined in the script itself: put it into a module"
    # Only a link that can be pickled can be sent to another process.
    try:
        pickle.dumps(link)
    except Exception as error:
        return f"{type(link).__name__} cannot be passed on ({error})"
    return None


def _start(end: socket.socket) -> "subprocess.Popen[bytes]":
    module = "airtact.emission.link_process"
    # The process can import the same modules, and signals to this session do not reach it.
    paths = os.pathsep.join(os.path.abspath(path) for path in sys.path)
    try:
        return subprocess.Popen(
            [sys.executable, "-P", "-m", module, str(end.fileno()), str(os.getpid())],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            env={**os.environ, "PYTHONPATH": paths, "OPENBLAS_NUM_THREADS": "1"},
            pass_fds=(end.fileno(),),
            start_new_session=True,
        )
    except OSError as error:
        raise LinkFailed(
            f"no process for the link could be started (error {error.errno}): {error.strerror}.",
            code="link_process_lost",
        ) from None


# --- in the process ---


def serve(
    channel: Channel, gone: Callable[[], bool] = lambda: False, here: Link | None = None
) -> None:
    """Play a link, ``here`` or from the first message, until its owner closes it or ends."""
    player: Player | None = None
    try:
        while not gone():
            message = channel.receive(0.1 if player is None else player.wait())
            if message is not None:
                number, name, arguments = message
                answer: Any = None
                fault: BaseException | None = None
                try:
                    if name == "open":
                        link, settings = arguments
                        opened = Player(here or link, settings)
                        opened.open()
                        # Set only now: a link that did not open is not silenced.
                        player = opened
                    else:
                        answer = getattr(player, name)(*arguments)
                except BaseException as error:
                    fault = _carried(error)
                channel.send((number, answer, fault, 0 if player is None else player.link.sent))
                if name == "close" or player is None:
                    return
            if player is not None:
                player.step()
    except (EOFError, OSError):  # the owner has ended: silence the boards below
        pass
    finally:
        if player is not None:
            _end(player)
        channel.close()


def _carried(error: BaseException) -> BaseException:
    """Return an error in a form that another process can raise."""
    if isinstance(error, InvalidInput | LinkFailed):
        error.__cause__ = error.__context__ = None
        return error
    return LinkFailed(f"the link raised {type(error).__name__}: {error}.", code="link_failed")


def _end(player: Player) -> None:
    # There is no owner to report to, so try again for 5 s if silence is not confirmed.
    for _ in range(50):
        try:
            player.finish("its process was gone")
            break
        except BaseException:
            time.sleep(0.1)
    with suppress(BaseException):
        player.close()


def main() -> None:
    """Serve the owner whose connection and process id are the arguments."""
    # Ignore all signals but SIGCHLD, needed to wait for child processes of libraries, and hardware
    # faults, which would repeat forever.
    needed = {
        signal.SIGCHLD,
        signal.SIGSEGV,
        signal.SIGFPE,
        signal.SIGILL,
        signal.SIGBUS,
        signal.SIGABRT,
    }
    for kind in signal.valid_signals() - needed:
        with suppress(OSError, ValueError):
            signal.signal(kind, signal.SIG_IGN)
    owner = int(sys.argv[2])
    serve(Channel(socket.socket(fileno=int(sys.argv[1]))), lambda: os.getppid() != owner)


if __name__ == "__main__":
    main()
