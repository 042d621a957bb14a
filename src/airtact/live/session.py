"""The session file of a run, ``session.h5``: written while the loop runs and read afterwards."""

import subprocess
import sys
import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from threading import Event, Thread
from typing import Any, cast, get_args

import numpy as np
from jaxtyping import Bool, Complex64, Float64

from airtact.acoustics.medium import Medium
from airtact.acoustics.planes import plane
from airtact.errors import InvalidInput, about, file_fault, fixed, in_short
from airtact.hands.joints import joints_of
from airtact.hands.tracking.frame import HandFrame
from airtact.hands.tracking.recordings import Recording
from airtact.hands.tracking.stream import StreamHealth
from airtact.live.moment import Moment, Rule, State
from airtact.live.scene import LiveScene
from airtact.live.worker import dump
from airtact.transducers.element import Element
from airtact.transducers.layout import PhasedArray
from airtact.transducers.modulation import AmplitudeModulation

# File name in the folder of a session.
FILE = "session.h5"

# The file stores rules and states by their index.
RULES: tuple[Rule, ...] = get_args(Rule)
STATES: tuple[State, ...] = get_args(State)


@dataclass(frozen=True, eq=False)
class Session:
    """Contents of a session file.

    Attributes
    ----------
    scene : the fixed part of the scene.
    text : the scene file.
    amplitudes : (N, E) amplitudes of N drives, as shares of full scale.
    time_in_air : (N,) time at which each drive reached the link, on the clock of the frames [s].
    drive_frame_time : (N,) timestamp of the newest frame that each drive used [s].
    rules, states : (N,) basis of each drive, and state of the loop.
    kept : (N,) expected share of the attainable pressure; NaN if unknown.
    shape_age : (N,) age of the solution used by each drive [s]; NaN without a solution.
    foci : (N, F, 3) predicted foci [m]; NaN if the hand was lost.
    joints : (N, 25, 3) predicted joints of the hand [m]; NaN if it was lost.
    frame_time : (M,) timestamps of the tracker's frames [s].
    landmarks : (M, 25, 3) landmarks in scene coordinates [m]; NaN if the hand was lost.
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
        """Mask (N,) of the drives that are neither silent nor fading."""
        return (np.array(self.states) == "playing") & self.amplitudes.any(axis=1)


class SessionWriter:
    """Writes a session while it runs; ``frame`` and ``drive`` return at once.

    A separate process appends the rows, so that a slow disk does not delay the loop and a killed
    loop does not damage the file.

    Parameters
    ----------
    path : file to write; an existing one is replaced.
    scene : the fixed part of the scene.
    text : the scene file's text.

    Raises
    ------
    OSError
        If the file cannot be written.
    """

    def __init__(self, path: Path, scene: LiveScene, text: str = "") -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.open("wb").close()
        self.path = path
        self.dropped: int = 0
        self._foci = len(scene.places)
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
            target=self._send, args=(_header(scene, text),), name="airtact session", daemon=True
        )
        self._thread.start()

    def frame(self, frame: HandFrame) -> None:
        """Record a frame of the hand, in scene coordinates."""
        landmarks = None if frame.landmarks is None else joints_of(frame.landmarks)
        self._take("frames", {"time": frame.time, "landmarks": landmarks})

    def drive(self, moment: Moment, time_in_air: float) -> None:
        """Record a drive that reached the link at a time of the frames' clock [s]."""
        self._take(
            "drives",
            {
                "amplitudes": moment.amplitudes.astype(np.complex64),
                "time_in_air": time_in_air,
                "frame_time": moment.frame_time,
                "rule": RULES.index(moment.rule),
                "state": STATES.index(moment.state),
                "kept": moment.kept,
                "shape_age": moment.shape_age,
                "foci": moment.foci,
                "joints": moment.joints,
            },
        )

    def close(self) -> None:
        """Write the remaining rows and close the file.

        Raises
        ------
        OSError
            If rows could not be written, for example on a full disk.
        """
        self._done.set()
        self._thread.join()
        fault = self._process.communicate()[1]
        if self._process.returncode:
            reason = fault.decode(errors="replace").strip().rpartition("\n")[2]
            raise OSError(None, f"the file is incomplete: {reason}", str(self.path))

    def _take(self, group: str, row: dict[str, Any]) -> None:
        if len(self._rows) >= 4096:  # half a minute of drives: the disk is too slow
            self.dropped += 1
        else:
            self._rows.append((group, row))

    def _send(self, header: dict[str, Any]) -> None:
        """Send the rows to the writer in a thread, so that a full pipe does not delay the loop."""
        pipe = self._process.stdin
        assert pipe is not None
        try:
            dump(header, pipe)
            while True:
                last = self._done.wait(0.1)
                rows = [self._rows.popleft() for _ in range(len(self._rows))]
                if rows:
                    dump(self._columns(rows), pipe)
                if last and not self._rows:
                    break
        except OSError:  # the writer ended; ``close`` reports why
            self._rows.clear()

    def _columns(self, rows: list[tuple[str, dict[str, Any]]]) -> dict[str, Any]:
        """Stack rows into the columns to append; unknown values become NaN."""
        shapes = {"foci": (self._foci, 3), "joints": (25, 3), "landmarks": (25, 3)}
        types = {"rule": np.uint8, "state": np.uint8}
        columns = {}
        for group in ("frames", "drives"):
            of_group = [row for name, row in rows if name == group]
            for key in of_group[0] if of_group else []:
                unknown = np.full(shapes.get(key, ()), np.nan)
                values = [unknown if row[key] is None else row[key] for row in of_group]
                columns[f"+{group}/{key}"] = np.array(values, dtype=types.get(key))
        return columns


