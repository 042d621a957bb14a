"""The sound follows a hand: a scene file, frames from somewhere, boards or none. Prints nothing."""

from dataclasses import dataclass
from pathlib import Path

from airtact import live
from airtact.drives.frame import check_cap
from airtact.evaluation.head_level import MAX_HEAD_LEVEL
from airtact.setup.building import read_scene
from airtact.setup.setup import Setup
from airtact.timing import Progress, no_progress
from airtact.workflows.emit import FULL, safe_cap


@dataclass(frozen=True, eq=False)
class Prepared:
    """What is followed, and where the sound goes.

    Attributes
    ----------
    setup : the scene file.
    hands : where the frames come from.
    output : where drives go.
    cap : largest amplitude of an element, a share of full scale.
    notes : why the level is what it is.
    """

    setup: Setup
    hands: live.HandSource
    output: live.Output
    cap: float
    notes: list[str]


def prepare(
    scene: Path,
    folder: Path,
    source: str | None = None,
    cap: float | None = None,
    board: str | None = None,
    link: str | None = None,
    report_step: Progress = no_progress,
    **settings: str | None,
) -> Prepared:
    """Read the scene and open what the frames come from; nothing is emitted yet."""
    cap = None if cap is None else check_cap(cap)
    report_step("reading the scene")
    setup = read_scene(scene, followed=True)
    output = live.output_to(setup, folder, board, link, **settings)
    notes = []
    if board is not None and cap is None and link != "file":
        report_step("choosing a level that keeps a head to 110 dB")
        cap, full = safe_cap(live.drive_at_rest(setup), board)
        if cap != FULL:
            notes.append(
                f"The cap of {cap:g} keeps a head to {MAX_HEAD_LEVEL:g} dB for the hand at rest; --full-scale "
                f"emits all, up to {full:.0f} dB there, and --cap another share."
            )
    hands = live.hands_from(setup, source, folder)
    return Prepared(setup, hands, output, FULL if cap is None else cap, notes)
