"""Paints the newest moment, some times a second, and lets a hand be dragged."""

import time
from collections.abc import Callable

import numpy as np
import viser

from airtact.live.page.dragged import DraggedHand
from airtact.live.page.panel import Panel, Send
from airtact.live.page.process import PageSettings, Shown
from airtact.live.page.view import View
from airtact.live.parts import Moment

INTERVAL = 1.0 / 13.0
"""Time between two updates [s]: each is a picture to draw, perhaps by a processor that has a loop to run, too."""

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
    scene = settings.scene
    view, panel = View(server, scene), Panel(server, scene, settings.controls, send)
    dragged = (
        None if settings.hand is None else DraggedHand(server, scene.side, settings.hand, send)
    )
    nothing = Moment(
        0.0, 0.0, None, None, np.zeros(len(scene.array), dtype=np.complex128), state="waiting"
    )
    before, shown = None, Shown(nothing, 0)
    while not ended():
        start, watched = time.monotonic(), bool(server.get_clients())
        shown = newest() or shown
        if dragged is not None:
            dragged.watched = watched
        if watched and (shown, panel.look) != before:
            before = (shown, panel.look)
            with server.atomic():
                view.update(shown.moment, panel.look)
        if watched:
            panel.update(shown, view.sound, view.most)
        spent = time.monotonic() - start
        time.sleep(max(INTERVAL - spent, REST / (1.0 - REST) * spent))
    view.close()
    if dragged is not None:
        dragged.close()
