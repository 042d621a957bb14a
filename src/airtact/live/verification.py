"""Verification of a session: compare its drives with the best ones for the recorded hand."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from airtact.acoustics.scene import Scene, sound_hard
from airtact.acoustics.solvers.bem.solver import BoundaryElement
from airtact.acoustics.target import Target
from airtact.drives.methods import best
from airtact.drives.transfer import transfer_matrix
from airtact.errors import InvalidInput, fixed, in_short
from airtact.hands.hand import hand_from_joints
from airtact.live.moment import Rule
from airtact.live.scene import Joints, foci_on
from airtact.live.session import Session
from airtact.timing import Progress, no_progress


@dataclass(frozen=True, eq=False)
class VerifiedSession:
    """Pressures on the hand from selected drives of a session.

    Attributes
    ----------
    indices : (V,) indices of the drives.
    times : (V,) times in the air, on the clock of the frames [s].
    pressures : (V, F) pressures at the foci [Pa].
    kept : (V,) pressure at the weakest focus, divided by that of the drive made for the hand at
        that time, at equal energy.
    expected : (V,) share expected when the drive was made; NaN if unknown.
    rules : (V,) basis of the drives.
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
        """Median of ``kept``."""
        return float(np.median(self.kept))

    @property
    def lowest_tenth(self) -> float:
        """The 10th percentile of ``kept``."""
        return float(np.percentile(self.kept, 10.0))


def hand_at(session: Session, time: float) -> Joints:
    """Return the joints at a time of the frames' clock [m], interpolated between frames.

    Raises
    ------
    InvalidInput
        If there is no frame with a hand before or after that time.
    """
    seen = np.isfinite(session.landmarks[:, 0, 0])
    times = session.frame_time[seen]
    landmarks = session.landmarks[seen]
    after = int(np.searchsorted(times, time))
    if not 0 < after < len(times):
        raise InvalidInput(
            f"the session has no frames with a hand both before and after {time:.4g} s, so its "
            "joints at that time are unknown.",
            code="out_of_range",
        )
    share = (time - times[after - 1]) / (times[after] - times[after - 1])
    return (1.0 - share) * landmarks[after - 1] + share * landmarks[after]


def verify_session(
    session: Session,
    every: int = 20,
    accuracy: float = 0.02,
    truth: Callable[[float], Joints] | None = None,
    report_step: Progress = no_progress,
) -> VerifiedSession:
    """Compare drives of a session with the best ones for the whole hand at their time in the air.

    Parameters
    ----------
    session : session, as returned by ``read_session``.
    every : every n-th drive with sound is verified.
    accuracy : relative error of the solutions.
    truth : returns the joints (25, 3) [m] at a time of the frames' clock [s]; by default they are
        interpolated between frames, which contain the tracker's noise.
    report_step : called with each drive.

    Raises
    ------
    InvalidInput
        If there is no hand at the times of the selected drives.
    """
    scene = session.scene
    solver = BoundaryElement(accuracy=accuracy)
    playing = np.flatnonzero(session.playing).tolist()
    chosen = playing[:: max(every, 1)]
    indices = []
    pressures = []
    kept = []
    for number, index in enumerate(chosen):
        report_step(f"drive {number + 1} of {len(chosen)}")
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
        amplitudes = session.amplitudes[index]
        received = np.abs(transfer.matrix @ amplitudes)
        ideal = best(transfer, target)
        # For equal energy, divide each weakest pressure by the norm of its drive.
        share = float(received.min()) / float(np.linalg.norm(amplitudes))
        attainable = np.abs(transfer.pressure(ideal)).min() / np.linalg.norm(ideal.amplitudes)
        indices.append(index)
        pressures.append(received)
        kept.append(share / float(attainable))
    if not indices:
        raise InvalidInput(
            f"there was no hand at the times of the {len(playing)} drives with sound: record a "
            "longer session.",
            code="empty",
        )
    return VerifiedSession(
        indices=tuple(indices),
        times=fixed(session.time_in_air[indices]),
        pressures=fixed(np.array(pressures)),
        kept=fixed(np.array(kept)),
        expected=fixed(session.kept[indices]),
        rules=tuple(session.rules[index] for index in indices),
    )