def _header(scene: LiveScene, text: str) -> dict[str, Any]:
    array = scene.array
    element = array.element
    attributes: dict[str, Any] = {
        "format": "airtact session",
        "format_version": 2 if scene.planes else 1,
        "frequency": scene.frequency,
        "sound_speed": scene.medium.sound_speed,
        "density": scene.medium.density,
        "absorption": scene.medium.absorption,
        "side": scene.side,
        "places": list(scene.places),
        "offsets": np.asarray(scene.offsets),
        "method": scene.method,
        "rules": list(RULES),
        "states": list(STATES),
        "modulation": np.zeros(0),
        "sensitivity": element.sensitivity,
        "directional": element.directional,
        "radius": element.radius,
    }
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
        # A session without frames or drives has these columns, too.
        "+frames/time": np.zeros(0),
        "+frames/landmarks": np.zeros((0, 25, 3)),
        "+drives/amplitudes": np.zeros((0, len(array)), dtype=np.complex64),
        "+drives/time_in_air": np.zeros(0),
        "+drives/frame_time": np.zeros(0),
    }
    if scene.radii is not None:
        header["hand/radii"] = np.asarray(scene.radii)
    return header


def read_session(path: str | Path) -> Session:
    """Read a session, even if its loop was killed.

    Parameters
    ----------
    path : ``session.h5``, or the folder that holds it.

    Raises
    ------
    InvalidInput
        If the file cannot be read, is no session, or has a newer version; the message begins with
        its name.
    """
    with _opened(path) as file:
        drives = file["drives"]
        frames = file["frames"]
        # A killed loop can leave the last column longer than the others.
        count = len(drives["time_in_air"])
        shapes = {"foci": (len(file.attrs["places"]), 3), "joints": (25, 3)}
        rules = [str(rule) for rule in file.attrs["rules"]]
        states = [str(state) for state in file.attrs["states"]]

        def column(name: str) -> Any:
            if name in drives:
                return drives[name][:count]
            return np.zeros((0, *shapes.get(name, ())))  # a session without drives

        return Session(
            scene=_scene_in(file),
            text=file["scene"].asstr()[()],
            amplitudes=drives["amplitudes"][:count],
            time_in_air=column("time_in_air"),
            drive_frame_time=column("frame_time"),
            rules=tuple(cast(Rule, rules[index]) for index in column("rule").astype(int)),
            states=tuple(cast(State, states[index]) for index in column("state").astype(int)),
            kept=column("kept"),
            shape_age=column("shape_age"),
            foci=column("foci"),
            joints=column("joints"),
            frame_time=frames["time"][:],
            landmarks=frames["landmarks"][:],
        )


def recording_of(path: str | Path) -> Recording:
    """Read the frames of a session as a recording, in scene coordinates.

    Parameters
    ----------
    path : ``session.h5``, or the folder that holds it.

    Raises
    ------
    InvalidInput
        As ``read_session``, or if the session has no frame.
    """
    session = read_session(path)
    if not len(session.frame_time):
        raise InvalidInput(
            f"{Path(path).name} has no frames: record one with a hand.", code="empty"
        )
    frames = [
        HandFrame(time, session.scene.side, index, joints if np.isfinite(joints).all() else None)
        for index, (time, joints) in enumerate(
            zip(session.frame_time.tolist(), session.landmarks, strict=True)
        )
    ]
    return Recording(tuple(frames), StreamHealth(received=len(frames), used=len(frames)))


@contextmanager
def _opened(path: str | Path) -> Iterator[Any]:
    """Open a session file, or the one in a folder, and convert errors to ``InvalidInput``."""
    path = Path(path)
    path = path / FILE if path.is_dir() else path
    with about(path.name):
        try:
            with _unlocked(path) as file:
                version = int(cast(int, file.attrs["format_version"]))
                if version > 2:
                    raise InvalidInput(
                        f"its version is {version}, newer than 2: update airtact to read it.",
                        code="unsupported_version",
                    )
                yield file
        except OSError as error:
            if error.errno is not None:
                raise file_fault(path, error) from None
            raise InvalidInput(f"this is no HDF5 file: {error}.", code="wrong_kind") from None
        except KeyError as error:
            raise InvalidInput(
                f"this is no session, because an entry is missing: {error}.", code="wrong_kind"
            ) from None


def _unlocked(path: Path) -> Any:
    """Open an HDF5 file, and wait up to 10 s while another process has it locked."""
    import h5py

    # The process that writes a session can end seconds after its loop on a busy machine.
    end = time.monotonic() + 10.0
    while True:
        try:
            return h5py.File(path, "r")
        except BlockingIOError:
            if time.monotonic() > end:
                raise
            time.sleep(0.25)


def _scene_in(file: Any) -> LiveScene:
    attributes = file.attrs
    array = file["array"]
    element = Element(
        array["face_points"][:],
        array["face_weights"][:],
        float(attributes["sensitivity"]),
        bool(attributes["directional"]),
        float(attributes["radius"]),
    )
    modulation = [float(number) for number in attributes["modulation"]]
    return LiveScene(
        medium=Medium(
            float(attributes["sound_speed"]),
            float(attributes["density"]),
            float(attributes["absorption"]),
        ),
        frequency=float(attributes["frequency"]),
        array=PhasedArray(
            array["positions"][:],
            array["normals"][:],
            element,
            array["tangents"][:],
            array["gains"][:],
        ),
        side="left" if attributes["side"] == "left" else "right",
        radii=fixed(file["hand/radii"][:]) if "hand/radii" in file else None,
        places=tuple(str(place) for place in attributes["places"]),
        offsets=fixed(attributes["offsets"]),
        method=str(attributes["method"]),
        modulation=AmplitudeModulation(*modulation) if modulation else None,
        planes=tuple(plane(point, normal) for point, normal in attributes.get("planes", [])),
    )
