"""Extended Kalman filter of an articulated hand: a rigid palm, and bones of constant lengths.

The state has 86 degrees of freedom: translation and rotation of the palm, 7 rotations of each
finger's joints, and the shape. The shape consists of 15 bone lengths and 10 positions of joints in
the palm. The shape hardly changes, so it is learned from the first second of frames, together with
any constant error of the tracker's landmarks. The palm and the main turns also have rates and
accelerations. The accelerations are random and decay within 0.2 s. All other degrees of freedom are
constant except for a slow random walk.

The state is stored as the 25 joints, the rates and the accelerations. The covariance describes
small changes of the degrees of freedom from this state, about the present axes of the joints.

Sources
-------
- R. A. Singer, "Estimating optimal tracking filter performance for manned maneuvering targets",
  IEEE Trans. Aerosp. Electron. Syst. AES-6, 473 (1970): random accelerations that decay.
- Y. Bar-Shalom, X. R. Li, T. Kirubarajan, *Estimation with Applications to Tracking and
  Navigation*, Wiley 2001: section 6.2.3, noise of an acceleration in short steps (equation
  6.2.3-9); section 10.3.2, the extended Kalman filter.
- R. M. Murray, Z. Li, S. S. Sastry, *A Mathematical Introduction to Robotic Manipulation*, CRC
  Press 1994: section 3.4.1, the velocity of a point as the sum over its joints' twists.
"""

import numpy as np
from jaxtyping import Float64, Int64
from scipy.linalg import solve_triangular
from scipy.spatial.transform import Rotation

from airtact.hands.joints import Joints, crossed
from airtact.hands.kinematics import OUTER_JOINTS, finger_bones

# Joints of the palm, which include the roots of the fingers.
PALM = np.setdiff1d(np.arange(25), OUTER_JOINTS[:, 1:])

# Degrees of freedom of the finger joints (5 fingers, 7 each), of the bone lengths (5, 3), and of
# the joints of the palm (10, 3). The first six are the shift and turn of the palm.
TURNS = slice(6, 41)
LENGTHS = slice(41, 56)
PALM_JOINTS = slice(56, 86)
COUNT = 86

# Joint of the finger to which each of its 7 turns belongs: bend, spread and twist of the root, bend
# and spread of the middle joint and of the last joint.
LEVELS = np.array([0, 0, 0, 1, 1, 2, 2])
USED_AXES = [0, 1, 2, 3, 4, 6, 7]
BENDS = TURNS.start + 7 * np.arange(5)[:, None] + np.array([3, 5])

# Standard deviation of the acceleration for an agility of 1 m/s²: shift of the palm [m/s²], its
# turn, and turns of joints [rad/s²]. A degree of freedom without acceleration has no rate.
ACCELERATIONS = np.array(
    [1.0] * 6
    + [9.0, 1.0, 0.0, 5.0, 0.0, 4.0, 0.0]  # thumb
    + 4 * [9.0, 0.5, 0.0, 5.0, 0.0, 4.0, 0.0]  # other fingers
    + [0.0] * 45
)
MOVING = np.flatnonzero(ACCELERATIONS)
# Rows of the rates and of the accelerations in the covariance.
RATES = COUNT + np.arange(len(MOVING))
SECOND_RATES = RATES + len(MOVING)
# Time after which an acceleration is forgotten [s].
MEMORY = 0.2

# Random walk of the remaining turns [rad²/s] and of the shape [m²/s].
WALKS = np.where(ACCELERATIONS > 0.0, 0.0, np.where(np.arange(COUNT) < LENGTHS.start, 1e-3, 1e-8))

# Result of ``finger_bones``, and the axes of all joint turns.
Bones = tuple[
    Float64[np.ndarray, "5 3 3"],
    Float64[np.ndarray, "5 3"],
    Float64[np.ndarray, "5 3 3"],
    Float64[np.ndarray, "5 7 3"],
]

