"""What the foci of a scene get where some keys of its file have other values."""

import hashlib
import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import msgspec
import numpy as np

from airtact.drives.drive import Drive
from airtact.drives.transfer import TransferMatrix
from airtact.errors import LARGEST_MESH_FILE, LARGEST_SCENE_FILE, InvalidInput, about
from airtact.files.bounded import bytes_of, text_of
from airtact.geometry.pose import Pose
from airtact.hands.files import load_hand
from airtact.hands.tracking.recordings import Recording, load_recording
from airtact.setup import tables
from airtact.setup.bodies import pose_of
from airtact.setup.building import read_scene
from airtact.setup.changes import Value
from airtact.setup.parsing import parse_scene
from airtact.setup.setup import Setup
from airtact.setup.solving import control_drive, named, solve_foci, synthesise
from airtact.setup.sweeping.rows import Row
from airtact.timing import Clock

FRAME, SIDE, TIME = "frame", "side", "time"
"""Columns of a point that is a frame of a recording: its number, which hand, and the tracker's time [s]."""


@dataclass(frozen=True)
class ScenePoint:
    """The function of a sweep over a scene file: makes the drive for a point and returns what the foci get.

    A point has a value for each path of a key, and `FRAME` and `SIDE` where the hand is that of a
    recording.

    Attributes
    ----------
    scene : the file.
    recording : of the hand, or None.
    content : digests of both files and of those that the scene file names. They name the results,
        not the paths.
    """

    scene: Path = field(compare=False)
    recording: Path | None = field(default=None, compare=False)
    content: tuple[str, ...] = ()

    def __call__(self, point: Row) -> Row:
        """Solve, make the drive, and evaluate it and the one that ignores the bodies.

        Returns
        -------
        The peak pressure at each focus, at the weakest of them, ``gain``, ``unknowns``, ``estimated_error`` and
        ``warnings``. The pressures are those of the solution that the drive is made from.
        """
        setup = self.setup(point)
        transfer, report = solve_foci(setup, Clock())
        drive, notes = synthesise(setup.synthesise, transfer, setup.target)
        count, weights = len(setup.foci), setup.target.weights
        pressures = np.abs(transfer.pressure(drive))[:count]
        asked = np.flatnonzero(weights > 0.0)
        weakest = asked[np.argmin(pressures[asked] / weights[asked])]
        columns = {
            f"{name}_Pa": float(got)
            for name, got in zip(_distinct(setup.foci), pressures, strict=True)
        }
        return {
            **columns,
            "weakest_Pa": float(pressures[weakest]),
            "gain": _gain(setup, transfer, drive),
            "unknowns": report.nodes,
            "estimated_error": float(report.estimated_error),
            "warnings": "; ".join([*notes, *named(report.warnings, setup.bodies)]),
        }

    def setup(self, point: Mapping[str, Value]) -> Setup:
        """Build the scene of a point."""
        if self.recording is None:
            return read_scene(self.scene, point)
        changes = {path: value for path, value in point.items() if path not in (FRAME, SIDE, TIME)}
        with _hand_of_frame(self.scene, self.recording, point) as posed:
            return read_scene(self.scene, posed | changes)


def scene_point(scene: Path, recording: Path | None = None) -> ScenePoint:
    """Return the function of a sweep over a scene file, and over the frames of a recording.

    Raises
    ------
    InvalidInput
        A file cannot be read, or the scene does not have one hand for a recording.
    """
    files = [scene, *_files_named(scene)]
    if recording is not None:
        _hand_key(scene)
        files.append(recording)
    content = tuple(hashlib.blake2b(bytes_of(file), digest_size=20).hexdigest() for file in files)
    return ScenePoint(scene, recording, content)


def frames_of(recording: Path) -> list[Row]:
    """Return a point for each frame of a recording in which a hand is seen."""
    frames = _recorded(recording).frames
    return [
        {FRAME: one.sequence, SIDE: one.side, TIME: one.time}
        for one in frames
        if one.landmarks is not None
    ]


