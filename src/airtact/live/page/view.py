"""The content of the page for a moment: numbers, text and arrays that its scripts draw."""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float64
from scipy.spatial.transform import Rotation

from airtact.acoustics.scene import Plane
from airtact.drives.methods import FOR_SAMPLES, METHODS
from airtact.geometry.mesh.triangles import FlatMesh, Vertices
from airtact.geometry.pose import Pose
from airtact.hands.body import Hulls, hand_hulls
from airtact.hands.joints import hand_length, radii_of
from airtact.hands.shape import hull_weights, moved_with_hulls
from airtact.hands.skin_mesh import HandMesh, even_skin
from airtact.live.moment import Moment
from airtact.live.page.process import Shown
from airtact.live.page.sound import (
    SLICE_SIZE,
    Axis,
    Section,
    Sound,
    SoundRequest,
    enlarged,
    solve_sounds,
)
from airtact.live.scene import Joints, LiveScene
from airtact.live.worker import Worker
from airtact.reports.array_figures import spacing, view_of
from airtact.reports.solids import sheet_of, towards_viewer
from airtact.reports.viewer import colour_scales, framed, joined, pressure_bytes
from airtact.transducers.layout import PhasedArray


@dataclass(frozen=True, eq=False)
class Picture:
    """Content of the page at one time.

    Attributes
    ----------
    facts : numbers and texts to display, by name.
    arrays : arrays that change with every picture.
    kept : groups of arrays that seldom change, by key. The page keeps a group as long as pictures
        contain its key.
    """

    facts: dict[str, Any]
    arrays: dict[str, np.ndarray]
    kept: dict[str, dict[str, np.ndarray]]


