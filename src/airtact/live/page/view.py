"""The 3-D view of the page: array, hand, foci and a slice of the field."""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import matplotlib
import numpy as np
import viser
from jaxtyping import Float64, Int64, UInt8
from scipy.spatial.transform import Rotation
from viser._messages import RunJavascriptMessage

from airtact.hands.body import Hulls, hand_hulls
from airtact.hands.joints import hand_length, radii_of
from airtact.hands.shape import hull_weights, moved_with_hulls
from airtact.hands.skin_mesh import HandMesh, even_skin
from airtact.live.moment import Moment
from airtact.live.page.sound import (
    SLICE_SIZE,
    Axis,
    Section,
    Sound,
    SoundProcess,
    SoundRequest,
    enlarged,
)
from airtact.live.scene import Amplitudes, Foci, Joints, LiveScene
from airtact.reports.array_figures import spacing, view_of
from airtact.reports.solids import SHEET, sheet_of, towards_viewer

# Colours of a colour map.
STEPS = 256

# Corners of an element's disc; few, because each slows down a software renderer.
CORNERS = 6

SKIN_COLOUR = (205, 180, 165)

Vertices = Float64[np.ndarray, "vertices 3"]
Colours = UInt8[np.ndarray, "vertices 3"]


def colour_map(name: str) -> UInt8[np.ndarray, "steps 3"]:
    """Return a colour map of Matplotlib (256, 3)."""
    colours = matplotlib.colormaps[name](np.linspace(0.0, 1.0, STEPS))
    return (255 * colours[:, :3]).round().astype(np.uint8)


PHASES = colour_map("twilight")
PRESSURES = colour_map("OrRd")
AMPLITUDES = colour_map("viridis")


@dataclass(frozen=True)
class Look:
    """Settings of the view.

    Attributes
    ----------
    array : quantity shown by the colours of the elements.
    skin : whether the pressure on the skin is shown.
    slice : whether the slice is shown.
    across : axis normal to the slice.
    offset : offset of the slice from the centre of the foci along that axis [m].
    """

    array: Literal["phase", "amplitude"] = "phase"
    skin: bool = True
    slice: bool = True
    across: Axis = "y"
    offset: float = 0.0


