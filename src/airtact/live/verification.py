"""Verification of a session: its drives are compared with the best ones for the recorded hand."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from airtact.acoustics.scene import Scene, sound_hard
from airtact.acoustics.solvers.bem.solver import BoundaryElement
from airtact.acoustics.target import Target
from airtact.acoustics.target_points import outward
from airtact.drives.methods import best
from airtact.drives.transfer import transfer_matrix
from airtact.errors import InvalidInput, fixed, in_short, of_kind
from airtact.hands.hand import Hand, Side
from airtact.hands.joints import radii_of
from airtact.live.scene import SIDES, Foci, Joints, foci_on
from airtact.live.session import Session, padded
from airtact.setup.parsing import parse_scene
from airtact.setup.setup import Setup
from airtact.timing import Progress, no_progress


@dataclass(frozen=True, eq=False)
class VerifiedSession:
    """Pressures that selected drives of a session produce at the recorded hands.

    ``verify_session`` returns it. The hands are those that the tracker recorded for the time at
    which the sound was in the air, so the pressures include errors of the prediction.

    Attributes
    ----------
    indices : indices of the V verified drives in the session.
    pressures : (V, F) peak pressures at the foci of each drive [Pa], where F is the largest number
        of foci; the rows of drives with fewer foci end with NaN.
    kept : (V,) pressure at the weakest focus divided by that of the best drive of equal energy
        Σ|d|² for the same hands; 1 is ideal. To find the weakest focus, pressures are divided by
        the strengths of the foci.
    """

    indices: tuple[int, ...]
    pressures: Float64[np.ndarray, "verified most"]
    kept: Float64[np.ndarray, "verified"]

    __repr__ = in_short


def verify_session(
    session: Session, drives: int = 10, report_step: Progress = no_progress
) -> VerifiedSession:
    """Compare drives of a session with the best drives for the recorded hands.

    The recorded joints at the time of the sound replace the hand that the loop predicted, so the
    result includes the errors of prediction.

    Parameters
    ----------
    session : session, as returned by ``read_session``.
    drives : number of drives to verify, at least 1; 10 by default. They are spread evenly over the
        drives that are not silent; if there are fewer of these, all are verified. For each drive,
        the field around the hand is solved with an error of 2 %.
    report_step : function called with "drive N of M" at the start of each drive; by default,
        nothing is called.

    Returns
    -------
    A ``VerifiedSession`` with the peak pressures at the foci, and their ratio to those of the best
    drive of equal energy. Drives at times without a hand or without foci are omitted.

    Raises
    ------
    InvalidInput
        If the session contains no drive with sound, or no hand at the times of the selected drives.
    NotConverged
        If the solver stops before it converges.
    """
    scene = of_kind(session, Session, "the session", "read_session(path)").scene
    playing = np.flatnonzero(session.playing)
    if not len(playing):
        raise InvalidInput(
            "the session contains no drive with sound: record one with a hand in front of the "
            "array.",
            code="empty",
        )
    chosen = np.unique(playing[np.linspace(0, len(playing) - 1, drives).astype(int)])
    indices = []
    pressures = []
    kept = []
    for number, index in enumerate(chosen.tolist()):
        report_step(f"drive {number + 1} of {len(chosen)}")
        hands = []
        for side in SIDES if scene.both else (scene.side,):
            joints = _joints_at(session, float(session.time_in_air[index]), side)
            if joints is not None:
                hands.append(Hand(joints, radii_of(scene.radii, None, joints), side))
        if scene.both:
            foci, strengths = _touched(session, index, hands)
        else:
            foci = np.array([foci_on(hand, scene) for hand in hands]).reshape(-1, 3)
            strengths = np.ones(len(foci))
        if not hands or not len(foci):
            continue
        target = Target(foci, shares=strengths)
        body = Scene(
            scene.medium,
            [sound_hard(hand.surface) for hand in hands],
            frequency=scene.frequency,
            planes=scene.planes,
        )
        field = BoundaryElement(accuracy=0.02).radiate(body, target.beacons())
        transfer = transfer_matrix(field, scene.array)
        received = np.abs(transfer.matrix @ session.amplitudes[index])
        # For equal energy, divide each weakest pressure by the norm of its drive.
        share = (received / strengths).min() / np.linalg.norm(session.amplitudes[index])
        ideal = best(transfer, target)
        weakest = (np.abs(transfer.pressure(ideal)) / strengths).min()
        attainable = weakest / np.linalg.norm(ideal.amplitudes)
        indices.append(index)
        pressures.append(received)
        kept.append(share / attainable)
    if not indices:
        raise InvalidInput(
            f"the session shows no hand at the times of the {len(chosen)} selected drives: "
            "record a longer session.",
            code="empty",
        )
    most = max(map(len, pressures))
    table = np.array([padded(row, (most,)) for row in pressures])
    return VerifiedSession(tuple(indices), fixed(table), fixed(np.array(kept)))


def differing_tables(session: Session, setup: Setup) -> list[str]:
    """Return the names of the scene file's tables that differ between a session and a setup.

    Settings for computing the drive are ignored, because a session is evaluated with its own
    drives.
    """
    if session.text and setup.text:
        recorded = parse_scene(session.text)
        scene = parse_scene(setup.text)
        names = ("frequency", "medium", "array", "planes", "obstacles", "objects", "foci")
        return [name for name in names if getattr(recorded, name) != getattr(scene, name)]
    positions = session.scene.array.positions
    other = setup.array.positions
    same = positions.shape == other.shape and np.allclose(positions, other, atol=1e-6)
    return [] if same else ["array"]


def _touched(
    session: Session, index: int, hands: Sequence[Hand]
) -> tuple[Foci, Float64[np.ndarray, "foci"]]:
    """Return the foci (F, 3) of a drive [m], just outside the true skin, and their strengths.

    Foci with a strength of 0.05 or less are omitted, because the others mask them.
    """
    foci = []
    strengths = []
    for focus, strength in zip(session.foci[index], session.strengths[index], strict=True):
        if not strength > 0.05:  # NaN without a focus
            continue
        for hand in hands:
            # The loop only predicted the hand, so its foci are not exactly at the true skin.
            if -3e-3 < hand.shape.depth(focus[None])[0] < 5e-3:
                skin = hand.shape.project(focus[None])
                focus = (skin + 0.5e-3 * outward(hand.shape.depth, skin))[0]
        foci.append(focus)
        strengths.append(strength)
    return np.array(foci).reshape(-1, 3), np.array(strengths)


def _joints_at(session: Session, time: float, side: Side) -> Joints | None:
    """Interpolate the joints (25, 3) at a time on the frames' clock [s].

    Returns
    -------
    The joints [m]; None unless the hand was seen both before and after that time.
    """
    seen = np.isfinite(session.landmarks[:, 0, 0]) & (np.array(session.sides) == side)
    times = session.frame_time[seen]
    landmarks = session.landmarks[seen]
    after = int(np.searchsorted(times, time))
    if not 0 < after < len(times):
        return None
    share = (time - times[after - 1]) / (times[after] - times[after - 1])
    return (1.0 - share) * landmarks[after - 1] + share * landmarks[after]
