"""Fit a hand to the points that a depth camera saw and to the rough landmarks of a tracker."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float64, Real

from airtact.acoustics.uncertainty import Uncertainty
from airtact.checks import check_finite, counted, fixed, in_mm, of_kind, real_numbers
from airtact.errors import InvalidInput
from airtact.geometry.pose import nearest_motion
from airtact.geometry.surface import Surface
from airtact.hands.anatomy_parts import OWNER, PARTS
from airtact.hands.fitting.gauss_newton import HandEstimate, best_hand, next_hand, skin_spread
from airtact.hands.fitting.normal_equations import Observation, skin_residuals
from airtact.hands.fitting.point_cloud import AROUND, cell_means, checked_cloud
from airtact.hands.fitting.silhouette import silhouette_of
from airtact.hands.fitting.size_prior import HandAnatomy, population_prior
from airtact.hands.fitting.skin_offset import EDGES, with_offset
from airtact.hands.fitting.unknowns import JOINTS, SIZES
from airtact.hands.hand import Hand
from airtact.hands.joints import (
    BONES,
    FINGERS,
    NAMES,
    Side,
    check_finger_order,
    checked_side,
    joints_of,
)
from airtact.hands.kinematics import evenly_bent
from airtact.printing import in_short
from airtact.timing import Progress, no_progress, one_thread


@dataclass(frozen=True, eq=False)
class FittedHand:
    """A hand found in a cloud; made by ``fit_hand``.

    Attributes
    ----------
    hand : the hand.
    anatomy : sizes of this person's hand, learned so far.
    joint_errors : (25,) standard deviation of the position of each joint [m].
    part_errors : standard deviation of the skin of each part, along its normal [m].
    points : (N, 3) means of the cloud in cells around the hand [m].
    distances : (N,) of these from its skin, positive outside [m].
    outliers : (N,) whether each had no weight in the fit.
    misfit : root mean square of the distances of the others [m].
    """

    hand: Hand
    anatomy: HandAnatomy
    joint_errors: Float64[np.ndarray, "25"]
    part_errors: Mapping[str, float]
    points: Float64[np.ndarray, "points 3"]
    distances: Float64[np.ndarray, "points"]
    outliers: Bool[np.ndarray, "points"]
    misfit: float

    __repr__ = in_short

    @property
    def uncertainty(self) -> Uncertainty:
        """What is in doubt after the fit: each bone by itself, by the root mean square of the joints' errors."""
        return Uncertainty(own_position=float(np.sqrt(np.mean(self.joint_errors**2) / 3.0)))

    @cached_property
    def surface(self) -> Surface:
        """The closed skin of the hand, moved to the points of the cloud; ``hand.surface`` is not moved."""
        return self._with_offset(EDGES)

    def skin(self, edge: float) -> Surface:
        """Make that skin of triangles of another edge [m]; where it would cross itself, it is ``hand.surface``."""
        return self._with_offset((edge,))

    def _with_offset(self, edges: tuple[float, ...]) -> Surface:
        moved = with_offset(self.hand.shape.hulls, self.points[~self.outliers], edges)
        return self.hand.surface if moved is None else moved

    def place(self, name: str) -> tuple[Float64[np.ndarray, "3"], Float64[np.ndarray, "3"]]:
        """Find one of ``hand.places`` on ``surface`` (3,) [m] and the outward unit normal there, as ``Hand.place``."""
        point, normal = self.hand.place(name)
        return fixed(self.surface.shape.project(point[None])[0]), normal


ROUGH = 6e-3
"""Standard deviation of each coordinate of a landmark [m]."""

BASE = 20e-3
"""That of the bases of the metacarpals where a tracker does not give them [m]."""

CLEAR = 1.5
"""Sum of the sines of bends from which rough landmarks distinguish a left hand from a right one."""

SLACK = 20e-3
"""By so much may the bones between rough landmarks be longer or shorter than any are [m]."""


