"""What the page shows beside the three dimensions: what is set, what the loop does, and how fast."""

import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from html import escape
from typing import Any

import numpy as np
import viser
from jaxtyping import Float64, UInt8
from matplotlib.colors import to_hex
from viser import uplot

from airtact.drives.methods import METHODS
from airtact.hands.tracking.frame import HandFrame
from airtact.live.page.process import EMERGENCY, Shown
from airtact.live.page.solved import Sound
from airtact.live.page.view import AMPLITUDES, PHASES, PRESSURES, STEPS, Look
from airtact.live.parts import Controls, LiveScene, Moment, Rule, State

Send = Callable[[str | Controls | HandFrame], None]
"""How a message goes to the loop."""

WIDTH = 310
"""Width of the panels at both sides [pixels]."""

FIGURES = 0.33
"""Time between two readings of the figures [s]."""

SECONDS = 10.0
"""How far back the curves go [s]."""

RULES: dict[Rule, str] = {
    "distances": "distances alone, without the hand",
    "phalanges": "last phalanges solved",
    "fingers": "fingers solved",
    "hand": "whole hand solved",
    "carried": "whole hand solved, carried along",
}

STATES: dict[State, tuple[str, str]] = {
    "waiting": ("waiting for a hand", "#868e96"),
    "playing": ("playing", "#2f9e44"),
    "fading": ("fading: the hand was lost", "#e8590c"),
    "silent": ("silent", "#868e96"),
    "stopped": ("stopped for good", "#c92a2a"),
}

STYLE = """<style>
[id="{emergency}"] {{ height: 4.2em !important; font-size: 1.05em; font-weight: 700; letter-spacing: 0.04em; }}
.live {{ padding: 0.2em 0.9em 0.5em; font-size: 0.85em; line-height: 1.45; }}
.live table {{ width: 100%; border-collapse: collapse; }}
.live td, .live th {{ padding: 0.1em 0; text-align: right; font-variant-numeric: tabular-nums; font-weight: 400; }}
.live td:first-child, .live th:first-child {{ text-align: left; }}
.live th {{ opacity: 0.7; border-bottom: 1px solid rgba(128, 128, 128, 0.35); }}
.live .state {{ font-weight: 700; font-size: 1.1em; }}
.live .state::before {{ content: ""; display: inline-block; width: 0.75em; height: 0.75em; border-radius: 50%;
  background: var(--light); margin-right: 0.45em; }}
.live .bar {{ height: 0.7em; border-radius: 2px; margin-top: 0.45em; }}
.live .ends {{ display: flex; justify-content: space-between; opacity: 0.85; }}
.live small {{ opacity: 0.75; line-height: 1.3; display: block; margin-top: 0.25em; }}
</style>"""


