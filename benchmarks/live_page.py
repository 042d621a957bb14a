"""What the page costs the live loop, and how often it is painted: with none open, one, ten, and one that stalls.

    python -m benchmarks.live_page [CASE ...]

The loop is ``airtact live live_pinch`` with its bundled motion. The page is opened in Chromium,
drawn by the processor; ten pages are ten connections that read all that they get, the one that
stalls reads nothing.
"""

import ctypes
import json
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from contextlib import ExitStack, suppress
from threading import Thread

from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

SECONDS = 24
"""How long the loop runs each time [s]."""

RUNS = 3
"""Medians are of so many runs."""

PAINTED = """seconds => new Promise(done => {
    const canvas = document.querySelector("canvas"), first = Number(canvas.dataset.frames);
    setTimeout(() => done((canvas.dataset.frames - first) / seconds), 1e3 * seconds);
})"""
"""Count the pictures that were drawn, each with the newest hand, per second."""

BY_SOFTWARE = ["--enable-unsafe-swiftshader", "--no-sandbox"]
"""Where there is no graphics card Chromium draws so by itself; a real user has a sandbox."""

NICER, DROP = 23, 24
"""CAP_SYS_NICE and PR_CAPBSET_DROP of Linux."""


def give_up_rights() -> None:
    """Let no process that is started from here raise its priority, as Chromium does where it runs as root."""
    ctypes.CDLL(None).prctl(DROP, NICER, 0, 0, 0)


def run(watch: Callable[[str, ExitStack], dict[str, float]] | None) -> dict[str, float]:
    """Run the loop while its page is watched, and return its drives a second and what was seen."""
    page = ["--no-page"] if watch is None else ["--page-port", "0"]
    with tempfile.TemporaryDirectory() as folder, ExitStack() as watched:
        command = [
            sys.executable,
            "-m",
            "airtact",
            "live",
            "live_pinch",
            "--seconds",
            str(SECONDS),
            "--json",
        ]
        loop = subprocess.Popen(
            [*command, "--out", folder, *page],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        found: dict[str, float] = {}
        if watch is not None:
            found = watch(address_in(loop), watched)
        out, _ = loop.communicate()
    return {"drives a second": json.loads(out)["rate"], **found}


def address_in(loop: subprocess.Popen[str]) -> str:
    """Read the address of the page from what the loop prints."""
    assert loop.stderr is not None
    for line in loop.stderr:
        found = re.search(r"http://\S+", line)
        if found:
            Thread(target=loop.stderr.read, daemon=True).start()
            return found[0]
    raise SystemExit("the loop printed no address of a page.")


def connected(address: str) -> ClientConnection:
    """Connect as a page that is open does."""
    return connect(address.replace("http", "ws"), compression=None, max_size=None, proxy=None)


def read_all(page: ClientConnection) -> None:
    """Read until the connection ends, and ask for more as a page does that has drawn a picture."""
    with suppress(ConnectionClosed):
        for _ in page:
            page.send('{"drawn": true}')


def ten(address: str, watched: ExitStack) -> dict[str, float]:
    """Open ten pages that read what they get."""
    for _ in range(10):
        page = connected(address)
        watched.callback(page.close)
        Thread(target=read_all, args=(page,), daemon=True).start()
    return {}


def stalled(address: str, watched: ExitStack) -> dict[str, float]:
    """Open a page that reads nothing."""
    watched.callback(connected(address).close)
    return {}


def chromium(address: str, watched: ExitStack) -> dict[str, float]:
    """Open the page in Chromium, and count the updates that it paints."""
    from playwright.sync_api import sync_playwright

    browser = watched.enter_context(sync_playwright()).chromium.launch(
        executable_path=shutil.which("chromium"), args=BY_SOFTWARE
    )
    watched.callback(browser.close)
    page = browser.new_page(viewport={"width": 1280, "height": 800})
    page.goto(address)
    page.get_by_text("playing", exact=True).wait_for()
    return {"updates painted a second": page.evaluate(PAINTED, SECONDS / 3.0)}


def main() -> None:
    """Print a table."""
    give_up_rights()
    cases = {
        "no page": None,
        "page, not open": lambda address, watched: {},
        "one in Chromium": chromium,
        "ten": ten,
        "one that stalls": stalled,
    }
    # The cases take turns, because other work on the machine comes and goes.
    words = sys.argv[1:]
    cases = {name: watch for name, watch in cases.items() if not words or name in words}
    found = [{name: run(watch) for name, watch in cases.items()} for _ in range(RUNS)]
    for name in cases:
        keys = found[0][name]
        middle = {key: sorted(one[name][key] for one in found)[RUNS // 2] for key in keys}
        print(f"{name:16}", ", ".join(f"{value:.1f} {key}" for key, value in middle.items()))


if __name__ == "__main__":
    main()
