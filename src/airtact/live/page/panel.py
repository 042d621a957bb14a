"""The panels beside the view (settings, status, curves), the hand to drag, and the page updates."""

import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from html import escape
from threading import Thread
from typing import Any

import numpy as np
import viser
from jaxtyping import Float64, UInt8
from matplotlib.colors import to_hex
from scipy.spatial.transform import Rotation
from viser import uplot

from airtact.drives.methods import FOR_SAMPLES, METHODS
from airtact.errors import InvalidInput
from airtact.geometry.pose import Pose
from airtact.hands.joints import FINGERS, Side
from airtact.hands.kinematics import turned
from airtact.hands.tracking.frame import FaultyFrame, HandFrame
from airtact.live.moment import Controls, Moment, Rule, State, silent_moment
from airtact.live.page.process import EMERGENCY, Message
from airtact.live.page.sound import Sound
from airtact.live.page.view import AMPLITUDES, PHASES, PRESSURES, STEPS, Look, View
from airtact.live.scene import Joints, LiveScene
from airtact.live.worker import Mailbox

# Sends a message to the loop.
Send = Callable[[Message], None]

# Time span of the curves [s].
CURVE_SECONDS = 10.0

# Title, colour and upper limit of each curve.
CURVES = (
    ("latency, frame to sound [ms]", "#1971c2", 150.0),
    ("drives per second", "#2f9e44", 150.0),
    ("expected pressure, of the attainable [%]", "#e8590c", 110.0),
)

RULES: dict[Rule, str] = {
    "distances": "phases from path lengths, without the hand",
    "phalanges": "solved: the last phalanges",
    "hand": "solved: the whole hand",
    "carried": "solved: the whole hand, moved with its bones",
}

# Words and colour of each state.
STATES: dict[State, tuple[str, str]] = {
    "waiting": ("waiting for a hand", "#868e96"),
    "playing": ("playing", "#2f9e44"),
    "fading": ("fading: the hand was lost", "#e8590c"),
    "silent": ("silent", "#868e96"),
    "stopped": ("stopped for good", "#c92a2a"),
}

STYLE = """<style>
[id="{emergency}"] {{ height: 4.2em !important; font-size: 1.05em; font-weight: 700;
  letter-spacing: 0.04em; }}
.live {{ padding: 0.2em 0.9em 0.5em; font-size: 0.85em; line-height: 1.45; }}
.live table {{ width: 100%; border-collapse: collapse; }}
.live td, .live th {{ padding: 0.1em 0; text-align: right; font-variant-numeric: tabular-nums;
  font-weight: 400; }}
.live td:first-child, .live th:first-child {{ text-align: left; }}
.live th {{ opacity: 0.7; border-bottom: 1px solid rgba(128, 128, 128, 0.35); }}
.live .state {{ font-weight: 700; font-size: 1.1em; }}
.live .state::before {{ content: ""; display: inline-block; width: 0.75em; height: 0.75em;
  border-radius: 50%;
  background: var(--light); margin-right: 0.45em; }}
.live .bar {{ height: 0.7em; border-radius: 2px; margin-top: 0.45em; }}
.live .ends {{ display: flex; justify-content: space-between; opacity: 0.85; }}
.live small {{ opacity: 0.75; line-height: 1.3; display: block; margin-top: 0.25em; }}
</style>"""


