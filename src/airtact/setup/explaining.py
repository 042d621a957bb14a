"""Causes of a weak focus, and the pressure that each of them costs."""

import csv
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from airtact.acoustics.scene import Scene
from airtact.acoustics.target import Target
from airtact.drives.drive import Drive, quantise
from airtact.drives.head_level import HeadLevel
from airtact.drives.methods import best
from airtact.drives.transfer import TransferMatrix, open_air_matrix
from airtact.errors import in_short, of_kind
from airtact.evaluation.metrics import drive_sources
from airtact.evaluation.steepening import steepening
from airtact.files.atomic import whole_file
from airtact.setup.rendering import Rendering
from airtact.transducers.layout import PhasedArray
from airtact.transducers.levels import AmplitudeModulation
from airtact.transducers.placement import strongest_open_air

Pressures = Float64[np.ndarray, "foci"]

MODULATED = "modulation, root mean square over time"
"""Name of the first cause after which pressures are not peak values."""


@dataclass(frozen=True, eq=False)
class Cause:
    """A cause that changes the pressure at the F foci of a drive, in ``Explanation.causes``.

    Attributes
    ----------
    name : short description of what changes, such as the hand or the rounding to levels.
    pressures : (F,) peak pressure at each focus with this cause and all preceding causes [Pa]. For
        ``MODULATED`` and all later causes, it is the root mean square of the peak pressure over one
        period of the modulation.
    remedy : change that would remove the cause, as a sentence; empty if there is none.
    """

    name: str
    pressures: Pressures
    remedy: str = ""

    __repr__ = in_short


@dataclass(frozen=True, eq=False)
class Explanation:
    """Explanation of the pressure at each focus, as returned by ``why``.

    It begins with the largest pressure in open air and ends with that of the emitted drive. Causes
    such as the hand, the number of foci or the rounding to levels are added one by one.

    Attributes
    ----------
    foci : names of the F foci.
    causes : the ``Cause`` objects in the order in which they are added, each with the pressures at
        the foci once it is added. The first contains the reference: the largest pressure that the
        array, with all elements nominal, can produce anywhere in open air.
    advice : sentence on the change that would increase the pressure at the weakest
        focus most.
    weakest : index of the focus that is weakest relative to its request.
    """

    foci: tuple[str, ...]
    causes: tuple[Cause, ...]
    advice: str
    weakest: int

    __repr__ = in_short

    @property
    def changes(self) -> Float64[np.ndarray, "causes foci"]:
        """(C, F) change of each focus's pressure by each cause [Pa]; NaN for the first cause."""
        return np.diff([cause.pressures for cause in self.causes], axis=0, prepend=np.nan)

    def change_in_words(self, cause: int, focus: int) -> str:
        """Return how much a cause changes the pressure at a focus, as text such as "−26 %"."""
        before = self.causes[cause - 1].pressures[focus] if cause else 0.0
        # A millionth of the reference is the rounding error of a silent focus.
        if before <= 1e-6 * self.causes[0].pressures[focus]:
            return ""
        share = round(100.0 * (self.causes[cause].pressures[focus] / before - 1.0))
        return f"{share:+d} %".replace("-", "\u2212") if share else "0 %"

    def save(self, path: str | Path) -> None:
        """Write or replace a .csv file: a table with one row per cause and focus."""
        with whole_file(Path(path)) as partial, partial.open("w", newline="") as file:
            table = csv.writer(file)
            table.writerow(["cause", "focus", "pressure_Pa", "change_Pa", "remedy"])
            for cause, changes in zip(self.causes, self.changes, strict=True):
                for name, pressure, change in zip(self.foci, cause.pressures, changes, strict=True):
                    words = "" if np.isnan(change) else f"{change:.6g}"
                    table.writerow([cause.name, name, f"{pressure:.6g}", words, cause.remedy])


