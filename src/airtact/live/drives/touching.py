"""Drives for contacts of hands with virtual objects and for foci requested by applications."""

import time as clock
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float64
from scipy.spatial.distance import cdist

from airtact.drives.transfer import MIN_FOCUS_DISTANCE
from airtact.errors import InvalidInput, millimetres
from airtact.hands.hand import Hand, Side
from airtact.hands.joints import Point
from airtact.hands.tracking.frame import HandFrame
from airtact.hands.tracking.prediction import AGILITY, Predictor
from airtact.live.drives.bending import Bones
from airtact.live.drives.factors import OpenAir
from airtact.live.drives.maker import SolvingMaker, predicted_joints
from airtact.live.drives.moving import aligned, turned_towards
from airtact.live.drives.moving_skin import MovingSkin
from airtact.live.drives.outlines import Outline, Round, curves_at, round_along
from airtact.live.drives.skin_solver import SkinFactors, SkinRequest
from airtact.live.drives.solver_process import SolverProcess
from airtact.live.drives.strengths import balanced
from airtact.live.moment import (
    MOST_CONTACTS,
    MOST_FOCI,
    Controls,
    Moment,
    silent_moment,
)
from airtact.live.safety import Workspace
from airtact.live.scene import SIDES, Frames, LiveScene, hand_in
from airtact.live.world import WantedFocus
from airtact.setup.bodies import unsided
from airtact.touch.finding import approaching
from airtact.touch.objects import VirtualObject
from airtact.touch.skin import Skin
from airtact.touch.state import TouchState

# Time in which a focus rises from silence to full strength, or falls back to silence [s].
RAMP = 20e-3

# Distance of the contacts' foci from the skin [m].
OFFSET = 0.5e-3


@dataclass(eq=False)
class _TrackedHand:
    """A tracked hand and its contacts."""

    predictor: Predictor
    touch: TouchState
    moving: MovingSkin = field(default_factory=MovingSkin)
    newest: HandFrame | None = None  # None while the hand is not seen
    hand: Hand | None = None
    skin: Skin | None = None  # in the newest pose
    velocities: Float64[np.ndarray, "25 3"] | None = None


@dataclass(eq=False)
class _WantedState:
    """A requested focus while it is being emitted."""

    point: Point = field(default_factory=lambda: np.zeros(3))
    side: Side | None = None  # side of the hand that the focus is on
    goal: float = 0.0
    level: float = 0.0


@dataclass(eq=False)
class _Foci:
    """The foci of one drive."""

    points: list[Point] = field(default_factory=list)
    strengths: list[float] = field(default_factory=list)
    names: list[str] = field(default_factory=list)
    sides: list[Side | None] = field(default_factory=list)  # sides of the hands that carry them

    def add(self, name: str, point: Point, strength: float, side: Side | None) -> None:
        if len(self.points) < MOST_FOCI:
            self.points.append(point)
            self.strengths.append(strength)
            self.names.append(name)
            self.sides.append(side)