def fit_hand(
    points: Real[np.ndarray, "points 3"],
    landmarks: Real[np.ndarray, "joints 3"],
    side: Side | None = None,
    camera: Real[np.ndarray, "3"] | None = None,
    before: FittedHand | None = None,
    anatomy: HandAnatomy | None = None,
    *,
    progress: Progress | None = None,
) -> FittedHand:
    """Fit a hand to a cloud of points of its skin, seen from one side or many.

    The fit minimises the distances of the points from the skin of a sphere mesh (Tkach, Pauly,
    Tagliasacchi, ACM Trans. Graph. 35, 222 (2016)) under priors: constant bone lengths, limits of
    joints and the sizes of people. Outliers have no weight; what the points do not show follows
    from the priors. The sizes of the person are learned from the first 8 frames and then kept.

    Parameters
    ----------
    points : (N, 3) of the skin, with noise, holes and outliers [m].
    landmarks : (25, 3) rough joints in the order of WebXR, or (21, 3) in that of MediaPipe and Leap
        [m].
    side : ``"right"`` or ``"left"``; found from the landmarks unless given, where the fingers bend
        enough.
    camera : (3,) the position that all points were seen from [m]. Where it is given, points belong
        to skin that faces it, and the hand stays within the silhouette that it saw.
    before : the fit of the previous frame, whose pose is the start; its anatomy is used unless
        ``anatomy`` is given.
    anatomy : sizes of the person from an earlier fit; those of the population if neither this nor
        ``before`` is given.
    progress : called with the words of each step as it begins.

    Raises
    ------
    InvalidInput
        If landmarks are missing, NaN, in millimetres, swapped or impossible; the side is unclear; the cloud is tiny, in
        millimetres, far off or holds another body; the camera is among the points; or the hand does not match them.
    """
    joints = joints_of(landmarks, SLACK)
    check_finger_order(joints, SLACK)
    side = checked_side(joints, side, "landmarks", CLEAR)
    if before is not None:
        of_kind(before, FittedHand, "the frame before", "what fit_hand gave")
    cloud = checked_cloud(points, joints)
    eye = None if camera is None else _checked_camera(camera, cloud)
    person = anatomy or (before.anatomy if before is not None else None)
    known = person if person is not None and person.settled else population_prior(joints)
    spread = np.full(25, ROUGH)
    if len(landmarks) == 21:
        spread[[5, 10, 15, 20]] = BASE
    silhouette = None if eye is None else silhouette_of(cloud, eye)
    seen = Observation(cell_means(cloud), joints, spread, side, known, eye, silhouette)
    start = _carried(before, joints) if before is not None and before.hand.side == side else None
    sizes = known.mean if person is None else person.mean
    with one_thread():  # threads would wait for each other, the matrices being small
        found = _found(seen, start, sizes, progress or no_progress)
        fitted = _fitted(seen, found, before, person or known)
        _check_explained(seen, fitted, cloud)
        return fitted


def _found(
    seen: Observation,
    start: Float64[np.ndarray, "25 3"] | None,
    sizes: Float64[np.ndarray, "62"],
    report_step: Progress,
) -> HandEstimate:
    """Find the hand of a cloud from the frame before, or, where that gives no start, from the landmarks alone."""
    known, cloud = seen.anatomy, counted(len(seen.points), "point", "points")
    if start is not None:
        report_step(f"moving the hand of the frame before to {cloud}")
        return next_hand(seen, start, sizes, hold=known.settled)
    report_step("fitting a hand to the landmarks")
    nothing = replace(seen, points=np.zeros((0, 3)), camera=None, silhouette=None)
    bent = evenly_bent(seen.landmarks, np.exp(known.mean[: len(BONES)]), seen.side)
    starts = (best_hand(nothing, (bent,), known.mean, hold=known.settled).joints, seen.landmarks)
    report_step(f"fitting it to {cloud}")
    return best_hand(seen, starts, sizes, hold=known.settled)


DEEP = 1e-3
"""Standard deviation of each coordinate of a joint under skin, however well that is known [m]."""


