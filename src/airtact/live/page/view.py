"""What the page shows in three dimensions: the array, the hand, the foci and a slice of the field."""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import matplotlib
import numpy as np
import viser
from jaxtyping import Complex128, Float64, Int64, UInt8
from scipy.spatial.transform import Rotation
from viser._messages import RunJavascriptMessage

from airtact.live.page.section import ACROSS, Across, Section, enlarged
from airtact.live.page.skin import MovingSkin
from airtact.live.page.solved import Asked, SolvedSound, Sound
from airtact.live.page.sound import DirectSound
from airtact.live.parts import LiveScene, Moment
from airtact.reports.array_figures import spacing, view_of
from airtact.reports.solids import SHEET, sheet_of

HAND = 0.15
"""How far a hand reaches from the middle of its foci, more or less [m]."""

SATURATED = 0.6
"""Pressures above this share of the largest have the last colour, so that the others differ."""

AMBIENT = 3.0
"""Intensity of the light; colours are lit by it alone."""

OLD = 20.0
"""A sound that was solved longer ago gives way to the direct sound of now [s]."""

DIRECT = 0.25
"""Time between two direct sounds [s]."""

FOLLOWING = 0.3
"""How much of a change of the largest pressure the colours follow at once."""

CORNERS = 6
"""Corners of an element's disc; a processor that draws it feels each."""

STEPS = 256
"""Colours of a colour map."""

SILENT = np.array([150, 150, 155], dtype=np.uint8)
"""Colour of an element that emits nothing, where colours mean phases."""

SKIN, FOCUS = (205, 180, 165), (0, 190, 90)
"""Colours of a hand without sound, and of foci."""

LIGHT = 255 * np.where(
    np.arange(256) <= 10,
    np.arange(256) / 255 / 12.92,
    ((np.arange(256) / 255 + 0.055) / 1.055) ** 2.4,
)
LIGHT = LIGHT.round().astype(np.uint8)
"""Amount of light of each value of a screen's colours."""

DRAWING = Path(__file__).with_name("drawing.js")

Shown = Literal["phase", "amplitude"]


def colour_map(name: str) -> UInt8[np.ndarray, "steps 3"]:
    """Return a colour map of matplotlib (256, 3)."""
    return (
        (255 * matplotlib.colormaps[name](np.linspace(0.0, 1.0, STEPS))[:, :3])
        .round()
        .astype(np.uint8)
    )


PHASES, PRESSURES, AMPLITUDES = colour_map("twilight"), colour_map("OrRd"), colour_map("viridis")


@dataclass(frozen=True)
class Look:
    """What the page is asked to show.

    Attributes
    ----------
    array : what the colours of the elements mean.
    skin : whether the pressure on the skin is shown.
    slice : whether the slice is shown.
    across : the axis across the slice.
    offset : of the slice from the middle of the foci along that axis [m].
    """

    array: Shown = "phase"
    skin: bool = True
    slice: bool = True
    across: Across = "y"
    offset: float = 0.0


