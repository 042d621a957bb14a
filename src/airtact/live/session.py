"""A session: what the live loop did, in ``session.h5``, written while it runs and read afterwards."""

import pickle
import struct
import subprocess
import sys
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from threading import Event, Thread
from typing import Any, cast, get_args

import numpy as np
from jaxtyping import Bool, Complex64, Float64

from airtact.acoustics.medium import Medium
from airtact.acoustics.planes import plane
from airtact.checks import file_fault, fixed
from airtact.errors import InvalidInput, about
from airtact.hands.joints import Side, joints_of
from airtact.hands.tracking.frame import HandFrame
from airtact.hands.tracking.recordings import Recording
from airtact.hands.tracking.stream import StreamHealth
from airtact.live.parts import LiveScene, Moment, Rule, State
from airtact.printing import in_short
from airtact.transducers.element import Element
from airtact.transducers.layout import PhasedArray
from airtact.transducers.modulation import AmplitudeModulation

FILE = "session.h5"
"""Name of the file in the folder of a session."""

VERSION = 2
"""Version of its format, in the attribute ``format_version``; sessions without a plane have the version 1."""

RULES: tuple[Rule, ...] = get_args(Rule)
STATES: tuple[State, ...] = get_args(State)
"""What ``drives/rule`` and ``drives/state`` hold the indices of."""

MOST_WAITING = 4096
"""Rows that wait for the writer at most; further ones are dropped and counted."""

PAUSE = 0.1
"""How long the thread waits between two messages to the writer [s]."""


@dataclass(frozen=True, eq=False)
class Session:
    """What a session file holds.

    Attributes
    ----------
    scene : what stayed the same.
    text : the scene file.
    amplitudes : (N, E) of N drives, share of full scale.
    time_in_air : (N,) when each reached the link, on the clock of the frames [s].
    drive_frame_time : (N,) time in the newest frame that each used [s].
    rules, states : (N,) what each was made from, and what the loop did then.
    kept : (N,) expected share of the attainable pressure; NaN where it is not known.
    shape_age : (N,) age of the solution that each was made from [s]; NaN without.
    foci : (N, F, 3) where the foci were predicted [m]; NaN where the hand was lost.
    joints : (N, 25, 3) of the hand as predicted [m]; NaN where it was lost.
    frame_time : (M,) of the tracker's frames [s].
    landmarks : (M, 25, 3) in the scene's frame [m]; NaN where the hand was lost.
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

    __repr__ = in_short

    @property
    def playing(self) -> Bool[np.ndarray, "drives"]:
        """Which drives are neither silent nor fade, (N,)."""
        return (np.array(self.states) == "playing") & self.amplitudes.any(axis=1)


class SessionWriter:
    """Writes a session while it runs; ``frame`` and ``drive`` return at once.

    Parameters
    ----------
    path : the file, which is written anew.
    scene : what stays the same.
    text : the scene file's text.

    Raises
    ------
    OSError
        When the file cannot be written.
    """

    def __init__(self, path: Path, scene: LiveScene, text: str = "") -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.open("wb").close()
        self.path = path
        self.dropped: int = 0
        self._rows: deque[tuple[str, dict[str, Any]]] = deque()
        self._done = Event()
        self._process = subprocess.Popen(
            [sys.executable, "-m", "airtact.files.appending", str(path.resolve())],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            start_new_session=True,
        )
        self._thread = Thread(
            target=self._send, args=(_first(scene, text),), name="airtact session", daemon=True
        )
        self._thread.start()

    def frame(self, frame: HandFrame) -> None:
        """Take a frame of the hand, in the scene's frame."""
        landmarks = (
            np.full((25, 3), np.nan) if frame.landmarks is None else joints_of(frame.landmarks)
        )
        self._take("frames", {"time": frame.time, "landmarks": landmarks})

    def drive(self, moment: Moment, time_in_air: float) -> None:
        """Take a drive that reached the link at a time of the frames' clock [s]."""
        foci = len(moment.foci) if moment.foci is not None else 0
        self._take(
            "drives",
            {
                "amplitudes": moment.amplitudes.astype(np.complex64),
                "time_in_air": time_in_air,
                "frame_time": moment.frame_time,
                "rule": RULES.index(moment.rule),
                "state": STATES.index(moment.state),
                "kept": np.nan if moment.kept is None else moment.kept,
                "shape_age": np.nan if moment.shape_age is None else moment.shape_age,
                "foci": moment.foci if foci else None,
                "joints": moment.joints,
            },
        )

    def close(self) -> None:
        """Write what waits and close the file.

        Raises
        ------
        OSError
            When not all could be written, such as on a full disk.
        """
        self._done.set()
        self._thread.join()
        fault = self._process.communicate()[1]
        if self._process.returncode:
            reason = fault.decode(errors="replace").strip().rpartition("\n")[2]
            raise OSError(None, f"it was not written to its end: {reason}", str(self.path))

    def _take(self, group: str, row: dict[str, Any]) -> None:
        if len(self._rows) >= MOST_WAITING:
            self.dropped += 1
            return
        self._rows.append((group, row))

    def _send(self, first: dict[str, Any]) -> None:
        """Send what was taken, in a thread of its own: a pipe that is full holds up nothing else."""
        pipe = self._process.stdin
        assert pipe is not None
        foci = len(first["attributes"]["places"])
        try:
            _write(pipe, first)
            while True:
                last = self._done.wait(PAUSE)
                taken = [self._rows.popleft() for _ in range(len(self._rows))]
                if taken:
                    _write(pipe, _columns(taken, foci))
                if last and not self._rows:
                    break
        except OSError:  # the writer ended; ``close`` reports why
            self._rows.clear()