class Panel:
    """The controls and the figures of the page.

    Parameters
    ----------
    server : that shows them.
    scene : what stays the same while the hand moves.
    controls : how they are set from the start.
    send : takes controls, and the emergency stop, to the loop.
    """

    def __init__(
        self, server: viser.ViserServer, scene: LiveScene, controls: Controls, send: Send
    ) -> None:
        self._server, self._scene, self._send = server, scene, send
        self._controls, self.look = controls, Look()
        self._seen: deque[tuple[float, int, float, float]] = deque(maxlen=1000)
        self._stopped, self._written = False, 0.0
        gui = server.gui
        self._theme(False)
        gui.set_panel_label("airtact live")
        self._style = gui.add_html("")
        self._add_stops()
        with gui.add_folder("Sound"):
            self._add_controls()
        with gui.add_folder("View"):
            self._add_views()
        gui.main_panel.dock_right()
        gui.main_panel.set_width(WIDTH)
        panel = gui.add_panel()
        with panel.add_tab("What the loop does"):
            self._status = gui.add_html('<div class="live">starting</div>')
            gui.add_html(
                f'<div class="live"><small>Curves of the last {SECONDS:g} s, time in s:</small></div>'
            )
            self._curves = [self._add_curve(*named) for named in CURVES]
        panel.dock_left()
        panel.set_width(WIDTH)

    def update(self, shown: Shown, sound: Sound | None, most: float) -> None:
        """Show the figures of a moment, 3 times a second.

        Parameters
        ----------
        shown : the moment.
        sound : that skin and slice show, or None.
        most : pressure at the end of the colours [Pa].
        """
        now, moment = time.monotonic(), shown.moment
        age = 1e3 * (moment.time - moment.frame_time) if moment.joints is not None else np.nan
        kept = np.nan if moment.kept is None else 100 * moment.kept
        self._seen.append((now, shown.drives, age, kept))
        if now - self._written < FIGURES:
            return
        self._written = now
        while self._seen[0][0] < now - SECONDS:
            self._seen.popleft()
        times, drives, ages, kepts = np.array(self._seen).T
        rates = rates_of(times, drives)
        with self._server.atomic():
            self._status.content = status_in_html(moment, self._scene, rates[-1], age)
            self._legend.content = legend_in_html(self.look, sound, most)
            for curve, values in zip(self._curves, (ages, rates, kepts), strict=True):
                curve.data = (times - now, values)

    def stop(self) -> None:
        """Show that the emergency stop was pressed, and let nothing start again."""
        self._stopped = True
        for button in (self._start, self._pause, self._emergency):
            button.disabled = True
        self._emergency.label = "STOPPED FOR GOOD"

    def _set(self, **changed: Any) -> None:
        self._controls = replace(self._controls, **changed)
        self._send(self._controls)

    def _see(self, **changed: Any) -> None:
        self.look = replace(self.look, **changed)

    def _theme(self, dark: bool) -> None:
        self._server.gui.configure_theme(
            dark_mode=dark, show_logo=False, show_share_button=False, brand_color=(25, 113, 194)
        )

    def _add_stops(self) -> None:
        gui = self._server.gui
        self._emergency = gui.add_button(
            "EMERGENCY STOP",
            color="red",
            hint="silence at once and for good; the key Escape does it too",
        )
        self._style.content = STYLE.format(emergency=self._emergency._impl.uuid)
        self._start = gui.add_button("Start", color="green", icon=viser.Icon.PLAYER_PLAY)
        self._pause = gui.add_button("Stop", color="gray", icon=viser.Icon.PLAYER_STOP)
        self._start.disabled, self._pause.disabled = (
            self._controls.playing,
            not self._controls.playing,
        )

        async def stop(
            _: Any,
        ) -> None:  # on the server's own thread: it waits for no other callback
            self._send(EMERGENCY)
            self.stop()

        self._emergency.on_click(stop)
        gui.add_command("Emergency stop", hotkey="escape").on_trigger(stop)
        self._start.on_click(lambda _: self._play(True))
        self._pause.on_click(lambda _: self._play(False))

    def _play(self, playing: bool) -> None:
        if not self._stopped:
            self._set(playing=playing)
            self._start.disabled, self._pause.disabled = playing, not playing

    def _add_controls(self) -> None:
        gui, scene, first = self._server.gui, self._scene, self._controls
        offset = scene.offsets.mean() if first.offset is None else first.offset
        offset = float(np.clip(1e3 * offset, 0.0, 20.0).round(1))
        why = "drives from distances alone, to feel the difference"
        ignore = gui.add_checkbox("ignore the hand", first.ignore_hand, hint=why)
        none = scene.modulation is None and scene.moving is None
        words = modulation_in_words(scene)
        modulated = gui.add_checkbox("modulated", first.modulated, disabled=none, hint=words)
        gap = gui.add_slider("gap [mm]", 0.0, 20.0, 0.1, offset, hint="of the foci from the skin")
        cap = gui.add_slider(
            "level cap [%]",
            0,
            100,
            1,
            round(100 * first.cap),
            hint="largest amplitude of an element",
        )
        method = gui.add_dropdown(
            "method",
            list(METHODS),
            initial_value=first.method or scene.method,
            hint="that makes the drives; robust: as the prediction doubts",
        )
        ignore.on_update(lambda _: self._set(ignore_hand=ignore.value))
        modulated.on_update(lambda _: self._set(modulated=modulated.value))
        gap.on_update(lambda _: self._set(offset=1e-3 * gap.value))
        cap.on_update(lambda _: self._set(cap=cap.value / 100))
        method.on_update(lambda _: self._set(method=method.value))

    def _add_views(self) -> None:
        gui = self._server.gui
        array = gui.add_dropdown("array", ("phase", "amplitude"))
        skin = gui.add_checkbox("pressure on the skin", True)
        cut = gui.add_checkbox("slice of the field", True)
        across = gui.add_dropdown("slice across", ("x", "y", "z"), initial_value="y")
        offset = gui.add_slider(
            "slice at [mm]", -60, 60, 1, 0, hint="from the middle of the foci, along that axis"
        )
        dark = gui.add_checkbox("dark", False)
        self._legend = gui.add_html(legend_in_html(self.look, None, 0.0))
        array.on_update(lambda _: self._see(array=array.value))
        skin.on_update(lambda _: self._see(skin=skin.value))
        cut.on_update(lambda _: self._see(slice=cut.value))
        across.on_update(lambda _: self._see(across=across.value))
        offset.on_update(lambda _: self._see(offset=1e-3 * offset.value))
        dark.on_update(lambda _: self._theme(dark.value))

    def _add_curve(self, name: str, colour: str, low: float, high: float) -> viser.GuiUplotHandle:
        empty = np.array([-SECONDS, 0.0])
        return self._server.gui.add_uplot(
            (empty, np.full(2, np.nan)),
            (uplot.Series(label="s"), uplot.Series(label=name, stroke=colour, width=2)),
            title=name,
            scales={
                "x": uplot.Scale(time=False, range=(-SECONDS, 0.0)),
                "y": uplot.Scale(range=(low, high)),
            },
            legend=uplot.Legend(show=False),
            height=112,
        )


