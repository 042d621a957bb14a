"""Pose of a tracker in a scene, found by touching known points with a fingertip."""

from collections import deque
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64, Real
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from airtact.errors import InvalidInput, between, fixed, in_short, points_of
from airtact.geometry.pose import Pose, nearest_motion
from airtact.hands.joints import GENERIC_RADII, TRACKED
from airtact.hands.tracking.frame import HandFrame

Points = Float64[np.ndarray, "touches 3"]

# Index of the tip of the index finger among the 25 joints of WebXR.
INDEX_TIP = 9


@dataclass(frozen=True, eq=False)
class Registration:
    """Pose of a tracker and its uncertainty, as returned by ``register``.

    ``register`` fits the pose to T touches of known points, such as transducers, with a fingertip.

    Attributes
    ----------
    tracker : pose that maps the tracker's coordinates, multiplied by ``scale``, to those of the
        scene.
    scale : factor by which the tracker's lengths are multiplied before the pose is applied; 1
        unless another factor was given or fitted.
    offset : distance between the joint in the fingertip and a touched face [m], given or fitted.
    residuals : (T,) distance of each touch, after the fit, from its point shifted outward by
        ``offset`` [m].
    position_error : standard deviation of the position at the middle of the touched points, in the
        least certain direction [m].
    angle_error : standard deviation of the rotation about the least certain axis [rad].
    repeat : index of the touch to repeat, because it contradicts all others and was excluded from
        the fit; None if all touches agree.
    likely_scale : scale at which the residuals (rms) would be less than 0.4 times as large; None if
        no scale reduces them that much, if they are at most 0.5 mm, if the scale was fitted, or if
        the pose is fitted to fewer than 5 touches.
    """

    tracker: Pose
    scale: float
    offset: float
    residuals: Float64[np.ndarray, "touches"]
    position_error: float
    angle_error: float
    repeat: int | None = None
    likely_scale: float | None = None

    __repr__ = in_short


