"""Fit a hand to the point cloud of a depth camera and to inaccurate tracker landmarks."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float64, Real
from scipy.spatial import KDTree

from airtact.acoustics.uncertainty import Uncertainty
from airtact.errors import (
    InvalidInput,
    counted,
    fixed,
    in_mm,
    in_short,
    millimetres,
    of_kind,
    point_of,
    points_of,
)
from airtact.geometry.mesh.triangles import unit as unit_rows
from airtact.geometry.pose import nearest_motion
from airtact.geometry.surface import Surface
from airtact.hands.body import Hulls
from airtact.hands.fitting.gauss_newton import (
    Observation,
    Solution,
    best_hand,
    next_hand,
    skin_residuals,
)
from airtact.hands.fitting.priors import (
    JOINTS,
    RADII,
    SIZES,
    HandAnatomy,
    Sizes,
    joints_in,
    population_prior,
)
from airtact.hands.fitting.silhouette import silhouette_of
from airtact.hands.hand import Hand
from airtact.hands.joints import (
    BONES,
    CHAINS,
    NAMES,
    Joints,
    PerPoint,
    Place,
    Point,
    Points,
    Side,
    check_finger_order,
    checked_side,
    joints_of,
    unit,
)
from airtact.hands.kinematics import evenly_bent
from airtact.hands.skin_mesh import even_skin
from airtact.timing import Progress, no_progress, one_thread

# Standard deviation of each coordinate of a landmark [m].
LANDMARK_SPREAD = 6e-3

# Tolerance of the lengths of bones between landmarks [m].
LANDMARK_TOLERANCE = 20e-3

# Smallest number of points of a cloud.
MIN_POINTS = 200

# Points farther than this from all bones are not part of the hand [m].
HAND_RADIUS = 45e-3


@dataclass(frozen=True, eq=False)
class FittedHand:
    """A hand fitted to a point cloud, as returned by ``fit_hand``.

    Attributes
    ----------
    hand : the fitted ``Hand``, in the frame of the cloud.
    anatomy : sizes of the person's hand, learned from the frames so far. Pass it, or this object,
        to the next call of ``fit_hand``.
    joint_errors : (25,) standard deviation of the position of each joint in WebXR order [m]: the
        root of the summed variances of its three coordinates, at least 1.7 mm.
    points : (N, 3) points of the cloud near the landmarks, averaged in cubes of 4 mm, in the frame
        of the cloud [m].
    distances : (N,) distances of these points from the fitted skin [m], positive outside.
    outliers : (N,) mask of the points that the fit ignored as outliers.
    misfit : root mean square distance of the points, without outliers, from the skin [m].
    """

    hand: Hand
    anatomy: HandAnatomy
    joint_errors: Float64[np.ndarray, "25"]
    points: Points
    distances: PerPoint
    outliers: Bool[np.ndarray, "points"]
    misfit: float

    __repr__ = in_short

    @property
    def uncertainty(self) -> Uncertainty:
        """Uncertainty of the hand: each bone shifts independently by the joints' rms error."""
        return Uncertainty(own_position=float(np.sqrt(np.mean(self.joint_errors**2) / 3.0)))

    @cached_property
    def surface(self) -> Surface:
        """The closed skin, shifted to the points of the cloud."""
        # Smaller triangles are less likely to cross between close fingers.
        return self.skin(3.5e-3, 2.5e-3)

    def skin(self, *edges: float) -> Surface:
        """Return the skin, meshed with the first of ``edges`` [m] for which no triangles cross.

        If triangles cross at all these edge lengths, ``hand.surface`` is returned, without the
        offset to the points.
        """
        moved = with_offset(self.hand.shape.hulls, self.points[~self.outliers], edges)
        return self.hand.surface if moved is None else moved

    def place(self, name: str) -> Place:
        """Return the position (3,) [m] and normal (3,) of one of ``hand.places`` on ``surface``.

        Raises
        ------
        InvalidInput
            If the name is unknown, or the position is inside the body because a finger touches it.
        """
        point, normal = self.hand.place(name)
        return fixed(self.surface.shape.project(point[None])[0]), normal


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
    """Fit a hand to a point cloud of its skin, measured from one or more directions.

    The fit minimises the distances of the points from the skin of a sphere mesh (Tkach, Pauly,
    Tagliasacchi, ACM Trans. Graph. 35, 222 (2016)) under priors: constant bone lengths, joint
    limits and the distribution of hand sizes. Outliers get no weight. Parts of the hand without
    points are determined by the priors. To fit several frames of one hand, pass each result as
    ``before`` of the next call: the sizes of the person's hand are then learned from the first
    8 frames, and stay fixed afterwards.

    Parameters
    ----------
    points : (N, 3) points of the skin, with noise, holes and outliers [m]. At least 200 must be
        within 45 mm of the bones between the landmarks; others, and those of the forearm, are
        ignored.
    landmarks : (25, 3) joints in WebXR order, or (21, 3) in MediaPipe and Leap order, in the frame
        of the points [m]. They may be wrong by several millimetres, but not by more than 30.
    side : ``"right"`` or ``"left"``; by default it is inferred from the landmarks if the fingers
        bend enough.
    camera : (3,) position of the camera that saw all points, in the frame of the points [m]. Points
        are then matched only to skin that faces the camera, and the hand stays within the observed
        silhouette. Omit it if the points were measured from several directions.
    before : result for the previous frame. Its pose is the initial guess if a rigid motion
        brings all of its joints to within 25 mm of the landmarks. Its anatomy is used unless
        ``anatomy`` is given.
    anatomy : sizes of the person's hand, from an earlier fit. They stay fixed if they were learned
        from 8 frames; otherwise they are initial values, and learning continues. The default is the
        anatomy of ``before``, or the distribution of all hands if there is no previous frame.
    progress : function called with a description of each step as it begins.

    Returns
    -------
    A ``FittedHand`` that contains the hand in the frame of the points, its closed skin, the
    standard deviations of the joints and the sizes learned so far.

    Raises
    ------
    InvalidInput
        If landmarks are missing, NaN, in millimetres, swapped or implausible, if the side is
        unclear, if a point is less than 30 mm in front of the camera, if less than 80 % of the
        points are within 6 mm of the fitted hand, or if a joint is more than 30 mm from its
        landmark. The error is also raised if the cloud has too few points near the landmarks, is in
        millimetres, or has more than 30 % of its points elsewhere, for example on another body.
    """
    joints = joints_of(landmarks, LANDMARK_TOLERANCE)
    check_finger_order(joints, LANDMARK_TOLERANCE)
    # Inaccurate landmarks distinguish a left hand from a right one only if the fingers bend
    # clearly.
    side = checked_side(joints, side, "landmarks", min_evidence=0.8)
    if before is not None:
        of_kind(before, FittedHand, "the frame before", "a result of fit_hand")
    cloud = _checked_cloud(points, joints)
    eye = None if camera is None else _checked_camera(camera, cloud)
    # A settled anatomy is the prior. An anatomy that is still being learned only sets initial
    # sizes.
    person = anatomy or (None if before is None else before.anatomy)
    prior = person if person is not None and person.settled else population_prior(joints)
    spread = np.full(25, LANDMARK_SPREAD)
    if len(landmarks) == 21:
        spread[[5, 10, 15, 20]] = 20e-3  # bases of the metacarpals, which trackers do not see
    seen = Observation(
        cell_means(cloud),
        joints,
        spread,
        side,
        prior,
        eye,
        None if eye is None else silhouette_of(cloud, eye),
    )
    start = _start_from(before, joints) if before is not None and before.hand.side == side else None
    person = person or prior
    with one_thread():  # the matrices are too small for several threads
        end, covariance = _solved(seen, start, person.mean, progress or no_progress)
        if not person.settled:
            person = person.learned(end.unknowns[SIZES], covariance[SIZES, SIZES])
        # No joint under skin is located to better than 1 mm in each coordinate.
        variance = np.diag(covariance)[JOINTS].reshape(25, 3).sum(axis=1) + 3.0 * 1e-3**2
        distances = fixed(end.residuals.distance)
        outliers = end.weights == 0.0
        fitted = FittedHand(
            Hand(
                fixed(joints_in(end.unknowns)),
                fixed(np.exp(end.unknowns[RADII])),
                side,
                None if before is None else before.hand.shape.keyframe,
            ),
            person,
            joint_errors=fixed(np.sqrt(variance)),
            points=fixed(seen.points),
            distances=distances,
            outliers=outliers,
            misfit=float(np.sqrt(np.mean(distances[~outliers] ** 2))),
        )
        _check_explained(seen, fitted, cloud)
        return fitted


