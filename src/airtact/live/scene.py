"""The fixed part of a live scene, and a posed hand with the foci on it.

The effect of a hand on the sound at a focus depends mainly on the relative positions of
the bones that carry foci, and much less on the pose of the whole hand. ``gap_change``
compares these relative positions in two poses, and ``turn`` compares the orientations
of the hand.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Complex, Complex128, Float64, Int64

from airtact.acoustics.medium import Medium
from airtact.acoustics.scene import Plane, check_no_boards
from airtact.drives.methods import FOR_SAMPLES
from airtact.drives.motion import DEFAULT_FRAMES, Motion
from airtact.drives.sequence import MIN_FRAMES
from airtact.errors import InvalidInput, fixed, in_short, of_kind
from airtact.hands.hand import PLACES, Hand, Side
from airtact.hands.joints import (
    CHAINS,
    Joints,
    check_finger_order,
    crossed,
    joints_of,
    radii_of,
)
from airtact.setup.bodies import unsided
from airtact.setup.setup import Setup
from airtact.touch.objects import VirtualObject
from airtact.transducers.layout import PhasedArray
from airtact.transducers.levels import AmplitudeModulation
from airtact.transducers.placement import flush

SIDES: tuple[Side, Side] = ("left", "right")

Foci = Float64[np.ndarray, "foci 3"]
Amplitudes = Complex128[np.ndarray, "elements"]
Frames = Complex128[np.ndarray, "frames elements"]
# Pressure at each focus per unit drive of each element and of each image [Pa].
Rows = Complex128[np.ndarray, "foci sources"]


@dataclass(frozen=True, eq=False)
class MovingFoci:
    """Paths of foci along the hand, as a sequence of frames that is repeated.

    ``live_scene`` derives it from the motion of a scene file, as ``LiveScene.moving``. The paths
    move with the bones of the hand.

    Attributes
    ----------
    places : (N, K) index, in ``LiveScene.places``, of the place near which each of the K foci of a
        frame lies, for each of N frames.
    shifts : (N, K, 3) vector from the place to the focus [m], along the axes of the bone that
        carries the place (``PosedHand.frames``).
    rate : frames per second; the paths are repeated ``rate``/N times per second.
    words : short description of the motion.
    """

    places: Int64[np.ndarray, "frames together"]
    shifts: Float64[np.ndarray, "frames together 3"]
    rate: float
    words: str

    __repr__ = in_short


@dataclass(frozen=True, eq=False)
class WithImages:
    """An array of E elements, and the images of these elements in a rigid plane, such as a table.

    The attribute ``with_images`` of a ``LiveScene`` contains it. Elements that are part of the
    plane have no image. The hand scatters the sound of elements and images, but the plane does not
    reflect the scattered sound: the phase of this reflection changes with every millimetre of
    height, so a solution with it could not be reused as the hand moves.

    Attributes
    ----------
    array : R sources in the frame of the scene: first the elements, then their images. Without a
        plane, these are the elements alone.
    imaged : (R - E,) index of the element that each image mirrors.
    strengths : (E,) factor for the strength of each element: 2 for a monopole in the plane, where
        it coincides with its image, else 1. It is not part of ``array``; ``folded`` and
        ``unfolded`` apply it.
    """

    array: PhasedArray
    imaged: Int64[np.ndarray, "images"]
    strengths: Float64[np.ndarray, "elements"]

    __repr__ = in_short

    @classmethod
    def of(cls, array: PhasedArray, planes: Sequence[Plane]) -> "WithImages":
        """Build an array together with its images in the plane, if there is a plane."""
        imaged = np.zeros(0, dtype=np.int64)
        strengths = np.ones(len(array))
        for plane in planes:
            off = ~flush(plane, array)
            imaged = np.flatnonzero(off)
            # The plane doubles a point source that lies in it. For faces with a directivity, the
            # sensitivity already includes the effect of a board.
            strengths = np.where(off | array.element.directional, 1.0, 2.0)
            # Reflect directions d as d - 2 (d·p) p, where p is the plane's normal.
            mirror = np.eye(3) - 2.0 * np.outer(plane.normal, plane.normal)
            array = PhasedArray(
                np.concatenate([array.positions, plane.image(array.positions[imaged])]),
                np.concatenate([array.normals, array.normals[imaged] @ mirror]),
                array.element,
                np.concatenate([array.tangents, array.tangents[imaged] @ mirror]),
                np.concatenate([array.gains, array.gains[imaged]]),
            )
        return cls(array, imaged, strengths)

    def folded(
        self, rows: Complex[np.ndarray, "*any sources"]
    ) -> Complex[np.ndarray, "*any elements"]:
        """Combine pressures (..., R) of elements and images into pressures (..., E) of elements."""
        count = len(self.strengths)
        if rows.shape[-1] == count and (self.strengths == 1.0).all():
            return rows
        folded = rows[..., :count] * self.strengths
        folded[..., self.imaged] += rows[..., count:]
        return folded.astype(rows.dtype, copy=False)

    def unfolded(self, amplitudes: Amplitudes) -> Complex128[np.ndarray, "sources"]:
        """Expand the amplitudes of the elements to those of the elements and their images."""
        return np.concatenate([amplitudes * self.strengths, amplitudes[self.imaged]])


@dataclass(frozen=True, eq=False)
class LiveScene:
    """The part of a scene that does not change while the hand moves; see ``live_scene``.

    Attributes
    ----------
    medium : ``Medium`` in which the sound propagates.
    frequency : frequency of the sound [Hz].
    array : transducers, in scene coordinates like the tracked hands.
    side : side of the hand that carries the foci, "left" or "right".
    radii : (25,) radius of the skin around each joint [m]; None for a generic hand.
    places : names of the F places on the hand, such as ``"thumb.pad"``, that carry the foci.
    offsets : (F,) distances of the foci from the skin, outward [m].
    method : name of the method that computes the drives, a key of ``drives.METHODS``.
    modulation : amplitude modulation that makes the drive perceptible; None if there is none.
    moving : paths of the foci relative to the hand; None if they do not move.
    planes : rigid planes, such as a table; empty if there are none.
    objects : virtual objects at the start of the run, whose contacts are foci as well.
    both : whether both hands are followed; False by default. If True, ``radii`` apply to both
        hands, and places whose name lacks "left" or "right" are on the hand ``side``.
    """

    medium: Medium
    frequency: float
    array: PhasedArray
    side: Side
    radii: Float64[np.ndarray, "25"] | None
    places: tuple[str, ...]
    offsets: Float64[np.ndarray, "foci"]
    method: str = "best"
    modulation: AmplitudeModulation | None = None
    moving: MovingFoci | None = None
    planes: tuple[Plane, ...] = ()
    objects: tuple[VirtualObject, ...] = ()
    both: bool = False

    __repr__ = in_short

    @cached_property
    def with_images(self) -> WithImages:
        """The elements together with their images in the plane."""
        return WithImages.of(self.array, self.planes)

    @property
    def wavenumber(self) -> complex:
        """Wavenumber in the medium [rad/m]."""
        return self.medium.wavenumber(self.frequency)


def live_scene(setup: Setup) -> LiveScene:
    """Return the part of a setup that stays fixed while the live loop follows a hand.

    Parameters
    ----------
    setup : scene with foci at places on one or two hands, or with virtual objects whose contacts
        with the hands are the foci, such as ``read_scene("live_pinch")`` or
        ``read_scene("touch_ball")``.

    Returns
    -------
    A ``LiveScene``, for ``follow``. The poses of the hands in the setup are not part of it.

    Raises
    ------
    InvalidInput
        If the scene contains bodies other than one or two sound-hard hands, or reflecting boards.
        If the scene has neither objects nor foci, or has a focus that is not at a place on a hand.
        If the scene requests pressures, unequal shares, phases or suppression. If its method needs
        samples of an uncertainty. If the scene combines paths of foci with virtual objects or two
        hands. If a path leaves the skin, has more than 64 frames, or has frames shorter than one
        period of the sound.
    """
    of_kind(setup, Setup, "the setup", "read_scene(path)")
    name = "the setup" if setup.path is None else setup.path.name
    check_no_boards(setup.scene, "live")
    on_hand = [place for place in setup.riding if place and unsided(place[0]) in PLACES]
    # A scene without foci must contain objects, whose contacts then define the foci.
    touched = setup.contacts is not None
    if not touched and (len(on_hand) < len(setup.foci) or not setup.hands):
        raise InvalidInput(
            f"{name}: only {len(on_hand) if setup.hands else 0} of {len(setup.foci)} foci are at a "
            "place on a hand that is defined by joints. Add a place to each focus, such as "
            'at = "thumb.pad", or replace all foci by [[objects]]. '
            f"Possible values of at: {', '.join(PLACES)}.",
            code="misplaced",
        )
    # The two fingers of the example pinch stand for the tracked hand.
    stands_in = touched and setup.bodies == ("thumb", "finger")
    hard = all(body.boundary == "sound_hard" for body in setup.scene.obstacles)
    if not hard or not (stands_in or len(setup.bodies) == len(setup.hands)):
        raise InvalidInput(
            f"{name}: live supports only one or two sound-hard hands. Remove all other bodies from "
            'the scene, and set boundary = "sound_hard".',
            code="not_supported",
        )
    target = setup.target
    if (
        target.pressures is not None
        or target.phases is not None
        or (np.ptp(target.weights) and not touched)
        or target.suppression_points.size
    ):
        raise InvalidInput(
            f"{name}: live always maximises the pressure at the weakest focus. Remove the keys "
            "pressure, share, phase_degrees and suppression.",
            code="options_clash",
        )
    if setup.method in FOR_SAMPLES:
        raise InvalidInput(
            f'{name}: live cannot compute drives for uncertain hands: set method = "best".',
            code="options_clash",
        )
    both = touched or bool(setup.objects) or len(setup.hands) > 1
    outlined = any(thing.style == "outline" for thing in setup.objects)
    # A setup with outlines contains this motion by default.
    if both and setup.motion not in (None, *([Motion("stm", "points")] if outlined else [])):
        raise InvalidInput(
            f"{name}: live cannot move foci along paths if there are objects or two hands. Remove "
            'kind = "stm" or "lm". To move a focus along contacts, use style = "outline".',
            code="not_supported",
        )
    modulation = setup.modulation if isinstance(setup.modulation, AmplitudeModulation) else None
    # Static foci need a modulation, and so do boards that cannot play a round along an outline.
    if modulation is None and outlined:
        modulation = AmplitudeModulation()
    scene = LiveScene(
        medium=setup.medium,
        frequency=setup.frequency,
        array=setup.array,
        side=setup.hands[0].side if setup.hands else "right",
        radii=setup.hands[0].radii if setup.hands else None,
        places=tuple(place for place, _ in on_hand),
        offsets=fixed(np.array([offset for _, offset in on_hand], dtype=np.float64)),
        method=setup.method,
        modulation=modulation,
        planes=tuple(setup.scene.planes),
        objects=setup.objects,
        both=both,
    )
    if isinstance(setup.modulation, Motion) and not both:
        return replace(scene, moving=_moving_foci(setup, setup.modulation, scene, name))
    return scene


def _moving_foci(setup: Setup, motion: Motion, scene: LiveScene, name: str) -> MovingFoci:
    """Attach the paths of a scene file, called ``name`` in messages, to the bones of the hand."""
    foci = len(scene.places)
    target = setup.target
    if motion.through_points(foci):
        paths = target.points[None]
        places = np.arange(foci)[:, None]
        shifts = np.zeros((foci, 1, 3))
        words = f"a focus runs through the {foci} places"
    else:
        paths = motion.paths(setup.scene, target, setup.array.positions.mean(axis=0))
        frames = pose_hand(scene, setup.hands[0].joints).frames
        shifts = np.einsum("fnj,fij->nfi", paths - target.points[:, None], frames)
        places = np.tile(np.arange(foci), (len(shifts), 1))
        words = "each focus runs along a path"
    # Boards require sequences of at least a few frames, so short paths are repeated.
    repeat = -(-MIN_FRAMES // len(places))
    places = np.repeat(places, repeat, axis=0)
    shifts = np.repeat(shifts, repeat, axis=0)
    if len(places) > 64:  # each pose requires a drive for every frame
        raise InvalidInput(
            f"{name}: live supports paths of at most 64 frames, but this path has "
            f"{len(places)}: use frames = {DEFAULT_FRAMES}.",
            code="sizes_differ",
        )
    rounds = motion.turns(paths)
    if rounds * len(places) > setup.frequency:
        raise InvalidInput(
            f"{name}: a path of {len(places)} frames, repeated at {rounds:g} Hz, "
            f"requires {rounds * len(places):g} frames/s. A frame must last at least one period of "
            f"the sound: use {setup.frequency / len(places):.4g} Hz or less.",
            code="out_of_range",
        )
    # Each frame lasts a whole number of periods, so that boards can play it by their own clock.
    rate = setup.frequency / round(setup.frequency / (rounds * len(places)))
    words = f"{words} {rate / len(places):.3g} times a second"
    return MovingFoci(places, fixed(shifts), rate, words)


def hand_in(
    scene: LiveScene, landmarks: Float64[np.ndarray, "landmarks 3"], side: Side | None = None
) -> Hand:
    """Return the hand that has the given landmarks or joints [m].

    By default, the hand is right or left as in the scene. The side is not checked again, because it
    was checked when the frame was received.
    """
    joints = joints_of(landmarks)
    check_finger_order(joints)
    return Hand(joints, radii_of(scene.radii, None, joints), side or scene.side)


def foci_on(hand: Hand, scene: LiveScene, offset: float | None = None) -> Foci:
    """Return the foci (F, 3) on a hand [m]; ``offset`` [m] overrides the scene's offsets."""
    offsets = scene.offsets if offset is None else np.full(len(scene.places), offset)
    foci = []
    for place, distance in zip(scene.places, offsets, strict=True):
        point, normal = hand.position(place)
        foci.append(point + distance * normal)
    return np.array(foci)


