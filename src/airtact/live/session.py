"""The file ``session.h5``, which is written while the loop runs and can be read afterwards."""

import os
import subprocess
import time
from collections import deque
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from threading import Event, Thread
from typing import Any, get_args

import numpy as np
from jaxtyping import Bool, Complex64, Float64

from airtact.acoustics.medium import Medium
from airtact.acoustics.scene import plane
from airtact.errors import (
    LARGEST_DATA,
    InvalidInput,
    about,
    check_choice,
    check_finite,
    check_frequency,
    fixed,
    in_short,
    of_kind,
    path_of,
)
from airtact.files.atomic import writable_folder
from airtact.files.bounded import datasets_of
from airtact.hands.hand import PLACES, Side
from airtact.hands.joints import joints_of
from airtact.hands.tracking.frame import HandFrame
from airtact.hands.tracking.recordings import Recording
from airtact.hands.tracking.stream import StreamHealth
from airtact.live.moment import MOST_CONTACTS, MOST_FOCI, Moment, Rule, State
from airtact.live.scene import SIDES, LiveScene
from airtact.live.worker import dump
from airtact.setup.bodies import unsided
from airtact.timing import start_python
from airtact.transducers.element import Element
from airtact.transducers.layout import PhasedArray
from airtact.transducers.levels import AmplitudeModulation

# Name of the session file in its folder.
FILE = "session.h5"

# The file stores each rule and state as an index into these tuples.
RULES: tuple[Rule, ...] = get_args(Rule)
STATES: tuple[State, ...] = get_args(State)


@dataclass(frozen=True, eq=False)
class Session:
    """Contents of a session file, which records a run of the live loop.

    ``read_session`` returns it. It contains N drives and M frames of the tracker. Positions are in
    scene coordinates, and times are on the clock of the frames.

    Attributes
    ----------
    scene : the part of the scene that does not change, as a ``LiveScene``.
    text : text of the scene file.
    amplitudes : (N, E) complex amplitudes of N drives as emitted, after the cap and fades, as
        fractions of full scale.
    time_in_air : (N,) time at which each drive took effect [s]: when it reached the link, or later
        if the link has a ``lead`` and the drive was sent ahead.
    drive_frame_time : (N,) timestamp of the newest frame that each drive used [s].
    rules, states : (N,) rule by which each drive was computed, and state of the live loop at that
        time, as in ``Moment.rule`` and ``Moment.state``.
    kept : (N,) expected fraction of the attainable pressure (``Moment.kept``); NaN where unknown.
    shape_age : (N,) age of the scattering solution that each drive used, as in ``Moment.shape_age``
        [s]; NaN if there was no solution.
    foci : (N, F, 3) predicted foci [m]; NaN where the hand was lost or a drive has fewer foci.
    joints : (N, 25, 3) predicted joints of the hand in WebXR order [m]; NaN where it was lost.
    frame_time : (M,) timestamps of the tracker's frames [s].
    landmarks : (M, 25, 3) joints in WebXR order in each frame [m]; NaN where the hand was lost.
    sides : (M,) "left" or "right" for the hand in each frame.
    strengths : (N, F) strengths of the foci, from 0 to 1; 1 if all are equal.
    contacts : (N, C, 3) points of the skin in contact with objects [m]; unused entries are NaN.
    depths : (N, C) depths in the objects at the points ``contacts`` [m]; unused entries are NaN.
    other : (N, 25, 3) predicted joints of the other hand [m]; NaN where it was not seen.
    """

    scene: LiveScene
    text: str
    amplitudes: Complex64[np.ndarray, "drives elements"]
    time_in_air: Float64[np.ndarray, "drives"]
    drive_frame_time: Float64[np.ndarray, "drives"]
    rules: tuple[Rule, ...]
    states: tuple[State, ...]
    kept: Float64[np.ndarray, "drives"]
    shape_age: Float64[np.ndarray, "drives"]
    foci: Float64[np.ndarray, "drives foci 3"]
    joints: Float64[np.ndarray, "drives 25 3"]
    frame_time: Float64[np.ndarray, "frames"]
    landmarks: Float64[np.ndarray, "frames 25 3"]
    sides: tuple[Side, ...]
    strengths: Float64[np.ndarray, "drives foci"]
    contacts: Float64[np.ndarray, "drives contacts 3"]
    depths: Float64[np.ndarray, "drives contacts"]
    other: Float64[np.ndarray, "drives 25 3"]

    __repr__ = in_short

    @property
    def playing(self) -> Bool[np.ndarray, "drives"]:
        """Mask (N,) of the drives that were neither silent nor fading."""
        return (np.array(self.states) == "playing") & self.amplitudes.any(axis=1)


