"""The function of a sweep over a scene file."""

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import msgspec
import numpy as np

from airtact.acoustics.solvers.bem.solver import BoundaryElement
from airtact.errors import (
    LARGEST_MESH_FILE,
    LARGEST_SCENE_FILE,
    InvalidInput,
    NotConverged,
    about,
)
from airtact.files.bounded import bytes_of, text_of
from airtact.hands.files import load_hand
from airtact.hands.tracking.recordings import Recording, load_recording
from airtact.setup import tables
from airtact.setup.bodies import pose_of
from airtact.setup.building import read_scene
from airtact.setup.parsing import Value, parse_scene
from airtact.setup.setup import Setup
from airtact.setup.solving import (
    control_drive,
    memory_of_a_solve,
    named,
    solve_foci,
    synthesise,
    unknowns_of,
)
from airtact.timing import Clock

# Columns of a frame of a recording: its number, the side, the tracker's time [s]
FRAME_COLUMNS = ("frame", "side", "time")

# Codes of faults of the paths of a point
PATH_FAULTS = ("unknown_key", "key_misplaced", "given_twice")


@dataclass(frozen=True)
class ScenePoints:
    """Makes the drive of a scene file at a point, and returns the pressure at its foci.

    A point has a value for each path of a key, and the columns of a frame where the hand is that of
    a recording.

    Attributes
    ----------
    scene : the file.
    recording : of the hand, or None.
    content : digests of both files and of those that the scene file names. They identify the
        results; the paths do not.
    """

    scene: Path = field(compare=False)
    recording: Path | None = field(default=None, compare=False)
    content: tuple[str, ...] = ()

    def __call__(self, point: Mapping[str, Value]) -> dict[str, Value]:
        """Return the peak pressure at each focus, the gain over the control, and the solve."""
        # Foci without a weight ask for nothing, so they do not count as the weakest.
        setup = self.setup(point)
        transfer, report = solve_foci(setup, Clock())
        drive, stalled = synthesise(setup.synthesise, transfer, setup.target)
        weights = setup.target.weights
        asked = np.flatnonzero(weights > 0.0)
        pressures = np.abs(transfer.pressure(drive))[: len(weights)]
        weakest = asked[np.argmin(pressures[asked] / weights[asked])]

        gain = None
        control = control_drive(setup, setup.synthesise)
        if control is not None:
            # As a render compares: at full scale where the drive is there, else at its energy.
            held_equal = "peak" if drive.is_full_scale else "energy"
            at_control = np.abs(transfer.pressure(control))[asked] / weights[asked]
            factor = control.factor_to_match(drive, held_equal)
            gain = float(pressures[weakest] / weights[weakest] / (factor * at_control.min()))
        # Foci may share a name, and columns may not.
        words = [name.replace(" ", "_") for name in setup.foci]
        columns = [
            f"{word}_{index + 1}" if words.count(word) > 1 else word
            for index, word in enumerate(words)
        ]
        return {
            **{
                f"{column}_Pa": float(pressure)
                for column, pressure in zip(columns, pressures, strict=True)
            },
            "weakest_Pa": float(pressures[weakest]),
            "gain": gain,
            "unknowns": report.nodes,
            "estimated_error": float(report.estimated_error),
            "warnings": "; ".join([*stalled, *named(report.warnings, setup.bodies)]),
        }

    def setup(self, point: Mapping[str, Value]) -> Setup:
        """Build the setup of a point."""
        if self.recording is None:
            return read_scene(self.scene, point)
        changes = {path: value for path, value in point.items() if path not in FRAME_COLUMNS}
        with _hand_of_frame(self.scene, self.recording, point) as posed:
            return read_scene(self.scene, posed | changes)

    def memory(self, points: Sequence[Mapping[str, Value]]) -> float:
        """Estimate the memory of a solve from the first, the middle and the last point [bytes].

        Raise the fault of a path that leads nowhere, or of the points if none can be built.
        """
        read_scene(self.scene)
        needed = 1.2e8  # of a process that has loaded airtact and solves nothing
        faults = []
        # Size varies along an axis if at all, so its ends and middle bound it well enough.
        for index in sorted({0, len(points) // 2, len(points) - 1}):
            try:
                setup = self.setup(points[index])
                if isinstance(setup.solver, BoundaryElement):
                    unknowns = unknowns_of(setup.solver, setup.scene, setup.target.points)
                    needed = max(needed, memory_of_a_solve(unknowns, setup.accuracy))
            except (InvalidInput, NotConverged) as fault:
                if fault.code in PATH_FAULTS:
                    raise
                faults.append(fault)
        if len(faults) == len(points):
            raise faults[0]
        return needed


def scene_points(scene: Setup | str | Path, recording: Path | None = None) -> ScenePoints:
    """Return the function of a sweep over a scene file, and over the frames of a recording.

    Raises
    ------
    InvalidInput
        A file cannot be read, the scene does not have one hand for a recording, or the setup has no
        scene file.
    """
    if isinstance(scene, Setup):
        if scene.path is None:
            raise InvalidInput(
                "a setup without a scene file has no keys to vary: give a function instead.",
                code="wrong_kind",
            )
        scene = scene.path
    scene = Path(scene)
    files = [scene, *_files_named(scene)]
    if recording is not None:
        _hand_key(scene)
        files.append(recording)
    # Results are kept by content: a file that was moved or renamed gives the same ones.
    content = tuple(hashlib.blake2b(bytes_of(file), digest_size=20).hexdigest() for file in files)
    return ScenePoints(scene, recording, content)


def frames_of(recording: Path) -> list[dict[str, Value]]:
    """Return a point for each frame of a recording in which a hand is seen."""
    return [
        dict(zip(FRAME_COLUMNS, (frame.sequence, frame.side, frame.time), strict=True))
        for frame in _recorded(recording).frames
        if frame.landmarks is not None
    ]


def _scene_file(scene: Path) -> tables.SceneFile:
    with about(scene.name):
        return parse_scene(text_of(scene, LARGEST_SCENE_FILE))


def _files_named(scene: Path) -> Iterator[Path]:
    """Find the files that a scene file names, and those that a glTF file among them names."""
    # Any text of the file may name one; what is no file is not read.
    for word in dict.fromkeys(_words(msgspec.to_builtins(_scene_file(scene)))):
        file = scene.parent / word
        if "\0" in word or len(word) > 255 or not file.is_file():
            continue
        yield file
        if file.suffix.lower() == ".gltf":
            content = json.loads(bytes_of(file, LARGEST_MESH_FILE))
            for buffer in _words(content.get("buffers", [])):
                if not buffer.startswith("data:") and (file.parent / buffer).is_file():
                    yield file.parent / buffer


def _words(data: Any) -> Iterator[str]:
    if isinstance(data, str):
        yield data
    elif isinstance(data, dict):
        yield from _words(list(data.values()))
    elif isinstance(data, list | tuple):
        for value in data:
            yield from _words(value)


def _hand_key(scene: Path) -> tuple[str, Path]:
    """Find the key of the obstacle that is a hand, and the file of its pose."""
    hands = [
        (index, table.hand)
        for index, table in enumerate(_scene_file(scene).obstacles)
        if table.hand is not None
    ]
    if len(hands) != 1:
        raise InvalidInput(
            f'{scene.name}: {len(hands)} obstacles are a hand = "POSE.json", but a recording '
            "moves just 1.",
            code="unknown_key",
        )
    index, pose = hands[0]
    return f"obstacles[{index}]", scene.parent / pose


@contextmanager
def _hand_of_frame(
    scene: Path, recording: Path, point: Mapping[str, Value]
) -> Iterator[dict[str, Value]]:
    """Write the hand of a frame to a file, and yield the keys that replace the scene's hand.

    It keeps the radii of the scene's hand; the gap and the pose that the scene gives its own hand
    are left out.
    """
    number, side, _ = (point[column] for column in FRAME_COLUMNS)
    frames = [
        frame
        for frame in _recorded(recording).frames
        if frame.sequence == number and frame.side == side and frame.landmarks is not None
    ]
    if not frames:
        raise InvalidInput(f"there is no frame {number} of the {side} hand.", code="unknown_name")
    key, pose = _hand_key(scene)
    frame = frames[0].moved(pose_of(_scene_file(scene).tracker or tables.PoseTable()))
    hand = frame.hand(load_hand(pose).radii)
    content = {
        "positions_m": hand.joints.tolist(),
        "radii_m": hand.radii.tolist(),
        "side": hand.side,
    }
    # A scene file names the hand by a file, so the frame's hand becomes one.
    with TemporaryDirectory() as folder:
        file = Path(folder) / f"frame_{frame.sequence}.json"
        file.write_text(json.dumps(content), encoding="utf-8")
        yield {f"{key}.hand": str(file), f"{key}.gap": None, f"{key}.pose": None}


@lru_cache(maxsize=1)
def _recorded(recording: Path) -> Recording:
    return load_recording(recording, leave_out=True)