def _gain(setup: Setup, transfer: TransferMatrix, drive: Drive) -> float | None:
    """Divide what the weakest focus gets by what the same method gives it that ignores the bodies; None without any.

    At full scale both drives have their strongest element there; below, where no more is asked,
    they have one energy.
    """
    control = control_drive(setup, setup.synthesise)
    if control is None:
        return None
    weights = setup.target.weights
    asked = weights > 0.0

    def weakest(emitted: Drive) -> float:
        pressures = np.abs(transfer.pressure(emitted))[: len(weights)]
        return float((pressures[asked] / weights[asked]).min())

    held_equal = "peak" if drive.is_full_scale else "energy"
    return weakest(drive) / (weakest(control) * control.factor_to_match(drive, held_equal))


def _distinct(names: tuple[str, ...]) -> list[str]:
    """Return names for columns, numbered where they are there twice."""
    words = [name.replace(" ", "_") for name in names]
    return [
        f"{word}_{index + 1}" if words.count(word) > 1 else word for index, word in enumerate(words)
    ]


def _data(scene: Path) -> dict[str, Any]:
    """Decode a scene file that is a right one."""
    text = text_of(scene, LARGEST_SCENE_FILE)
    with about(scene.name):
        parse_scene(text)
    return msgspec.toml.decode(text.encode())


def _files_named(scene: Path) -> Iterator[Path]:
    """Find the files that a scene file names, and those that a glTF file among them names."""
    for word in dict.fromkeys(_words(_data(scene))):
        file = scene.parent / word
        if "\0" in word or len(word) > 255 or not file.is_file():
            continue
        yield file
        if file.suffix.lower() == ".gltf":
            whole = json.loads(bytes_of(file, LARGEST_MESH_FILE))
            others = [
                file.parent / one
                for one in _words(whole.get("buffers", []))
                if not one.startswith("data:")
            ]
            yield from (one for one in others if one.is_file())


def _words(data: Any) -> Iterator[str]:
    if isinstance(data, str):
        yield data
    elif isinstance(data, dict | list):
        for value in data.values() if isinstance(data, dict) else data:
            yield from _words(value)


def _hand_key(scene: Path) -> tuple[str, Path]:
    """Find the obstacle of the scene that is a hand, and the file of its pose."""
    with about(scene.name):
        data = _data(scene)
        bodies = parse_scene(text_of(scene, LARGEST_SCENE_FILE)).obstacles
        hands = [
            index for index, one in enumerate(bodies) if isinstance(one.body, tables.HandTable)
        ]
        if len(hands) != 1:
            raise InvalidInput(
                f'{len(hands)} obstacles are a hand = "POSE.json", but a recording moves just 1.',
                code="unknown_key",
            )
    return f"obstacles[{hands[0]}]", scene.parent / data["obstacles"][hands[0]]["hand"]


@contextmanager
def _hand_of_frame(
    scene: Path, recording: Path, point: Mapping[str, Value]
) -> Iterator[dict[str, Value]]:
    """Write the hand of a frame to a file, and yield the keys that put it in the place of the scene's hand.

    It keeps the radii of the scene's hand; the gap and the pose that the scene gives its own hand
    are left out.
    """
    body, pose = _hand_key(scene)
    found = [
        one
        for one in _recorded(recording).frames
        if one.sequence == point[FRAME] and one.side == point[SIDE] and one.landmarks is not None
    ]
    if not found:
        raise InvalidInput(
            f"there is no frame {point[FRAME]} of the {point[SIDE]} hand.", code="unknown_name"
        )
    frame = found[0].moved(_tracker(scene))
    hand = frame.hand(load_hand(pose).radii)
    whole = {"positions_m": hand.joints.tolist(), "radii_m": hand.radii.tolist(), "side": hand.side}
    with TemporaryDirectory() as folder:
        file = Path(folder) / f"frame_{frame.sequence}.json"
        file.write_text(json.dumps(whole), encoding="utf-8")
        yield {f"{body}.hand": str(file), f"{body}.gap": None, f"{body}.pose": None}


def _tracker(scene: Path) -> Pose:
    table = parse_scene(text_of(scene, LARGEST_SCENE_FILE)).tracker
    return pose_of(tables.PoseTable() if table is None else table)


@lru_cache(maxsize=1)
def _recorded(recording: Path) -> Recording:
    return load_recording(recording, leave_out=True)
