"""Free memory, and the number of processors that may be used."""

import os


def available_memory() -> float:
    """Return the memory available without swapping [bytes]; infinity if it is not reported."""
    try:
        # Unbuffered for speed, because this file is read before every solve.
        with open("/proc/meminfo", "rb", buffering=0) as file:
            _, mark, rest = (file.read(4096) or b"").partition(b"MemAvailable:")
    except OSError:
        return float("inf")
    return 1024.0 * int(rest.split(maxsplit=1)[0]) if mark else float("inf")


def processor_count() -> int:
    """Return the number of processors available to this process."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