def _fitted(
    seen: Observation, found: HandEstimate, before: FittedHand | None, person: HandAnatomy
) -> FittedHand:
    anatomy = (
        person if person.settled else person.learned(found.sizes, found.covariance[SIZES, SIZES])
    )
    keyframe = None if before is None else before.hand.shape.keyframe
    hand = Hand(fixed(found.joints), fixed(found.radii), seen.side, keyframe)
    by_joint = np.diag(found.covariance)[JOINTS].reshape(25, 3).sum(axis=1)
    spread = skin_spread(found)
    owner = np.r_[OWNER, np.full(len(PARTS) - len(OWNER), len(FINGERS))]
    parts = (*FINGERS, "palm")
    part_errors = {
        name: float(np.sqrt(np.mean(spread[owner == index] ** 2)))
        for index, name in enumerate(parts)
    }
    joint_errors = fixed(np.sqrt(by_joint + 3.0 * DEEP**2))
    distances, outliers = fixed(found.residuals.distance), found.weights == 0.0
    misfit = float(np.sqrt(np.mean(distances[~outliers] ** 2)))
    return FittedHand(
        hand, anatomy, joint_errors, part_errors, fixed(seen.points), distances, outliers, misfit
    )


JUMP = 25e-3
"""A hand that has moved farther since the frame before starts anew from its landmarks [m]."""


def _carried(
    before: FittedHand, joints: Float64[np.ndarray, "25 3"]
) -> Float64[np.ndarray, "25 3"] | None:
    """Move the hand of the frame before rigidly to new landmarks; None where these have another pose."""
    turn, shift = nearest_motion(before.hand.joints, joints)
    moved = before.hand.joints @ turn.T + shift
    return moved if np.linalg.norm(moved - joints, axis=1).max() < JUMP else None


EXPLAINED, CLOSE = 0.8, 6e-3
"""Share of the points around a hand that must lie on its skin, within this distance [m]."""

ASKED = 2000
"""About so many of them are evaluated."""

FAULTY = 30e-3
"""Landmarks farther than this from the joints that the cloud shows are faulty and not rough [m]."""


def _check_explained(
    seen: Observation, fitted: FittedHand, cloud: Float64[np.ndarray, "near 3"]
) -> None:
    some = cloud[:: max(len(cloud) // ASKED, 1)]
    used = float(
        (np.abs(skin_residuals(some, fitted.hand.shape.hulls, seen.camera).distance) < CLOSE).mean()
    )
    elsewhere = "" if seen.camera is None else ", or does the camera stand elsewhere"
    if used < EXPLAINED:
        raise InvalidInput(
            f"the hand explains {100 * used:.0f} % to {1e3 * CLOSE:g} mm of the {len(cloud)} points within "
            f"{1e3 * AROUND:g} mm of the landmarks: is there a second hand or another body, or are the landmarks of "
            f"another moment{elsewhere}?",
            code="pose_not_found",
        )
    off = np.linalg.norm(fitted.hand.joints - seen.landmarks, axis=1)
    worst = int(np.where(seen.spread > ROUGH, 0.0, off).argmax())
    if off[worst] > FAULTY and seen.spread[worst] <= ROUGH:
        raise InvalidInput(
            f"the landmark {NAMES[worst]} is {1e3 * off[worst]:.3g} mm from where the cloud shows that joint, and "
            f"rough ones are within {1e3 * FAULTY:g} mm: are landmarks swapped{elsewhere}?",
            seen.landmarks[worst],
            code="misplaced",
        )


BEFORE = 30e-3
"""A camera stands farther than this before what it sees [m]."""


def _checked_camera(
    camera: Real[np.ndarray, "3"], cloud: Float64[np.ndarray, "near 3"]
) -> Float64[np.ndarray, "3"]:
    what = "the position of the camera"
    eye = real_numbers(camera, what)
    if eye.shape != (3,):
        raise InvalidInput(
            f"{what} has shape {eye.shape}, but it is 3 numbers, in metres.", code="wrong_shape"
        )
    check_finite(eye, what)
    sight = np.median(cloud, axis=0) - eye
    ahead = (cloud - eye) @ sight / max(float(np.linalg.norm(sight)), BEFORE)
    if ahead.min() < BEFORE:
        raise InvalidInput(
            f"the camera stands at {in_mm(eye)}, and {(ahead < BEFORE).sum()} of {len(cloud)} points lie beside it, "
            f"behind it or less than {1e3 * BEFORE:g} mm before it: give the place they were seen from, in metres.",
            eye,
            code="misplaced",
        )
    return eye
