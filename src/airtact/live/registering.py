"""Pose of a tracker, fitted to touches of transducers whose positions are known."""

import queue
import re
import time
import tomllib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float64
from scipy.spatial.transform import Rotation

from airtact.errors import InvalidInput, in_mm, of_kind, path_of
from airtact.files.atomic import whole_file
from airtact.files.bounded import text_of
from airtact.geometry.pose import Pose
from airtact.hands.joints import GENERIC_RADII
from airtact.hands.tracking.frame import HandFrame
from airtact.hands.tracking.recordings import load_recording
from airtact.hands.tracking.registration import (
    INDEX_TIP,
    Registration,
    RestingFingertip,
    register,
)
from airtact.live.running import received
from airtact.setup.setup import Setup
from airtact.transducers.boards import board_named
from airtact.transducers.layout import PhasedArray


@dataclass(frozen=True)
class TouchStep:
    """Progress of a registration, for display on a page or in a terminal.

    ``register_tracker`` passes it to its argument ``report``.

    Attributes
    ----------
    number, count : number of the current touch, from 1, and total number of touches.
    element, point : array index of the transducer to touch, and its position in the scene
        (3,) [m].
    words : name and position of the transducer, as shown to the user.
    share : fraction of the required 1 s for which the fingertip has been at rest; 1 once the touch
        is recorded.
    trouble : reason why no fingertip is seen; "" if one is seen.
    residuals : (count,) distance of each touch from its transducer after the fit [m]; empty until
        all touches have been recorded once.
    """

    number: int
    count: int
    element: int
    point: Float64[np.ndarray, "3"]
    words: str
    share: float
    trouble: str = ""
    residuals: tuple[float, ...] = ()

    def __str__(self) -> str:
        """One line of text."""
        state = "recorded; move away" if self.share == 1.0 else f"hold for {1.0 - self.share:.1f} s"
        return f"touch {self.number} of {self.count}: {self.words}: {self.trouble or state}"


@dataclass(frozen=True, eq=False)
class RegisteredTracker:
    """Pose of a tracker, as returned by ``register_tracker``.

    ``fit.tracker`` is the ``Pose`` that maps the tracker's coordinates to those of the scene;
    ``write_tracker`` writes it to the scene file.

    Attributes
    ----------
    fit : ``Registration`` with the fitted pose and its uncertainty.
    elements : array indices of the T touched transducers, in the order of the touches.
    words : names of these transducers for the user, with their positions.
    """

    fit: Registration
    elements: tuple[int, ...]
    words: tuple[str, ...]

    def table(self) -> str:
        """Return the table ``[tracker]`` for a scene file as text."""
        values = _values(self.fit.tracker)
        return "\n".join(["[tracker]", *(f"{key} = {value}" for key, value in values.items())])


def elements_to_touch(array: PhasedArray, count: int = 6) -> tuple[int, ...]:
    """Choose transducers that are far apart, such as at corners of boards.

    ``register_tracker`` determines the pose of a tracker from touches of these transducers.

    Parameters
    ----------
    array : the transducers.
    count : number of transducers to choose, from 3 to the number in the array.

    Returns
    -------
    Tuple of ``count`` indices of elements, in the order in which they are chosen: first the element
    farthest from the middle of the array, then those with the largest product of distances from the
    elements already chosen.

    Raises
    ------
    InvalidInput
        If the count is outside its range.
    """
    positions = of_kind(array, PhasedArray, "the array", "one such as surrounding_box()").positions
    if not 3 <= count <= len(positions):
        raise InvalidInput(
            f"{count} touches are not possible: use 3 to {len(positions)}, preferably at least 6.",
            code="out_of_range",
        )
    chosen = [int(np.argmax(np.linalg.norm(positions - positions.mean(axis=0), axis=1)))]
    while len(chosen) < count:
        distances = np.linalg.norm(positions[:, None] - positions[chosen], axis=2)
        # The product prefers corners, whereas the smallest distance would prefer places in between.
        chosen.append(int(distances.prod(axis=1).argmax()))
    return tuple(chosen)


