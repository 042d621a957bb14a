"""The process that runs a link, its guard, and the code with which their owner starts them.

The owner starts the guard, which forks the link process. The link process plays the owner's drives,
and silences the boards when the owner, the guard or the connection ends. The guard has a copy of
the link. If the link process ends or stops responding, the guard kills it, opens the link itself,
and silences the boards. Each process runs in its own session and ignores every signal that can be
ignored. Only if all three processes are lost do boards that repeat a frame by themselves keep
emitting.
"""

import copy
import os
import pickle
import select
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
from airtact.emission.player import STALL, Player, Settings
from airtact.errors import InvalidInput
from airtact.timing import start_python

# Time that a link process has to answer before it is killed [s].
ANSWER_TIMEOUT = 30.0

# Time that a link process has to open its link before it is killed [s].
OPENING_TIMEOUT = 120.0

# Time that a guard has to silence the boards, or to exit after the link is closed [s].
ENDING_TIMEOUT = 15.0

# Exit status of a guard that silenced the boards after the link process was lost.
SILENCED = 3


class Channel:
    """One end of a connection that transfers Python objects; incomplete messages do not block it.

    Parameters
    ----------
    end : one of two connected sockets.
    """

    # The header of each message is its length in bytes.
    LENGTH = struct.Struct("<Q")

    def __init__(self, end: socket.socket) -> None:
        self._socket = end
        self._received = bytearray()

    def send(self, message: tuple[object, ...]) -> None:
        """Send picklable objects; raise OSError if the other end does not accept them in 10 s."""
        data = pickle.dumps(message, protocol=pickle.HIGHEST_PROTOCOL)
        # An owner that does not read messages must not block the player's watchdog.
        self._socket.settimeout(10.0)
        self._socket.sendall(self.LENGTH.pack(len(data)) + data)

    def receive(self, seconds: float) -> tuple[Any, ...] | None:
        """Return the next message, or None on timeout; raise EOFError if the other end closed."""
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
        """Close this end of the connection; the other end notices it at once."""
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
    """A link that runs in another process, or in a thread of this process if that is impossible.

    Parameters
    ----------
    link : link that is not open yet.
    settings : settings of the playback.

    Attributes
    ----------
    process : id of the process that runs the link; None if it is this one.
    """

    def __init__(self, link: Link, settings: Settings) -> None:
        self.process: int | None = None
        self._link = link
        self._settings = settings
        self._lock = threading.Lock()
        self._number = 0
        self._lost: LinkFailed | None = None
        self._guard: subprocess.Popen[bytes] | None = None
        reason = why_here(link)
        if reason is not None:
            warnings.warn(
                f"the {link.name} link is open in this process, because {reason}; if the process "
                f"is killed, its {link.elements} elements keep emitting.",
                stacklevel=4,
            )
        # A socket is used instead of a pipe, because both ends notice when it is closed.
        ours, theirs = socket.socketpair()
        self._channel = Channel(ours)
        if reason is None:
            with theirs:
                self._guard = _start(theirs)
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
            process = self.ask("open", sent_link, settings, seconds=OPENING_TIMEOUT)
        except BaseException:
            self.end()
            raise
        if self._guard is not None:
            self.process = process

    def ask(self, name: str, *arguments: object, seconds: float | None = None) -> Any:
        """Call a method of the link's player and return its answer within ``seconds``.

        By default, ``seconds`` is ``ANSWER_TIMEOUT``.

        Raises
        ------
        InvalidInput, LinkFailed
            The error raised by the link; its code is "link_process_lost" or "silence_failed" if the
            link's process has ended.
        """
        seconds = ANSWER_TIMEOUT if seconds is None else seconds
        with self._lock:
            if self._lost is not None:
                raise self._lost
            self._number += 1
            try:
                self._channel.send((self._number, name, arguments))
                answer = self._answer(seconds)
            except (EOFError, OSError):
                raise self._lose("ended or stopped responding") from None
            if answer is None:
                if self._guard is not None:
                    os.killpg(self._guard.pid, signal.SIGKILL)
                raise self._lose(f"did not answer for {seconds:g} s")
        _, value, fault, sent = answer
        self._link.sent = sent
        if fault is not None:
            raise fault
        return value

    def _answer(self, seconds: float) -> Any:
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0.0:
            answer = self._channel.receive(left)
            # Answers with lower numbers belong to calls that were interrupted.
            if answer is not None and answer[0] == self._number:
                return answer
        return None

    def _lose(self, event: str) -> LinkFailed:
        """Return the error for a lost process once the guard or this method silenced the boards."""
        code = "link_process_lost"
        then = "it had not opened"
        if self._guard is None:
            then = "the boards may still emit: cut their power"
        else:
            status = self._end_guard()
            if self.process is not None:
                then = "another process has silenced the boards"
                # The guard was lost as well, or it failed.
                if status not in (0, SILENCED):
                    try:
                        successor = LinkProcess(copy.copy(self._link), self._settings)
                        successor.ask("finish", "another link process was lost")
                        successor.close()
                    except Exception as error:
                        code = "silence_failed"
                        then = (
                            f"no other process could silence the boards: {str(error).rstrip('.')}; "
                            "the boards may still emit: cut their power"
                        )
        who = "thread" if self._guard is None else f"process {self.process or ''}".strip()
        self._lost = LinkFailed(
            f"the link's {who} {event}, after {self._link.sent} frames; {then}.", code=code
        )
        return self._lost

    def close(self) -> str | None:
        """Close the link; return the reason why the emission ended, or None if it had not.

        Raises
        ------
        LinkFailed
            If the link process has ended unexpectedly.
        """
        try:
            return self.ask("close")
        finally:
            self.end()

    def end(self) -> None:
        """Close the connection and wait until the link process has ended."""
        self._channel.close()
        if self._guard is not None:
            self._end_guard()

    def _end_guard(self) -> int:
        """Wait for the guard to exit and return its status; kill it after ``ENDING_TIMEOUT``."""
        assert self._guard is not None
        try:
            return self._guard.wait(ENDING_TIMEOUT)
        except subprocess.TimeoutExpired:
            os.killpg(self._guard.pid, signal.SIGKILL)  # and the link process
            return self._guard.wait()