@dataclass(frozen=True, eq=False)
class PosedHand:
    """A hand in one pose, with its foci.

    Attributes
    ----------
    hand : the hand, in scene coordinates.
    foci : (F, 3) foci on the hand [m].
    frames : (F, 3, 3) axes of the bone that carries each focus, one per row.
    distances : (K,) distances between all pairs of points: the foci and the ends of their bones
        [m].
    directions : (F, S, 3) unit vectors from each focus to S elements spread over the array, in the
        axes of the focus's bone.
    """

    hand: Hand
    foci: Foci
    frames: Float64[np.ndarray, "foci 3 3"]
    distances: Float64[np.ndarray, "pairs"]
    directions: Float64[np.ndarray, "foci samples 3"]

    __repr__ = in_short


def bone_of(place: str) -> tuple[int, int]:
    """Return the indices of the two joints at the ends of the bone that carries a place.

    >>> bone_of("index.pad")
    (8, 9)
    """
    if place == "palm":
        return CHAINS[2][0], CHAINS[2][1]
    return CHAINS[PLACES.index(place)][-2], CHAINS[PLACES.index(place)][-1]


def pose_hand(scene: LiveScene, joints: Joints, offset: float | None = None) -> PosedHand:
    """Place the foci of a scene on a hand.

    Parameters
    ----------
    scene : scene of the live loop; its places, offsets, radii and array are used.
    joints : (25, 3) joints in scene coordinates [m].
    offset : distance of all foci from the skin [m]; by default, the scene's
        offsets.

    Raises
    ------
    InvalidInput
        If joints are NaN or in millimetres, if bones have impossible lengths, if fingers are out of
        order, or if a place is unknown.
    """
    hand = hand_in(scene, joints)
    # The directions to 12 elements, spread over the array, describe the orientation of the hand.
    elements = scene.array.positions[:: max(1, len(scene.array) // 12)]
    foci = foci_on(hand, scene, offset)
    ends = hand.joints[[bone_of(place) for place in scene.places]]
    along = ends[:, 1] - ends[:, 0]
    across = crossed(along, foci - ends[:, 0])
    frames = np.stack([along, across, crossed(along, across)], axis=1)
    frames /= np.linalg.norm(frames, axis=2, keepdims=True)
    seen = elements - foci[:, None]
    seen /= np.linalg.norm(seen, axis=2, keepdims=True)
    points = np.concatenate([foci[:, None], ends], axis=1).reshape(-1, 3)
    first, second = np.triu_indices(len(points), 1)
    distances = np.linalg.norm(points[first] - points[second], axis=1)
    return PosedHand(hand, foci, frames, distances, seen @ frames.swapaxes(1, 2))


def gap_change(
    distances: Float64[np.ndarray, "*poses pairs"], reference: Float64[np.ndarray, "pairs"]
) -> Float64[np.ndarray, "*poses"]:
    """Return the rms deviation [m] of ``PosedHand.distances`` from those of a reference pose."""
    return np.asarray(np.sqrt(np.mean((distances - reference) ** 2, axis=-1)))


def turn(
    directions: Float64[np.ndarray, "*poses foci samples 3"],
    reference: Float64[np.ndarray, "foci samples 3"],
) -> Float64[np.ndarray, "*poses"]:
    """Return the rms deviation [rad] of ``PosedHand.directions`` from those of a reference pose."""
    squares = np.sum((directions - reference) ** 2, axis=-1)
    return np.asarray(np.sqrt(np.mean(squares, axis=(-2, -1))))


def moving_points(moving: MovingFoci, posed: PosedHand) -> Float64[np.ndarray, "frames together 3"]:
    """Return the K foci in each of N frames for a posed hand, as an array (N, K, 3) [m]."""
    shifts = np.einsum("nki,nkij->nkj", moving.shifts, posed.frames[moving.places])
    return posed.foci[moving.places] + shifts
