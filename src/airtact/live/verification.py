"""What the drives of a session gave the hand that was there: each is held against the hand at its time in the air."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from airtact.acoustics.scene import Scene, sound_hard
from airtact.acoustics.solvers.bem.solver import BoundaryElement
from airtact.acoustics.target import Target
from airtact.checks import fixed
from airtact.drives.methods import best
from airtact.drives.transfer import transfer_matrix
from airtact.errors import InvalidInput
from airtact.hands.hand import hand_from_joints
from airtact.live.distances import foci_on
from airtact.live.parts import Rule
from airtact.live.session import Session
from airtact.printing import in_short
from airtact.timing import Progress, no_progress

EVERY = 20
"""One in so many drives is verified unless another number is given."""

ACCURACY = 0.02
"""Relative error of the verification solves unless another is given."""


@dataclass(frozen=True, eq=False)
class VerifiedSession:
    """What chosen drives of a session gave the hand that was there.

    Attributes
    ----------
    indices : (V,) of the drives.
    times : (V,) at which they were in the air, on the clock of the frames [s].
    pressures : (V, F) that the foci got [Pa].
    kept : (V,) pressure at the weakest focus over that of the drive made for the hand of that time,
        at equal energy.
    expected : (V,) the share that was expected when the drive was made; NaN where it was not known.
    rules : (V,) what the drives were made from.
    """

    indices: tuple[int, ...]
    times: Float64[np.ndarray, "verified"]
    pressures: Float64[np.ndarray, "verified foci"]
    kept: Float64[np.ndarray, "verified"]
    expected: Float64[np.ndarray, "verified"]
    rules: tuple[Rule, ...]

    __repr__ = in_short

    @property
    def median(self) -> float:
        """Median of the pressure kept."""
        return float(np.median(self.kept))

    @property
    def lowest_tenth(self) -> float:
        """The share that nine of ten drives keep at least."""
        return float(np.percentile(self.kept, 10.0))


def hand_at(session: Session, time: float) -> Float64[np.ndarray, "25 3"]:
    """Return the joints at a time of the frames' clock [m], between those of the frames before and after.

    Raises
    ------
    InvalidInput
        If no frame with a hand came before, or none after.
    """
    seen = np.isfinite(session.landmarks[:, 0, 0])
    times, landmarks = session.frame_time[seen], session.landmarks[seen]
    after = int(np.searchsorted(times, time))
    if not 0 < after < len(times):
        raise InvalidInput(
            f"at {time:.4g} s the session has no frame before or none after: its {len(times)} frames with a hand do "
            "not say where the hand was.",
            code="out_of_range",
        )
    share = (time - times[after - 1]) / (times[after] - times[after - 1])
    return (1.0 - share) * landmarks[after - 1] + share * landmarks[after]


def verify_session(
    session: Session,
    every: int = EVERY,
    accuracy: float = ACCURACY,
    truth: Callable[[float], Float64[np.ndarray, "25 3"]] | None = None,
    report_step: Progress = no_progress,
) -> VerifiedSession:
    """Solve the whole hand at the times in the air of chosen drives, and compare these with the best for that hand.

    Parameters
    ----------
    session : as ``read_session`` gives it.
    every : one in so many of the drives that play is chosen.
    accuracy : relative error of the solves.
    truth : gives the joints (25, 3) [m] at a time of the frames' clock [s], where they are known
        better than from the frames, which are interpolated otherwise; a tracker's noise is in them.
    report_step : called with each drive.

    Raises
    ------
    InvalidInput
        If no chosen drive has a hand at its time.
    """
    scene = session.scene
    solver = BoundaryElement(accuracy=accuracy)  # elements may stand near the skin
    playing = np.flatnonzero(session.playing).tolist()
    rows = []
    for number, index in enumerate(playing[:: max(every, 1)]):
        report_step(f"drive {number + 1} of {len(playing[:: max(every, 1)])}")
        time = float(session.time_in_air[index])
        try:
            joints = hand_at(session, time) if truth is None else truth(time)
            hand = hand_from_joints(joints, scene.radii, side=scene.side)
            target = Target(foci_on(hand, scene))
            bodies = [sound_hard(hand.surface)]
            body = Scene(scene.medium, bodies, frequency=scene.frequency, planes=scene.planes)
            transfer = transfer_matrix(solver.radiate(body, target.beacons()), scene.array)
        except InvalidInput as fault:
            report_step(f"drive {number + 1} is left out: {fault}")
            continue
        got = np.abs(transfer.matrix @ session.amplitudes[index])
        ideal = best(transfer, target)
        attainable = float(np.abs(transfer.pressure(ideal)).min()) / float(
            np.linalg.norm(ideal.amplitudes)
        )
        energy = float(np.linalg.norm(session.amplitudes[index]))
        rows.append((index, time, got, float(got.min()) / energy / attainable))
    if not rows:
        raise InvalidInput(
            f"0 of {len(playing)} drives that play have a hand at their time: record a longer session.",
            code="empty",
        )
    indices, times, pressures, kept = zip(*rows, strict=True)
    return VerifiedSession(
        indices=indices,
        times=fixed(np.array(times)),
        pressures=fixed(np.array(pressures)),
        kept=fixed(np.array(kept)),
        expected=fixed(session.kept[list(indices)]),
        rules=tuple(session.rules[index] for index in indices),
    )