def why_here(link: Link) -> str | None:
    """Return why a link cannot be opened in another process, or None if it can."""
    if os.name != "posix":
        return f"link processes need a POSIX system, but this is {sys.platform}"
    if not sys.executable:
        return "the path of the Python interpreter is not known"
    if type(link).__module__ == "__main__":
        return f"{type(link).__name__} is defined in the script itself: put it into a module"
    # Only a link that can be pickled can be sent to another process.
    try:
        pickle.dumps(link)
    except Exception as error:
        return f"{type(link).__name__} cannot be sent to another process ({error})"
    return None


def _start(end: socket.socket) -> "subprocess.Popen[bytes]":
    try:
        return start_python(
            "-m",
            "airtact.emission.link_process",
            str(end.fileno()),
            str(os.getpid()),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            pass_fds=(end.fileno(),),
        )
    except OSError as error:
        raise LinkFailed(
            f"no process for the link could be started (error {error.errno}): {error.strerror}.",
            code="link_process_lost",
        ) from None


# --- in the link process ---


class Tether:
    """Connection of a link process to its guard, which silences the boards if that process ends.

    The methods never block.
    """

    TIME = struct.Struct("<d")

    def __init__(self, end: socket.socket) -> None:
        self._socket = end
        end.setblocking(False)

    def alive(self, seconds: float) -> None:
        """Tell the guard that the link is open, and how long the next call may take [s]."""
        with suppress(OSError):
            self._socket.send(self.TIME.pack(seconds))

    def ended(self) -> bool:
        """Whether the guard, or the process that owns the link, has ended."""
        try:
            self._socket.recv(1)  # one byte if the owner ended, none if the guard did
        except BlockingIOError:
            return False
        except OSError:
            pass
        return True


