"""Rigid motions."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float64, Real

from airtact.errors import (
    InvalidInput,
    Vector,
    check_finite,
    in_short,
    number,
    point_of,
    real_numbers,
)


@dataclass(frozen=True, eq=False)
class Pose:
    """A rigid motion x -> rotation x + translation.

    The pose of an object maps coordinates in the object's frame to those in another frame, such as
    the scene's. ``apply`` moves points, and ``a @ b`` is the motion ``b`` followed by ``a``.

    Attributes
    ----------
    rotation : (3, 3) rotation matrix, applied first.
    translation : (3,) translation [m].

    Raises
    ------
    InvalidInput
        If the matrix is not a rotation (orthonormal to 1e-6, no reflection), or if a number is not
        finite.

    Examples
    --------
    >>> quarter = Pose.turn((0, 0, 1), math.pi / 2, translation=(0, 0, 1))
    >>> quarter.apply(np.array([[1.0, 0, 0]])).round(12).tolist()
    [[0.0, 1.0, 1.0]]
    """

    rotation: Real[np.ndarray, "3 3"]
    translation: Real[np.ndarray, "3"]

    __repr__ = in_short

    def __post_init__(self) -> None:
        rotation = real_numbers(self.rotation, "the pose's rotation")
        translation = real_numbers(self.translation, "the pose's translation")
        if rotation.shape != (3, 3) or translation.shape != (3,):
            raise InvalidInput(
                f"the rotation and translation of a pose have shapes {rotation.shape} and "
                f"{translation.shape}, but must have (3, 3) and (3,).",
                code="wrong_shape",
            )
        check_finite(rotation, "the pose's rotation")
        check_finite(translation, "the pose's translation")
        skew = float(np.abs(rotation.T @ rotation - np.eye(3)).max())
        # np.linalg.det would take longer than all other checks together.
        (a, b, c), (d, e, f), (g, h, i) = rotation.tolist()
        determinant = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
        if skew > 1e-6 or determinant < 0.0:
            raise InvalidInput(
                f"the pose's matrix is not a rotation: it deviates by {skew:.2g} from an "
                f"orthonormal matrix and its determinant is {determinant:.3g}. For a rotation, "
                "these numbers are 0 and 1.",
                code="wrong_kind",
            )
        object.__setattr__(self, "rotation", rotation)
        object.__setattr__(self, "translation", translation)

    @classmethod
    def identity(cls) -> "Pose":
        """Return the identity, which leaves every point in place."""
        return cls(np.eye(3), np.zeros(3))

    @classmethod
    def shift(cls, translation: Vector) -> "Pose":
        """Return the translation by a vector (3,) [m]."""
        return cls(np.eye(3), point_of(translation, "the shift"))

    @classmethod
    def between(cls, first: Vector, second: Vector) -> "Pose":
        """Return the smallest rotation that turns one direction (3,) into another.

        For opposite directions, the axis is an arbitrary perpendicular direction.
        """
        start = point_of(first, "the first direction")
        end = point_of(second, "the second direction")
        axis = np.cross(start, end)
        angle = math.atan2(float(np.linalg.norm(axis)), float(start @ end))
        if np.linalg.norm(axis) < 1e-9 * np.linalg.norm(start) * np.linalg.norm(end):
            axis = np.cross(start, np.eye(3)[np.argmin(np.abs(start))])
        return cls.turn(axis, angle)

    @classmethod
    def turn(cls, axis: Vector, angle: float, translation: Vector = (0, 0, 0)) -> "Pose":
        """Return the pose that rotates about an axis through the origin, then translates.

        Parameters
        ----------
        axis : (3,) vector of any length above zero along the axis.
        angle : right-handed angle about the axis, at most 2π in magnitude [rad].
        translation : (3,) translation after the rotation [m].

        Raises
        ------
        InvalidInput
            If the axis is zero, if a number is not real or finite, or if the angle exceeds 2π.
        """
        along = real_numbers(np.asarray(axis), "the axis of a rotation")
        angle = number(angle, "the angle of a rotation", "rad")
        if math.isfinite(angle) and abs(angle) > 2.0 * math.pi * (1.0 + 1e-9):
            raise InvalidInput(
                f"the angle of a rotation is {angle:g} rad, but at most 2π is allowed: is it in "
                f"degrees? Use np.radians({angle:g}).",
                code="out_of_range",
            )
        if along.shape != (3,):
            raise InvalidInput(
                f"the axis of a rotation has shape {along.shape}, but a direction must have shape "
                "(3,).",
                code="wrong_shape",
            )
        length = float(np.linalg.norm(along))
        if not length > 0.0:
            raise InvalidInput(
                f"the axis of a rotation has length {length:g}; use a longer vector.",
                code="all_zero",
            )
        x, y, z = along / length
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        rotation = np.eye(3) + math.sin(angle) * cross + (1.0 - math.cos(angle)) * cross @ cross
        return cls(rotation, np.asarray(translation, dtype=np.float64))

    def apply(self, points: Real[np.ndarray, "*axes 3"]) -> Float64[np.ndarray, "*axes 3"]:
        """Return the points (..., 3) [m] after the motion: rotation x + translation."""
        return self.rotate(points) + self.translation

    def rotate(self, vectors: Real[np.ndarray, "*axes 3"]) -> Float64[np.ndarray, "*axes 3"]:
        """Rotate directions (..., 3) without translating them."""
        try:
            return np.asarray(vectors, dtype=np.float64) @ self.rotation.T
        except (TypeError, ValueError):
            # Checked only after the failure, because the live loop moves points many times a second
            raise InvalidInput(
                "a pose moves points of shape (..., 3), but these have another shape or are not "
                "numbers; pass an array.",
                code="wrong_shape",
            ) from None

    def inverse(self) -> "Pose":
        """Return the inverse motion."""
        return self._inverse

    @cached_property
    def _inverse(self) -> "Pose":
        return Pose(self.rotation.T, -self.rotation.T @ self.translation)

    def __matmul__(self, first: "Pose") -> "Pose":
        """Chain two motions: ``(self @ other).apply(x) == self.apply(other.apply(x))``."""
        return Pose(self.rotation @ first.rotation, self.apply(first.translation))


def nearest_motion(
    old: Float64[np.ndarray, "points 3"], new: Float64[np.ndarray, "points 3"]
) -> tuple[Float64[np.ndarray, "3 3"], Float64[np.ndarray, "3"]]:
    """Return the rotation and translation that fit the motion of points by least squares.

    Source: W. Kabsch, Acta Cryst. A32, 922 (1976).
    """
    old_mean = old.mean(axis=0)
    new_mean = new.mean(axis=0)
    left, _, right = np.linalg.svd((new - new_mean).T @ (old - old_mean))
    # The sign of the determinant excludes mirror images.
    turn = left @ np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))]) @ right
    return turn, new_mean - turn @ old_mean
