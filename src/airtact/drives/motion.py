"""Modulation by foci that move along paths on the skin (lateral and spatiotemporal).

Lateral modulation moves each focus along a small path around its position. For circles at 10 to
200 Hz it feels stronger than amplitude modulation with the same largest amplitude (R. Takahashi,
K. Hasegawa, H. Shinoda, IEEE Trans. Haptics 13, 334, 2020). Spatiotemporal modulation draws a shape
with a focus. It feels strongest when the focus moves as fast as the waves on the skin, at 5 to 8
m/s (W. Frier et al., EuroHaptics 2018, 270).
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Float64, Int64, Real

from airtact.acoustics.scene import Scene
from airtact.acoustics.target import Target
from airtact.acoustics.target_points import MAX_OFFSET, frame_of, onto_surface, outward
from airtact.drives.drive import Amplitudes
from airtact.drives.methods import best
from airtact.drives.sequence import MIN_FRAMES, Sequence
from airtact.drives.transfer import MakeDrive, TransferMatrix, check_foci
from airtact.errors import (
    InvalidInput,
    check_choice,
    millimetres,
    of_kind,
    positive,
    shaped,
    within,
)

# Default number of positions on a path around a focus.
DEFAULT_FRAMES = 16

# Largest number of frames that an AUTD3 board stores.
MAX_FRAMES = 1024

# Positions of each focus in each frame [m].
Paths = Float64[np.ndarray, "foci frames 3"]


@dataclass(frozen=True)
class Motion:
    """Motion of the foci of a target along paths, which makes them perceptible.

    ``paths`` returns the positions of the foci; ``moving_target`` and ``moving_foci`` convert them
    to a ``Sequence`` of drives. All foci move at the same time, unless one focus moves through the
    target's points.

    Attributes
    ----------
    kind : "lm" for lateral or "stm" for spatiotemporal modulation. It sets the defaults of the
        other attributes.
    path : "circle" or "line" around each focus, or "points", where one focus moves through the
        target's points in order and back to the first. The default is "points" for "stm" with 2 or
        more points, and "circle" otherwise.
    size : radius of the circle or total length of the line [m], above zero and at most 0.1. The
        default radius is 3 mm for "lm" and 10 mm for "stm"; the default length is twice as large.
    frequency : number of times per second that a focus traverses its path, back and forth in the
        case of a line [Hz]. The default is 50 Hz for "lm"; for "stm" it is the frequency at which
        the focus moves at 7 m/s.
    frames : number of positions on a path around a focus, 4 to 1024; the default is 16.
    along : "skin" for a path at the focus's constant distance from the nearest
        surface, or "array" for a path in the plane through the focus that is
        perpendicular to the line from the focus to the array's middle. The
        default is "skin" if a surface is within 20 mm, and "array" otherwise.

    Raises
    ------
    InvalidInput
        If ``kind``, ``path`` or ``along`` is unknown, if a number is outside its range, if
        ``size``, ``frames`` or ``along`` is given for the path "points", or if this path is used
        with the kind "lm".
    """

    kind: Literal["lm", "stm"]
    path: Literal["circle", "line", "points"] | None = None
    size: float | None = None
    frequency: float | None = None
    frames: int | None = None
    along: Literal["skin", "array"] | None = None

    def __post_init__(self) -> None:
        check_choice(self.kind, "the kind of a motion", ("lm", "stm"))
        if self.path is not None:
            check_choice(self.path, "the path of a motion", ("circle", "line", "points"))
        if self.along is not None:
            check_choice(self.along, "the surface of a path", ("skin", "array"))
        if self.size is not None:  # a path longer than 0.1 m would leave any hand
            # ``vars`` bypasses the frozen dataclass.
            vars(self)["size"] = within(self.size, 0.0, 0.1, "the radius or length of a path", "m")
        if self.frequency is not None:
            vars(self)["frequency"] = positive(self.frequency, "the frequency of a motion", "Hz")
        if self.frames is not None and not MIN_FRAMES <= self.frames <= MAX_FRAMES:
            raise InvalidInput(
                f"a path must have {MIN_FRAMES} to {MAX_FRAMES} frames, not {self.frames}.",
                code="out_of_range",
            )
        if self.path != "points":
            return
        for name in ("size", "frames", "along"):
            if getattr(self, name) is not None:
                raise InvalidInput(
                    f"a path through the points of the target does not use {name}. Omit it.",
                    code="options_clash",
                )
        if self.kind == "lm":
            raise InvalidInput(
                "the path of lateral modulation is a circle or a line around each focus. Use kind "
                '"stm" for "points".',
                code="unknown_name",
            )

    def through_points(self, foci: int) -> bool:
        """Return whether a single focus moves through all ``foci`` points of a target."""
        return self.path == "points" or (self.kind == "stm" and self.path is None and foci > 1)

    def paths(self, scene: Scene, target: Target, array_middle: Real[np.ndarray, "3"]) -> Paths:
        """Return the positions of each focus of a target, frame by frame [m].

        Parameters
        ----------
        scene : the bodies; paths with ``along`` "skin" follow their surfaces.
        target : the foci.
        array_middle : (3,) the middle of the array [m].

        Returns
        -------
        (F, N, 3) positions [m]. A circle begins to the right of its focus. A line begins at its
        middle and runs back and forth.

        Raises
        ------
        InvalidInput
            If ``along`` is "skin" but a focus is more than 20 mm from every body, or if a path
            would enter a crevice or pass in front of another part of the body.
        """
        return np.stack([self._laid(scene, focus, array_middle) for focus in target.points])

    def _flat_path(self) -> Float64[np.ndarray, "frames 2"]:
        frames = self.frames or DEFAULT_FRAMES
        angles = 2.0 * np.pi * np.arange(frames) / frames
        # A circle of 3 mm fits on a finger pad (T. Morisaki et al., arXiv 2301.11572).
        radius = self.size or (3e-3 if self.kind == "lm" else 10e-3)
        if self.path != "line":
            return radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        reach = self.size / 2.0 if self.size else radius
        # A triangle wave gives the focus a constant speed, with no rest at the ends.
        to_and_fro = 2.0 / np.pi * np.arcsin(np.sin(angles))
        return reach * np.stack([to_and_fro, np.zeros(frames)], axis=1)

    def _laid(
        self, scene: Scene, focus: Float64[np.ndarray, "3"], array_middle: Real[np.ndarray, "3"]
    ) -> Float64[np.ndarray, "frames 3"]:
        """Place the path around a focus, along the skin or in the plane that faces the array."""
        surfaces = [obstacle.surface for obstacle in scene.obstacles]
        distances = [-float(surface.depth(focus[None])[0]) for surface in surfaces]
        distance = min(distances, default=np.inf)
        on_skin = distance <= MAX_OFFSET
        if self.along == "skin" and not on_skin:
            away = f"{millimetres(distance, 3)} from the nearest body"
            where = away if surfaces else "in open air"
            raise InvalidInput(
                f"a path along the skin needs a focus within {1e3 * MAX_OFFSET:g} mm of the skin, "
                f'but the focus is {where}. Use along = "array".',
                focus,
                code="misplaced",
            )
        if self.along == "array" or not on_skin:
            normal = np.asarray(array_middle) - focus
            if np.linalg.norm(normal) <= 1e-3:  # the focus is at the array's middle
                normal = np.array([0.0, 0.0, 1.0])
            return focus + self._flat_path() @ np.stack(frame_of(tuple(normal))[:2])
        surface = surfaces[distances.index(distance)]
        (normal,) = outward(surface.depth, focus[None])
        flat = focus + self._flat_path() @ np.stack(frame_of(tuple(normal))[:2])
        return onto_surface(flat, surface, distance)

    def turns(self, paths: Paths) -> float:
        """Return the number of cycles of a path per second [Hz]: ``frequency`` or its default."""
        if self.frequency is not None:
            return self.frequency
        if self.kind == "lm":
            return 50.0  # the middle, in octaves, of the 10 to 200 Hz of Takahashi and others
        return 7.0 / longest_path(paths)  # within the 5 to 8 m/s of Frier and others


def longest_path(paths: Paths) -> float:
    """Return the length of the longest closed path [m]."""
    steps = np.linalg.norm(np.roll(paths, -1, axis=1) - paths, axis=2)
    return float(steps.sum(axis=1).max())


def moving_target(target: Target, paths: Paths) -> Target:
    """Return a target that contains all positions of all foci, frame by frame.

    Solve for its beacons to get the transfer matrix that ``moving_foci`` needs.

    Parameters
    ----------
    target : the F foci at rest; only its requests and its suppression points are used.
    paths : (F, N, 3) positions of each focus in each of N frames, in the frame of the obstacles
        [m], as returned by ``Motion.paths``.

    Returns
    -------
    A ``Target`` with F·N foci: all foci of the first frame, then those of the next. Each position
    of a focus has the pressure, share and phase requested for this focus. The suppression points
    are those of ``target``.

    Raises
    ------
    InvalidInput
        If a position is not finite, or is more than 2 m from the origin of the obstacles' frame.
    """
    of_kind(target, Target, "the target", "Target(points, pressures)")
    paths = shaped(paths, (len(target.points), -1, 3), "the paths")
    points = paths.transpose(1, 0, 2).reshape(-1, 3)
    phases = 1.0 if target.phases is None else np.exp(1j * target.phases)
    asked = np.tile(target.weights * phases, paths.shape[1])
    suppressed = target.suppression_points
    if target.pressures is not None:
        return Target(points, asked, suppression_points=suppressed)
    if target.shares is None and target.phases is None:
        return Target(points, suppression_points=suppressed)
    return Target(points, shares=asked, suppression_points=suppressed)


def moving_foci(
    transfer: TransferMatrix,
    target: Target,
    foci: int,
    turns: float,
    method: MakeDrive = best,
    *,
    clock: float = 40e3,
) -> Sequence:
    """Compute the sequence that moves one or more foci at a time through the points of a target.

    The foci traverse their paths repeatedly (spatiotemporal modulation), so that they can be felt.

    Parameters
    ----------
    transfer : (P, E) transfer matrix of all P points in the order of ``moving_target``: all foci of
        the first frame, then those of the next.
    target : the points, in the same order as the rows of the matrix.
    foci : number of foci in one frame; P must be a multiple of this number.
    turns : number of times per second that the foci traverse the path [Hz], above 0 and at most
        ``clock`` divided by the number of frames.
    method : function that computes the ``Drive`` of a frame from the rows of the matrix and the
        part of the target that belong to the frame; ``best`` by default.
    clock : frequency of the sound [Hz]; 40 kHz by default. Each frame lasts a whole number of
        periods, as boards require.

    Returns
    -------
    A ``Sequence`` of P / ``foci`` frames. If this number is below 4, every frame is repeated
    equally often, so that there are at least 4. Because each frame lasts a whole number of periods,
    the frequency of the path may differ slightly from ``turns``.

    Raises
    ------
    InvalidInput
        If the points do not fill whole frames, if ``turns`` is outside its range, if the matrix was
        computed for other points, or if the method cannot compute the drive of a frame.
    """
    of_kind(target, Target, "the target", "moving_target(target, paths)")
    points = len(target.points)
    positive(foci, "the number of foci", "")
    if points % foci or not points:
        raise InvalidInput(
            f"{points} points cannot be divided evenly into frames with {foci} foci each. Use a "
            "multiple of the number of foci.",
            code="sizes_differ",
        )
    # Boards need a few frames; each position is repeated until there are enough.
    repeat = -(-MIN_FRAMES * foci // points)
    frames = points // foci * repeat
    turns = positive(turns, "the frequency of the modulation", "Hz")
    if turns * frames > clock:
        raise InvalidInput(
            f"a path of {frames} frames at {turns:g} Hz needs more frames per second than the "
            f"sound has periods ({clock:g} Hz). Use a modulation frequency of "
            f"{clock / frames:.4g} Hz or less.",
            code="out_of_range",
        )
    # Boards play a frame for a whole number of periods, so the rate is rounded accordingly.
    rate = clock / round(clock / (turns * frames))
    check_foci(transfer, target)
    drives = []
    before = None
    for indices in np.arange(points).reshape(-1, foci):
        amplitudes = _frame_amplitudes(transfer, target, indices, method)
        # The first frame keeps its phase. Each later one differs least from the previous frame.
        if before is not None:
            turn = np.vdot(amplitudes, before)
            amplitudes = amplitudes * (turn / abs(turn) if abs(turn) > 0.0 else 1.0)
        # A silent frame has no phase to match.
        if amplitudes.any():
            before = amplitudes
        drives.append(amplitudes)
    return Sequence(np.repeat(drives, repeat, axis=0), rate)


def _frame_amplitudes(
    transfer: TransferMatrix, target: Target, foci: Int64[np.ndarray, "foci"], method: MakeDrive
) -> Amplitudes:
    """Compute the drive of one frame; a frame without requests is silent."""
    weights = target.weights[foci]
    if not weights.any():
        return np.zeros(transfer.matrix.shape[1], dtype=np.complex128)
    phases = 1.0 if target.phases is None else np.exp(1j * target.phases[foci])
    # Shares also apply across frames: a frame of weaker foci has less energy.
    scale = 1.0
    asked = {}
    if target.shares is not None:
        scale = float(weights.max() / target.shares.max())
        asked = {"shares": weights * phases}
    elif target.pressures is not None:
        asked = {"pressures": weights * phases}
    suppressed = len(transfer.matrix) - len(target.points)
    frame_target = Target(
        target.points[foci], **asked, suppression_points=target.suppression_points[:suppressed]
    )
    rows = np.append(foci, np.arange(len(target.points), len(transfer.matrix)))
    # Without positions, the check allows foci of one frame at the same place.
    frame_transfer = replace(transfer.of_rows(rows), foci=None, wavelength=None)
    return scale * method(frame_transfer, frame_target).amplitudes
