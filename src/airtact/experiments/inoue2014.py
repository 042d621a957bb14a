"""The experiment of Inoue, Makino and Shinoda (SICE 2014), repeated from its own numbers. Prints nothing."""

import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from airtact.errors import InvalidInput, NotConverged
from airtact.experiments.beacons import beacons
from airtact.experiments.differences import differences
from airtact.experiments.measurement import measurement
from airtact.experiments.mesh_sizes import mesh_sizes
from airtact.experiments.part import Part
from airtact.experiments.pressures import pressures
from airtact.experiments.ratios import ratios
from airtact.experiments.rigid_motion import rigid_motion
from airtact.experiments.settings import FULL, QUICK, Settings
from airtact.experiments.solved import solved
from airtact.files.atomic import whole_file, writable_folder
from airtact.reports.page import document, folded, heading, key_numbers, paragraph, section, table
from airtact.timing import Clock, Progress, no_progress

PAGE = "index.html"
"""The page, which needs no other file."""


@dataclass(frozen=True)
class Reproduced:
    """The page that was written, the most important results (number, label), and the wall time in all [s].

    ``failed`` gives by title why a part failed.
    """

    page: Path
    facts: tuple[tuple[str, str], ...]
    seconds: float
    failed: Mapping[str, str]


def reproduce(
    folder: Path,
    quick: bool = False,
    report_step: Progress = no_progress,
    settings: Settings | None = None,
) -> Reproduced:
    """Do the paper's experiment and write a page about it, with the numbers behind each figure beside it.

    The page is rewritten after each part, so that an interrupted run leaves a page with all that
    was done. A part that fails is shown with its reason, and the others are done all the same. The
    quick run takes three minutes and does less of everything; ``settings`` replace those of both.

    Raises
    ------
    InvalidInput
        The folder is at fault, or memory is short for the first solve.
    NotConverged
        The first solve did not converge.
    """
    chosen = settings or (QUICK if quick else FULL)
    data = writable_folder(folder / "data")
    clock = Clock(report_step)
    made = solved(chosen, clock)
    makers: dict[str, Callable[[], Part]] = {
        "The model and the phases": lambda: beacons(made, chosen, data, clock),
        "Considered and ignored": lambda: pressures(made, data, clock),
        "A virtual measurement": lambda: measurement(made, chosen, data, clock),
        "Water against rigid": lambda: differences(made, chosen, data, clock),
        "What the paper leaves open": lambda: ratios(chosen, data, clock),
        "Rigid motion": lambda: rigid_motion(chosen, data, clock),
        "Mesh and order": lambda: mesh_sizes(chosen, data, clock),
    }
    parts: list[Part] = []
    failed: dict[str, str] = {}
    for title, make in makers.items():
        parts.append(_made(title, make, failed))
        waiting = list(makers)[len(parts) :]
        with whole_file(folder / PAGE) as partial:
            partial.write_text(_page(chosen, parts, waiting, clock), encoding="utf-8")
    return Reproduced(folder / PAGE, _facts(parts), sum(clock.seconds.values()), failed)


def _made(title: str, make: Callable[[], Part], failed: dict[str, str]) -> Part:
    """Make a part, or one with the reason why there is none."""
    try:
        return make()
    except (
        Exception
    ) as fault:  # whatever it is, what was computed before and what can be after is worth more
        failed[title] = str(fault) or type(fault).__name__
        pieces = [
            paragraph(
                f"This part failed, and the others were done without it: {failed[title]}", "warning"
            )
        ]
        if not isinstance(fault, InvalidInput | NotConverged):
            pieces.append(folded("Where it failed", traceback.format_exc()))
        return Part(title, tuple(pieces))


def _facts(parts: list[Part]) -> tuple[tuple[str, str], ...]:
    return tuple(fact for part in parts for fact in part.facts)


def _page(settings: Settings, parts: list[Part], waiting: list[str], clock: Clock) -> str:
    title = "Inoue, Makino, Shinoda 2014, done again"
    head = [
        heading(title),
        paragraph(
            "Producing Airborne Ultrasonic 3D Tactile Image by Time Reversal Field Rendering, SICE Annual Conference "
            "2014, computed anew: 996 transducers round 14 x 14 x 18 cm at 40 kHz, two fingers, a focus on the skin of "
            "each, open solvers only.",
            "lead",
        ),
        key_numbers(_facts(parts)),
    ]
    if waiting:
        words = f"Unfinished: {len(waiting)} parts are still to come ({', '.join(waiting)})."
        head.append(
            paragraph(
                f"{words} Their tables in data/, if there are any, are of an earlier run.",
                "warning",
            )
        )
    if settings is not FULL:
        head.append(paragraph(_left_out(settings), "warning"))
    body = [piece for part in parts for piece in (section(part.title), *part.pieces)]
    return document(title, [*head, *body, *_foot(settings, clock)])


def _left_out(settings: Settings) -> str:
    return (
        f"This is the {settings.name} run. Of the full one it has: "
        f"{len(settings.gaps) * len(settings.radii)} of {len(FULL.gaps) * len(FULL.radii)} gaps and radii, "
        f"{len(settings.tilts)} tilts at {len(settings.tilt_gaps)} of {len(FULL.tilt_gaps)} gaps; microphone steps of "
        f"{1e3 * settings.scan_step:g} mm in place of {1e3 * FULL.scan_step:g} mm; in the study of meshes only what is "
        f"predicted under {settings.study_seconds:g} s in place of {FULL.study_seconds:g} s; {settings.poses} of "
        f"{FULL.poses} poses; a reference at {100 * settings.reference:g} % in place of {100 * FULL.reference:g} %."
    )


def _foot(settings: Settings, clock: Clock) -> list[str]:
    """Write what was not modelled, and how long each part took."""
    swept = sum(seconds for name, seconds in clock.seconds.items() if name.startswith("fingers "))
    studied = sum(seconds for name, seconds in clock.seconds.items() if name.startswith("order "))
    others = {
        name: seconds
        for name, seconds in clock.seconds.items()
        if not name.startswith(("fingers ", "order "))
    }
    rows = [*others.items(), ("sweep of fingers", swept), ("study of meshes", studied)]
    return [
        section("How it was done"),
        paragraph(
            "Fingers are capsules 44 mm long from the tip's centre to the root's; transducers are monopoles at the "
            "positions of four AUTD3 boards and, like the walls, do not reflect (section 3.1 of the paper). Beacons "
            "stand on the surfaces. Every drive is rounded to 256 levels of amplitude and phase before it is verified. "
            "The numbers behind each figure are in data/, as .csv and .h5."
        ),
        table(
            ["step", "time"],
            [[name, f"{seconds:.1f} s"] for name, seconds in rows],
            f"{settings.name} run, {sum(clock.seconds.values()):.0f} s in all.",
        ),
    ]
