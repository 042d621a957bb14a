"""Verification of a session: compare its drives with the best ones for the recorded hand."""

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
from airtact.live.scene import Joints, foci_on
from airtact.live.session import Session
from airtact.timing import Progress, no_progress


@dataclass(frozen=True, eq=False)
class VerifiedSession:
    """Pressures on the hand from selected drives of a session.

    Attributes
    ----------
    indices : (V,) indices of the drives.
    pressures : (V, F) pressures at the foci [Pa].
    kept : (V,) pressure at the weakest focus, divided by that of the drive made for the hand at
        that time, at equal energy.
    """

    indices: tuple[int, ...]
    pressures: Float64[np.ndarray, "verified foci"]
    kept: Float64[np.ndarray, "verified"]

    __repr__ = in_short


def verify_session(
    session: Session, drives: int = 10, report_step: Progress = no_progress
) -> VerifiedSession:
    """Compare drives of a session with the best ones for the whole hand at their time in the air.

    Parameters
    ----------
    session : session, as returned by ``read_session``.
    drives : number of drives with sound to verify, evenly spread; each takes a solve to 2 %.
    report_step : called with each drive.

    Raises
    ------
    InvalidInput
        If there is no hand at the times of the selected drives.
    """
    scene = session.scene
    playing = np.flatnonzero(session.playing)
    chosen = np.unique(playing[np.linspace(0, max(len(playing) - 1, 0), drives).astype(int)])
    indices = []
    pressures = []
    kept = []
    for number, index in enumerate(chosen.tolist()):
        report_step(f"drive {number + 1} of {len(chosen)}")
        joints = _joints_at(session, float(session.time_in_air[index]))
        if joints is None:
            continue
        hand = hand_from_joints(joints, scene.radii, side=scene.side)
        target = Target(foci_on(hand, scene))
        body = Scene(
            scene.medium,
            [sound_hard(hand.surface)],
            frequency=scene.frequency,
            planes=scene.planes,
        )
        field = BoundaryElement(accuracy=0.02).radiate(body, target.beacons())
        transfer = transfer_matrix(field, scene.array)
        received = np.abs(transfer.matrix @ session.amplitudes[index])
        # For equal energy, divide each weakest pressure by the norm of its drive.
        share = received.min() / np.linalg.norm(session.amplitudes[index])
        ideal = best(transfer, target)
        attainable = np.abs(transfer.pressure(ideal)).min() / np.linalg.norm(ideal.amplitudes)
        indices.append(index)
        pressures.append(received)
        kept.append(share / attainable)
    if not indices:
        raise InvalidInput(
            f"there was no hand at the times of the {len(playing)} drives with sound: record a "
            "longer session.",
            code="empty",
        )
    return VerifiedSession(tuple(indices), fixed(np.array(pressures)), fixed(np.array(kept)))


def _joints_at(session: Session, time: float) -> Joints | None:
    """Joints at a time of the frames' clock [m], between two frames with a hand; or None."""
    seen = np.isfinite(session.landmarks[:, 0, 0])
    times = session.frame_time[seen]
    landmarks = session.landmarks[seen]
    after = int(np.searchsorted(times, time))
    if not 0 < after < len(times):
        return None
    share = (time - times[after - 1]) / (times[after] - times[after - 1])
    return (1.0 - share) * landmarks[after - 1] + share * landmarks[after]
