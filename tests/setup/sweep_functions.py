"""Functions of sweeps that processes can import; run as a script STORE LOG COUNT, a sweep that is killed."""

import json
import os
import signal
import sys
import time
from functools import partial
from pathlib import Path


def square(point):
    return {"square": point["x"] ** 2}


def logged(point, log):
    """Write the beginning and the end of a point, each in one go."""
    for word in ("begins", "ends"):
        with open(log, "a", encoding="utf-8") as stream:
            stream.write(f"{word} {point['x']} {os.getpid()}\n")
        time.sleep(0.01)
    if point["x"] == 3:
        raise ValueError("three")
    return {"square": point["x"] ** 2}


def ends(point):
    os.kill(os.getpid(), signal.SIGKILL)


def main(store: str, log: str, count: str) -> None:
    import airtact as at

    rows = at.sweep(partial(logged, log=log), [{"x": x} for x in range(int(count))], store=store)
    Path(store, "rows.json").write_text(json.dumps(rows), encoding="utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
