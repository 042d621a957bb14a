"""What the page shows in three dimensions: the array, the hand, the foci and a slice of the field."""

from dataclasses import dataclass
from typing import Literal

import matplotlib
import numpy as np
import viser
from jaxtyping import Complex128, Float64, Int64, UInt8
from scipy.spatial.transform import Rotation

from airtact.figures.array_figures import spacing, view_of
from airtact.live.page.skin import MovingSkin
from airtact.live.page.sound import DirectSound
from airtact.live.parts import LiveScene, Moment

ACROSS = 0.12
"""Side of the slice [m]."""

PIXELS = 56
"""Points along a side of the slice at which the field is computed."""

ENLARGED = 2
"""Each of them is so many pixels wide, the field between being interpolated."""

HAND = 0.15
"""How far a hand reaches from the middle of its foci, more or less [m]."""

SATURATED = 0.6
"""Pressures above this share of the largest have the last colour, so that the others differ."""

AMBIENT, ABOVE = 2.3, 1.2
"""Intensities of the light from all sides and of that from above; more of it would wash out the colours."""

STEPS = 256
"""Colours of a colour map."""

SILENT = np.array([150, 150, 155], dtype=np.uint8)
"""Colour of an element that emits nothing, where colours mean phases."""

Shown = Literal["phase", "amplitude"]
Across = Literal["x", "y", "z"]