def register_tracker(
    setup: Setup,
    source: str,
    elements: Iterable[int] | None = None,
    *,
    offset: float | None = None,
    fit_offset: bool = False,
    fit_scale: bool = False,
    report: Callable[[TouchStep], None] = lambda step: None,
) -> RegisteredTracker:
    """Determine the pose of a hand tracker from touches of transducers with an index fingertip.

    The user touches the transducers in order, each for a second, and moves the finger away in
    between. A touch that contradicts the others must be repeated; after two repetitions, it is
    left out of the fit. The array should be silent.

    Parameters
    ----------
    setup : scene with the array. If the scene has hands, the first one determines whether the
        left or the right hand must touch the transducers.
    source : "websocket" for a tracker that sends frames, optionally with ":PORT"; or the path of a
        recording of the touches.
    elements : array indices of at least 3 transducers to touch, in order; by default, those of
        ``elements_to_touch``.
    offset : distance of the fingertip's joint from a touched face [m], 0 to 0.05; by default, the
        skin radius of the scene's hand, or of a generic hand, at this joint. It is ignored if
        ``fit_offset`` is True.
    fit_offset, fit_scale : whether to fit the offset, or a factor for all of the tracker's lengths,
        together with the pose; False by default.
    report : function called with the progress as a ``TouchStep``, up to ten times per second.

    Returns
    -------
    A ``RegisteredTracker`` with the fitted pose (from the tracker's frame to the scene's), its
    uncertainty, and the touched transducers. Its ``table`` is the text to add to the scene file.

    Raises
    ------
    InvalidInput
        If an element does not exist, if there are fewer than 3 elements, or if they lie on one
        line. If a recording contains too few touches, or touches contradict each other by more than
        10 mm. If the offset is not between 0 and 50 mm or cannot be determined.
    """
    of_kind(setup, Setup, "the setup", "read_scene(path)")
    chosen = elements_to_touch(setup.array) if elements is None else tuple(elements)
    wrong = [element for element in chosen if not 0 <= element < len(setup.array)]
    if wrong:
        raise InvalidInput(
            f"there is no transducer {wrong[0]}; use numbers from 0 to {len(setup.array) - 1}.",
            code="out_of_range",
        )
    words = tuple(_named(setup, element) for element in chosen)
    points = setup.array.positions[list(chosen)]
    normals = setup.array.normals[list(chosen)]
    if offset is None:
        radii = setup.hands[0].radii if setup.hands else GENERIC_RADII
        offset = float(radii[INDEX_TIP])
    # The other hand may rest anywhere.
    side = setup.hands[0].side if setup.hands else None
    touched = np.full((len(chosen), 3), np.nan)
    pending = list(range(len(chosen)))
    attempts = 3
    finger = RestingFingertip()
    reported = -np.inf
    fit: Registration | None = None
    for frame in _frames(source):
        number = pending[0]
        name = words[number]
        if fit is not None:
            name += f" again, which was off by {1e3 * fit.residuals[number]:.0f} mm"
        residuals = () if fit is None else tuple(fit.residuals.tolist())
        step = TouchStep(
            number + 1, len(chosen), chosen[number], points[number], name, 0.0, residuals=residuals
        )
        if isinstance(frame, str):
            report(replace(step, trouble=frame))
            continue
        side = side or frame.side
        if frame.side != side:
            continue
        place = finger.take(frame)
        if place is None:
            if abs(frame.time - reported) >= 0.1:
                reported = frame.time
                trouble = "the hand is lost" if frame.landmarks is None else ""
                report(replace(step, share=min(finger.share, 0.99), trouble=trouble))
            continue
        touched[number] = place
        report(replace(step, share=1.0))
        pending.pop(0)
        if pending:
            continue
        fit = register(
            touched,
            points,
            normals,
            offset=None if fit_offset else offset,
            scale=None if fit_scale else 1.0,
        )
        attempts -= 1
        if fit.repeat is None or attempts == 0:
            return RegisteredTracker(fit, chosen, words)
        pending.append(fit.repeat)
    if fit is None:
        count = int(np.isfinite(touched[:, 0]).sum())
        raise InvalidInput(
            f"{source} contains {count} touches, but {len(chosen)} are required: rest the "
            "fingertip on each transducer for a second, and move it away in between.",
            code="too_few",
        )
    return RegisteredTracker(fit, chosen, words)