CURVES = (
    ("age of the frame in the air [ms]", "#1971c2", 0.0, 150.0),
    ("drives a second", "#2f9e44", 0.0, 150.0),
    ("kept of the attainable pressure, expected [%]", "#e8590c", 0.0, 110.0),
)
"""Title, colour and limits of each curve."""


def modulation_in_words(scene: LiveScene) -> str:
    """Say how the amplitude varies, or how foci move."""
    if scene.moving is not None:
        return scene.moving.words
    modulation = scene.modulation
    return (
        "the scene has none"
        if modulation is None
        else f"the amplitude swings at {modulation.frequency:g} Hz"
    )


def rates_of(
    times: Float64[np.ndarray, "times"], drives: Float64[np.ndarray, "times"]
) -> Float64[np.ndarray, "times"]:
    """Return drives a second over the last second before each time."""
    first = np.searchsorted(times, times - 1.0)
    spans = np.maximum(times - times[first], 1e-9)
    return np.where(spans > 0.5, (drives - drives[first]) / spans, np.nan)


def status_in_html(moment: Moment, scene: LiveScene, rate: float, age: float) -> str:
    """Write what the loop does, and what each focus gets."""
    words, light = STATES[moment.state]
    solved = "-" if moment.shape_age is None else f"{1e3 * moment.shape_age:.0f} ms"
    rows = [
        ("drives a second", number(rate, "{:.0f}")),
        ("age of the frame in the air", number(age, "{:.0f} ms")),
        ("age of the solution", solved),
        ("kept at the weakest focus", "-" if moment.kept is None else f"{100 * moment.kept:.0f} %"),
        ("elements' mean amplitude", f"{100 * np.abs(moment.amplitudes).mean():.0f} %"),
    ]
    facts = "".join(f"<tr><td>{name}</td><td>{value}</td></tr>" for name, value in rows)
    foci = ""
    for index, place in enumerate(scene.places):
        got = "-" if moment.pressures is None else f"{moment.pressures[index]:,.0f} Pa"
        foci += f"<tr><td>{escape(place)}</td><td>{got}</td></tr>"
    return (
        f'<div class="live"><div class="state" style="--light: {light}">{words}</div>{RULES[moment.rule]}'
        f"<table>{facts}</table><br><table><tr><th>focus</th><th>gets, peak</th></tr>{foci}</table></div>"
    )


def number(value: float, shape: str) -> str:
    """Write a number, or a dash where there is none."""
    return shape.format(value) if np.isfinite(value) else "-"


def legend_in_html(look: Look, sound: Sound | None, most: float) -> str:
    """Explain the colours: those of the elements, of the skin and of the slice."""
    array = bar(PHASES, "0", "phase of the elements", "2π") if look.array == "phase" else ""
    array = array or bar(AMPLITUDES, "0", "amplitude of the elements", "100 %")
    pressure = bar(PRESSURES, "0", "pressure, peak", f"≥ {most:,.0f} Pa" if most > 1.0 else "-")
    return f'<div class="live">{array}{pressure}<small>{sound_in_words(sound)}</small></div>'


def sound_in_words(sound: Sound | None) -> str:
    """Say what skin and slice show, and how old it is."""
    if sound is None:
        return "Skin and slice: silent."
    if sound.hand:
        age = time.monotonic() - sound.time
        return (
            f"Skin and slice: all the sound, with the hand in its place as it was {age:.1f} s ago."
        )
    return "Skin and slice: the direct sound of now, doubled on the skin, without the hand's shadow until it is solved."


def bar(colours: UInt8[np.ndarray, "steps 3"], low: str, name: str, high: str) -> str:
    """Draw a bar of colours with what its ends mean."""
    stops = ", ".join(to_hex(colours[step] / 255) for step in range(0, STEPS, STEPS // 12))
    ends = f'<div class="ends"><span>{low}</span><span>{name}</span><span>{high}</span></div>'
    return f'<div class="bar" style="background: linear-gradient(to right, {stops})"></div>{ends}'