def colour_map(name: str) -> UInt8[np.ndarray, "steps 3"]:
    """Return a colour map of matplotlib (256, 3)."""
    return (255 * matplotlib.colormaps[name](np.linspace(0.0, 1.0, STEPS))[:, :3]).round().astype(np.uint8)


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
        self._sound, self._skin = DirectSound(scene), MovingSkin(scene.radii)
        self._middle = focal_point(scene)
        self._peaks, self._turn = {"skin": 0.0, "slice": 0.0}, 0
        self._pressures = np.zeros(0)
        server.scene.set_up_direction("+z")
        server.scene.configure_environment_map(None)
        server.scene.configure_default_lights(False)
        server.scene.add_light_ambient("/lights/ambient", intensity=AMBIENT)
        server.scene.add_light_directional("/lights/above", intensity=ABOVE, position=(0.3, -0.5, 1.0))
        self._set_camera()
        self._array = self._add_array()
        self._foci = [self._add_focus(*named) for named in enumerate(scene.places)]
        self._hand: tuple[viser.MeshHandle, viser.PointCloudHandle] | None = None
        blank = np.zeros((2, 2, 4), dtype=np.uint8)
        self._slice = server.scene.add_image(
            "/slice", blank, ACROSS, ACROSS, format="png", cast_shadow=False, receive_shadow=False, visible=False
        )

    def update(self, moment: Moment, look: Look) -> None:
        """Show a moment; the pressure on the skin and that in the slice follow in turn, each at every other call."""
        silent = not np.any(moment.amplitudes)
        self._array.batched_colors = element_colours(moment.amplitudes, look.array)
        if moment.foci is not None:
            self._middle = moment.foci.mean(axis=0)
        self._show_foci(moment)
        self._turn += 1
        self._show_hand(moment, look.skin and not silent)
        self._slice.visible = look.slice and not silent
        if look.slice and not silent and self._turn % 2 == 0:
            self._show_slice(moment, look)

    @property
    def most(self) -> float:
        """Pressure at the end of the colours of skin and slice [Pa]."""
        return max(SATURATED * max(self._peaks.values()), 1.0)

    def _show_hand(self, moment: Moment, pressed: bool) -> None:
        if moment.joints is None:
            for part in self._hand or ():
                part.visible = False
            return
        vertices, normals, triangles = self._skin.at(moment.joints)
        points, directions = between(vertices, triangles), between(normals, triangles)
        if self._hand is None:
            self._hand = self._add_hand(vertices, triangles)
        mesh, cloud = self._hand
        mesh.vertices, mesh.visible, cloud.visible = vertices.astype(np.float32), True, pressed
        if not pressed:
            return
        if self._turn % 2 == 1 or len(self._pressures) != len(points):
            found = self._sound.on_skin(vertices, normals, moment.amplitudes, self._middle)
            self._pressures = between(found[:, None], triangles)[:, 0]
            self._scale_to("skin", float(np.quantile(found, 0.995)))
        with self._server.atomic():
            cloud.points = (points + 0.3e-3 * directions).astype(np.float32)
            cloud.colors = shaded(self._coloured(self._pressures), directions)

    def _show_slice(self, moment: Moment, look: Look) -> None:
        along, up, across = axes_across(look.across)
        middle = self._middle + look.offset * across
        steps = np.linspace(-0.5, 0.5, PIXELS) * ACROSS
        grid = middle + steps[None, :, None] * along - steps[:, None, None] * up
        field = self._sound.at(grid.reshape(-1, 3), moment.amplitudes, self._middle).reshape(PIXELS, PIXELS)
        pressures = np.abs(enlarged(field))
        self._scale_to("slice", float(np.quantile(pressures, 0.999)))
        with self._server.atomic():
            self._slice.image = self._with_edges_clear(pressures)
            self._slice.position = middle
            self._slice.wxyz = quaternion(np.stack([along, up, np.cross(along, up)], axis=1))

    def _coloured(self, pressures: Float64[np.ndarray, "*some"]) -> UInt8[np.ndarray, "*some 3"]:
        return PRESSURES[np.clip(pressures / self.most * (STEPS - 1), 0, STEPS - 1).astype(np.int64)]

    def _with_edges_clear(self, pressures: Float64[np.ndarray, "rows columns"]) -> UInt8[np.ndarray, "rows columns 4"]:
        """Colour a slice, clear where there is little sound, so that what stands behind it stays in sight."""
        opaque = 255 * np.clip(0.1 + 3.0 * pressures / self.most, 0.0, 0.95)
        return np.dstack([self._coloured(pressures), opaque.astype(np.uint8)])

    def _scale_to(self, what: str, most: float) -> None:
        """Follow the largest pressure slowly, so that colours do not flicker."""
        before = self._peaks[what]
        self._peaks[what] = most if before == 0.0 else 0.9 * before + 0.1 * most

    def _show_foci(self, moment: Moment) -> None:
        for index, (ball, label) in enumerate(self._foci):
            ball.visible = label.visible = moment.foci is not None
            if moment.foci is None:
                continue
            ball.position = label.position = moment.foci[index]
            label.text = focus_in_words(self._scene.places[index], index, moment)

    def _set_camera(self) -> None:
        towards = view_of(self._scene.array.normals).towards_viewer
        hand = self._middle + HAND * np.concatenate([np.eye(3), -np.eye(3)])
        points = np.vstack([self._scene.array.positions, hand])
        middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
        reach = float(np.linalg.norm(points - middle, axis=1).max())
        camera = self._server.initial_camera
        camera.position, camera.look_at, camera.up = middle + 2.5 * reach * towards, middle, (0.0, 0.0, 1.0)
        camera.fov, camera.near, camera.far = np.radians(50.0), 0.005, 20.0

    def _add_array(self) -> viser.BatchedMeshHandle:
        array = self._scene.array
        corners, triangles = disc(0.46 * spacing(array.positions))
        turns = np.array([quaternion(np.stack(frame, axis=1)) for frame in zip(*frames_of(array.normals), strict=True)])
        return self._server.scene.add_batched_meshes_simple(
            "/array",
            corners,
            triangles,
            turns.astype(np.float32),
            array.positions.astype(np.float32),
            batched_colors=np.tile(SILENT, (len(array), 1)),
            lod="off",
            flat_shading=True,
            cast_shadow=False,
            receive_shadow=False,
        )

    def _add_focus(self, index: int, place: str) -> tuple[viser.IcosphereHandle, viser.LabelHandle]:
        ball = self._server.scene.add_icosphere(
            f"/foci/{place}", 2e-3, color=(0, 190, 90), cast_shadow=False, receive_shadow=False, visible=False
        )
        anchor = "bottom-left" if index % 2 == 0 else "top-right"  # neighbours' labels stay apart
        label = self._server.scene.add_label(f"/labels/{place}", place, anchor=anchor, visible=False)
        return ball, label

    def _add_hand(
        self, vertices: Float64[np.ndarray, "vertices 3"], triangles: Int64[np.ndarray, "triangles 3"]
    ) -> tuple[viser.MeshHandle, viser.PointCloudHandle]:
        mesh = self._server.scene.add_mesh_simple(
            "/hand",
            vertices.astype(np.float32),
            triangles.astype(np.uint32),
            color=(205, 180, 165),
            cast_shadow=False,
            receive_shadow=False,
        )
        points = between(vertices, triangles)
        colours = np.zeros(points.shape, dtype=np.uint8)
        cloud = self._server.scene.add_point_cloud(
            "/pressure", points.astype(np.float32), colours, point_size=3.4e-3, point_shape="circle"
        )
        return mesh, cloud


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