class View:
    """The scene of the page.

    Parameters
    ----------
    server : that shows it.
    scene : what stays the same while the hand moves.
    """

    def __init__(self, server: viser.ViserServer, scene: LiveScene) -> None:
        self._server, self._scene = server, scene
        self._direct, self._skin, self._solving = (
            DirectSound(scene),
            MovingSkin(scene.radii),
            SolvedSound(scene),
        )
        self._middle = focal_point(scene)
        self._peak = 0.0
        self._sound: Sound | None = None
        server._websock_server.queue_message(
            RunJavascriptMessage(DRAWING.read_text(encoding="utf-8"))
        )
        server.scene.set_up_direction("+z")
        server.scene.configure_environment_map(None)
        server.scene.configure_default_lights(False)
        server.scene.add_light_ambient("/lights/ambient", intensity=AMBIENT)
        self._set_camera()
        self._array = self._add_array()
        self._add_planes()
        self._foci, self._labels = self._add_foci()
        self._hand: tuple[viser.MeshHandle, viser.PointCloudHandle] | None = None
        blank = np.zeros((2, 2, 4), dtype=np.uint8)
        self._slice = server.scene.add_image(
            "/slice",
            blank,
            ACROSS,
            ACROSS,
            format="png",
            cast_shadow=False,
            receive_shadow=False,
            visible=False,
        )

    def update(self, moment: Moment, look: Look) -> None:
        """Show a moment, with the newest sound on the skin and in the slice."""
        self._array.colors = np.repeat(
            in_light(element_colours(moment.amplitudes, look.array)), CORNERS, axis=0
        )
        self._show_foci(moment)
        before, self._sound = self._sound, None
        if moment.joints is None or moment.foci is None:
            for part in (*(self._hand or ())[:1], self._slice):
                part.visible = False
            return
        self._middle = moment.foci.mean(axis=0)
        vertices, normals = self._skin.at(moment.joints)
        if np.any(moment.amplitudes):
            self._sound = self._heard(moment, vertices, normals, look, before)
        if self._sound is not None and self._sound is not before:
            self._follow(self._sound)
            self._show_slice(self._sound)
        self._show_hand(
            vertices, normals, None if self._sound is None or not look.skin else self._sound.skin
        )
        self._slice.visible = self._sound is not None and look.slice

    def close(self) -> None:
        """End what runs beside."""
        self._solving.close()

    @property
    def most(self) -> float:
        """Pressure at the end of the colours of skin and slice [Pa]."""
        return max(SATURATED * self._peak, 1.0)

    @property
    def sound(self) -> Sound | None:
        """What skin and slice show; None where there is silence."""
        return self._sound

    def _heard(
        self,
        moment: Moment,
        vertices: Float64[np.ndarray, "vertices 3"],
        normals: Float64[np.ndarray, "vertices 3"],
        look: Look,
        before: Sound | None,
    ) -> Sound:
        """Return the sound with the hand in its place, or the direct one, new or as before, where none was solved."""
        assert moment.joints is not None
        assert moment.foci is not None
        section, now = Section(self._middle, look.across, look.offset), time.monotonic()
        self._solving.ask(
            Asked(now, moment.joints, moment.foci, moment.amplitudes, vertices, section)
        )
        solved = self._solving.newest
        if solved is not None and len(solved.skin) == len(vertices) and now - solved.time < OLD:
            return solved
        if before is not None and len(before.skin) == len(vertices) and now - before.time < DIRECT:
            return before
        skin = self._direct.on_skin(vertices, normals, moment.amplitudes, self._middle)
        field = self._direct.at(section.points(), moment.amplitudes, self._middle)
        return Sound(now, False, skin, section, field)

    def _follow(self, sound: Sound) -> None:
        """Let the colours follow the largest pressure, slowly, so that they do not flicker."""
        most = max(float(np.quantile(np.abs(part), 0.998)) for part in (sound.skin, sound.field))
        self._peak += (1.0 if self._peak == 0.0 else FOLLOWING) * (most - self._peak)

    def _show_hand(
        self,
        vertices: Float64[np.ndarray, "vertices 3"],
        normals: Float64[np.ndarray, "vertices 3"],
        pressures: Float64[np.ndarray, "vertices"] | None,
    ) -> None:
        """Show the hand with the pressure on it; its colours are those of points that nobody sees."""
        colours = (
            np.broadcast_to(SKIN, vertices.shape)
            if pressures is None
            else self._coloured(pressures)
        )
        colours = in_light(shaded(colours, normals))
        if self._hand is None:
            self._hand = self._add_coloured("/hand", vertices, self._skin.triangles, colours)
        mesh, points = self._hand
        if len(mesh.vertices) != len(vertices):
            mesh.faces, points.points = (
                self._skin.triangles.astype(np.uint32),
                np.zeros(vertices.shape, np.float16),
            )
        mesh.vertices, points.colors, mesh.visible = vertices.astype(np.float32), colours, True

    def _show_slice(self, sound: Sound) -> None:
        self._slice.image = self._with_edges_clear(enlarged(sound.field))
        self._slice.position, self._slice.wxyz = (
            sound.section.middle,
            quaternion(sound.section.axes.T),
        )

    def _coloured(self, pressures: Float64[np.ndarray, "*some"]) -> UInt8[np.ndarray, "*some 3"]:
        return PRESSURES[
            np.clip(pressures / self.most * (STEPS - 1), 0, STEPS - 1).astype(np.int64)
        ]

    def _with_edges_clear(
        self, pressures: Float64[np.ndarray, "rows columns"]
    ) -> UInt8[np.ndarray, "rows columns 4"]:
        """Colour a slice, clear where there is little sound, so that what stands behind it stays in sight."""
        opaque = 255 * np.clip(0.1 + 3.0 * pressures / self.most, 0.0, 0.95)
        return np.dstack([self._coloured(pressures), opaque.astype(np.uint8)])

    def _show_foci(self, moment: Moment) -> None:
        for part in (self._foci, *self._labels):
            part.visible = moment.foci is not None
        if moment.foci is None:
            return
        self._foci.points = moment.foci.astype(np.float32)
        for index, label in enumerate(self._labels):
            label.position, label.text = (
                moment.foci[index],
                focus_in_words(self._scene.places[index], index, moment),
            )

    def _set_camera(self) -> None:
        towards = view_of(self._scene.array.normals).towards_viewer
        hand = self._middle + HAND * np.concatenate([np.eye(3), -np.eye(3)])
        points = np.vstack([self._scene.array.positions, hand])
        middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
        reach = float(np.linalg.norm(points - middle, axis=1).max())
        camera = self._server.initial_camera
        camera.position, camera.look_at, camera.up = (
            middle + 2.5 * reach * towards,
            middle,
            (0.0, 0.0, 1.0),
        )
        camera.fov, camera.near, camera.far = np.radians(50.0), 0.005, 20.0

    def _add_array(self) -> viser.PointCloudHandle:
        array = self._scene.array
        corners, triangles = disc(0.46 * spacing(array.positions))
        frames = np.stack(frames_of(array.normals), axis=1)
        vertices = array.positions[:, None] + np.einsum("cj,ejk->eck", corners, frames)
        faces = CORNERS * np.arange(len(array))[:, None, None] + triangles
        colours = np.tile(SILENT, (vertices.size // 3, 1))
        return self._add_coloured("/array", vertices.reshape(-1, 3), faces.reshape(-1, 3), colours)[
            1
        ]

    def _add_planes(self) -> None:
        """Add each rigid plane as a sheet that shows what is behind it, under array and hand."""
        for index, plane in enumerate(self._scene.planes):
            points = np.vstack([self._scene.array.positions, self._middle])
            self._server.scene.add_mesh_simple(
                f"/planes/{index}",
                sheet_of(plane, points).astype(np.float32),
                np.array([[0, 1, 2], [0, 2, 3]], dtype=np.uint32),
                color=SHEET[:3],
                opacity=SHEET[3],
                side="double",
                cast_shadow=False,
                receive_shadow=False,
            )

    def _add_foci(self) -> tuple[viser.PointCloudHandle, list[viser.LabelHandle]]:
        places = self._scene.places
        points = np.zeros((len(places), 3), dtype=np.float32)
        balls = self._server.scene.add_point_cloud(
            "/foci",
            points,
            FOCUS,
            point_size=4e-3,
            point_shape="circle",
            precision="float32",
            visible=False,
        )
        labels = []
        for index, place in enumerate(places):
            anchor = (
                "bottom-left" if index % 2 == 0 else "top-right"
            )  # neighbours' labels stay apart
            labels.append(
                self._server.scene.add_label(
                    f"/labels/{place}", place, anchor=anchor, visible=False
                )
            )
        return balls, labels

    def _add_coloured(
        self,
        name: str,
        vertices: Float64[np.ndarray, "vertices 3"],
        faces: Int64[np.ndarray, "triangles 3"],
        colours: UInt8[np.ndarray, "vertices 3"],
    ) -> tuple[viser.MeshHandle, viser.PointCloudHandle]:
        """Add a mesh, and points that nobody sees, whose colours ``drawing.js`` gives to its vertices."""
        scene, nowhere = self._server.scene, np.zeros(vertices.shape, dtype=np.float16)
        mesh = scene.add_mesh_simple(
            name,
            vertices.astype(np.float32),
            faces.astype(np.uint32),
            color=SKIN,
            cast_shadow=False,
            receive_shadow=False,
        )
        return mesh, scene.add_point_cloud(f"{name}-colours", nowhere, colours, visible=False)


def focal_point(scene: LiveScene) -> Float64[np.ndarray, "3"]:
    """Return where a hand is expected: 0.2 m before an array that looks one way, else in its middle (3,) [m]."""
    front = scene.array.normals.mean(axis=0)
    middle = 0.5 * (scene.array.positions.min(axis=0) + scene.array.positions.max(axis=0))
    return middle + (0.2 * front / np.linalg.norm(front) if np.linalg.norm(front) > 0.3 else 0.0)


def focus_in_words(place: str, index: int, moment: Moment) -> str:
    """Say what a focus gets."""
    if moment.pressures is None:
        return place
    return f"{place}  {moment.pressures[index]:,.0f} Pa"


def element_colours(
    amplitudes: Complex128[np.ndarray, "elements"], shown: Shown
) -> UInt8[np.ndarray, "elements 3"]:
    """Colour elements by their phase, grey where silent, or by their amplitude from 0 to full scale."""
    if shown == "amplitude":
        return AMPLITUDES[np.clip(np.abs(amplitudes) * (STEPS - 1), 0, STEPS - 1).astype(np.int64)]
    colours = PHASES[(np.angle(amplitudes) / (2 * np.pi) % 1.0 * (STEPS - 1)).astype(np.int64)]
    return np.where((amplitudes == 0.0)[:, None], SILENT, colours)


def in_light(colours: UInt8[np.ndarray, "*some 3"]) -> UInt8[np.ndarray, "*some 3"]:
    """Return colours in amounts of light, as a mesh takes them, of those of a screen (sRGB, IEC 61966-2-1)."""
    return LIGHT[colours]


def shaded(
    colours: UInt8[np.ndarray, "points 3"], normals: Float64[np.ndarray, "points 3"]
) -> UInt8[np.ndarray, "points 3"]:
    """Darken colours of a surface a little where it looks down, as light from above does."""
    return (colours * (0.8 + 0.2 * normals[:, 2:])).astype(np.uint8)


def frames_of(
    normals: Float64[np.ndarray, "elements 3"],
) -> tuple[
    Float64[np.ndarray, "elements 3"],
    Float64[np.ndarray, "elements 3"],
    Float64[np.ndarray, "elements 3"],
]:
    """Return axes whose third is the normal."""
    helper = np.where(np.abs(normals[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    along = np.cross(helper, normals)
    along = along / np.linalg.norm(along, axis=1, keepdims=True)
    return along, np.cross(normals, along), normals


def disc(
    radius: float,
) -> tuple[Float64[np.ndarray, "corners 3"], Int64[np.ndarray, "triangles 3"]]:
    """Return a disc of a radius [m] in the plane z = 0, its front to +z."""
    angles = 2.0 * np.pi * np.arange(CORNERS) / CORNERS
    rim = radius * np.stack([np.cos(angles), np.sin(angles), 0.0 * angles], axis=1)
    steps = np.arange(CORNERS - 2)
    return rim, np.stack([0 * steps, 1 + steps, 2 + steps], axis=1)


def quaternion(turn: Float64[np.ndarray, "3 3"]) -> Float64[np.ndarray, "4"]:
    """Return a rotation as viser takes it: w, x, y, z."""
    return np.roll(Rotation.from_matrix(turn).as_quat(), 1)