def _write(pipe: Any, message: dict[str, Any]) -> None:
    body = pickle.dumps(message, protocol=pickle.HIGHEST_PROTOCOL)
    pipe.write(struct.pack("<Q", len(body)) + body)
    pipe.flush()


def _columns(rows: Sequence[tuple[str, Mapping[str, Any]]], foci: int) -> dict[str, Any]:
    """Stack rows to the columns that are appended; foci and joints that are not known are NaN."""
    shapes, columns = {"foci": (foci, 3), "joints": (25, 3)}, {}
    for group in ("frames", "drives"):
        own = [row for name, row in rows if name == group]
        for key in own[0] if own else ():
            values = [np.full(shapes[key], np.nan) if row[key] is None else row[key] for row in own]
            kind = {"rule": np.uint8, "state": np.uint8}.get(key)
            columns[f"+{group}/{key}"] = np.array(values, dtype=kind)
    return columns


def _first(scene: LiveScene, text: str) -> dict[str, Any]:
    array, modulation = scene.array, scene.modulation
    element, medium = array.element, scene.medium
    attributes: dict[str, Any] = {
        "format": "airtact session",
        "format_version": VERSION if scene.planes else 1,
        "frequency": scene.frequency,
        "sound_speed": medium.sound_speed,
        "density": medium.density,
        "absorption": medium.absorption,
        "side": scene.side,
        "places": list(scene.places),
        "offsets": np.asarray(scene.offsets),
        "method": scene.method,
        "rules": list(RULES),
        "states": list(STATES),
        "modulation": np.array(
            [] if modulation is None else [modulation.frequency, modulation.depth]
        ),
        "sensitivity": element.sensitivity,
        "directional": element.directional,
        "radius": element.radius,
    }
    message: dict[str, Any] = {"attributes": attributes, "scene": text}
    for name, value in (
        *(("positions", array.positions), ("normals", array.normals), ("tangents", array.tangents)),
        *(
            ("gains", array.gains),
            ("face_points", element.points),
            ("face_weights", element.weights),
        ),
    ):
        message[f"array/{name}"] = np.asarray(value)
    if scene.planes:
        attributes["planes"] = np.array([[one.point, one.normal] for one in scene.planes])
    if scene.radii is not None:
        message["hand/radii"] = np.asarray(scene.radii)
    for name, columns in (
        ("frames", 25),
        ("drives", len(array)),
    ):  # so that an empty session has them, too
        message[f"+{name}/time" if name == "frames" else "+drives/time_in_air"] = np.zeros(0)
        key, kind = ("landmarks", np.float64) if name == "frames" else ("amplitudes", np.complex64)
        message[f"+{name}/{key}"] = np.zeros(
            (0, columns, 3) if name == "frames" else (0, columns), dtype=kind
        )
    message["+drives/frame_time"] = np.zeros(0)
    return message