def _frames(source: str) -> Iterator[HandFrame | str]:
    """Yield frames from a recording or tracker in its own axes; for a missing one, the reason."""
    hands = received(source)
    if hands is None:
        yield from load_recording(source, leave_out=True).frames
        return
    frames: queue.SimpleQueue[HandFrame] = queue.SimpleQueue()
    try:
        stream = hands.begin(lambda frame, arrived: frames.put(frame))
        before = stream.health
        checked = time.monotonic()
        while True:
            try:
                yield frames.get(timeout=0.1)
            except queue.Empty:
                if time.monotonic() - checked >= 0.5:
                    checked = time.monotonic()
                    health = stream.health
                    waiting = f"waiting for a hand at {hands.words}"
                    yield health.rejected_since(before) or hands.remark() or waiting
                    before = health
    finally:
        hands.close()


def _named(setup: Setup, element: int) -> str:
    """Name a transducer by its number and position, and by its board if there are several."""
    place = in_mm(setup.array.positions[element])
    count = len(board_named(setup.board)) if setup.board is not None else len(setup.array)
    if len(setup.array) <= count:
        return f"transducer {element} at {place}"
    return f"transducer {element % count} of board {element // count + 1} at {place}"


def _values(pose: Pose) -> dict[str, str]:
    """Write a pose as the keys and values of a table in a scene file."""
    turn = Rotation.from_matrix(pose.rotation).as_rotvec()
    angle = float(np.linalg.norm(turn))
    axis = turn / angle if angle > 0.0 else np.array([1.0, 0.0, 0.0])
    return {
        "axis": "[" + ", ".join(f"{number:z.6f}" for number in axis) + "]",
        "degrees": f"{np.degrees(angle):z.4f}",
        "translation": "[" + ", ".join(f"{number:z.5f}" for number in pose.translation) + "]",
    }


def with_tracker(text: str, pose: Pose) -> str:
    """Return the text of a scene file with a new table ``[tracker]`` and no other change.

    Raises
    ------
    InvalidInput
        If the file defines the tracker, but not as a table ``[tracker]``.
    """
    values = _values(pose)
    lines = text.splitlines(keepends=True)
    header = re.compile(r"\s*\[\s*tracker\s*\]")
    if not any(map(header.match, lines)):
        lines = [text.rstrip(), "\n\n[tracker]\n"]
    start = end = 1 + next(index for index, line in enumerate(lines) if header.match(line))
    depth = 0  # of brackets: a row of a matrix begins like the header of a table
    kept = []
    while end < len(lines) and (depth or not lines[end].lstrip().startswith("[")):
        line, hash_sign, comment = lines[end].partition("#")
        key = line.partition("=")[0].strip()
        if depth == 0 and key in values and hash_sign:
            values[key] += f" #{comment.rstrip()}"
        if not depth and key not in ("axis", "degrees", "rotation", "translation"):
            kept.append(lines[end])
        depth += line.count("[") - line.count("]")
        end += 1
    new = [f"{key} = {value}\n" for key, value in values.items()]
    changed = "".join([*lines[:start], *new, *kept, *lines[end:]])
    try:
        after = tomllib.loads(changed)
        before = tomllib.loads(text)
        same = {**before, "tracker": 0} == {**after, "tracker": 0}
    except tomllib.TOMLDecodeError:
        same = False
    if not same:
        raise InvalidInput(
            "the scene file has no table [tracker] in which the values can be replaced: enter the "
            "new values yourself.",
            code="not_writable",
        )
    return changed


def write_tracker(scene: str | Path, pose: Pose, copy: str | Path | None = None) -> None:
    """Write a table ``[tracker]`` to a scene file or a copy, leaving everything else unchanged.

    An existing table ``[tracker]`` is replaced.

    Parameters
    ----------
    scene : path of the scene file; the file is changed unless ``copy`` is given.
    pose : pose that maps the tracker's coordinates to those of the scene, such as
        ``register_tracker(...).fit.tracker``.
    copy : path for a changed copy, which replaces an existing file; by default, ``scene`` itself is
        changed. If the scene names other files, the copy must be in the same folder.

    Raises
    ------
    InvalidInput
        If a file cannot be read or written, or if the scene file defines the tracker other than
        by a table ``[tracker]``.
    """
    changed = with_tracker(text_of(path_of(scene, "the scene file")), pose)
    with whole_file(Path(copy or scene)) as unfinished:
        unfinished.write_bytes(changed.encode())