# The palm (0) and each finger (1 to 5) have their own agility: group of each joint and each rate.
GROUPS = np.zeros(25, dtype=np.int64)
GROUPS[OUTER_JOINTS[:, 1:]] = np.arange(1, 6)[:, None]
RATE_GROUPS = np.where(MOVING < 6, 0, 1 + (MOVING - TURNS.start) // 7)


def _moved_joints() -> Float64[np.ndarray, "25 1 dofs"]:
    """Return a matrix with 1 where a degree of freedom moves a joint, and 0 elsewhere."""
    moved = np.zeros((25, COUNT))
    moved[:, :6] = 1.0
    for finger, joints in enumerate(OUTER_JOINTS):
        for turn, level in enumerate(LEVELS):
            moved[joints[level + 1 :], TURNS.start + 7 * finger + turn] = 1.0
        for bone in range(3):
            moved[joints[bone + 1 :], LENGTHS.start + 3 * finger + bone] = 1.0
    for index, joint in enumerate(PALM):
        # A finger moves together with its root.
        roots = joint == OUTER_JOINTS[:, 0]
        start = PALM_JOINTS.start + 3 * index
        moved[[joint, *OUTER_JOINTS[roots].ravel()], start : start + 3] = 1.0
    return moved[:, None]


MOVED = _moved_joints()


class ArticulatedHand:
    """Extended Kalman filter of a hand; a copy can be advanced to predict the hand.

    For each frame, call ``advance`` with its time, then ``update`` with its landmarks.

    Parameters
    ----------
    time : time of the first frame [s].
    joints : (25, 3) joints in the first frame [m].
    side : ``"left"`` or ``"right"``.
    noise : standard deviation of each coordinate of the landmarks [m].
    agility : standard deviation of the palm's acceleration [m/s²]. The standard deviations of the
        joints' accelerations are proportional to it.

    Attributes
    ----------
    time : time of the estimate [s].
    joints : (25, 3) estimated joints [m].
    rates : (26,) rates of the degrees of freedom ``MOVING`` [m/s, rad/s].
    accelerations : (26,) accelerations of the degrees of freedom ``MOVING`` [m/s², rad/s²].
    covariance : (138, 138) covariance of the degrees of freedom, the rates and the accelerations.
    """

    def __init__(
        self,
        time: float,
        joints: Joints,
        side: str,
        noise: float,
        agility: float,
    ) -> None:
        self.time = time
        self.joints = np.array(joints, dtype=np.float64)
        self.rates = np.zeros(len(MOVING))
        self.accelerations = np.zeros(len(MOVING))
        self._side = side
        self._agilities = np.full(6, agility)
        # Variance of the error of the frames' times [s²], time of the last frame [s], mean step
        # between frames [s] and its variance [s²]. The first frames may be 5 ms off.
        self._time_variance = 5e-3**2
        self._updated = time
        self._step = 1 / 60
        self._uneven = 2.0 * 5e-3**2
        # Joints of the last call of ``_bones``, and its result.
        self._known: tuple[Joints, Bones] | None = None
        # By definition, the palm's pose and the twists of the fingers are exact in the first frame.
        # The remaining 75 degrees of freedom are as uncertain as the 75 coordinates.
        twists = TURNS.start + 7 * np.arange(5) + 2
        free = np.setdiff1d(np.arange(6, COUNT), twists)
        inverse = noise * np.linalg.inv(self._slopes().reshape(75, COUNT)[:, free])
        # Standard deviations of the rates in the first frame: 0.5 m/s for shifts and 4 rad/s.
        rates = np.where(MOVING < 3, 0.5, 4.0)
        deviations = np.concatenate([np.zeros(COUNT), rates, agility * ACCELERATIONS[MOVING]])
        self.covariance = np.diag(deviations**2)
        self.covariance[np.ix_(free, free)] = inverse @ inverse.T

    def joints_at(self, time: float) -> Joints:
        """Return the joints [m] extrapolated to a time, with all bends limited to their range."""
        step = time - self.time
        change = np.zeros(COUNT)
        change[MOVING] = step * self.rates + _shares(step)[0] * self.accelerations
        # Middle and last joints bend by -20 to 120 degrees, or as far as they already do.
        along, _, hinges, _ = self._bones()
        sines = np.sum(crossed(along[:, :-1], along[:, 1:]) * hinges[:, 1:], axis=2)
        bends = np.arctan2(sines, np.sum(along[:, :-1] * along[:, 1:], axis=2))
        low = np.minimum(bends, np.radians(-20.0))
        high = np.maximum(bends, np.radians(120.0))
        change[BENDS] = np.clip(bends + change[BENDS], low, high) - bends
        return self._changed(change)

    def advance(self, time: float) -> None:
        """Extrapolate the estimate to ``time`` [s]."""
        self.joints = self.joints_at(time)
        step = time - self.time
        self.time = time
        of_shift, of_rate, remaining = _shares(step)
        self.rates = self.rates + of_rate * self.accelerations
        self.accelerations = remaining * self.accelerations
        # Rows first, then columns. A degree of freedom changes before the rate that changes it.
        for covariance in (self.covariance, self.covariance.T):
            covariance[MOVING] += step * covariance[RATES] + of_shift * covariance[SECOND_RATES]
            covariance[RATES] += of_rate * covariance[SECOND_RATES]
            covariance[SECOND_RATES] *= remaining
        # Noise that keeps the variance of the accelerations.
        noise = 2.0 / MEMORY * (self._agilities[RATE_GROUPS] * ACCELERATIONS[MOVING]) ** 2
        size = abs(step)
        parts = (MOVING, RATES, SECOND_RATES)
        orders = (size**2 / 2.0, step, 1.0)
        for first, row in enumerate(parts):
            for second, column in enumerate(parts):
                share = orders[first] * orders[second] * size / (5 - first - second)
                self.covariance[row, column] += share * noise
        self.covariance[np.arange(COUNT), np.arange(COUNT)] += size * WALKS

    def update(
        self,
        landmarks: Float64[np.ndarray, "landmarks 3"],
        seen: Int64[np.ndarray, "landmarks"],
        noise: float,
        common: float,
        agility: float,
    ) -> None:
        """Update the estimate with a measurement made at the time of the estimate.

        Parameters
        ----------
        landmarks : (N, 3) measured joints [m].
        seen : (N,) indices of the measured joints.
        noise : standard deviation of the independent error of each coordinate [m].
        common : standard deviation of the error common to all joints [m].
        agility : smallest standard deviation that the filter assumes for the palm's acceleration
            [m/s²].
        """
        slopes = self._slopes()[seen].reshape(-1, COUNT)
        surprise = (landmarks - self.joints[seen]).ravel()
        mixed = slopes @ self.covariance[:COUNT]
        expected = mixed[:, :COUNT] @ slopes.T
        if common > 0.0:
            expected += common**2 * np.tile(np.eye(3), (len(seen), len(seen)))
        # At least 1 µm, so that rounding errors do not matter.
        expected += max(noise, 1e-6) ** 2 * np.eye(len(expected))
        # An error of the frame's time shifts all joints along their velocities. Its variance is
        # learned from frames of a fast hand, and cannot exceed that of the uneven steps in time.
        velocity = slopes[:, MOVING] @ self.rates
        square = float(velocity @ velocity) + 1e-12
        late = float(np.clip(velocity @ surprise / square, -0.03, 0.03))
        without = float(velocity @ expected @ velocity) / square**2
        share = 0.1 * (3e-3**2 / (3e-3**2 + without)) ** 2
        self._time_variance += share * (late**2 - without - self._time_variance)
        step = self.time - self._updated
        self._updated = self.time
        self._step += 0.1 * (step - self._step)
        self._uneven += 0.1 * ((step - self._step) ** 2 - self._uneven)
        self._time_variance = float(np.clip(self._time_variance, 0.0, 0.5 * self._uneven))
        expected += self._time_variance * np.outer(velocity, velocity)
        # The gain is the product of two triangular factors, which takes half the time.
        lower = np.linalg.cholesky(expected)
        scaled = solve_triangular(lower, mixed, lower=True, check_finite=False)
        change = scaled.T @ solve_triangular(lower, surprise, lower=True, check_finite=False)
        self.covariance -= scaled.T @ scaled
        self.covariance = 0.5 * (self.covariance + self.covariance.T)
        self.joints = self._changed(change[:COUNT])
        self.rates = self.rates + change[RATES]
        self.accelerations = self.accelerations + change[SECOND_RATES]
        # The agility of a part rises if its motion is less predictable than expected, or else
        # falls.
        excess = (surprise**2 / np.diag(expected)).reshape(-1, 3).mean(axis=1) - 1.0
        groups = GROUPS[seen]
        of_groups = np.bincount(groups, excess) / np.bincount(groups)
        self._agilities *= np.exp(0.05 * np.minimum(of_groups, 4.0))
        self._agilities = np.clip(self._agilities, agility, 10.0 * agility)

    def joint_covariance(self) -> Float64[np.ndarray, "75 75"]:
        """Return the covariance (75, 75) of the coordinates of all joints [m²]."""
        slopes = self._slopes().reshape(75, COUNT)
        return slopes @ self.covariance[:COUNT, :COUNT] @ slopes.T

    def _bones(self) -> Bones:
        joints = self.joints
        if self._known is not None and self._known[0] is joints:
            return self._known[1]
        along, lengths, hinges = finger_bones(joints, self._side)
        axes = np.stack([hinges, crossed(along, hinges), along], axis=2)
        axes = axes.reshape(5, 9, 3)[:, USED_AXES]
        self._known = (joints, (along, lengths, hinges, axes))
        return self._known[1]

    def _slopes(self) -> Float64[np.ndarray, "25 3 dofs"]:
        joints = self.joints
        along, _, _, axes = self._bones()
        axes = np.concatenate([np.eye(3), axes.reshape(-1, 3)])
        centre = joints[PALM].mean(axis=0)
        roots = joints[OUTER_JOINTS[:, LEVELS]].reshape(-1, 3)
        origins = np.concatenate([[centre, centre, centre], roots])
        slopes = np.empty((25, 3, COUNT))
        slopes[:, :, :3] = np.eye(3)
        arms = joints[:, None] - origins
        slopes[:, :, 3 : TURNS.stop] = np.swapaxes(crossed(axes[None], arms), 1, 2)
        slopes[:, :, LENGTHS] = along.reshape(-1, 3).T
        slopes[:, :, PALM_JOINTS] = np.tile(np.eye(3), 10)
        return slopes * MOVED

    def _changed(self, change: Float64[np.ndarray, "dofs"]) -> Joints:
        """Return the joints after a change of their degrees of freedom and of bone lengths."""
        along, lengths, _, axes = self._bones()
        lengths = lengths + change[LENGTHS].reshape(5, 3)
        vectors = change[TURNS].reshape(5, 7, 1) * axes
        vectors = np.add.reduceat(vectors, [0, 3, 5], axis=1).reshape(-1, 3)
        turns = Rotation.from_rotvec(np.vstack([change[3:6], vectors])).as_matrix()
        turn = turns[0]
        turns = turns[1:].reshape(5, 3, 3, 3)
        first = turn @ turns[:, 0]
        second = first @ turns[:, 1]
        turned = np.stack([first, second, second @ turns[:, 2]], axis=1) @ along[..., None]
        palm = self.joints[PALM]
        centre = palm.mean(axis=0)
        joints = np.empty((25, 3))
        joints[PALM] = (palm - centre) @ turn.T + centre + change[:3]
        joints[PALM] += change[PALM_JOINTS].reshape(10, 3)
        bones = np.cumsum(lengths[..., None] * turned[..., 0], axis=1)
        joints[OUTER_JOINTS[:, 1:]] = joints[OUTER_JOINTS[:, :1]] + bones
        return joints


def _shares(step: float) -> tuple[float, float, float]:
    """Return the factors of an acceleration in a shift [s²] and a rate [s], and of its decay."""
    remaining = float(np.exp(-step / MEMORY))
    of_rate = MEMORY * (1.0 - remaining)
    return MEMORY * (step - of_rate), of_rate, remaining