class Panel:
    """The controls and the status of the page.

    Parameters
    ----------
    server : server of the page.
    scene : the fixed part of the scene.
    controls : initial settings.
    send : sends controls and the emergency stop to the loop.
    """

    def __init__(
        self, server: viser.ViserServer, scene: LiveScene, controls: Controls, send: Send
    ) -> None:
        self._server = server
        self._scene = scene
        self._send = send
        self._controls = controls
        self.look = Look()
        # Time [s], number of drives, age [ms] and share [%] of each update.
        self._history: deque[tuple[float, int, float, float]] = deque(maxlen=1000)
        self._stopped = False
        self._written = 0.0
        gui = server.gui
        gui.configure_theme(show_logo=False, show_share_button=False, brand_color=(25, 113, 194))
        gui.set_panel_label("airtact live")
        self._style = gui.add_html("")
        self._add_stops()
        with gui.add_folder("Sound"):
            self._add_controls()
        with gui.add_folder("View"):
            self._add_views()
        width = 310  # pixels
        gui.main_panel.dock_right()
        gui.main_panel.set_width(width)
        panel = gui.add_panel()
        with panel.add_tab("Status"):
            self._status = gui.add_html('<div class="live">starting</div>')
            words = f"Curves of the last {CURVE_SECONDS:g} s, time in s:"
            gui.add_html(f'<div class="live"><small>{words}</small></div>')
            self._curves = [self._add_curve(*curve) for curve in CURVES]
        panel.dock_left()
        panel.set_width(width)

    def update(
        self, moment: Moment, drives: int, status: str, sound: Sound | None, largest: float
    ) -> None:
        """Show the status of a moment, 3 times a second.

        Parameters
        ----------
        moment : newest moment.
        drives : number of moments so far.
        status : status of the loop in words.
        sound : pressure shown on skin and slice, or None.
        largest : upper limit of the colour scale [Pa].
        """
        now = time.monotonic()
        age = np.nan if moment.joints is None else 1e3 * (moment.time - moment.frame_time)
        kept = np.nan if moment.kept is None else 100 * moment.kept
        self._history.append((now, drives, age, kept))
        if now - self._written < 0.33:
            return
        self._written = now
        while self._history[0][0] < now - CURVE_SECONDS:
            self._history.popleft()
        times, counts, ages, shares = np.array(self._history).T
        rates = rates_of(times, counts)
        with self._server.atomic():
            facts = status_html(moment, self._scene, rates[-1], age, status)
            self._status.content = facts
            self._legend.content = legend_html(self.look, sound, largest)
            for curve, values in zip(self._curves, (ages, rates, shares), strict=True):
                curve.data = (times - now, values)

    def _set(self, **changed: Any) -> None:
        # Values that no browser sends are ignored.
        with suppress(InvalidInput):
            self._controls = replace(self._controls, **changed)
            self._send(self._controls)

    def _show(self, **changed: Any) -> None:
        self.look = replace(self.look, **changed)

    def _add_stops(self) -> None:
        gui = self._server.gui
        hint = "silences at once and permanently; the Escape key does the same"
        emergency = gui.add_button("EMERGENCY STOP", color="red", hint=hint)
        self._style.content = STYLE.format(emergency=emergency._impl.uuid)
        start = gui.add_button("Start", color="green", icon=viser.Icon.PLAYER_PLAY)
        pause = gui.add_button("Stop", color="gray", icon=viser.Icon.PLAYER_STOP)
        start.disabled = self._controls.playing
        pause.disabled = not self._controls.playing

        # Asynchronous callbacks run on the server's own thread, so other callbacks do not delay
        # them.
        async def stop(_: Any) -> None:
            self._send(EMERGENCY)
            self._stopped = True
            for button in (start, pause, emergency):
                button.disabled = True
            emergency.label = "STOPPED FOR GOOD"

        def play(playing: bool) -> None:
            if not self._stopped:
                self._set(playing=playing)
                start.disabled = playing
                pause.disabled = not playing

        emergency.on_click(stop)
        gui.add_command("Emergency stop", hotkey="escape").on_trigger(stop)
        start.on_click(lambda _: play(True))
        pause.on_click(lambda _: play(False))

    def _add_controls(self) -> None:
        gui = self._server.gui
        scene = self._scene
        first = self._controls
        offset = scene.offsets.mean() if first.offset is None else first.offset
        offset = float(np.clip(1e3 * offset, 0.0, 20.0).round(1))
        if scene.moving is not None:
            modulation = scene.moving.words
        elif scene.modulation is not None:
            modulation = f"the amplitude varies at {scene.modulation.frequency:g} Hz"
        else:
            modulation = "the scene has no modulation"
        constant = scene.modulation is None and scene.moving is None
        hint = "set the phases from path lengths alone, to feel the difference"
        _on_change(
            gui.add_checkbox("ignore the hand", first.ignore_hand, hint=hint),
            lambda value: self._set(ignore_hand=value),
        )
        _on_change(
            gui.add_checkbox("modulated", first.modulated, disabled=constant, hint=modulation),
            lambda value: self._set(modulated=value),
        )
        hint = "distance of the foci from the skin"
        _on_change(
            gui.add_slider("offset [mm]", 0.0, 20.0, 0.1, offset, hint=hint),
            lambda value: self._set(offset=1e-3 * value),
        )
        hint = "largest amplitude of an element"
        _on_change(
            gui.add_slider("level cap [%]", 0, 100, 1, round(100 * first.cap), hint=hint),
            lambda value: self._set(cap=value / 100),
        )
        # Robust methods need samples of an uncertain scene.
        methods = [name for name in METHODS if name not in FOR_SAMPLES]
        chosen = first.method or scene.method
        _on_change(
            gui.add_dropdown("method", methods, initial_value=chosen),
            lambda value: self._set(method=value),
        )

    def _add_views(self) -> None:
        gui = self._server.gui
        _on_change(
            gui.add_dropdown("array", ("phase", "amplitude")),
            lambda value: self._show(array=value),
        )
        _on_change(
            gui.add_checkbox("pressure on the skin", True), lambda value: self._show(skin=value)
        )
        _on_change(
            gui.add_checkbox("slice of the field", True), lambda value: self._show(slice=value)
        )
        _on_change(
            gui.add_dropdown("slice across", ("x", "y", "z"), initial_value="y"),
            lambda value: self._show(across=value),
        )
        hint = "from the centre of the foci along that axis"
        _on_change(
            gui.add_slider("slice at [mm]", -60, 60, 1, 0, hint=hint),
            lambda value: self._show(offset=1e-3 * value),
        )
        self._legend = gui.add_html(legend_html(self.look, None, 0.0))

    def _add_curve(self, name: str, colour: str, high: float) -> viser.GuiUplotHandle:
        times = np.array([-CURVE_SECONDS, 0.0])
        return self._server.gui.add_uplot(
            (times, np.full(2, np.nan)),
            (uplot.Series(label="s"), uplot.Series(label=name, stroke=colour, width=2)),
            title=name,
            scales={
                "x": uplot.Scale(time=False, range=(-CURVE_SECONDS, 0.0)),
                "y": uplot.Scale(range=(0.0, high)),
            },
            legend=uplot.Legend(show=False),
            height=112,
        )