class SessionWriter:
    """Writes the session of a run of the live loop to a file, which ``read_session`` reads.

    Pass the writer to ``follow``, which calls all its methods. ``frame`` records a frame of a
    tracker and ``drive`` a drive; both return at once, because a separate process writes the file.
    A slow disk therefore does not delay the loop, and a killed loop or a full disk does not damage
    the file. An existing file is replaced when the loop begins. The real and imaginary parts of
    amplitudes are rounded to multiples of a step, which is 1/15 to 1/7 of the largest amplitude in
    the drive. This changes the pressure at a focus by about 0.5 %. Landmarks are rounded to 1 µm;
    positions and depths that belong to a drive are rounded to 8 µm.

    Parameters
    ----------
    path : file to write, an HDF5 file such as ``session.h5``. Its folder is created if necessary,
        and locked against other writers until ``close``.
    scene : the parts of the scene that stay fixed during the run.
    text : text of the scene file, which is stored in the session.

    Attributes
    ----------
    dropped : number of frames and drives that were not recorded because the disk was too slow and
        4096 others were already waiting.
    fault : message that states why writing failed, and the time since the start of the loop after
        which nothing was recorded; None if there was no failure. Earlier data stay in the file, and
        later frames and drives are ignored; no exception is raised.

    Raises
    ------
    InvalidInput
        If the folder cannot be created or written to, or if another run is writing a session to a
        file in this folder.
    """

    def __init__(self, path: Path, scene: LiveScene, text: str = "") -> None:
        of_kind(scene, LiveScene, "the scene", "live_scene(setup)")
        self.path = path_of(path, "the path of a session")
        self.dropped: int = 0
        self.fault: str | None = None
        self._scene = scene
        self._text = text
        self._rows: deque[tuple[str, dict[str, Any]]] = deque()
        self._done = Event()
        self._begun = 0.0
        self._process: subprocess.Popen[bytes] | None = None
        self._lock = lock_folder(writable_folder(self.path.parent))

    def begin(self) -> None:
        """Create or replace the file; the live loop calls this once the boards are connected."""
        self._begun = time.monotonic()
        self._process = start_python(
            "-m",
            "airtact.files.appending",
            str(self.path.resolve()),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,  # HDF5 floods it if the disk is full
        )
        self._thread = Thread(
            target=self._send, args=(self._process,), name="airtact session", daemon=True
        )
        self._thread.start()

    def frame(self, frame: HandFrame) -> None:
        """Record a frame of a hand, in scene coordinates."""
        landmarks = None if frame.landmarks is None else joints_of(frame.landmarks)
        row = {"time": frame.time, "landmarks": landmarks}
        if self._scene.both:
            row["side"] = SIDES.index(frame.side)
        self._take("frames", row)

    def drive(self, moment: Moment, time_in_air: float) -> None:
        """Record a drive that reached the link at ``time_in_air`` on the frames' clock [s]."""
        row = {
            "amplitudes": moment.amplitudes.astype(np.complex64),
            "time_in_air": time_in_air,
            "frame_time": moment.frame_time,
            "rule": RULES.index(moment.rule),
            "state": STATES.index(moment.state),
            "kept": moment.kept,
            "shape_age": moment.shape_age,
            "foci": moment.foci,
            "joints": moment.joints,
        }
        if self._scene.both:
            row["foci"] = padded(moment.foci, (MOST_FOCI, 3))
            row["strengths"] = padded(moment.strengths, (MOST_FOCI,))
            row["contacts"] = padded(moment.contacts, (MOST_CONTACTS, 3))
            row["depths"] = padded(moment.depths, (MOST_CONTACTS,))
            row["other"] = moment.other
        self._take("drives", row)

    def close(self) -> None:
        """Write the remaining data and close the file; ``fault`` then describes missing data."""
        if self._process is None and self._rows:
            self.begin()
        self._done.set()
        if self._process is not None:
            # A disk that hangs must not prevent the program from ending.
            self._thread.join(30.0)
            self._process.kill()
            self._thread.join(5.0)
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    def _take(self, group: str, row: dict[str, Any]) -> None:
        if len(self._rows) >= 4096:  # half a minute of drives: the disk is too slow
            self.dropped += 1
        elif self.fault is None:
            self._rows.append((group, row))

    def _send(self, process: "subprocess.Popen[bytes]") -> None:
        """Send rows to the writing process from a thread, so that a full pipe delays nothing."""
        assert process.stdin is not None
        assert process.stdout is not None
        with suppress(OSError), process.stdin as pipe:  # the writing process may have ended
            dump(_header(self._scene, self._text), pipe)
            last = False
            while process.poll() is None and not (last and not self._rows):
                last = self._done.wait(0.1)
                rows = [self._rows.popleft() for _ in range(len(self._rows))]
                if rows:
                    dump(self._columns(rows), pipe)
        seconds = time.monotonic() - self._begun
        with process.stdout as answer:
            reason = answer.read().decode(errors="replace").strip().rstrip(".")
        if process.wait():
            reason = reason or "the process that writes it has ended"
            self.fault = f"nothing after {seconds:.0f} s: {reason}"
            self._rows.clear()

    def _columns(self, rows: list[tuple[str, dict[str, Any]]]) -> dict[str, Any]:
        """Stack rows into the columns to append; unknown values become NaN."""
        lengths = {
            "foci": (len(self._scene.places), 3),
            "joints": (25, 3),
            "landmarks": (25, 3),
            "other": (25, 3),
            "contacts": (MOST_CONTACTS, 3),
            "depths": (MOST_CONTACTS,),
        }
        types = {"rule": np.uint8, "state": np.uint8, "side": np.uint8}
        columns = {}
        for group in ("frames", "drives"):
            of_group = [row for name, row in rows if name == group]
            for key in of_group[0] if of_group else []:
                unknown = np.full(lengths.get(key, ()), np.nan)
                values = [unknown if row[key] is None else row[key] for row in of_group]
                column = np.array(values, dtype=types.get(key))
                if key == "amplitudes":
                    column = _rounded(column)
                elif key in lengths:
                    # Frames are replayed, whereas predicted joints are less accurate than 8 µm.
                    per_metre = 2.0**20 if group == "frames" else 2.0**17
                    column = (np.round(per_metre * column) / per_metre).astype(np.float32)
                columns[f"+{group}/{key}"] = column
        return columns