def read_session(path: str | Path) -> Session:
    """Read a session, also one whose loop was killed.

    Parameters
    ----------
    path : ``session.h5``, or the folder that holds it.

    Raises
    ------
    InvalidInput
        The file cannot be read, is no session, or is of a newer version; the sentence begins with its name.
    """
    with _opened(path) as file:
        return _session_in(file)


def recording_of(path: str | Path) -> Recording:
    """Read the frames of a session as a recording, in the scene's frame; its drives are left alone.

    Parameters
    ----------
    path : ``session.h5``, or the folder that holds it.

    Raises
    ------
    InvalidInput
        As ``read_session``, or the session has no frame.
    """
    with _opened(path) as file:
        side = _side_in(file)
        times, landmarks = file["frames/time"][:], file["frames/landmarks"][:]
        if not len(times):
            raise InvalidInput(
                "0 frames are in this session: record one with a hand.", code="empty"
            )
        seen = np.isfinite(landmarks).all(axis=(1, 2))
        frames = [
            HandFrame(float(then), side, index, joints if there else None)
            for index, (then, joints, there) in enumerate(zip(times, landmarks, seen, strict=True))
        ]
    return Recording(tuple(frames), StreamHealth(received=len(frames), used=len(frames)))


@contextmanager
def _opened(path: str | Path) -> Iterator[Any]:
    """Open a session, or the one in a folder, and put what is wrong with it into a sentence."""
    import h5py

    path = Path(path)
    path = path / FILE if path.is_dir() else path
    with about(path.name):
        try:
            with h5py.File(path, "r") as file:
                version = int(cast(int, file.attrs["format_version"]))
                if version > VERSION:
                    raise InvalidInput(
                        f"its version is {version}, and this airtact reads up to {VERSION}.",
                        code="unsupported_version",
                    )
                yield file
        except OSError as error:
            if error.errno is not None:
                raise file_fault(path, error) from None
            raise InvalidInput(f"this is no HDF5 file: {error}.", code="wrong_kind") from None
        except KeyError as error:
            raise InvalidInput(
                f"this is no session: 1 entry is missing: {error}.", code="wrong_kind"
            ) from None


def _session_in(file: Any) -> Session:
    drives, frames = file["drives"], file["frames"]
    count, foci = len(drives["time_in_air"]), len(file.attrs["places"])
    empty = {"foci": (foci, 3), "joints": (25, 3)}  # what a session without a drive lacks

    def column(name: str) -> Any:
        return drives[name][:count] if name in drives else np.zeros((0, *empty.get(name, ())))

    return Session(
        scene=_scene_in(file),
        text=file["scene"].asstr()[()],
        amplitudes=drives["amplitudes"][:count],
        time_in_air=column("time_in_air"),
        drive_frame_time=column("frame_time"),
        rules=tuple(RULES[index] for index in column("rule").astype(int)),
        states=tuple(STATES[index] for index in column("state").astype(int)),
        kept=column("kept"),
        shape_age=column("shape_age"),
        foci=column("foci"),
        joints=column("joints"),
        frame_time=frames["time"][:],
        landmarks=frames["landmarks"][:],
    )


def _scene_in(file: Any) -> LiveScene:
    has, array = file.attrs, file["array"]
    element = Element(
        array["face_points"][:],
        array["face_weights"][:],
        float(has["sensitivity"]),
        bool(has["directional"]),
        float(has["radius"]),
    )
    fixed_array = PhasedArray(
        array["positions"][:], array["normals"][:], element, array["tangents"][:], array["gains"][:]
    )
    return LiveScene(
        medium=Medium(float(has["sound_speed"]), float(has["density"]), float(has["absorption"])),
        frequency=float(has["frequency"]),
        array=fixed_array,
        side=_side_in(file),
        radii=fixed(file["hand/radii"][:]) if "hand/radii" in file else None,
        places=tuple(str(place) for place in has["places"]),
        offsets=fixed(has["offsets"]),
        method=str(has["method"]),
        modulation=AmplitudeModulation(*map(float, has["modulation"]))
        if len(has["modulation"])
        else None,
        planes=tuple(plane(*one) for one in has["planes"]) if "planes" in has else (),
    )


def _side_in(file: Any) -> Side:
    return "left" if file.attrs["side"] == "left" else "right"