def _on_change(handle: Any, take: Callable[[Any], None]) -> None:
    handle.on_update(lambda _: take(handle.value))


def rates_of(
    times: Float64[np.ndarray, "times"], drives: Float64[np.ndarray, "times"]
) -> Float64[np.ndarray, "times"]:
    """Return drives per second over the last second before each time."""
    first = np.searchsorted(times, times - 1.0)
    spans = np.maximum(times - times[first], 1e-9)
    return np.where(spans > 0.5, (drives - drives[first]) / spans, np.nan)


def status_html(moment: Moment, scene: LiveScene, rate: float, age: float, status: str) -> str:
    """Write the status of the loop and the pressure at each focus."""
    words, light = STATES[moment.state]
    kept = np.nan if moment.kept is None else 100 * moment.kept
    solved = np.nan if moment.shape_age is None else 1e3 * moment.shape_age
    rows = [
        ("drives per second", _number(rate, "")),
        ("latency, frame to sound", _number(age, " ms")),
        ("age of the solved hand", _number(solved, " ms")),
        ("expected share of attainable", _number(kept, " %")),
        ("mean amplitude of the elements", _number(100 * np.abs(moment.amplitudes).mean(), " %")),
    ]
    facts = "".join(f"<tr><td>{name}</td><td>{value}</td></tr>" for name, value in rows)
    foci = ""
    for index, place in enumerate(scene.places):
        pressure = "-" if moment.pressures is None else f"{moment.pressures[index]:,.0f} Pa"
        foci += f"<tr><td>{escape(place)}</td><td>{pressure}</td></tr>"
    return (
        f'<div class="live"><div class="state" style="--light: {light}">{words}</div>'
        f"<small>{escape(status)}</small>"
        f"{RULES[moment.rule]}<table>{facts}</table>"
        "<small>The solved hand is the pose for which scattering was solved; a drive uses the "
        "solution of the most similar pose, which may be old. Attainable: pressure at the "
        "weakest focus by a drive solved for the present hand.</small><br>"
        f"<table><tr><th>focus</th><th>peak pressure</th></tr>{foci}</table></div>"
    )


def _number(value: float, unit: str) -> str:
    return f"{value:.0f}{unit}" if np.isfinite(value) else "-"