def padded(
    values: Float64[np.ndarray, "*some"] | None, shape: tuple[int, ...]
) -> Float64[np.ndarray, "*most"]:
    """Pad the first axis of ``values`` with NaN to the given shape."""
    filled = np.full(shape, np.nan)
    if values is not None:
        filled[: len(values)] = values
    return filled


def _rounded(amplitudes: Complex64[np.ndarray, "drives elements"]) -> np.ndarray:
    """Round amplitudes to about 1/8 of the largest in their drive, so that they compress well."""
    largest = np.abs(amplitudes).max(axis=1, keepdims=True, initial=1e-12)
    # Numbers with few binary digits compress best, so the steps are powers of two. Halving
    # the step would add 2 bits per amplitude to 8. The step must still be 1/8 if the largest
    # amplitude is slightly below 1.
    step = 2.0 ** np.floor(np.log2(1.07 * largest)) / 8.0
    rounded = np.round(np.real(amplitudes) / step) + 1j * np.round(np.imag(amplitudes) / step)
    return (step * rounded).astype(np.complex64)


def lock_folder(folder: Path) -> int | None:
    """Lock a folder until the returned file descriptor is closed.

    Returns
    -------
    The file descriptor, or None on systems without file locks.

    Raises
    ------
    InvalidInput
        If another run is recording into the folder.
    """
    try:
        import fcntl
    except ImportError:
        return None
    file = os.open(folder, os.O_RDONLY | os.O_CLOEXEC)
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(file)
        raise InvalidInput(
            f"another run is recording into {folder}: choose another folder.",
            code="not_writable",
        ) from None
    return file


