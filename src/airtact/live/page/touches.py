"""The page that guides a registration: the transducer to touch now, and the touches so far."""

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import msgspec
from jinja2 import FileSystemLoader
from websockets.exceptions import ConnectionClosed
from websockets.sync.server import ServerConnection

from airtact.live.page.server import start_server
from airtact.live.page.view import array_facts
from airtact.live.registering import RegisteredTracker, TouchStep
from airtact.reports.page import FOLDER, TEMPLATES
from airtact.reports.viewer import embedded
from airtact.setup.setup import Setup


class TouchPage:
    """Server of the page that guides a registration; use it in a ``with`` block.

    Parameters
    ----------
    setup : scene with the array.
    elements : indices of the transducers to touch, in order.
    port, host : port and address to listen on; port 0 selects a free port.

    Attributes
    ----------
    address : URL of the page.

    Raises
    ------
    InvalidInput
        If the port is in use or invalid.
    """

    def __init__(self, setup: Setup, elements: Sequence[int], port: int, host: str) -> None:
        self._open: set[ServerConnection] = set()
        self._newest = b"{}"
        facts, numbers = array_facts(setup.array, setup.scene.planes)
        facts["touches"] = [
            {
                "position": setup.array.positions[element].tolist(),
                "normal": setup.array.normals[element].tolist(),
            }
            for element in elements
        ]
        loader = FileSystemLoader([Path(__file__).parent, FOLDER])
        page = TEMPLATES.overlay(loader=loader).get_template("touches.html.j2")
        html = page.render(space=embedded(facts, numbers), title="airtact register")
        self._server, self.address = start_server(port, host, html, self._serve)

    def __enter__(self) -> "TouchPage":
        return self

    def __exit__(self, *fault: object) -> None:
        self._server.shutdown()
        for connection in self._open.copy():
            connection.close()

    def show(self, step: TouchStep) -> None:
        """Show the progress on all open pages."""
        self._send(
            {
                "number": step.number,
                "words": step.words,
                "share": step.share,
                "trouble": step.trouble,
                "residuals": step.residuals,
            }
        )

    def finish(self, found: RegisteredTracker) -> None:
        """Show the residuals of the final fit."""
        residuals = found.fit.residuals.tolist()
        self._send({"residuals": residuals, "ignored": found.fit.repeat, "finished": True})

    def _send(self, facts: dict[str, object]) -> None:
        self._newest = msgspec.json.encode(facts)
        for connection in self._open.copy():
            with suppress(ConnectionClosed):
                connection.send(self._newest, text=True)

    def _serve(self, connection: ServerConnection) -> None:
        self._open.add(connection)
        with suppress(ConnectionClosed):
            connection.send(self._newest, text=True)
            for _ in connection:
                pass  # the page sends nothing, but this notices when it is closed
        self._open.discard(connection)