def _start_from(before: FittedHand, joints: Joints) -> Joints | None:
    """Move the previous frame's hand to new landmarks; return None if the pose differs much."""
    turn, shift = nearest_motion(before.hand.joints, joints)
    moved = before.hand.joints @ turn.T + shift
    return moved if np.linalg.norm(moved - joints, axis=1).max() < 25e-3 else None


def _solved(
    seen: Observation, start: Joints | None, sizes: Sizes, report_step: Progress
) -> Solution:
    prior = seen.anatomy
    cloud = counted(len(seen.points), "point", "points")
    if start is not None:
        report_step(f"moving the hand of the previous frame to {cloud}")
        return next_hand(seen, start, sizes, hold=prior.settled)
    report_step("fitting a hand to the landmarks")
    no_points = replace(seen, points=np.zeros((0, 3)), camera=None, silhouette=None)
    bent = evenly_bent(seen.landmarks, np.exp(prior.mean[: len(BONES)]), seen.side)
    # The landmarks alone are fitted first, because the finger of each point is still unknown.
    first, _ = best_hand(no_points, (bent,), prior.mean, hold=prior.settled)
    report_step(f"fitting it to {cloud}")
    return best_hand(seen, (joints_in(first.unknowns), seen.landmarks), sizes, hold=prior.settled)