def legend_html(look: Look, sound: Sound | None, largest: float) -> str:
    """Write the legend of the colours of elements, skin and slice."""
    if look.array == "phase":
        array = _bar(PHASES, "0", "phase of the elements", "2π")
    else:
        array = _bar(AMPLITUDES, "0", "amplitude of the elements", "100 %")
    end = f"≥ {largest:,.0f} Pa" if largest > 1.0 else "-"
    pressure = _bar(PRESSURES, "0", "pressure, peak", end)
    words = "silent, or not solved yet"
    if sound is not None:
        age = time.monotonic() - sound.time
        words = f"pressure for the hand {age:.1f} s ago"
    return f'<div class="live">{array}{pressure}<small>Skin and slice: {words}.</small></div>'


def _bar(colours: UInt8[np.ndarray, "steps 3"], low: str, name: str, high: str) -> str:
    stops = ", ".join(to_hex(colours[step] / 255) for step in range(0, STEPS, STEPS // 12))
    ends = f'<div class="ends"><span>{low}</span><span>{name}</span><span>{high}</span></div>'
    return f'<div class="bar" style="background: linear-gradient(to right, {stops})"></div>{ends}'


class DraggedHand:
    """Hand that is dragged on the page and has sliders for its fingers: a tracker at 60 frames/s.

    It gives frames only while it is ``watched``: closing the page counts as losing the hand.

    Parameters
    ----------
    server : server of the page.
    side : ``"right"`` or ``"left"``.
    joints : (25, 3) initial joints [m].
    send : sends the frames to the loop.
    """

    def __init__(self, server: viser.ViserServer, side: Side, joints: Joints, send: Send) -> None:
        self.watched = False
        self._side: Side = side
        self._send = send
        middle = joints.mean(axis=0)
        self._joints = joints - middle
        self._gizmo = server.scene.add_transform_controls(
            "/drag", scale=0.07, line_width=3.0, depth_test=False, position=middle
        )
        with server.gui.add_folder("Hand: drag it by its arrows"):
            self._angles = [
                server.gui.add_slider(f"{finger} [°]", -40, 60, 1, 0, hint="opens at the root")
                for finger in FINGERS
            ]
        Thread(target=self._give, daemon=True).start()

    def joints(self) -> Joints:
        """Return the present joints on the page (25, 3) [m]."""
        joints = self._joints
        for finger, angle in enumerate(self._angles):
            if angle.value:
                joints = turned(joints, self._side, finger, float(np.radians(angle.value)))
        turn = Rotation.from_quat(np.roll(self._gizmo.wxyz, -1)).as_matrix()
        return Pose(turn, np.asarray(self._gizmo.position, dtype=np.float64)).apply(joints)

    def _give(self) -> None:
        sequence = 0
        while True:
            if self.watched:
                # While fingers are bent beyond their limits, the hand counts as lost.
                with suppress(FaultyFrame):
                    self._send(HandFrame(time.monotonic(), self._side, sequence, self.joints()))
                sequence += 1
            time.sleep(1.0 / 60.0)


def paint(
    server: viser.ViserServer,
    mailbox: Mailbox,
    send: Send,
    scene: LiveScene,
    joints: Joints | None,
    controls: Controls,
) -> None:
    """Show the newest moment while the page is open, until the loop ends.

    Parameters
    ----------
    server : server of the page.
    mailbox : contains the newest moment, the number of moments so far, and the status in words.
    send : sends messages to the loop.
    scene : the fixed part of the scene.
    joints : (25, 3) initial joints of a hand to drag [m], or None.
    controls : initial settings.
    """
    view = View(server, scene)
    panel = Panel(server, scene, controls, send)
    dragged = None if joints is None else DraggedHand(server, scene.side, joints, send)
    painted = None
    while not mailbox.ended:
        start = time.monotonic()
        watched = bool(server.get_clients())
        shown = mailbox.newest or (silent_moment(scene, 0.0, 0.0), 0, "")
        if dragged is not None:
            dragged.watched = watched
        if watched:
            moment, drives, status = shown
            if (shown, panel.look) != painted:
                painted = (shown, panel.look)
                with server.atomic():
                    view.update(moment, panel.look)
            panel.update(moment, drives, status, view.sound, view.largest)
        # 13 pictures a second, because they may be drawn on the loop's processor. Even on a slow
        # computer the loop keeps at least 30 % of the time.
        spent = time.monotonic() - start
        time.sleep(max(1.0 / 13.0 - spent, 3.0 / 7.0 * spent))