class View:
    """Compute the pictures on the page from the data that the live loop sends.

    Call ``picture`` with each ``Shown`` that the loop sends.

    Parameters
    ----------
    scene : the parts of the scene that stay fixed during the run.

    Attributes
    ----------
    objects : dict from the integer that identifies a virtual object's shape (``Placed.key``) to the
        vertices and triangles of this shape.
    """

    def __init__(self, scene: LiveScene) -> None:
        self._scene = scene
        self._skins = {"hand": MovingSkin(scene.radii), "other": MovingSkin(scene.radii)}
        self._newest: Sound | None = None  # the newest result
        # Each solution takes most of a second.
        self._solver = Worker(solve_sounds, (scene,), self._solved, pause=0.2)
        self._peak = 0.0  # running mean of the largest pressure, for the colours [Pa]
        self._sound: Sound | None = None  # the result shown now
        self._sounds = 0
        self._sound_arrays: dict[str, np.ndarray] = {}
        self.objects: dict[int, FlatMesh] = {}

    def picture(self, shown: Shown, across: Axis, offset: float, joints: Joints | None) -> Picture:
        """Convert data from the live loop to the data that the page draws.

        Parameters
        ----------
        shown : data that the live loop sends for display.
        across : axis normal to the slice of the field.
        offset : offset of the slice from the foci along the axis ``across`` [m].
        joints : (25, 3) joints of a hand that is being dragged on the page [m]; None if no hand is
            dragged.
        """
        moment = shown.moment
        # Map phases from -π to π to 0 to 254; 255 represents silence.
        phases = 254 * (0.5 + np.angle(moment.amplitudes) / (2.0 * np.pi))
        phases = np.where(moment.amplitudes == 0.0, 255, phases)
        shares = np.minimum(np.abs(moment.amplitudes), 1.0)
        arrays: dict[str, np.ndarray] = {
            "phase": np.round(phases).astype(np.uint8),
            "amplitude": np.round(255 * shares).astype(np.uint8),
        }
        kept: dict[str, dict[str, np.ndarray]] = {}
        skins = []
        poses = {"hand": moment.joints if joints is None else joints, "other": moment.other}
        for name, pose in poses.items():
            if pose is not None:
                skin = self._skins[name]
                arrays[name] = skin.at(pose).astype(np.float32)
                skins.append({"name": name, "key": f"{name} {skin.count}"})
                kept[f"{name} {skin.count}"] = {"triangles": skin.triangles.astype(np.uint32)}
        # Add new shapes of virtual objects, and remove those that no longer exist.
        known = {**self.objects, **shown.meshes}
        self.objects = {
            thing.key: known[thing.key] for thing in shown.objects if thing.key in known
        }
        for key, (vertices, triangles) in self.objects.items():
            kept[f"object {key}"] = {
                "vertices": vertices.astype(np.float32),
                "triangles": triangles.astype(np.uint32),
            }
        facts = {
            "state": moment.state,
            "rule": moment.rule,
            "status": shown.status,
            "drives": shown.drives,
            "time": time.monotonic(),
            "latency": None if moment.foci is None else moment.time - moment.frame_time,
            "age": moment.shape_age,
            "kept": moment.kept,
            "mean": float(np.abs(moment.amplitudes).mean()),
            "foci": _foci(moment, self._scene),
            "contacts": [] if moment.contacts is None else moment.contacts.tolist(),
            "skins": skins,
            "objects": [
                {"name": thing.name, "key": f"object {thing.key}", **_placed(thing.pose)}
                for thing in shown.objects
                if thing.key in self.objects
            ],
        }
        sound = None
        if moment.joints is not None and "hand" in arrays and np.any(moment.amplitudes):
            sound = self._sound_of(moment, arrays["hand"], across, offset)
        if sound is not None:
            kept[f"sound {self._sounds}"] = self._sound_arrays
            facts["sound"] = {
                "key": f"sound {self._sounds}",
                "age": time.monotonic() - sound.time,
                "most": self._most,
                "middle": sound.section.middle.tolist(),
                "axes": sound.section.axes.tolist(),
            }
        return Picture(facts, arrays, kept)

    def _solved(self, sound: Sound | None) -> None:
        self._newest = sound or self._newest

    @property
    def _most(self) -> float:
        """Upper limit of the colour scale of the skin and the slice [Pa]."""
        return max(self._peak, 1.0)

    def _sound_of(
        self, moment: Moment, skin: np.ndarray, across: Axis, offset: float
    ) -> Sound | None:
        """Request the pressure of a moment; return the newest result if it is under 20 s old."""
        if moment.joints is None or moment.foci is None or not len(moment.foci):
            return None
        section = Section(moment.foci.mean(axis=0), across, offset)
        vertices = skin.astype(np.float64)
        now = time.monotonic()
        self._solver.put(
            SoundRequest(now, moment.joints, moment.foci, moment.amplitudes, vertices, section)
        )
        sound = self._newest
        if sound is None or len(sound.skin) != len(vertices) or now - sound.time > 20.0:
            return None
        if sound is not self._sound:
            self._sound = sound
            self._sounds += 1
            # The colour scale follows the largest pressure slowly, to avoid flicker, and always
            # includes the foci.
            parts = (sound.skin, np.abs(sound.field))
            peak = max(float(np.quantile(part, 0.998)) for part in parts)
            self._peak += (1.0 if self._peak == 0.0 else 0.3) * (peak - self._peak)
            if moment.pressures is not None:
                self._peak = max(self._peak, float(moment.pressures.max()))
            self._sound_arrays = {
                "skin": pressure_bytes(sound.skin, self._most),
                "field": pressure_bytes(enlarged(sound.field), self._most),
            }
        return sound


def _foci(moment: Moment, scene: LiveScene) -> list[dict[str, Any]]:
    """Return the name, position [m], pressure [Pa] and strength of each focus."""
    foci = []
    for index, name in enumerate(moment.names or scene.places):
        values = (moment.foci, moment.pressures, moment.strengths)
        point, pressure, strength = (None if rows is None else rows[index] for rows in values)
        foci.append(
            {
                "name": name,
                "position": None if point is None else point.tolist(),
                "pressure": None if pressure is None else float(pressure),
                "strength": None if strength is None else float(strength),
            }
        )
    return foci


def _placed(pose: Pose | None) -> dict[str, list[float]]:
    """Return the position [m] and quaternion (x, y, z, w) of a pose."""
    pose = pose or Pose.identity()
    turn = Rotation.from_matrix(pose.rotation).as_quat()
    return {"position": pose.translation.tolist(), "turn": turn.tolist()}


def packed(facts: dict[str, Any], arrays: dict[str, np.ndarray]) -> bytes:
    """Pack values (numbers and texts) and arrays for a page.

    The result contains the number of bytes of the facts, the facts as JSON, and the arrays.
    """
    import msgspec

    places, data = joined(arrays)
    words = msgspec.json.encode({**facts, "arrays": places})
    words += b" " * (-len(words) % 4)  # align the arrays to a multiple of their item size
    return len(words).to_bytes(4, "little") + words + data