def _header(scene: LiveScene, text: str) -> dict[str, Any]:
    array = scene.array
    element = array.element
    attributes: dict[str, Any] = {
        "format": "airtact session",
        "format_version": 3 if scene.both else 2 if scene.planes else 1,
        "frequency": scene.frequency,
        "sound_speed": scene.medium.sound_speed,
        "density": scene.medium.density,
        "absorption": scene.medium.absorption,
        "side": scene.side,
        "method": scene.method,
        "rules": list(RULES),
        "states": list(STATES),
        "modulation": np.zeros(0),
        "sensitivity": element.sensitivity,
        "directional": element.directional,
        "radius": element.radius,
    }
    if scene.places:
        attributes["places"] = list(scene.places)
        attributes["offsets"] = np.asarray(scene.offsets)
    if scene.both:
        attributes["both"] = True
    if scene.modulation is not None:
        attributes["modulation"] = np.array([scene.modulation.frequency, scene.modulation.depth])
    if scene.planes:
        attributes["planes"] = np.array([[wall.point, wall.normal] for wall in scene.planes])
    header: dict[str, Any] = {
        "attributes": attributes,
        "scene": text,
        "array/positions": np.asarray(array.positions),
        "array/normals": np.asarray(array.normals),
        "array/tangents": np.asarray(array.tangents),
        "array/gains": np.asarray(array.gains),
        "array/face_points": np.asarray(element.points),
        "array/face_weights": np.asarray(element.weights),
        # Sessions without any frame or drive need these columns as well.
        "+frames/time": np.zeros(0),
        "+frames/landmarks": np.zeros((0, 25, 3), dtype=np.float32),
        "+drives/amplitudes": np.zeros((0, len(array)), dtype=np.complex64),
        "+drives/time_in_air": np.zeros(0),
        "+drives/frame_time": np.zeros(0),
        "+drives/rule": np.zeros(0, dtype=np.uint8),
        "+drives/state": np.zeros(0, dtype=np.uint8),
        "+drives/kept": np.zeros(0),
        "+drives/shape_age": np.zeros(0),
        "+drives/foci": np.zeros((0, len(scene.places), 3), dtype=np.float32),
        "+drives/joints": np.zeros((0, 25, 3), dtype=np.float32),
    }
    if scene.both:
        header |= {
            "+frames/side": np.zeros(0, dtype=np.uint8),
            "+drives/foci": np.zeros((0, MOST_FOCI, 3), dtype=np.float32),
            "+drives/strengths": np.zeros((0, MOST_FOCI)),
            "+drives/contacts": np.zeros((0, MOST_CONTACTS, 3), dtype=np.float32),
            "+drives/depths": np.zeros((0, MOST_CONTACTS), dtype=np.float32),
            "+drives/other": np.zeros((0, 25, 3), dtype=np.float32),
        }
    if scene.radii is not None:
        header["hand/radii"] = np.asarray(scene.radii)
    return header


FRAME_LAYOUT = {
    "@format_version": "whole",
    "@format": "text",
    "@side": "text",
    "frames/time": "real *",
    "frames/landmarks": "real * 25 3",
    "frames/side": "optional whole *",
}

