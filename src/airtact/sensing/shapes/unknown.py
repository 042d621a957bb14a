"""Bodies whose shape is known up to some numbers."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64, Real

from airtact.acoustics.scene import Scene, sound_hard
from airtact.checks import check_finite, counted, fixed, positive, real_numbers
from airtact.errors import InvalidInput
from airtact.geometry.primitives import Capsule, capsule, turn_from_z
from airtact.printing import one_line

STEP = 0.02
"""Step of the differences by which a number moves a surface, in its standard deviations."""


@dataclass(frozen=True, eq=False)
class UnknownShape:
    """Sound-hard bodies whose shape depends on some numbers that are known only roughly.

    Attributes
    ----------
    scene_of : makes the bodies from the numbers (K,), in a frame of their own.
    expected : (K,) the most probable numbers.
    deviations : (K,) standard deviations: how far off each may be, in its own unit.

    Raises
    ------
    InvalidInput
        "wrong_shape", "not_finite", "out_of_range": of the numbers; or as ``scene_of`` for the expected ones.

    Examples
    --------
    >>> import airtact as at
    >>> def ball(numbers):
    ...     return at.Scene(at.air(celsius=20.0), [at.sound_hard(at.sphere(numbers[0], 1e-3))], frequency=40e3)
    >>> UnknownShape(ball, np.array([5e-3]), np.array([1e-3]))
    UnknownShape(1 number, 1 body)
    """

    scene_of: Callable[[Float64[np.ndarray, "numbers"]], Scene]
    expected: Real[np.ndarray, "numbers"]
    deviations: Real[np.ndarray, "deviations"]

    def __post_init__(self) -> None:
        """Check the numbers."""
        expected, deviations = (
            real_numbers(given, what)
            for given, what in (
                (self.expected, "expected numbers"),
                (self.deviations, "deviations"),
            )
        )
        if expected.ndim != 1 or expected.shape != deviations.shape or not len(expected):
            raise InvalidInput(
                f"the expected numbers have shape {expected.shape} and their deviations {deviations.shape}: give (K,) "
                "of each, one or more.",
                code="wrong_shape",
            )
        check_finite(np.stack([expected, deviations]), "expected numbers and deviations")
        if (worst := float(deviations.min())) <= 0.0:
            raise InvalidInput(
                f"the deviation of number {int(deviations.argmin())} is {worst:g}, but it must be above zero: leave "
                "numbers that are known out.",
                code="out_of_range",
            )
        object.__setattr__(self, "expected", fixed(expected))
        object.__setattr__(self, "deviations", fixed(deviations))
        for index, one in enumerate(self.scene.obstacles):
            if one.boundary != "sound_hard":
                raise InvalidInput(
                    f"obstacle {index} is {one.kind}, but the shape of sound-hard bodies alone is found from echoes.",
                    code="not_supported",
                )

    @classmethod
    def of_capsules(cls, scene: Scene, ends: float = 3e-3, radius: float = 1e-3) -> "UnknownShape":
        """Take both ends and the radius of each capsule of a scene as unknown: seven numbers each [m].

        Of a sphere these are its centre and its radius, four numbers.

        Parameters
        ----------
        scene : of capsules and spheres alone, such as the fingers of ``pinch``; the expected shape.
        ends, radius : standard deviations of each coordinate of an end and of a radius [m].

        Raises
        ------
        InvalidInput
            "wrong_kind": a body is no capsule.
        """
        ends, radius = (
            positive(ends, "the deviation of ends", "m"),
            positive(radius, "the deviation of radii", "m"),
        )
        parts, by = [], []
        for index, one in enumerate(scene.obstacles):
            shape = one.surface.shape
            if not isinstance(shape, Capsule):
                raise InvalidInput(
                    f"body {index} of {len(scene.obstacles)} is no capsule, whose ends and radius could be found; give "
                    "UnknownShape the function that makes your bodies from numbers.",
                    code="wrong_kind",
                )
            half = 0.5 * shape.length * shape.pose.rotation[:, 2]
            places = [shape.pose.translation - half, shape.pose.translation + half][
                : 2 if shape.length else 1
            ]
            parts.append(np.concatenate([*places, [shape.radius]]))
            by.append(np.append(np.full(3 * len(places), ends), radius))
        edge = min(float(one.surface.edge_lengths.max()) for one in scene.obstacles)
        starts = np.cumsum([len(one) for one in parts])[:-1]

        def scene_of(numbers: Float64[np.ndarray, "numbers"]) -> Scene:
            made = [
                capsule(one[:3], one[-4:-1], float(one[-1]), edge)
                for one in np.split(numbers, starts)
            ]
            return replace(scene, obstacles=[sound_hard(one) for one in made])

        return cls(scene_of, np.concatenate(parts), np.concatenate(by))

    def __repr__(self) -> str:
        numbers = counted(len(self.expected), "number", "numbers")
        return one_line(self, numbers, counted(len(self.scene.obstacles), "body", "bodies"))

    @property
    def scene(self) -> Scene:
        """The bodies of the expected numbers."""
        return self.scene_of(np.array(self.expected))

    def shifts(
        self, numbers: Float64[np.ndarray, "numbers"], points: Float64[np.ndarray, "points 3"]
    ) -> Float64[np.ndarray, "points numbers"]:
        """How far each number moves the surfaces outward at points on them [m per unit], by differences."""
        out = np.empty((len(points), len(numbers)))
        for index, step in enumerate(STEP * self.deviations):
            by = np.zeros(len(numbers))
            by[index] = step
            deeper = self.scene_of(numbers + by).depth(points) - self.scene_of(numbers - by).depth(
                points
            )
            out[:, index] = deeper / (2.0 * step)
        return out


def carried_by_capsules(
    points: Float64[np.ndarray, "points 3"], before: Scene, after: Scene
) -> Float64[np.ndarray, "points 3"]:
    """Move points with the capsule that each is nearest to, from the capsules of one scene to those of another.

    A point keeps its distance from the skin, its share of the way along the axis and its side of
    it.
    """
    pairs = zip(before.obstacles, after.obstacles, strict=True)
    depths = np.stack([one.surface.depth(points) for one in before.obstacles])
    out = np.empty_like(points)
    for body, (one, other) in enumerate(pairs):
        old, new = one.surface.shape, other.surface.shape
        assert isinstance(old, Capsule)  # of UnknownShape.of_capsules
        assert isinstance(new, Capsule)
        for index in np.flatnonzero(depths.argmax(axis=0) == body):
            local = old.pose.inverse().apply(points[index][None])[0]
            along = float(np.clip(local[2], -0.5 * old.length, 0.5 * old.length))
            away = local - [0.0, 0.0, along]
            distance = float(np.linalg.norm(away))
            turn = (
                turn_from_z(new.pose.rotation[:, 2])
                @ turn_from_z(old.pose.rotation[:, 2]).T
                @ old.pose.rotation
            )
            axis = (
                new.pose.translation
                + along * (new.length / max(old.length, 1e-9)) * new.pose.rotation[:, 2]
            )
            out[index] = axis + turn @ away * (distance + new.radius - old.radius) / distance
    return out
