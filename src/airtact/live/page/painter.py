"""Paints the newest moment, 15 times a second, and lets a hand be dragged."""

import time
from collections.abc import Callable

import viser

from airtact.live.page.dragged import DraggedHand
from airtact.live.page.panel import Panel, Send
from airtact.live.page.process import PageSettings, Shown
from airtact.live.page.view import View

INTERVAL = 1.0 / 15.0
"""Time between two pictures [s]."""

REST = 0.3
"""Least share of the time in which the page does nothing, so that a slow computer has room for the loop."""


def paint(
    server: viser.ViserServer,
    settings: PageSettings,
    newest: Callable[[], Shown | None],
    send: Send,
    ended: Callable[[], bool],
) -> None:
    """Show the newest moment whenever there is another one and someone looks, until the loop ends."""
    view, panel = View(server, settings.scene), Panel(server, settings.scene, send)
    dragged = None if settings.hand is None else DraggedHand(server, settings.scene.side, settings.hand, send)
    before = None
    while not ended():
        start, shown = time.monotonic(), newest()
        if dragged is not None:
            dragged.watched = bool(server.get_clients())
        if shown is not None and shown is not before and server.get_clients():
            before = shown
            with server.atomic():
                view.update(shown.moment, panel.look)
            panel.update(shown, view.most)
        spent = time.monotonic() - start
        time.sleep(max(INTERVAL - spent, REST / (1.0 - REST) * spent))
    if dragged is not None:
        dragged.close()