SESSION_LAYOUT = {
    **FRAME_LAYOUT,
    "@frequency": "real",
    "@sound_speed": "real",
    "@density": "real",
    "@absorption": "real",
    "@places": "optional text foci",
    "@offsets": "optional real foci",
    "@both": "optional whole",
    "@method": "text",
    "@modulation": "real *",
    "@planes": "optional real * 2 3",
    "@sensitivity": "real",
    "@directional": "whole",
    "@radius": "real",
    "scene": "text",
    "array/positions": "real elements 3",
    "array/normals": "real elements 3",
    "array/tangents": "real elements 3",
    "array/gains": "complex elements",
    "array/face_points": "real nodes 3",
    "array/face_weights": "real nodes",
    "hand/radii": "optional real 25",
    "@rules": "text *",
    "@states": "text *",
    "drives/amplitudes": "complex * elements",
    "drives/time_in_air": "real *",
    "drives/frame_time": "real *",
    "drives/rule": "whole *",
    "drives/state": "whole *",
    "drives/kept": "real *",
    "drives/shape_age": "real *",
    "drives/foci": "real * most 3",
    "drives/joints": "real * 25 3",
    "drives/strengths": "optional real * most",
    "drives/contacts": "optional real * touching 3",
    "drives/depths": "optional real * touching",
    "drives/other": "optional real * 25 3",
}


def read_session(path: str | Path) -> Session:
    """Read the file in which a live loop recorded its session, even if the loop was killed.

    Parameters
    ----------
    path : file ``session.h5``, or the folder that contains it.

    Returns
    -------
    A ``Session`` with the scene, the tracker's frames and the emitted drives, for example for
    ``verify_session``.

    Raises
    ------
    InvalidInput
        If the file cannot be read, is not a session, or was written by a newer version. The
        message begins with the name of the file.
    """
    raw = _read(path, SESSION_LAYOUT)
    with about(Path(path).name):
        for name in ("amplitudes", "time_in_air", "frame_time"):
            check_finite(raw[f"drives/{name}"], name)
        count = len(raw["drives/time_in_air"])
        columns = raw["drives/foci"].shape[1]
        places = len(raw.get("places", ()))
        if "both" not in raw and columns != places:
            raise InvalidInput(
                f"drives/foci has {columns} columns, but there are {places} places; write one "
                "column per place.",
                code="wrong_shape",
            )
        return Session(
            scene=_scene_of(raw),
            text=raw["scene"],
            amplitudes=raw["drives/amplitudes"].astype(np.complex64, copy=False),
            time_in_air=raw["drives/time_in_air"],
            drive_frame_time=raw["drives/frame_time"],
            rules=_words(raw, "rule"),
            states=_words(raw, "state"),
            kept=raw["drives/kept"],
            shape_age=raw["drives/shape_age"],
            foci=raw["drives/foci"],
            joints=raw["drives/joints"],
            frame_time=raw["frames/time"],
            landmarks=raw["frames/landmarks"],
            sides=_sides(raw),
            strengths=raw.get("drives/strengths", np.ones((count, columns))),
            contacts=raw.get("drives/contacts", np.zeros((count, 0, 3))),
            depths=raw.get("drives/depths", np.zeros((count, 0))),
            other=raw.get("drives/other", np.full((count, 25, 3), np.nan)),
        )


def recording_of(path: str | Path) -> Recording:
    """Read the frames of a session as a recording, in scene coordinates.

    Parameters
    ----------
    path : file ``session.h5``, or the folder that contains it.

    Returns
    -------
    A ``Recording`` of all hands that the live loop followed, which ``RecordedHands`` can replay.
    The frames are numbered from 0. Each contains the joints of one hand in WebXR order, or no
    joints if the hand was lost.

    Raises
    ------
    InvalidInput
        If the file cannot be read, is not a session, was written by a newer version, or contains no
        frames.
    """
    raw = _read(path, FRAME_LAYOUT)
    if not len(raw["frames/time"]):
        raise InvalidInput(
            f"{Path(path).name} contains no frames: record a session with a hand.", code="empty"
        )
    with about(Path(path).name):
        frames = [
            HandFrame(time, side, index, joints if np.isfinite(joints).all() else None)
            for index, (time, side, joints) in enumerate(
                zip(raw["frames/time"].tolist(), _sides(raw), raw["frames/landmarks"], strict=True)
            )
        ]
    return Recording(tuple(frames), StreamHealth(received=len(frames), used=len(frames)))