class View:
    """The scene of the page.

    Parameters
    ----------
    server : server of the page.
    scene : the fixed part of the scene.
    """

    def __init__(self, server: viser.ViserServer, scene: LiveScene) -> None:
        self._server = server
        self._scene = scene
        self._skin = MovingSkin(scene.radii)
        self._solving = SoundProcess(scene)
        self._middle = expected_middle(scene)
        self._peak = 0.0  # running mean of the largest pressure, for the colours [Pa]
        self.sound: Sound | None = None  # shown on skin and slice
        # viser has no public way to draw unlit vertex colours or to draw less often.
        script = Path(__file__).with_name("drawing.js").read_text(encoding="utf-8")
        server._websock_server.queue_message(RunJavascriptMessage(script))
        server.scene.set_up_direction("+z")
        server.scene.configure_environment_map(None)
        server.scene.configure_default_lights(False)
        server.scene.add_light_ambient("/lights/ambient", intensity=3.0)
        self._set_camera()
        self._array_colours = self._add_array()
        self._add_planes()
        self._add_foci()
        self._hand: tuple[viser.MeshHandle, viser.PointCloudHandle] | None = None
        self._slice = server.scene.add_image(
            "/slice",
            np.zeros((2, 2, 4), dtype=np.uint8),
            SLICE_SIZE,
            SLICE_SIZE,
            format="png",
            cast_shadow=False,
            receive_shadow=False,
            visible=False,
        )

    def update(self, moment: Moment, look: Look) -> None:
        """Show a moment, with the newest sound on the skin and in the slice."""
        colours = element_colours(moment.amplitudes, look.array)
        self._array_colours.colors = np.repeat(in_light(colours), CORNERS, axis=0)
        self._show_foci(moment)
        previous = self.sound
        self.sound = None
        if moment.joints is None or moment.foci is None:
            self._slice.visible = False
            if self._hand is not None:
                self._hand[0].visible = False
            return
        self._middle = moment.foci.mean(axis=0)
        vertices, normals = self._skin.at(moment.joints)
        if np.any(moment.amplitudes):
            self.sound = self._sound_of(moment, moment.joints, moment.foci, vertices, look)
        if self.sound is not None and self.sound is not previous:
            # The colour scale follows the largest pressure slowly, so that it does not flicker.
            parts = (self.sound.skin, self.sound.field)
            peak = max(float(np.quantile(np.abs(part), 0.998)) for part in parts)
            self._peak += (1.0 if self._peak == 0.0 else 0.3) * (peak - self._peak)
            self._show_slice(self.sound)
        pressures = None if self.sound is None or not look.skin else self.sound.skin
        self._show_hand(vertices, normals, pressures)
        self._slice.visible = self.sound is not None and look.slice

    @property
    def largest(self) -> float:
        """Upper limit of the colour scale of skin and slice [Pa]."""
        # Pressures above 60 % of the largest share the last colour, so that lower ones differ.
        return max(0.6 * self._peak, 1.0)

    def _sound_of(
        self, moment: Moment, joints: Joints, foci: Foci, vertices: Vertices, look: Look
    ) -> Sound | None:
        """Request the pressure of a moment, and return the newest result if under 20 s old."""
        section = Section(self._middle, look.across, look.offset)
        now = time.monotonic()
        self._solving.ask(SoundRequest(now, joints, foci, moment.amplitudes, vertices, section))
        sound = self._solving.newest
        if sound is None or len(sound.skin) != len(vertices) or now - sound.time > 20.0:
            return None
        return sound

    def _show_hand(
        self,
        vertices: Vertices,
        normals: Vertices,
        pressures: Float64[np.ndarray, "vertices"] | None,
    ) -> None:
        colours = np.broadcast_to(np.array(SKIN_COLOUR, dtype=np.uint8), vertices.shape)
        if pressures is not None:
            colours = self._coloured(pressures)
        # Downward surfaces are a little darker, as in light from above.
        colours = in_light((colours * (0.8 + 0.2 * normals[:, 2:])).astype(np.uint8))
        if self._hand is None:
            self._hand = self._add_coloured("/hand", vertices, self._skin.triangles, colours)
        mesh, points = self._hand
        if len(mesh.vertices) != len(vertices):
            mesh.faces = self._skin.triangles.astype(np.uint32)
            points.points = np.zeros(vertices.shape, np.float16)
        mesh.vertices = vertices.astype(np.float32)
        points.colors = colours
        mesh.visible = True

    def _show_slice(self, sound: Sound) -> None:
        pressures = enlarged(sound.field)
        # Low pressures are transparent, so that objects behind the slice stay visible.
        opaque = 255 * np.clip(0.1 + 3.0 * pressures / self.largest, 0.0, 0.95)
        self._slice.image = np.dstack([self._coloured(pressures), opaque.astype(np.uint8)])
        self._slice.position = sound.section.middle
        self._slice.wxyz = np.roll(Rotation.from_matrix(sound.section.axes.T).as_quat(), 1)

    def _coloured(self, pressures: Float64[np.ndarray, "*any"]) -> UInt8[np.ndarray, "*any 3"]:
        steps = np.clip(pressures / self.largest * (STEPS - 1), 0, STEPS - 1)
        return PRESSURES[steps.astype(np.int64)]

    def _show_foci(self, moment: Moment) -> None:
        for handle in (self._foci, *self._labels):
            handle.visible = moment.foci is not None
        if moment.foci is None:
            return
        self._foci.points = moment.foci.astype(np.float32)
        for index, (label, place) in enumerate(zip(self._labels, self._scene.places, strict=True)):
            label.position = moment.foci[index]
            pressures = moment.pressures
            label.text = place if pressures is None else f"{place}  {pressures[index]:,.0f} Pa"

    def _set_camera(self) -> None:
        array = self._scene.array
        towards = towards_viewer(*view_of(array.normals))
        # A hand reaches about 0.15 m from its foci.
        hand = self._middle + 0.15 * np.concatenate([np.eye(3), -np.eye(3)])
        points = np.vstack([array.positions, hand])
        middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
        reach = float(np.linalg.norm(points - middle, axis=1).max())
        camera = self._server.initial_camera
        camera.position = middle + 2.5 * reach * towards
        camera.look_at = middle
        camera.up = (0.0, 0.0, 1.0)
        camera.fov = np.radians(50.0)
        camera.near = 0.005
        camera.far = 20.0

    def _add_array(self) -> viser.PointCloudHandle:
        array = self._scene.array
        angles = 2.0 * np.pi * np.arange(CORNERS) / CORNERS
        radius = 0.46 * spacing(array.positions)  # discs of neighbours do not touch
        across = np.cross(array.normals, array.tangents)
        rim = (
            np.cos(angles)[None, :, None] * array.tangents[:, None]
            + np.sin(angles)[None, :, None] * across[:, None]
        )
        vertices = (array.positions[:, None] + radius * rim).reshape(-1, 3)
        steps = np.arange(CORNERS - 2)
        fan = np.stack([0 * steps, 1 + steps, 2 + steps], axis=1)
        faces = CORNERS * np.arange(len(array))[:, None, None] + fan
        colours = np.full((len(vertices), 3), 150, dtype=np.uint8)
        return self._add_coloured("/array", vertices, faces.reshape(-1, 3), colours)[1]

    def _add_planes(self) -> None:
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

    def _add_foci(self) -> None:
        scene = self._server.scene
        places = self._scene.places
        self._foci = scene.add_point_cloud(
            "/foci",
            np.zeros((len(places), 3), dtype=np.float32),
            (0, 190, 90),
            point_size=4e-3,
            point_shape="circle",
            precision="float32",
            visible=False,
        )
        self._labels = [
            scene.add_label(
                f"/labels/{place}",
                place,
                # Keep the labels of neighbouring foci apart.
                anchor="top-right" if index % 2 else "bottom-left",
                visible=False,
            )
            for index, place in enumerate(places)
        ]

    def _add_coloured(
        self,
        name: str,
        vertices: Vertices,
        faces: Int64[np.ndarray, "triangles 3"],
        colours: Colours,
    ) -> tuple[viser.MeshHandle, viser.PointCloudHandle]:
        """Add a mesh, and invisible points whose colours ``drawing.js`` gives to its vertices."""
        # viser can recolour points without sending them again, but not meshes.
        scene = self._server.scene
        mesh = scene.add_mesh_simple(
            name,
            vertices.astype(np.float32),
            faces.astype(np.uint32),
            color=SKIN_COLOUR,
            cast_shadow=False,
            receive_shadow=False,
        )
        nowhere = np.zeros(vertices.shape, dtype=np.float16)
        return mesh, scene.add_point_cloud(f"{name}-colours", nowhere, colours, visible=False)