def _check_explained(seen: Observation, fitted: FittedHand, cloud: Points) -> None:
    # A sample of 2000 points is enough to test for a share of 80 %.
    sampled = cloud[:: max(len(cloud) // 2000, 1)]
    residuals = skin_residuals(sampled, fitted.hand.shape.hulls, seen.camera)
    explained = float((np.abs(residuals.distance) < 6e-3).mean())
    hint = "" if seen.camera is None else ", and that the position of the camera is correct"
    if explained < 0.8:
        raise InvalidInput(
            f"only {100 * explained:.0f} % of the {len(cloud)} points within "
            f"{1e3 * HAND_RADIUS:g} mm of the landmarks are within 6 mm of the fitted hand. Check "
            f"that the cloud contains only one hand, in the same frame as the landmarks{hint}.",
            code="pose_not_found",
        )
    off = np.linalg.norm(fitted.hand.joints - seen.landmarks, axis=1)
    # Joints that the tracker does not provide were only estimated.
    off[seen.spread > LANDMARK_SPREAD] = 0.0
    worst = int(off.argmax())
    if off[worst] > 30e-3:
        raise InvalidInput(
            f"the landmark {NAMES[worst]} is {millimetres(off[worst], 3)} from the "
            "corresponding joint of the fitted hand (at most 30 mm is allowed). Check that no "
            f"landmarks are swapped{hint}.",
            seen.landmarks[worst],
            code="misplaced",
        )


def _checked_camera(camera: Real[np.ndarray, "3"], cloud: Points) -> Point:
    eye = point_of(camera, "the position of the camera")
    sight = np.median(cloud, axis=0) - eye
    # This is the depth along the line of sight to the middle of the cloud.
    ahead = (cloud - eye) @ sight / max(float(np.linalg.norm(sight)), 30e-3)
    if ahead.min() < 30e-3:
        raise InvalidInput(
            f"the camera is at {in_mm(eye)}, but {(ahead < 30e-3).sum()} of {len(cloud)} points "
            "are beside it, behind it or less than 30 mm in front of it; pass the position of the "
            "camera in metres.",
            eye,
            code="misplaced",
        )
    return eye


# --- the cloud --------------------------------------------------------------------------------


def _checked_cloud(
    points: Real[np.ndarray, "points 3"], joints: Joints
) -> Float64[np.ndarray, "near 3"]:
    """Return the points of a cloud (N, 3) [m] near the inaccurate joints of a hand."""
    cloud = points_of(points, "points of a cloud", least=0)
    if len(cloud) < MIN_POINTS:
        raise InvalidInput(
            f"the cloud has {counted(len(cloud), 'point', 'points')}; use at least {MIN_POINTS} "
            "points of a hand.",
            code="too_few",
        )
    largest = np.abs(cloud).max(axis=1)
    if largest.max() > 1e6:
        raise InvalidInput(
            f"point {largest.argmax()} of the cloud has a coordinate of {largest.max():.3g} m: "
            "use metres, and remove points that the camera did not see.",
            code="out_of_range",
        )
    distance = _distance_to_bones(cloud, joints)
    # The model has no forearm, so points behind the wrist near its axis are ignored.
    along = unit(joints[0] - joints[[6, 11, 16, 21]].mean(axis=0))
    behind = (cloud - joints[0]) @ along
    beside = np.linalg.norm(cloud - joints[0] - behind[:, None] * along, axis=1)
    forearm = (behind > 8e-3) & (beside < 70e-3)
    near = (distance < HAND_RADIUS) & ~forearm
    if near.sum() < MIN_POINTS:
        usual = float(np.median(distance))
        # If the cloud matches the landmarks after scaling by 0.001, it is in millimetres.
        if (_distance_to_bones(1e-3 * cloud, joints) < HAND_RADIUS).mean() > 0.5:
            raise InvalidInput(
                f"the cloud is {usual:.4g} m from the landmarks: is it in millimetres? Use metres.",
                code="not_in_metres",
            )
        raise InvalidInput(
            f"only {near.sum()} of {len(cloud)} points are within {1e3 * HAND_RADIUS:g} mm of the "
            f"landmarks (median distance {1e3 * usual:.4g} mm); use the same frame for points and "
            "landmarks.",
            code="misplaced",
        )
    elsewhere = ~near & ~forearm
    if elsewhere.mean() > 0.3:  # too many for outliers
        middle = np.median(cloud[elsewhere], axis=0)
        raise InvalidInput(
            f"{elsewhere.sum()} of {len(cloud)} points are more than {1e3 * HAND_RADIUS:g} mm "
            f"from the landmarks, with their median at {in_mm(middle)}: are they a second hand or "
            "the background? Remove these points.",
            middle,
            code="given_twice",
        )
    return cloud[near]


def _distance_to_bones(points: Points, joints: Joints) -> PerPoint:
    lines = np.array([(*ends, -1) for ends in (*BONES, *pairwise(chain[1] for chain in CHAINS))])
    return Hulls.unblended(np.column_stack([joints, np.zeros(25)]), lines).look(points).distance


def cell_means(points: Points, cell: float = 4e-3) -> Float64[np.ndarray, "fewer 3"]:
    """Return the mean of the points (N, 3) in each cube with edges of length ``cell`` [m].

    Cubes with few points are omitted as outliers. To reduce the influence of outliers, only points
    near the central point of a cube are averaged.
    """
    cubes = np.floor((points - points.min(axis=0)) / cell).astype(np.int64)
    # Each cube is encoded as one integer, so that ``unique`` sorts numbers instead of rows.
    wide = cubes.max(axis=0) + 1
    keys = (cubes[:, 0] * wide[1] + cubes[:, 1]) * wide[2] + cubes[:, 2]
    _, cube, count = np.unique(keys, return_inverse=True, return_counts=True)
    mean = np.column_stack([np.bincount(cube, column) / count for column in points.T])
    off = np.linalg.norm(points - mean[cube], axis=1)
    # Points are sorted by cube, then by distance from its mean, so the nearest is the first one.
    first = np.lexsort((off, cube))[np.r_[0, np.cumsum(count)[:-1]]]
    close = np.linalg.norm(points - points[first][cube], axis=1) < 3e-3
    sums = [np.bincount(cube[close], column, len(first)) for column in points[close].T]
    mean = np.column_stack(sums) / np.bincount(cube[close], minlength=len(first))[:, None]
    return mean[count >= 0.2 * np.median(count)]


# --- the skin ---------------------------------------------------------------------------------


def with_offset(hulls: Hulls, points: Points, edges: Sequence[float]) -> Surface | None:
    """Return a body's skin moved toward measured points (N, 3), or None if triangles cross.

    Each vertex moves along its normal by the mean distance of nearby points from the skin. The
    model and the real hand differ by 0.5 to 2 mm, which matters at a wavelength of 8.6 mm. The skin
    is meshed with the first of the edge lengths ``edges`` [m] for which its triangles do not cross.
    """
    for edge in edges:
        skin = even_skin(hulls, edge)
        look = hulls.look(skin.vertices)
        normals = unit_rows(look.gradient)
        # The offset is limited to a small share of the gap to other parts and of the bend radius.
        room = 0.3 * np.minimum(look.facing, np.abs(look.bend))
        limit = np.minimum(1.5e-3, np.maximum(room, 0.0))
        move = np.clip(_mean_offset(hulls, points, skin.vertices, normals), -limit, limit)
        for _ in range(3):
            surface = Surface(skin.vertices + move[:, None] * normals, skin.triangles)
            if len(surface.crossings) == 0:
                return surface
            # The skin near crossings is not moved.
            crossed = skin.vertices[skin.triangles[surface.crossings.ravel()].ravel()]
            move[KDTree(crossed).query(skin.vertices)[0] < 8e-3] = 0.0
    return None


def _mean_offset(
    hulls: Hulls,
    points: Points,
    vertices: Float64[np.ndarray, "vertices 3"],
    normals: Float64[np.ndarray, "vertices 3"],
) -> Float64[np.ndarray, "vertices"]:
    """Return the mean distance [m] of the points from the body near each vertex of its skin.

    The kernel average (E. A. Nadaraya, Theory Probab. Appl. 9, 141 (1964)) includes only points
    with a similar normal. It also includes an offset of 0, with the weight of one point.
    """
    width = 5e-3  # standard deviation of the weights
    look = hulls.look(points)
    near = np.flatnonzero(np.abs(look.distance) < 3e-3)
    outward = unit_rows(look.gradient[near])
    pairs = KDTree(vertices).sparse_distance_matrix(
        KDTree(points[near]), 2.5 * width, output_type="ndarray"
    )
    vertex = pairs["i"]
    point = pairs["j"]
    alike = np.maximum(np.einsum("pi,pi->p", normals[vertex], outward[point]), 0.0) ** 2
    weight = alike * np.exp(-0.5 * (pairs["v"] / width) ** 2)
    total = np.bincount(vertex, weight, len(vertices)) + 1.0
    return np.bincount(vertex, weight * look.distance[near][point], len(vertices)) / total