def register(
    touched: Real[np.ndarray, "touches 3"],
    points: Real[np.ndarray, "touches 3"],
    normals: Real[np.ndarray, "touches 3"],
    *,
    offset: float | None = float(GENERIC_RADII[INDEX_TIP]),
    scale: float | None = 1.0,
) -> Registration:
    """Find the pose of a hand tracker in a scene, given touches of a fingertip at known points.

    The pose is fitted by least squares. A touch is an outlier if, after a fit to all other touches,
    its distance from its point is more than 2 mm and more than 5 times the rms distance of the
    other touches. At most one touch is excluded as an outlier, and only if there are more than 3
    touches (plus one for each of ``offset`` and ``scale`` that is None); ``Registration.repeat`` is
    its index.

    Parameters
    ----------
    touched : (T, 3) positions of the fingertip's joint in the tracker's frame [m], at least 3.
    points : (T, 3) points of the scene that were touched, in the order of ``touched`` [m]. They
        must not lie on a line: at least one must be about 20 mm or more from the line through the
        others.
    normals : (T, 3) unit normals of the touched faces in the frame of the scene, toward the finger.
    offset : distance between the joint and a touched face [m], 0 to 0.05; 6.6 mm by default,
        the radius of a generic index fingertip. If None, it is determined from the touches, which
        requires faces in different directions.
    scale : factor by which to multiply the tracker's lengths, 1 by default; None determines it from
        the touches.

    Returns
    -------
    A ``Registration`` that contains the pose ``tracker``, its standard deviations
    ``position_error`` and ``angle_error``, and the ``residuals`` of all touches. The pose maps the
    tracker's coordinates, multiplied by ``scale``, to those of the scene.

    Raises
    ------
    InvalidInput
        If there are fewer than 3 touches, if the touches, points and normals differ in number, if
        the points lie on one line, if the offset is outside its range or cannot be distinguished
        from a shift of the tracker, or if the rms of the residuals is more than 10 mm and no single
        touch is the cause.

    Examples
    --------
    >>> corners = np.array([[0.0, 0.0, 0.0], [0.2, 0.0, 0.0], [0.0, 0.1, 0.0], [0.2, 0.1, 0.0]])
    >>> up = np.tile([0.0, 0.0, 1.0], (4, 1))
    >>> camera = Pose.turn((1, 0, 0), np.pi, translation=(0, 0, 0.5))
    >>> seen = camera.inverse().apply(corners + 7e-3 * up)
    >>> register(seen, corners, up, offset=7e-3).tracker.translation[2].round(6)
    np.float64(0.5)
    """
    touched = points_of(touched, "touches")
    points = points_of(points, "touched points")
    normals = points_of(normals, "normals of touched faces")
    if not len(touched) == len(points) == len(normals):
        raise InvalidInput(
            f"there are {len(touched)} touches of {len(points)} points with {len(normals)} "
            "normals; pass one position and one normal per touch.",
            code="sizes_differ",
        )
    if offset is not None:
        between(offset, 0.0, 0.05, "the offset of the fingertip's joint", "m")
    used = np.ones(len(points), dtype=bool)
    fit, rms = _fitted(touched, points, normals, used, offset, scale)
    if len(points) > 3 + (scale is None) + (offset is None):
        fits = {}
        for index in range(len(points)):
            others = used.copy()
            others[index] = False
            with suppress(InvalidInput):  # without this touch, the others are not enough
                fits[index] = _fitted(touched, points, normals, others, offset, scale)
        best = min(fits, key=lambda index: fits[index][1])
        without, rms_without = fits[best]
        # The error of a touch that agrees is below 3 times the root mean square of the others.
        if without.residuals[best] > max(2e-3, 5.0 * rms_without):
            fit = replace(without, repeat=best)
            rms = rms_without
            used[best] = False
    if scale is not None and used.sum() > 4:
        scaled, scaled_rms = _fitted(touched, points, normals, used, offset, None)
        if scaled_rms < 0.4 * rms and rms > 0.5e-3:
            fit = replace(fit, likely_scale=scaled.scale)
    if rms > 10e-3:
        raise InvalidInput(
            f"the touches contradict each other by {1e3 * rms:.0f} mm: repeat all of them, in "
            "the order of the points.",
            code="pose_not_found",
        )
    return fit


def _fitted(
    touched: Points,
    points: Points,
    normals: Points,
    used: np.ndarray,
    offset: float | None,
    scale: float | None,
) -> tuple[Registration, float]:
    """Fit the pose to the touches in the mask ``used``; also return their rms residual [m]."""
    middle = touched[used].mean(axis=0)
    goals = points + (0.0 if offset is None else offset) * normals
    spread = np.linalg.svd(goals[used] - goals[used].mean(axis=0), compute_uv=False)
    if used.sum() < 3 or spread[1] < 0.02:
        raise InvalidInput(
            "there are fewer than 3 touched points, or they lie on one line; touch other points, "
            "at least 20 mm off the line.",
            code="too_few",
        )
    first, _ = nearest_motion(touched[used], goals[used])
    start = goals[used].mean(axis=0)

    # The unknowns are a small rotation about the middle [rad], its position [m], and the optional
    # scale and offset [m]. All of them are changes from the start.
    def unpacked(unknowns: np.ndarray) -> tuple[np.ndarray, np.ndarray, float, float]:
        rotation = Rotation.from_rotvec(unknowns[:3]).as_matrix() @ first
        fitted_scale = 1.0 + unknowns[6] if scale is None else scale
        fitted_offset = float(unknowns[-1]) if offset is None else offset
        return rotation, start + unknowns[3:6], float(fitted_scale), fitted_offset

    def deviations(unknowns: np.ndarray) -> Points:
        rotation, place, fitted_scale, fitted_offset = unpacked(unknowns)
        moved = fitted_scale * (touched - middle) @ rotation.T + place
        return moved - points - fitted_offset * normals

    count = 6 + (scale is None) + (offset is None)
    solved = least_squares(lambda unknowns: deviations(unknowns)[used].ravel(), np.zeros(count))
    jacobian = solved.jac
    # Columns of rotation and scale are lengths and the others have no unit, so they are scaled.
    lengths = np.linalg.norm(jacobian, axis=0)
    if np.linalg.svd(jacobian / lengths, compute_uv=False)[-1] < 0.05:
        raise InvalidInput(
            "the touched faces have nearly the same direction, so the offset of the fingertip "
            "cannot be distinguished from the distance of the tracker. Set the offset, or touch "
            "faces that point in other directions.",
            code="data_missing",
        )
    freedom = 3 * int(used.sum()) - count
    variance = 2.0 * solved.cost / max(freedom, 1)
    covariance = variance * np.linalg.inv(jacobian.T @ jacobian)
    rotation, place, fitted_scale, fitted_offset = unpacked(solved.x)
    return Registration(
        Pose(rotation, place - fitted_scale * rotation @ middle),
        fitted_scale,
        fitted_offset,
        fixed(np.linalg.norm(deviations(solved.x), axis=1)),
        float(np.sqrt(np.linalg.eigvalsh(covariance[3:6, 3:6])[-1])),
        float(np.sqrt(np.linalg.eigvalsh(covariance[:3, :3])[-1])),
    ), float(np.sqrt(2.0 * solved.cost / used.sum()))