def _read(path: str | Path, layout: Mapping[str, str]) -> dict[str, Any]:
    """Read a session file, given its path or that of its folder."""
    path = path_of(path, "the path of a session")
    path = path / FILE if path.is_dir() else path
    # A session may last for hours, but a file that unpacks to far more bytes than this is damaged.
    largest = max(LARGEST_DATA, 16 * path.stat().st_size) if path.is_file() else LARGEST_DATA
    raw = datasets_of(path, layout, newest=3, largest=largest)
    with about(path.name):
        check_choice(raw["format"], "its format", ["airtact session"])
        check_choice(raw["side"], "the side of the hand", ["left", "right"])
    # If the loop was killed, the columns can have different lengths.
    for group in ("frames/", "drives/"):
        columns = [name for name in raw if name.startswith(group)]
        count = min((len(raw[name]) for name in columns), default=0)
        raw.update({name: raw[name][:count] for name in columns})
    return raw


def _sides(raw: Mapping[str, Any]) -> tuple[Side, ...]:
    """Return "left" or "right" for the hand in each frame."""
    count = len(raw["frames/time"])
    if "frames/side" not in raw:
        return (raw["side"],) * count
    return tuple(SIDES[index % 2] for index in raw["frames/side"].tolist())


def _words(raw: Mapping[str, Any], column: str) -> tuple[Any, ...]:
    """Look up the rule or state of each drive by its index in the file's list."""
    listed = raw[f"{column}s"]
    indices = raw[f"drives/{column}"]
    wrong = indices[(indices < 0) | (indices >= len(listed))]
    if len(wrong):
        raise InvalidInput(
            f"drives/{column} contains {wrong[0]}, but there are only {len(listed)} {column}s.",
            code="out_of_range",
        )
    return tuple(listed[index] for index in indices.tolist())


def _scene_of(raw: Mapping[str, Any]) -> LiveScene:
    places = tuple(raw.get("places", ()))
    for place in places:
        check_choice(unsided(place), "a place of a focus", PLACES)
    offsets = raw.get("offsets", np.zeros(0))
    if len(offsets) != len(places):
        raise InvalidInput(
            f"there are {len(places)} places but {len(offsets)} offsets; "
            "write one offset per place.",
            code="sizes_differ",
        )
    for name in ("offsets", "hand/radii"):
        check_finite(raw.get(name, np.zeros(0)), name)
    element = Element(
        raw["array/face_points"],
        raw["array/face_weights"],
        raw["sensitivity"],
        bool(raw["directional"]),
        raw["radius"],
    )
    modulation = raw["modulation"].tolist()
    if len(modulation) not in (0, 2):
        raise InvalidInput(
            f"modulation has {len(modulation)} numbers; use a frequency and a depth, or none.",
            code="wrong_shape",
        )
    return LiveScene(
        medium=Medium(raw["sound_speed"], raw["density"], raw["absorption"]),
        frequency=check_frequency(raw["frequency"]),
        array=PhasedArray(
            raw["array/positions"],
            raw["array/normals"],
            element,
            raw["array/tangents"],
            raw["array/gains"],
        ),
        side=raw["side"],
        radii=fixed(raw["hand/radii"]) if "hand/radii" in raw else None,
        places=places,
        offsets=fixed(offsets),
        both=bool(raw.get("both", 0)),
        method=raw["method"],
        modulation=AmplitudeModulation(*modulation) if modulation else None,
        planes=tuple(plane(point, normal) for point, normal in raw.get("planes", [])),
    )
