"""One process for one board: a lock that the system frees when its holder is gone, however that ended."""

import hashlib
import os
import tempfile
import time
from contextlib import suppress
from pathlib import Path

from airtact.errors import InvalidInput

GRACE = 0.5
"""How long a link waits for the one before it to close [s]."""


def lock_boards(resource: str, holder: int) -> int | None:
    """Reserve boards until the file that is returned is closed; None where the system has no such locks.

    Parameters
    ----------
    resource : what they are reached through, such as a port.
    holder : number of the process that others are referred to.

    Raises
    ------
    InvalidInput
        "link_in_use": another process holds them, with its number.
    """
    try:
        import fcntl
    except ImportError:
        return None
    name = f"airtact-{hashlib.sha256(resource.encode()).hexdigest()[:16]}.lock"
    path = Path(tempfile.gettempdir()) / name
    try:
        file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
    except PermissionError:
        file = os.open(path, os.O_RDONLY | os.O_CLOEXEC)  # another user's: enough for the lock
    end = time.monotonic() + GRACE
    while True:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            break
        except BlockingIOError:
            if time.monotonic() > end:
                first = os.pread(file, 40, 0).decode(errors="replace").strip() or "0"
                os.close(file)
                raise InvalidInput(
                    f"{resource} is in use by the process {first}: end it first.",
                    code="link_in_use",
                ) from None
            time.sleep(0.02)
    with suppress(OSError):
        os.ftruncate(file, 0)
        os.pwrite(file, str(holder).encode(), 0)
    return file