class MovingSkin:
    """The skin of one hand, meshed in the first pose and moved with its bones.

    Parameters
    ----------
    radii : (25,) radius of the skin around each joint [m]; None for those of a generic hand.

    Attributes
    ----------
    triangles : (T, 3) vertices of each triangle; none before the first pose.
    """

    def __init__(self, radii: Float64[np.ndarray, "25"] | None) -> None:
        self._given_radii = radii
        self._first: tuple[Hulls, HandMesh, Float64[np.ndarray, "vertices hulls"]] | None = None
        self._length = 0.0
        self.triangles = np.zeros((0, 3), dtype=np.int64)

    def at(self, joints: Joints) -> tuple[Vertices, Vertices]:
        """Return vertices on the skin (V, 3) [m] and the unit normals there (V, 3)."""
        length = hand_length(joints)
        # If the length changed by a tenth, it is another person's hand: mesh it again.
        if self._first is None or abs(length / self._length - 1.0) > 0.1:
            self._radii = radii_of(self._given_radii, None, joints)
            self._length = length
            hulls, _ = hand_hulls(joints, self._radii)
            # Edges of 5 mm exceed half a wavelength, but more would slow down software renderers.
            mesh = even_skin(hulls, 5e-3)
            self._first = hulls, mesh, hull_weights(hulls, mesh.vertices)
            self.triangles = mesh.triangles
        now, _ = hand_hulls(joints, self._radii)
        before, mesh, weights = self._first
        vertices = now.project(moved_with_hulls(before, now, mesh.vertices, weights))
        normals = now.look(vertices).gradient
        normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
        return vertices, normals


def expected_middle(scene: LiveScene) -> Float64[np.ndarray, "3"]:
    """Return the expected position of a hand (3,) [m]: 0.2 m from a flat array, else its middle."""
    positions = scene.array.positions
    front = scene.array.normals.mean(axis=0)
    middle = 0.5 * (positions.min(axis=0) + positions.max(axis=0))
    length = np.linalg.norm(front)
    return middle + 0.2 * front / length if length > 0.3 else middle


def element_colours(
    amplitudes: Amplitudes, shown: Literal["phase", "amplitude"]
) -> UInt8[np.ndarray, "elements 3"]:
    """Colour elements by their phase (grey if silent) or by their amplitude."""
    if shown == "amplitude":
        steps = np.clip(np.abs(amplitudes) * (STEPS - 1), 0, STEPS - 1)
        return AMPLITUDES[steps.astype(np.int64)]
    steps = np.angle(amplitudes) / (2 * np.pi) % 1.0 * (STEPS - 1)
    grey = np.array([150, 150, 155], dtype=np.uint8)
    return np.where((amplitudes == 0.0)[:, None], grey, PHASES[steps.astype(np.int64)])


def in_light(colours: UInt8[np.ndarray, "*any 3"]) -> UInt8[np.ndarray, "*any 3"]:
    """Convert screen colours (sRGB, IEC 61966-2-1) to linear light, which meshes need."""
    values = np.arange(256) / 255
    linear = np.where(values <= 10 / 255, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)
    return (255 * linear).round().astype(np.uint8)[colours]