def why(result: Rendering, kept: float | None = None) -> Explanation:
    """Explain the pressure at each focus of a rendered drive.

    The first pressure is the largest that the array can produce anywhere in open air. Causes such
    as the shadow of the hand or rounding are added one by one, and the pressure is computed after
    each. The pressure after the last cause is therefore the first pressure plus all changes.

    Parameters
    ----------
    result : rendering, as returned by ``render``.
    kept : fraction of the attainable pressure that remained in a recorded session despite the error
        and the age of the tracked pose, such as the median of ``VerifiedSession.kept``. The last
        cause multiplies the pressures by it. By default, tracking is not included.

    Returns
    -------
    An ``Explanation`` with the causes in order, the peak pressure at each focus after each of them
    [Pa], and advice on what to change. If the amplitude is modulated, the pressures after the
    modulation and all later causes are root mean squares of the peak pressure over a period of the
    modulation.

    Raises
    ------
    InvalidInput
        If the setup has traps.

    Examples
    --------
    >>> import airtact as at
    >>> pair = at.Target(np.array([[0.0, 0.0, 0.15], [0.04, 0.0, 0.15]]))
    >>> result = at.render(at.Setup(at.Scene(at.air()), at.flat_boards(1, 1), pair))
    >>> [cause.name for cause in at.setup.why(result).causes]  # doctest: +ELLIPSIS
    ['strongest place in open air', 'distance and direction', 'sharing with 1 other focus', ...]
    """
    setup = of_kind(result, Rendering, "the result", "render(setup)").setup
    setup.check_no_traps("why")
    target = setup.target
    count = len(target.points)
    nominal = PhasedArray(
        setup.array.positions, setup.array.normals, setup.array.element, setup.array.tangents
    )
    transfer = TransferMatrix(result.transfer.matrix[:count], result.transfer.estimated_error)
    # The largest pressure of any drive within full scale at one focus: all waves in phase.
    bare = Scene(setup.medium, frequency=setup.frequency)
    alone = [
        np.abs(open_air_matrix(scene, array, target).matrix[:count]).sum(axis=1)
        for scene, array in ((bare, nominal), (setup.scene, nominal), (setup.scene, setup.array))
    ]
    strongest = max(strongest_open_air(nominal, setup.scene.wavenumber), alone[0].max())
    causes = [
        Cause("strongest place in open air", np.full(count, strongest)),
        Cause(
            "distance and direction",
            alone[0],
            "move the foci towards the middle of the array's beams, or move the boards closer "
            "(airtact place)",
        ),
    ]
    if setup.scene.planes:
        causes.append(Cause("reflection by the planes", alone[1], "move the planes away"))
    if np.any(setup.array.gains != 1.0):
        causes.append(Cause("gains and dead elements", alone[2], "replace the dead elements"))
    if setup.bodies:
        # A long list of boards would hide the name of the hand.
        body = " and ".join(setup.bodies) if len(setup.bodies) <= 3 else "bodies"
        causes.append(
            Cause(
                f"shadow and reflection by the {body}",
                np.abs(transfer.matrix).sum(axis=1),
                f"turn the {body}, or move boards to the side that the focus faces (airtact place)",
            )
        )
    # A focus that runs through the points has its own drive at each of them.
    drives = [result.drive]
    parts = [slice(None)]
    if setup.in_turn:
        assert result.sequence is not None
        drives = [Drive(amplitudes) for amplitudes in result.sequence.drives]
        parts = [slice(index, index + 1) for index in range(count)]

    def at_foci(drives: list[Drive]) -> Pressures:
        pairs = zip(parts, drives, strict=True)
        return np.concatenate([np.abs(transfer.pressure(drive))[part] for part, drive in pairs])

    weights = target.weights
    shares = Target(target.points, shares=weights / weights.max())
    if not np.allclose(weights, weights[0]):
        # The highest pressures with the requested ratios, as if every focus were alone. In turn,
        # each focus has its share of its own highest pressure.
        asked = weights > 0.0
        pressures = causes[-1].pressures
        highest = pressures / weights.max()
        if not setup.in_turn:
            highest = (pressures[asked] / weights[asked]).min()
        # What was requested is not a fault, so it has no remedy.
        causes.append(Cause("the requested ratios of the foci", highest * weights))
    if count > 1 and not setup.in_turn:
        drive = best(transfer, shares).at_full_scale()
        others = "1 other focus" if count == 2 else f"{count - 1} other foci"
        causes.append(
            Cause(
                f"sharing with {others}",
                np.abs(transfer.pressure(drive)),
                "remove foci, or play them in turn",
            )
        )
    if setup.method != "best" or len(target.suppression_points):
        full = [drive.at_full_scale() if drive.peak else drive for drive in drives]
        name = f"the method {setup.method.replace('_', ' ')}"
        causes.append(Cause(name, at_foci(full), 'use method = "best"'))
    if min(drive.peak for drive in drives) < 0.999 or target.phases is not None:
        # Boards without amplitude levels emit at full scale, whatever is requested.
        remedy = "" if setup.levels.phase_only else "request higher pressures"
        causes.append(Cause("the requested pressures", at_foci(drives), remedy))
    rounded = [quantise(drive, setup.levels).drive() for drive in drives]
    causes.append(Cause("rounding to levels", at_foci(rounded), "use finer levels"))
    last = causes[-1].pressures
    emitted = rounded
    # Boards that only switch elements on and off cannot be turned down; ``emit`` asks for a cap.
    if setup.board is not None and not setup.levels.phase_only:
        level = HeadLevel(
            np.stack([drive.amplitudes for drive in rounded]),
            setup.array.positions,
            setup.levels,
            setup.scene.wavenumber.real,
            setup.array.element.sensitivity,
        )
        cap = min(1.0, level.safe_cap() / max(drive.peak for drive in rounded))
        if cap < 0.999:
            emitted = [
                quantise(Drive(cap * drive.amplitudes), setup.levels).drive() for drive in drives
            ]
            last = at_foci(emitted)
            # A limit for safety is not a fault of the scene, so it has no remedy here.
            causes.append(Cause("the level limit at a head, as in emit", last))
    # The steepening depends on the emitted drive, which rounding or a cap may have changed.
    in_real_air = np.ones(count)
    for part, drive in zip(parts, emitted, strict=True):
        if last[part].any():
            sources = drive_sources(setup.array, [drive], setup.scene)
            steepened = steepening(setup.scene, sources, target.points[part], last[part])
            in_real_air[part] = steepened.kept
    known = np.isfinite(in_real_air)
    if not known.all() or in_real_air.min() < 0.99:
        last = last * np.where(known, in_real_air, 1.0)
        name = "steepening in real air"
        if not known.all():
            unknown = [
                focus for focus, at_focus in zip(setup.foci, known, strict=True) if not at_focus
            ]
            name += f", unknown at {', '.join(unknown)}"
        causes.append(Cause(name, last, "surround the hand with boards"))
    if isinstance(setup.modulation, AmplitudeModulation):
        last = float(np.sqrt(np.mean(setup.modulation.envelope(64) ** 2))) * last
        causes.append(Cause(MODULATED, last))
    if kept is not None:
        causes.append(
            Cause(
                "error and age of the tracked pose",
                kept * last,
                "improve the tracker, its registration or its rate",
            )
        )
    weakest = target.weakest(causes[-1].pressures)
    best_gain = 1.1
    advice = "No single change would gain more than 10 %: use more boards, or move them closer."
    for before, cause in pairwise(causes):
        gain = float(before.pressures[weakest] / max(cause.pressures[weakest], 1e-9))
        # Causes without a remedy, such as the level limit at a head, cannot be removed.
        if cause.remedy and gain > best_gain:
            best_gain = gain
            advice = (
                f"The largest avoidable loss is due to {cause.name}. Without it, the pressure at "
                f"the weakest focus would be {gain:.2g} times as high. Remedy: {cause.remedy}."
            )
    return Explanation(setup.foci, tuple(causes), advice, weakest)