def serve(
    channel: Channel,
    tether: Tether | None = None,
    here: Link | None = None,
    message: tuple[Any, ...] | None = None,
) -> bool:
    """Run a link until its owner closes it or the owner's process ends.

    The function runs the link ``here`` or, if ``here`` is None, the link in the first message. It
    returns False only if the owner did not close the link and the boards could not be silenced.
    """
    player: Player | None = None
    closed = True
    try:
        while tether is None or not tether.ended():
            if message is None:
                message = channel.receive(0.1 if player is None else player.wait())
            if message is not None:
                number, name, arguments = message
                message = None
                answer: Any = None
                fault: BaseException | None = None
                try:
                    if name == "open":
                        link, settings = arguments
                        opened = Player(here or link, settings)
                        opened.open()
                        # Set only now, because a link that did not open is not silenced.
                        player = opened
                        answer = os.getpid()
                        if tether is not None:
                            player.alive = tether.alive
                    else:
                        if name == "close" and player is not None:
                            player.alive(5.0)
                        answer = getattr(player, name)(*arguments)
                except (InvalidInput, LinkFailed) as error:
                    # Their causes may not be picklable.
                    error.__cause__ = error.__context__ = None
                    fault = error
                except BaseException as error:
                    words = f"the link raised {type(error).__name__}: {error}."
                    fault = LinkFailed(words, code="link_failed")
                channel.send((number, answer, fault, 0 if player is None else player.link.sent))
                if name == "close" or player is None:
                    return True
            if player is not None:
                player.alive(STALL)
                player.step()
    except (EOFError, OSError):  # the owner has ended, so the boards are silenced below
        pass
    finally:
        if player is not None:
            closed = _silenced(player)
        channel.close()
    return closed


def _silenced(player: Player) -> bool:
    """Silence the boards and close the link; return whether the boards are silent."""
    silent = True
    try:
        player.finish("its process was gone")
    except BaseException:
        silent = False
    with suppress(BaseException):
        player.alive(5.0)
        player.close()
    return silent


def guard(process: int, end: socket.socket, owner: int, rescue: Callable[[], bool]) -> int:
    """Wait until the link process ends, and silence the boards unless that process has done so.

    Parameters
    ----------
    process : id of the link process, a child of this one.
    end : socket connected to the ``Tether`` of the link process.
    owner : id of the process that started this one.
    rescue : function that opens the link, silences the boards, and returns whether this succeeded.

    Returns
    -------
    The exit status of the guard.
    """
    opened = False
    left = OPENING_TIMEOUT
    while True:
        if select.select([end], [], [], 0.05)[0]:
            try:
                times = end.recv(1 << 16)
            except OSError:
                times = b""
            if not times:
                break  # the link process has ended
            opened = True
            (left,) = Tether.TIME.unpack(times[-Tether.TIME.size :])
        else:
            # Waits are counted instead of time, because both processes may have been stopped.
            left -= 0.05
            if left < 0.0:
                os.kill(process, signal.SIGKILL)
                break
        if os.getppid() != owner:
            with suppress(OSError):
                end.send(b"x")
    status = os.waitpid(process, 0)[1]
    if status == 0 or not opened:
        return 0
    return SILENCED if rescue() else 1


def main() -> None:
    """Start and guard a link process.

    The arguments are the connection to the owner and the owner's process id.
    """
    # All signals are ignored except SIGCHLD, which is needed to wait for child processes, and
    # hardware faults, which would repeat forever.
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
    channel = Channel(socket.socket(fileno=int(sys.argv[1])))
    try:
        message = channel.receive(OPENING_TIMEOUT)
    except EOFError:
        return
    assert message is not None
    link, settings = message[2]
    theirs, ours = socket.socketpair()
    # The process is forked because a second interpreter would take half a second to start.
    process = os.fork()
    if process == 0:
        theirs.close()
        silent = False
        try:
            silent = serve(channel, Tether(ours), message=message)
        finally:
            os._exit(0 if silent else 1)
    ours.close()
    channel.close()

    def rescue() -> bool:
        give_up = time.monotonic() + settings.silencing
        while True:
            player = Player(link, settings)
            try:
                player.open()
                return _silenced(player)
            except BaseException:
                if time.monotonic() > give_up:
                    return False
                time.sleep(0.1)

    sys.exit(guard(process, theirs, int(sys.argv[2]), rescue))


if __name__ == "__main__":
    main()
