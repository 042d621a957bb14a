"""From what a depth camera saw of a hand, and the rough landmarks of a tracker, to the hand itself."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from jaxtyping import Bool, Float64, Real
from threadpoolctl import ThreadpoolController

from airtact.conventions import InvalidInput
from airtact.hand.anatomy_parts import OWNER, PARTS
from airtact.hand.fitting.gauss_newton import Solved, followed, skin_spread, solved
from airtact.hand.fitting.normal_equations import SIZES, Seen
from airtact.hand.fitting.point_cloud import AROUND, checked_cloud, thinned
from airtact.hand.fitting.silhouette import outline
from airtact.hand.fitting.size_prior import HandAnatomy, anybody
from airtact.hand.fitting.skin_offset import EDGES, in_relief
from airtact.hand.fitting.skin_residuals import gaps_to
from airtact.hand.hand import Hand, Side
from airtact.hand.joints import BONES, FINGERS, NAMES, evidence_of, joints_of, refuse_swapped_fingers
from airtact.hand.kinematics import evenly_bent
from airtact.pose import nearest_motion
from airtact.printing import in_short
from airtact.surfaces.surface import Surface
from airtact.validation import check_finite, fixed, in_mm, of_kind, real_numbers

ROUGH = 6e-3
"""Standard deviation of each coordinate of a landmark [m]."""

BASE = 20e-3
"""That of the bases of the metacarpals where a tracker does not give them [m]."""

DEEP = 1e-3
"""Standard deviation of each coordinate of a joint that skin, however well known, leaves [m]."""

FAULTY = 30e-3
"""Landmarks farther than this from the joints that the cloud shows are no rough ones [m]."""

SLACK = 20e-3
"""By so much may the bones between rough landmarks be longer or shorter than any are [m]."""

CLEAR = 1.5
"""Sum of the sines of bends from which rough landmarks tell a left hand from a right one."""

EXPLAINED, CLOSE = 0.8, 6e-3
"""Share of the points around a hand that must be of its skin, nearer than this [m]."""

ASKED = 2000
"""Of so many of them, about, it is taken."""

BEFORE = 30e-3
"""A camera stands farther than this before what it sees [m]."""

JUMP = 25e-3
"""A hand that has moved farther since the frame before begins anew from its landmarks [m]."""


@dataclass(frozen=True, eq=False)
class FittedHand:
    """A hand found in a cloud; made by ``fit_hand``.

    Attributes
    ----------
    hand : the hand.
    anatomy : sizes of this person's hand, learned so far.
    joint_errors : (25,) standard deviation of the position of each joint [m].
    part_errors : standard deviation of the skin of each part, along its normal [m].
    points : (N, 3) points around the hand, thinned out [m].
    distances : (N,) from its skin, positive outside [m].
    strays : (N,) whether each counted for nothing.
    misfit : root mean square of the others' distances [m].
    """

    hand: Hand
    anatomy: HandAnatomy
    joint_errors: Float64[np.ndarray, "25"]
    part_errors: Mapping[str, float]
    points: Float64[np.ndarray, "points 3"]
    distances: Float64[np.ndarray, "points"]
    strays: Bool[np.ndarray, "points"]
    misfit: float

    __repr__ = in_short

    @cached_property
    def surface(self) -> Surface:
        """The closed skin of the hand, brought to the points where they show it; ``hand.surface`` is without."""
        return self._in_relief(EDGES)

    def skin(self, edge: float) -> Surface:
        """Make that skin of triangles of another size; where it would cross itself it is the body's, as ``surface``.

        Parameters
        ----------
        edge : of the triangles [m].
        """
        return self._in_relief((edge,))

    def _in_relief(self, edges: tuple[float, ...]) -> Surface:
        moved = in_relief(self.hand.shape.hulls, self.points[~self.strays], edges)
        return self.hand.surface if moved is None else moved

    def place(self, name: str) -> tuple[Float64[np.ndarray, "3"], Float64[np.ndarray, "3"]]:
        """Find a named place of the hand on ``surface`` (3,) [m] and the outward normal there (3,).

        Parameters
        ----------
        name : one of ``hand.places``.

        Raises
        ------
        InvalidInput
            As ``Hand.place``.
        """
        point, normal = self.hand.place(name)
        foot = self.surface.shape.project(point[None])[0]
        return fixed(foot), normal


def fit_hand(
    points: Real[np.ndarray, "points 3"],
    landmarks: Real[np.ndarray, "joints 3"],
    side: Side | None = None,
    camera: Real[np.ndarray, "3"] | None = None,
    before: FittedHand | None = None,
    anatomy: HandAnatomy | None = None,
) -> FittedHand:
    """Fit a hand to a cloud of points of its skin, seen from one side or many.

    The hand that explains the points best is sought with its bones' lengths, the limits of its joints, and what sizes
    people have; stray points count for nothing. What is not seen follows from these. The sizes of the person are
    learned from the first frames and then kept.

    Parameters
    ----------
    points : (N, 3) of the skin, with noise, holes and stray points [m].
    landmarks : (25, 3) rough joints in the order of WebXR, or (21, 3) in that of MediaPipe and Leap [m].
    side : ``"right"`` or ``"left"``; told from the landmarks unless given, where the fingers bend enough.
    camera : (3,) the place that all points were seen from [m]. Where it is given, points belong to skin that faces it,
        and the hand is kept out of where it looked past the hand.
    before : the frame before, whose pose is the beginning and whose anatomy is used.
    anatomy : sizes of the person, from earlier; anybody's unless given.

    Raises
    ------
    InvalidInput
        Landmarks missing, NaN, in millimetres, swapped, of the other hand or with impossible bones; a cloud that is
        tiny, in millimetres, far off, or holds another body; a camera among the points; a hand that does not explain
        the points.
    """
    joints = joints_of(landmarks, SLACK)
    refuse_swapped_fingers(joints, SLACK)
    side = _checked_side(joints, side)
    eye = None if camera is None else _checked_camera(camera)
    if before is not None:
        of_kind(before, FittedHand, "the frame before", "what fit_hand gave")
    cloud = checked_cloud(points, joints)
    if eye is not None:
        _check_camera_inside(eye, cloud)
    person = anatomy or (before.anatomy if before is not None else None)
    known = person if person is not None and person.settled else anybody(joints)
    spread = np.full(25, ROUGH)
    if len(landmarks) == 21:
        spread[[5, 10, 15, 20]] = BASE
    nothing = Seen(np.zeros((0, 3)), joints, spread, side, known, None, None)
    seen = Seen(thinned(cloud), joints, spread, side, known, eye, None if eye is None else outline(cloud, eye))
    start = _carried(before, joints) if before is not None and before.hand.side == side else None
    sizes = known.mean if person is None else person.mean
    with _threads().limit(limits=1, user_api="blas"):  # they wait for each other, the matrices being small
        if start is None:
            bent = evenly_bent(joints, np.exp(known.mean[: len(BONES)]), side)
            starts = (solved(nothing, (bent,), known.mean, hold=known.settled).joints, joints)
            found = solved(seen, starts, sizes, hold=known.settled)
        else:
            found = followed(seen, start, sizes, hold=known.settled)
        fitted = _told(seen, found, side, before, person or known)
        _check_poor(seen, fitted, cloud)
        return fitted


@cache
def _threads() -> ThreadpoolController:
    """Find the libraries whose threads can be limited, once: it takes milliseconds."""
    return ThreadpoolController()


def _told(seen: Seen, found: Solved, side: Side, before: FittedHand | None, person: HandAnatomy) -> FittedHand:
    anatomy = person if person.settled else person.learned(found.sizes, found.covariance[SIZES, SIZES])
    keyframe = None if before is None else before.hand.shape.keyframe
    hand = Hand(fixed(found.joints), fixed(found.radii), side, keyframe)
    by_joint = np.diag(found.covariance)[:75].reshape(25, 3).sum(axis=1)
    spread = skin_spread(found)
    owner = np.r_[OWNER, np.full(len(PARTS) - len(OWNER), len(FINGERS))]
    parts = {
        name: float(np.sqrt(np.mean(spread[owner == index] ** 2))) for index, name in enumerate((*FINGERS, "palm"))
    }
    strays = found.weights == 0.0
    return FittedHand(
        hand,
        anatomy,
        fixed(np.sqrt(by_joint + 3.0 * DEEP**2)),
        parts,
        fixed(seen.points),
        fixed(found.gaps.distance),
        strays,
        float(np.sqrt(np.mean(found.gaps.distance[~strays] ** 2))),
    )


def _checked_side(joints: Float64[np.ndarray, "25 3"], side: Side | None) -> Side:
    if side is not None and side not in ("right", "left"):
        raise InvalidInput(f"the side of a hand is {side!r}, but there are 2: 'right' and 'left'.")
    evidence = evidence_of(joints)
    seen = "right" if evidence > 0.0 else "left"
    if side is None and abs(evidence) < CLEAR:
        raise InvalidInput(
            f"the landmarks do not tell a left hand from a right one ({evidence:+.2f}, beyond {CLEAR:g} they would); "
            "give side."
        )
    if side is not None and seen != side and abs(evidence) > CLEAR:
        raise InvalidInput(
            f"the landmarks are said to be of a {side} hand, but the fingers bend and the thumb points as those of a "
            f"{seen} one ({evidence:+.2f}, above 0 being right): are they mirrored?"
        )
    return side or seen


def _checked_camera(camera: Real[np.ndarray, "3"]) -> Float64[np.ndarray, "3"]:
    eye = real_numbers(camera, "the place of the camera")
    if eye.shape != (3,):
        raise InvalidInput(f"the place of the camera has shape {eye.shape}, but it is 3 numbers, in metres.")
    check_finite(eye, "the place of the camera")
    return eye


def _carried(before: FittedHand, joints: Float64[np.ndarray, "25 3"]) -> Float64[np.ndarray, "25 3"] | None:
    """Move the hand of the frame before rigidly to new landmarks, or None where these have another pose."""
    turn, shift = nearest_motion(before.hand.joints, joints)
    moved = before.hand.joints @ turn.T + shift
    return moved if np.linalg.norm(moved - joints, axis=1).max() < JUMP else None


def _check_poor(seen: Seen, fitted: FittedHand, cloud: Float64[np.ndarray, "near 3"]) -> None:
    some = cloud[:: max(len(cloud) // ASKED, 1)]
    used = float((np.abs(gaps_to(some, fitted.hand.shape.hulls, seen.camera).distance) < CLOSE).mean())
    elsewhere = "" if seen.camera is None else ", or does the camera stand elsewhere"
    if used < EXPLAINED:
        raise InvalidInput(
            f"the hand explains {100 * used:.0f} % to {1e3 * CLOSE:g} mm of the {len(cloud)} points within "
            f"{1e3 * AROUND:g} mm of the landmarks: is there a second hand or another body, or are the landmarks of "
            f"another moment{elsewhere}?"
        )
    off = np.linalg.norm(fitted.hand.joints - seen.landmarks, axis=1)
    worst = int(np.where(seen.spread > ROUGH, 0.0, off).argmax())
    if off[worst] > FAULTY and seen.spread[worst] <= ROUGH:
        raise InvalidInput(
            f"the landmark {NAMES[worst]} is {1e3 * off[worst]:.3g} mm from where the cloud shows that joint, and "
            f"rough ones are within {1e3 * FAULTY:g} mm: are landmarks swapped{elsewhere}?",
            seen.landmarks[worst],
        )


def _check_camera_inside(camera: Float64[np.ndarray, "3"], cloud: Float64[np.ndarray, "near 3"]) -> None:
    sight = np.median(cloud, axis=0) - camera
    ahead = (cloud - camera) @ sight / max(float(np.linalg.norm(sight)), BEFORE)
    if ahead.min() < BEFORE:
        raise InvalidInput(
            f"the camera stands at {in_mm(camera)}, and {(ahead < BEFORE).sum()} of {len(cloud)} points lie beside it, "
            f"behind it or less than {1e3 * BEFORE:g} mm before it: give the place they were seen from, in metres.",
            camera,
        )
