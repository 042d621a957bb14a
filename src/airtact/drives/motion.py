"""Foci that move along paths: lateral and spatiotemporal modulation of several foci at once, along the skin.

Lateral modulation runs each focus along a small path around its position. With the same largest
amplitude it is felt stronger than amplitude modulation, for circles at 10 to 200 Hz (R. Takahashi,
K. Hasegawa, H. Shinoda, IEEE Trans. Haptics 13, 334, 2020). Spatiotemporal modulation draws a shape
with a focus; it is felt strongest where the focus is as fast as the waves on the skin, at 5 to 8
m/s (W. Frier et al., EuroHaptics 2018, 270).
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float64, Real

from airtact.acoustics.scene import Scene
from airtact.acoustics.target import Target
from airtact.acoustics.target_points import MAX_OFFSET, frame_of, onto_surface, outward
from airtact.checks import counted, of_kind, positive
from airtact.drives.methods import MakeDrive, best
from airtact.drives.sequence import FEWEST, Sequence, sequence_through
from airtact.drives.transfer import TransferMatrix
from airtact.errors import InvalidInput

LATERAL_FREQUENCY = 50.0
"""Rounds a second of lateral modulation: about the middle, in octaves, of the 10 to 200 Hz of Takahashi and others."""

LATERAL_RADIUS = 3e-3
"""Radius of its circle [m], which a finger pad holds (T. Morisaki et al., arXiv 2301.11572)."""

DRAWING_SPEED = 7.0
"""Speed of a focus that draws a shape [m/s], between the 5 and 8 m/s of Frier and others."""

LARGEST_SIZE = 0.1
"""Largest radius or length of a path [m]: the foci leave any hand beyond it."""

DRAWING_RADIUS = 10e-3
"""Radius of a circle that is drawn around a single focus [m]."""

FRAMES = 16
"""Positions on a path around a focus."""

MOST_FRAMES = 1024
"""As many as an AUTD3 board keeps."""

PATHS, ALONG = ("circle", "line", "points"), ("skin", "array")
"""The words that a motion takes."""

Kind = Literal["lm", "stm"]
Path = Literal["circle", "line", "points"]
Along = Literal["skin", "array"]

Paths = Float64[np.ndarray, "foci frames 3"]


@dataclass(frozen=True)
class Motion:
    """How the foci of a target move.

    Attributes
    ----------
    kind : "lm", lateral modulation, or "stm", spatiotemporal modulation; it chooses the defaults of
        the others.
    path : "circle" or "line" around each focus, or "points": one focus runs through the target's
        points in their order and back to the first. By default a circle for "lm", for "stm" the
        points where there are 2 or more.
    size : radius of the circle or length of the line [m]; by default 3 mm for "lm" (a line: 6 mm),
        10 mm for "stm".
    frequency : rounds a second [Hz]; by default 50 Hz for "lm", and 7 m/s along the path for "stm".
    frames : positions on a path around a focus.
    along : "skin", where a path lies in the surface nearest the focus, at its distance from it, or
        "array", in the plane across the direction to the array's middle. By default the skin where
        it is within 20 mm.

    Raises
    ------
    InvalidInput
        If a word is none of these, a number is not above zero, there are under 4 or over 1024 frames, or a size or
        frames are given for the points of the target, which have their own.
    """

    kind: Kind
    path: Path | None = None
    size: float | None = None
    frequency: float | None = None
    frames: int | None = None
    along: Along | None = None

    def __post_init__(self) -> None:
        words = {"kind": ("lm", "stm"), "path": PATHS, "along": ALONG}
        for name, known in words.items():
            value = getattr(self, name)
            if value not in known and not (value is None and name != "kind"):
                raise InvalidInput(
                    f"the {name} of a motion is {value!r}, but it must be one of {len(known)}: {', '.join(known)}.",
                    code="unknown_name",
                )
        for name, unit in (("size", "m"), ("frequency", "Hz")):
            if getattr(self, name) is not None:
                object.__setattr__(
                    self, name, positive(getattr(self, name), f"the {name} of a motion", unit)
                )
        if self.size is not None and self.size > LARGEST_SIZE:
            raise InvalidInput(
                f"the radius or length of a path is {self.size:g} m, but a path over a hand has {LARGEST_SIZE:g} m at "
                "most; is this in millimetres?",
                code="out_of_range",
            )
        if self.frames is not None and not FEWEST <= self.frames <= MOST_FRAMES:
            raise InvalidInput(
                f"a path has {FEWEST} to {MOST_FRAMES} frames, not {self.frames}.",
                code="sizes_differ",
            )
        given = [name for name in ("size", "frames", "along") if getattr(self, name) is not None]
        if self.path == "points" and given:
            raise InvalidInput(
                f"{given[0]} = {getattr(self, given[0])} does not go with the points of the target, which have their "
                "own: leave it out.",
                code="options_clash",
            )
        if self.path == "points" and self.kind == "lm":
            raise InvalidInput(
                'lateral modulation runs around each of the foci, so its path is one of 2: circle or line; "points" '
                'goes with kind "stm".',
                code="unknown_name",
            )

    def through_points(self, foci: int) -> bool:
        """Whether one focus runs through the points of a target that has so many."""
        return self.path == "points" or (self.kind == "stm" and self.path is None and foci > 1)

    def paths(self, scene: Scene, target: Target, array_middle: Real[np.ndarray, "3"]) -> Paths:
        """Return the positions of each focus of a target, frame by frame [m].

        Parameters
        ----------
        scene : the bodies along which the paths lie.
        target : the foci.
        array_middle : (3,) the middle of the array [m].

        Returns
        -------
        (F, N, 3) a circle begins to the right of its focus, a line at its middle; a line runs to and fro.

        Raises
        ------
        InvalidInput
            If a path cannot lie along the surface: it runs into a crevice or before another part of the body.
        """
        return np.stack([self._laid(scene, focus, array_middle)[0] for focus in target.points])

    def strayed(
        self, scene: Scene, target: Target, array_middle: Real[np.ndarray, "3"]
    ) -> Float64[np.ndarray, "foci frames"]:
        """Return how much farther from the nearest body than its focus each position is before it is laid on the skin.

        Parameters are those of ``paths``; (F, N) [m], 0 where a focus is in the air.
        """
        off = np.zeros((len(target.points), self.frames or FRAMES))
        if scene.obstacles:
            for index, (focus, depth) in enumerate(
                zip(target.points, scene.depth(target.points), strict=True)
            ):
                if -depth <= MAX_OFFSET:
                    off[index] = depth - scene.depth(self._laid(scene, focus, array_middle)[1])
        return off

    def _drawn(self) -> Float64[np.ndarray, "frames 2"]:
        """Return the path in a plane, around the origin [m]."""
        count = self.frames or FRAMES
        radius = self.size or (LATERAL_RADIUS if self.kind == "lm" else DRAWING_RADIUS)
        angles = 2.0 * np.pi * np.arange(count) / count
        right, upward = np.cos(angles), np.sin(angles)
        if self.path == "line":
            radius = radius / 2.0 if self.size else radius
            right, upward = 2.0 / np.pi * np.arcsin(np.sin(angles)), np.zeros(count)
        return radius * np.stack([right, upward], axis=1)

    def _laid(
        self, scene: Scene, focus: Float64[np.ndarray, "3"], array_middle: Real[np.ndarray, "3"]
    ) -> tuple[Float64[np.ndarray, "frames 3"], Float64[np.ndarray, "frames 3"]]:
        """Lay the path around a focus; return it, and before it was brought to a surface."""
        plane = self._drawn()
        surfaces = [obstacle.surface for obstacle in scene.obstacles]
        away = [-float(surface.depth(focus[None])[0]) for surface in surfaces]
        nearest = int(np.argmin(away)) if away else -1
        if self.along == "skin" and (not away or away[nearest] > MAX_OFFSET):
            far = f"{1e3 * away[nearest]:.3g} mm" if away else "without a body"
            raise InvalidInput(
                f"a path along the skin is asked, and the focus is {far} away from one, over {1e3 * MAX_OFFSET:g} mm: "
                'give along = "array".',
                focus,
                code="misplaced",
            )
        if self.along == "array" or not away or away[nearest] > MAX_OFFSET:
            towards = np.asarray(array_middle) - focus
            normal = towards if np.linalg.norm(towards) > 1e-3 else np.array([0.0, 0.0, 1.0])
            flat = focus + plane @ np.stack(frame_of(tuple(normal))[:2])
            return flat, flat
        surface = surfaces[nearest]
        (normal,) = outward(surface.depth, focus[None])
        flat = focus + plane @ np.stack(frame_of(tuple(normal))[:2])
        return onto_surface(flat, surface, away[nearest]), flat

    def turns(self, paths: Paths) -> float:
        """Return how often a second the paths are run: the frequency, or that of the drawing speed [Hz]."""
        if self.frequency is not None:
            return self.frequency
        if self.kind == "lm":
            return LATERAL_FREQUENCY
        steps = np.linalg.norm(np.roll(paths, -1, axis=1) - paths, axis=2)
        return DRAWING_SPEED / float(steps.sum(axis=1).max())


def moving_target(target: Target, paths: Paths) -> Target:
    """Return a target of all positions of all foci, frame by frame, each with what its focus asks.

    Parameters
    ----------
    target : the foci at rest.
    paths : (F, N, 3) their positions.
    """
    points = paths.transpose(1, 0, 2).reshape(-1, 3)
    phases = 1.0 if target.phases is None else np.exp(1j * target.phases)
    asked = np.tile(target.weights * phases, paths.shape[1])
    suppressed = target.suppression_points
    if target.pressures is not None:
        return Target(points, asked, suppression_points=suppressed)
    return Target(
        points,
        shares=None if target.shares is None and target.phases is None else asked,
        suppression_points=suppressed,
    )


def moving_foci(
    transfer: TransferMatrix,
    target: Target,
    foci: int,
    turns: float,
    method: MakeDrive = best,
    *,
    clock: float = 40e3,
) -> Sequence:
    """Make the sequence in which ``foci`` foci at a time run through the points of a target.

    Parameters
    ----------
    transfer : of all points, as ``moving_target`` orders them: all foci of the first frame, then
        those of the next.
    target : those points.
    foci : how many of them are in one frame.
    turns : rounds a second [Hz].
    method : makes the drive of each frame from its rows of the matrix.
    clock : frequency of the sound [Hz]: each frame lasts whole periods of it, as boards need it.

    Returns
    -------
    A sequence of at least 4 frames; its rounds a second are the nearest to those asked that whole periods allow.

    Raises
    ------
    InvalidInput
        If the points do not fill whole frames, the rounds are too many for the clock (how many are possible), or as
        the method.
    """
    of_kind(target, Target, "the target", "moving_target(target, paths)")
    count, rest = divmod(len(target.points), foci)
    if rest or not count:
        points = counted(len(target.points), "point is", "points are")
        raise InvalidInput(
            f"{points} no whole frames of {counted(foci, 'focus', 'foci')}.", code="sizes_differ"
        )
    repeat = -(-FEWEST // count)
    places = np.repeat(np.arange(len(target.points)).reshape(count, foci), repeat, axis=0)
    turns = positive(turns, "the frequency of the modulation", "Hz")
    if turns * len(places) > clock:
        raise InvalidInput(
            f"{turns:g} rounds of {len(places)} frames are more than the {clock:g} periods of the sound in a second: "
            f"give {clock / len(places):.4g} Hz or less.",
            code="out_of_range",
        )
    periods = round(clock / (turns * len(places)))
    return sequence_through(transfer, target, places, clock / periods, method)