def element_colours(amplitudes: Complex128[np.ndarray, "elements"], shown: Shown) -> UInt8[np.ndarray, "elements 3"]:
    """Colour elements by their phase, grey where silent, or by their amplitude from 0 to full scale."""
    if shown == "amplitude":
        return AMPLITUDES[np.clip(np.abs(amplitudes) * (STEPS - 1), 0, STEPS - 1).astype(np.int64)]
    colours = PHASES[(np.angle(amplitudes) / (2 * np.pi) % 1.0 * (STEPS - 1)).astype(np.int64)]
    return np.where((amplitudes == 0.0)[:, None], SILENT, colours)


def between(
    values: Float64[np.ndarray, "vertices kinds"], triangles: Int64[np.ndarray, "triangles 3"]
) -> Float64[np.ndarray, "points kinds"]:
    """Return values at vertices, and their means over triangles after them."""
    return np.concatenate([values, values[triangles].mean(axis=1)])


def shaded(
    colours: UInt8[np.ndarray, "points 3"], normals: Float64[np.ndarray, "points 3"]
) -> UInt8[np.ndarray, "points 3"]:
    """Darken colours of a surface a little where it looks down, as light from above does."""
    return (colours * (0.82 + 0.18 * normals[:, 2:])).astype(np.uint8)


def enlarged(field: Complex128[np.ndarray, "rows columns"]) -> Complex128[np.ndarray, "more_rows more_columns"]:
    """Interpolate a field linearly along both sides, to so many times as many points."""
    steps = np.arange(len(field))
    finer = np.linspace(0, len(field) - 1, ENLARGED * len(field))
    low = np.minimum(finer.astype(np.int64), len(steps) - 2)
    share = finer - low
    rows = field[low] * (1.0 - share)[:, None] + field[low + 1] * share[:, None]
    return rows[:, low] * (1.0 - share) + rows[:, low + 1] * share


def axes_across(
    across: Across,
) -> tuple[Float64[np.ndarray, "3"], Float64[np.ndarray, "3"], Float64[np.ndarray, "3"]]:
    """Return the axes along a slice, up in it and across it."""
    x, y, z = np.eye(3)
    return {"x": (y, z, x), "y": (x, z, y), "z": (x, y, z)}[across]


def frames_of(
    normals: Float64[np.ndarray, "elements 3"],
) -> tuple[Float64[np.ndarray, "elements 3"], Float64[np.ndarray, "elements 3"], Float64[np.ndarray, "elements 3"]]:
    """Return axes whose third is the normal."""
    helper = np.where(np.abs(normals[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    along = np.cross(helper, normals)
    along = along / np.linalg.norm(along, axis=1, keepdims=True)
    return along, np.cross(normals, along), normals


def disc(radius: float) -> tuple[Float64[np.ndarray, "corners 3"], Int64[np.ndarray, "triangles 3"]]:
    """Return a disc of a radius [m] in the plane z = 0, its front to +z."""
    angles = 2.0 * np.pi * np.arange(12) / 12
    rim = radius * np.stack([np.cos(angles), np.sin(angles), 0.0 * angles], axis=1)
    steps = np.arange(12)
    return np.vstack([np.zeros(3), rim]), np.stack([0 * steps, 1 + steps, 1 + (steps + 1) % 12], axis=1)


def quaternion(turn: Float64[np.ndarray, "3 3"]) -> Float64[np.ndarray, "4"]:
    """Return a rotation as viser takes it: w, x, y, z."""
    return np.roll(Rotation.from_matrix(turn).as_quat(), 1)