def fixed_facts(scene: LiveScene) -> tuple[dict[str, Any], bytes]:
    """Return the values and packed arrays that never change, for the template of the page."""
    moving = scene.moving
    if moving is not None:
        modulation = moving.words
    elif scene.modulation is not None:
        modulation = f"the amplitude varies at {scene.modulation.frequency:g} Hz"
    else:
        modulation = ""
    facts, numbers = array_facts(scene.array, scene.planes)
    facts |= {
        "slice": SLICE_SIZE,
        "modulation": modulation,
        "method": scene.method,
        "offset": float(scene.offsets.mean()) if len(scene.offsets) else 0.0,
        # Robust methods require samples of an uncertain scene.
        "methods": [name for name in METHODS if name not in FOR_SAMPLES],
    }
    return facts, numbers


def array_facts(array: PhasedArray, planes: Sequence[Plane]) -> tuple[dict[str, Any], bytes]:
    """Return the values and packed arrays with which a page draws transducers and planes."""
    # A hand is expected 0.2 m in front of a flat array, or at the centre of an array around it.
    middle = 0.5 * (array.positions.min(axis=0) + array.positions.max(axis=0))
    front = array.normals.mean(axis=0)
    length = float(np.linalg.norm(front))
    if length > 0.3:
        middle = middle + 0.2 * front / length
    # A hand extends about 0.15 m from its foci.
    hand = middle + 0.15 * np.concatenate([np.eye(3), -np.eye(3)])
    sheets = [sheet_of(plane, np.vstack([array.positions, middle])) for plane in planes]
    azimuth, elevation = view_of(array.normals)
    everything = np.concatenate([array.positions, hand, *sheets])
    centre, reach, _ = framed(everything, towards_viewer(azimuth, elevation))
    places, numbers = joined(
        {
            "positions": array.positions.astype(np.float32),
            "normals": np.asarray(array.normals, dtype=np.float32),
        }
    )
    facts = {
        "arrays": places,
        "colours": colour_scales(),
        "radius": 0.46 * spacing(array.positions),  # neighbouring discs do not touch
        # If the array surrounds the hand, do not draw the near side, which would hide it.
        "backs": length > 0.3,
        "sheets": [sheet.tolist() for sheet in sheets],
        "foci": [],
        "paths": [],
        "most": 1.0,
        "views": {
            "first": {
                "middle": centre.tolist(),
                "reach": reach,
                "seen": np.radians([azimuth, elevation]).tolist(),
            },
            "foci": {"middle": middle.tolist()},
        },
    }
    return facts, numbers


class MovingSkin:
    """The skin of one hand, meshed in its first pose and then moved with the bones.

    Parameters
    ----------
    radii : (25,) radius of the skin around each joint [m]; None for a generic hand.

    Attributes
    ----------
    triangles : (T, 3) indices of the vertices of each triangle; empty before the first
        pose.
    count : number of times that the skin has been meshed.
    """

    def __init__(self, radii: Float64[np.ndarray, "25"] | None) -> None:
        self._given_radii = radii
        self._first: tuple[Hulls, HandMesh, Float64[np.ndarray, "vertices hulls"]] | None = None
        self._length = 0.0
        self.triangles = np.zeros((0, 3), dtype=np.int64)
        self.count: int = 0

    def at(self, joints: Joints) -> Vertices:
        """Return the vertices (V, 3) [m] of the skin of a hand with the given joints."""
        length = hand_length(joints)
        # If the hand's length has changed by a tenth, it is another person's hand: mesh it again.
        if self._first is None or abs(length / self._length - 1.0) > 0.1:
            self._radii = radii_of(self._given_radii, None, joints)
            self._length = length
            hulls, _ = hand_hulls(joints, self._radii)
            # Edges of 5 mm exceed half a wavelength, but shorter ones slow down software renderers.
            mesh = even_skin(hulls, 5e-3)
            self._first = hulls, mesh, hull_weights(hulls, mesh.vertices)
            self.triangles = mesh.triangles
            self.count += 1
        now, _ = hand_hulls(joints, self._radii)
        before, mesh, weights = self._first
        return now.project(moved_with_hulls(before, now, mesh.vertices, weights))
