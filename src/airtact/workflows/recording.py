"""From a recording of hands to a picture of their pads over time, and the skins of chosen frames. Prints nothing."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from airtact.errors import InvalidInput, about
from airtact.files.atomic import writable_folder
from airtact.hands.hand import Side
from airtact.hands.tracking.frame import HandFrame
from airtact.hands.tracking.recordings import PadTrack, Recording, load_recording, pads_over_time
from airtact.reports.page import write_picture
from airtact.reports.plots import draw_tracks
from airtact.setup.panel_files import EDGE, check_ending, checked_edge, write_triangles
from airtact.timing import Progress, no_progress

SIDES: tuple[Side, ...] = ("left", "right")


@dataclass(frozen=True, eq=False)
class Replayed:
    """What was found in a recording, the pads of each hand in it, and the files of skins and of the picture."""

    recording: Recording
    tracks: tuple[PadTrack, ...]
    skins: tuple[Path, ...]
    picture: Path


def replay_recording(
    path: Path,
    file: Path,
    chosen: Sequence[int] = (),
    leave_out: bool = False,
    edge: float = EDGE,
    report_step: Progress = no_progress,
) -> Replayed:
    """Read a recording, draw the pads over time into a picture beside ``file``, and write the skins of chosen frames.

    Frames are chosen by their sequence numbers, the first that has landmarks unless given. With
    several frames, or two hands, side and number of each stand in the name of its file.
    ``leave_out`` leaves faulty frames out and counts them instead of raising; ``edge`` is of the
    triangles [m].

    Raises
    ------
    InvalidInput
        The recording is faulty, has no such frame or no landmarks, or nothing can be written there.
    """
    check_ending(file)
    edge = checked_edge(edge)
    report_step(f"reading {path.name}")
    recording = load_recording(path, leave_out)
    with about(path.name):
        frames = _chosen(recording, chosen)
    report_step(f"finding the pads in {len(recording.frames):,} frames")
    seen = {frame.side for frame in recording.frames if frame.landmarks is not None}
    tracks = tuple(pads_over_time(recording.frames, side) for side in SIDES if side in seen)
    writable_folder(file.parent)
    skins = []
    for frame in frames:
        named = (
            file
            if len(frames) == 1
            else file.with_stem(f"{file.stem}_{frame.side}_{frame.sequence}")
        )
        report_step(f"writing {named.name}")
        write_triangles(named, frame.hand().shape.panels(edge))
        skins.append(named)
    picture = file.with_suffix(".png")
    report_step(f"drawing {picture.name}")
    write_picture(picture, draw_tracks(tracks, f"{path.name}: {recording.health}"))
    return Replayed(recording, tracks, tuple(skins), picture)


def _chosen(recording: Recording, chosen: Sequence[int]) -> list[HandFrame]:
    """Find the frames whose skin is wanted."""
    whole = [frame for frame in recording.frames if frame.landmarks is not None]
    if not whole:
        raise InvalidInput(
            f"0 of {len(recording.frames)} frames have landmarks; fit a hand to their clouds first.",
            code="data_missing",
        )
    found = [frame for frame in whole if frame.sequence in chosen]
    missing = sorted(set(chosen) - {frame.sequence for frame in found})
    if missing:
        first, last = min(one.sequence for one in whole), max(one.sequence for one in whole)
        raise InvalidInput(
            f"there is no frame {missing[0]} with landmarks; those there are lie in {first} to {last}.",
            code="unknown_name",
        )
    return found or whole[:1]