class TouchAware(SolvingMaker):
    """Compute drives for contacts of both hands with virtual objects and for requested foci.

    Pass it to ``follow`` as ``maker``. For each drive, contacts are found on the hands at their
    predicted positions. Their foci appear, move and fade as described in ``TouchState``. Foci that
    applications or the scene request fade in and out at the same rate: from silence to full
    strength in 20 ms. Each entry of the open-air transfer matrix is multiplied by a factor: the
    ratio of the pressure with the skin to that in open air. The factors come from the newest
    solution for the skin near contacts; they are 1 if this solution is older than 0.25 s. A
    separate process computes such solutions, starting before the skin touches an object. A single
    focus runs along the outlines of all contacts with objects of the style "outline". The pressures
    at the foci are proportional to their strengths, from 0 to 1, and the largest amplitude of the
    drive, as a fraction of full scale, equals the strength of the strongest focus. A focus gets no
    sound of its own if a stronger focus is within a quarter of a wavelength, or if the largest
    pressure possible at this focus is below 5 % of the median for all foci.

    Parameters
    ----------
    scene : the parts of the scene that stay fixed during the run, as returned by ``live_scene``. If
        ``scene.both`` is False, only the hand ``scene.side`` is followed.
    noise : standard deviation of each coordinate of the tracker's landmarks [m]; by default, it is
        estimated from the frames.
    agility : standard deviation of the acceleration of the palm, for the prediction of its motion
        [m/s²]; by default 0.5.
    solvers : processes that compute the scattering by skin; by default, a single one. With an
        empty sequence, scattering is ignored, and phases are set from path lengths alone.
    rest : the hand that will be followed, in any pose. Passing this hand avoids a delay of half a
        second before the first sound, because its skin is meshed in advance.

    Attributes
    ----------
    fault : message about the last pose that could not be used or solved; None if there was none.
    solutions : number of solutions that have been computed.
    """

    def __init__(
        self,
        scene: LiveScene,
        noise: float | None = None,
        agility: float = AGILITY,
        solvers: Sequence[SolverProcess] | None = None,
        rest: Hand | None = None,
    ) -> None:
        self._scene = scene
        self._workspace = Workspace(scene)
        self._open_air = OpenAir(scene)
        wavelength = scene.medium.wavelength(scene.frequency)
        sides = SIDES if scene.both else (scene.side,)
        self._hands: dict[Side, _TrackedHand] = {
            side: _TrackedHand(
                Predictor(0.0, noise, agility),
                TouchState((), OFFSET, wavelength=wavelength, ramp=RAMP),
            )
            for side in sides
        }
        if rest is not None:
            self._hands[rest.side].moving.at(rest)
        super().__init__([SolverProcess(scene, "contacts")] if solvers is None else solvers)
        self._factors: SkinFactors | None = None
        self._objects = tuple(scene.objects)
        # The places of a scene file are requested all the time.
        self._always = tuple(
            WantedFocus(place, place=place, offset=float(offset))
            for place, offset in zip(scene.places, scene.offsets, strict=True)
        )
        self._asked: tuple[WantedFocus, ...] = ()
        self._wanted: dict[str, _WantedState] = {}
        self._time: float | None = None
        self._previous = np.zeros(len(scene.array), dtype=np.complex128)
        self._frames: Frames | None = None  # frames of the newest round along outlines
        self._step = 0

    def take(self, frame: HandFrame) -> None:
        """Process the newest frame of a hand; if it contains no hand, the foci of its side fade.

        Raises
        ------
        InvalidInput
            If the frame is not later than the previous one.
        """
        tracked = self._hands.get(frame.side)
        if tracked is None:
            return
        tracked.newest = None
        if frame.landmarks is not None:
            tracked.predictor.take(frame)
            tracked.newest = frame

    def feel(self, objects: Sequence[VirtualObject], foci: Sequence[WantedFocus]) -> None:
        """Set the virtual objects and the requested foci for the following drives."""
        self._objects = tuple(objects)
        self._asked = tuple(foci)

    def make(self, time: float, controls: Controls) -> Moment:
        """Compute the drive whose sound will be in the air at ``time`` [s].

        All amplitudes are 0 if there is no hand or no focus.
        """
        for solution in self.collected():
            self._factors = solution
        elapsed = 0.0 if self._time is None else max(time - self._time, 0.0)
        self._time = time
        seen: dict[Side, _TrackedHand] = {
            side: tracked
            for side, tracked in self._hands.items()
            if self._pose(side, tracked, time)
        }
        foci = _Foci()
        contacts = [np.zeros((0, 3))]
        depths = [np.zeros(0)]
        touching: list[tuple[str, str]] = []
        outlines: list[Outline] = []
        for side, tracked in self._hands.items():
            if tracked.skin is None:
                continue
            # A lost hand touches nothing. Its foci fade at their last positions.
            tracked.touch.objects = self._objects if side in seen else ()
            tracked.touch.offset = OFFSET if controls.offset is None else controls.offset
            touched = tracked.touch.update(tracked.skin, time)
            prefix = f"{side}." if self._scene.both else ""
            found = tracked.touch.found
            outlined: set[int] = set()
            for index, contact in enumerate(touched.contacts.tolist()):
                name = prefix + touched.names[index]
                strength = float(touched.strengths[index])
                thing = tracked.touch.objects[found.objects[contact]] if contact >= 0 else None
                # Outlines replace the foci of such a contact. When it ends, they fade as points.
                if thing is not None and thing.style == "outline" and contact not in outlined:
                    curves = curves_at(tracked.skin, thing, found, contact, tracked.touch.offset)
                    outlines += [Outline(name, curve, strength, side) for curve in curves]
                    if curves:
                        outlined.add(contact)
                if contact not in outlined:
                    foci.add(name, touched.points[index], strength, side)
            contacts.append(found.points)
            depths.append(found.depths)
            for place, index in zip(found.places, found.objects, strict=True):
                part = prefix + tracked.skin.places[place]
                touching.append((part, tracked.touch.objects[index].name))
        rejected = self._add_wanted(foci, seen, controls, elapsed)
        if not seen:
            return silent_moment(self._scene, time, time)
        path = round_along(outlines, self._scene.frequency) if outlines else None
        if self._solvers and not controls.ignore_hand:
            self._ask(time, foci, path, seen)
        frames = [tracked.newest.time for tracked in seen.values() if tracked.newest is not None]
        moment = self._drive(time, max(frames), foci, path, seen, controls)
        joints = {side: tracked.hand.joints for side, tracked in seen.items() if tracked.hand}
        return replace(
            moment,
            joints=joints.pop(self._scene.side, None),
            other=next(iter(joints.values()), None),
            contacts=np.concatenate(contacts)[:MOST_CONTACTS],
            depths=np.concatenate(depths)[:MOST_CONTACTS],
            touching=tuple(touching[:MOST_CONTACTS]),
            objects=self._objects,
            rejected=rejected,
        )

    def _pose(self, side: Side, tracked: _TrackedHand, time: float) -> bool:
        """Predict a hand and its skin; return whether the hand is present."""
        tracked.hand = None
        if tracked.newest is None:
            return False
        try:
            predicted = predicted_joints(tracked.predictor, time)
            if predicted is None:
                return False
            joints, tracked.velocities = predicted
            hand = hand_in(self._scene, joints, side)
            tracked.skin = tracked.moving.at(hand)
        except InvalidInput as fault:
            self.fault = str(fault)
            return False
        tracked.hand = hand
        return True

    def _add_wanted(
        self,
        foci: _Foci,
        seen: Mapping[Side, _TrackedHand],
        controls: Controls,
        elapsed: float,
    ) -> dict[str, str]:
        """Add requested foci and those that are fading; return rejected foci with the reasons."""
        rejected = {}
        present: list[str] = []  # in the order of the requests
        scene = self._scene
        closest = MIN_FOCUS_DISTANCE * scene.medium.wavelength(scene.frequency)
        for wanted in (*self._always, *self._asked):
            try:
                point, side = self._place_of(wanted, seen, controls)
                others = np.array([self._wanted[name].point for name in present]).reshape(-1, 3)
                apart = np.linalg.norm(others - point, axis=1)
                if (apart < closest).any():
                    name = present[int(apart.argmin())]
                    raise InvalidInput(
                        f"the focus is only {millimetres(apart.min())} from {name}. Move it at "
                        "least a tenth of the wavelength away, or remove one of them.",
                        point,
                        code="misplaced",
                    )
            except InvalidInput as fault:
                rejected[wanted.name] = str(fault)
                continue
            state = self._wanted.setdefault(wanted.name, _WantedState())
            state.point = point
            state.side = side
            state.goal = wanted.strength
            present.append(wanted.name)
        for name, state in list(self._wanted.items()):
            goal = state.goal if name in present else 0.0
            state.level += float(np.clip(goal - state.level, -elapsed / RAMP, elapsed / RAMP))
            if name not in present and state.level <= 0.0:
                del self._wanted[name]
            else:
                foci.add(name, state.point, state.level, state.side)
        return rejected

    def _place_of(
        self, wanted: WantedFocus, seen: Mapping[Side, _TrackedHand], controls: Controls
    ) -> tuple[Point, Side | None]:
        """Return the position of a requested focus [m], and which hand it is on, if any.

        Raises
        ------
        InvalidInput
            If its position is unknown, inside a hand or out of reach.
        """
        side: Side | None = None
        if wanted.place is not None:
            # A place such as "right.index.pad" or "palm".
            first = wanted.place.partition(".")[0]
            side = "left" if first == "left" else "right" if first == "right" else self._scene.side
            hand = seen[side].hand if side in seen else None
            if hand is None:
                raise InvalidInput(
                    f"the {side} hand is not seen: hold it in front of the tracker.",
                    code="data_missing",
                )
            offset = wanted.offset if controls.offset is None else controls.offset
            point = hand.focus(unsided(wanted.place), offset)
        else:
            assert wanted.point is not None
            point = wanted.point
            if wanted.on is not None:
                thing = next((one for one in self._objects if one.name == wanted.on), None)
                if thing is None:
                    raise InvalidInput(
                        f"there is no object {wanted.on!r}: add it first.", code="unknown_name"
                    )
                point = point if thing.pose is None else thing.pose.apply(point)
            for one, tracked in seen.items():
                assert tracked.hand is not None
                depth = float(tracked.hand.shape.depth(point[None])[0])
                if depth > 0.0:
                    raise InvalidInput(
                        f"the focus is {millimetres(depth)} inside the {one} hand: move it out.",
                        point,
                        code="inside_body",
                    )
                if depth > -20e-3:  # [m]; this close, the skin affects the focus
                    side = one
        fault = self._workspace.out_of_reach(point[None])
        if fault is not None:
            raise InvalidInput(fault, point, code="misplaced")
        return point, side

    def _ask(
        self, time: float, foci: _Foci, path: Round | None, seen: Mapping[Side, _TrackedHand]
    ) -> None:
        """Request a solution for the foci on hands and for skin that will soon touch an object."""
        points = []
        owners = []
        for side, tracked in seen.items():
            assert tracked.skin is not None
            own = [foci.points[index] for index, one in enumerate(foci.sides) if one == side]
            if path is not None:
                along = zip(path.points[::2], path.outlines[::2], strict=True)
                own += [point for point, outline in along if outline.side == side]
            # These points need not be exact. Skin within 15 mm of an object gets a beacon before it
            # touches.
            early = approaching(tracked.skin, self._objects, 15e-3)
            ahead = tracked.skin.points[early] + OFFSET * tracked.skin.normals[early]
            for point, away in zip(ahead, cdist(ahead, np.array(own).reshape(-1, 3)), strict=True):
                if away.min(initial=1.0) > 2e-3:
                    own.append(point)
            own = own[:12]  # at most 12 beacons per hand
            points += own
            owners += [SIDES.index(side)] * len(own)
        if points:
            request = SkinRequest(
                time=time,
                sent=clock.monotonic(),
                joints={
                    side: tracked.hand.joints for side, tracked in seen.items() if tracked.hand
                },
                velocities={
                    side: tracked.velocities
                    for side, tracked in seen.items()
                    if tracked.velocities is not None
                },
                points=np.array(points),
                owners=np.array(owners),
            )
            for solver in self._solvers:
                solver.ask(request)

    def _drive(
        self,
        time: float,
        frame_time: float,
        foci: _Foci,
        path: Round | None,
        seen: Mapping[Side, _TrackedHand],
        controls: Controls,
    ) -> Moment:
        still = len(foci.points)
        if path is not None:
            # Boards that cannot play the frames of a round advance by one frame at each drive.
            self._step = (self._step + 1) % len(path.points)
            outline = path.outlines[self._step]
            foci.add(outline.name, path.points[self._step], outline.strength, outline.side)
        points = np.array(foci.points).reshape(-1, 3)
        count = len(points)
        levels = [controls.levels.get(name, 1.0) for name in foci.names]
        strengths = np.array(foci.strengths) * np.array(levels)
        moment = silent_moment(self._scene, time, frame_time)
        moment = replace(
            moment, foci=points, names=tuple(foci.names), strengths=strengths, state="playing"
        )
        if not len(points):
            return replace(moment, pressures=np.zeros(0))
        # The foci of this drive, followed by those of all frames of the round.
        every = points if path is None else np.concatenate([points, path.points])
        rows = self._open_air.rows(every)
        solution = self._factors
        benefit = 0.0
        # A solution older than 0.25 s no longer fits the pose.
        if solution is not None and not controls.ignore_hand and time - solution.time < 0.25:
            bones: dict[Side, Bones] = {
                side: tracked.moving.bones for side, tracked in seen.items() if tracked.moving.bones
            }
            factors, benefits = solution.at(bones, every)
            rows = rows * factors
            benefit = float(benefits[:count].min())
            if benefits.mean() > 0.5:
                moment = replace(moment, rule="contacts", shape_age=time - solution.time)
        method = controls.method or self._scene.method
        # Medians of benchmarks/touch.py without noise: 0.93 with a solution, 0.75 without. The
        # effect of noise is that of ``expected_kept``.
        noise = max(tracked.predictor.noise for tracked in seen.values())
        kept = (0.75 + 0.18 * benefit) * np.exp(-((noise / 3.3e-3) ** 2))
        moment = replace(moment, kept=float(kept))
        amplitudes = balanced(self._scene, method, rows[:count], points, strengths)
        # A jump of the global phase has no effect at the foci, but makes the boards click.
        amplitudes = turned_towards(amplitudes, self._previous)
        if amplitudes.any():
            self._previous = amplitudes
        pressures = np.abs(self._scene.with_images.folded(rows[:count]) @ amplitudes)
        moment = replace(moment, amplitudes=amplitudes, pressures=pressures)
        if path is None or not amplitudes.any():
            self._frames = None
            return moment
        frames = []
        for index, outline in enumerate(path.outlines):
            chosen = [*range(still), count + index]
            # Modulate static foci once per round, because frames have no modulation of their own.
            swing = 0.5 - 0.5 * np.cos(2.0 * np.pi * index / len(path.points))
            strength = outline.strength * controls.levels.get(outline.name, 1.0)
            wanted = np.append(swing * strengths[:still], strength)
            frames.append(balanced(self._scene, method, rows[chosen], every[chosen], wanted))
        self._frames = aligned(np.array(frames), self._frames)
        return replace(moment, frames=self._frames, rate=path.rate)