class RestingFingertip:
    """Detector that finds when and where the tip of the index finger rests for a second.

    Use it to register a tracker by touching known points, such as transducers. Call ``take`` with
    each ``HandFrame``. The method returns None until the tip has rested, and then the mean position
    (3,) of the joint "index-finger-tip" in the coordinates of the frames [m]. The tip rests if it
    stays within 15 mm along each axis and does not drift by more than about 2 mm. The timer
    restarts if the tip moves, if the hand is lost, or if frames are 0.3 s or more apart. The next
    rest is only accepted after the tip has moved by 30 mm.

    Attributes
    ----------
    share : time for which the tip has already rested, as a fraction of the required second; 0 to 1.
    """

    def __init__(self) -> None:
        self._window: deque[tuple[float, np.ndarray]] = deque()
        self._last: np.ndarray | None = None
        self.share = 0.0

    def take(self, frame: HandFrame) -> Float64[np.ndarray, "3"] | None:
        """Process a frame, and return the mean position (3,) [m] of the tip after a second of rest.

        The result is None until the tip has rested for a second. The next rest is accepted only
        after the tip has moved by 30 mm.
        """
        if frame.landmarks is None:
            self._window.clear()
            self.share = 0.0
            return None
        tips = {25: INDEX_TIP, 21: int(np.flatnonzero(TRACKED == INDEX_TIP)[0])}
        tip = frame.landmarks[tips[len(frame.landmarks)]]
        if self._last is not None:
            if np.linalg.norm(tip - self._last) < 30e-3:
                return None
            self._last = None
        if self._window and not 0.0 < frame.time - self._window[-1][0] < 0.3:
            self._window.clear()
        self._window.append((frame.time, tip))
        # Start again at the latest frame after which the tip is at rest.
        while not self._rests():
            self._window.popleft()
        self.share = min(frame.time - self._window[0][0], 1.0)
        if self.share < 1.0:
            return None
        place = np.mean([position for _, position in self._window], axis=0)
        self._window.clear()
        self._last = place
        self.share = 0.0
        return place

    def _rests(self) -> bool:
        """Return whether noise of 3 mm can explain all motion of the tip."""
        places = np.array([position for _, position in self._window])
        half = len(places) // 2
        if half == 0:
            return True
        drift = np.linalg.norm(places[:half].mean(axis=0) - places[half:].mean(axis=0))
        # Drift is measured between means, so that noise averages out.
        near = bool((np.ptp(places, axis=0) < 15e-3).all())
        return near and float(drift) < 2e-3 + 4e-3 / half
