"""How good a hand's mesh must be: what wrong poses, shapes, panels and delays cost at the true hand.

Every drive is made with a hand that is wrong in one way, aimed at the pads where that hand has them, and judged on the
true hand by a finer solution: beacons at the true foci and at points all over the true skin are solved once for each
scene, so that any number of drives can be judged. All drives have the same energy. Pressures are told over those of a
drive that was made with the right hand, on panels finer than the judge's.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Complex128, Float64
from scipy.spatial import KDTree

from airtact.experiments.wrong_hands import bent, hand_of_triangles, random_direction, random_radii
from airtact.scene.hand import Hand
from airtact.scene.hand_files import load_hand
from airtact.scene.medium import air
from airtact.scene.pose import Pose
from airtact.scene.scene import Scene, sound_hard
from airtact.scene.shapes import skin_points
from airtact.scene.target import Target
from airtact.solvers.boundary_element import BoundaryElement
from airtact.solvers.problem import RadiatedField
from airtact.synthesis.time_reversal import time_reversal
from airtact.transducers.layout import PhasedArray, flat_boards, surrounding_box
from airtact.transfer import focus_by_distance, transfer_matrix

FREQUENCY = 40e3
"""Of the sound [Hz]."""

SPEED = 0.5
"""Of a hand that has moved on by the time that its drive is played [m/s]."""

OFF = 0.5e-3
"""Foci stand so far off the pads [m]."""

JUDGING, RIGHT, DRIVING = 0.03, 0.02, 0.1
"""Accuracies of the judge, of the drive that all are held against, and of drives with wrong hands."""

SPACING = 20e-3
"""Of the points of the skin where stray sound is heard [m]; those within a wavelength of a focus are left out."""

POSES = (0.5e-3, 1e-3, 2e-3, 3e-3, 5e-3)
"""Errors of the pose [m]."""

SHIFTS = (*POSES, 7.5e-3, 10e-3, 15e-3, 20e-3)
"""How far a whole hand is elsewhere [m]: by error, or by delay times ``SPEED``."""

SHARES = (0.05, 0.1, 0.15, 0.2)
"""Errors of radii over the radii."""

ACCURACIES = (0.02, 0.05, 0.1, 0.2, 0.3)
"""Of the solver, whose panels grow with them."""

TRIANGLES = (3e-3, 5e-3, 8e-3, 12e-3, 16e-3)
"""Edges of the triangles of a mesh that stands for the hand [m]."""


@dataclass(frozen=True)
class Outcome:
    """What one drive gives at the true hand.

    Attributes
    ----------
    scene : "pinch" or "open hand".
    error : what is wrong.
    size : by how much, in the unit that the error's name tells.
    seed : of the random choice.
    focus : pressure in the foci, their mean, over that of the right drive.
    worst : the same of the focus that loses most.
    stray : root mean square of the pressure on the skin away from the foci, over that of the right drive.
    loudest : the loudest of it over the mean of the foci, both of this drive.
    """

    scene: str
    error: str
    size: float
    seed: int
    focus: float
    worst: float
    stray: float
    loudest: float


@dataclass(frozen=True, eq=False)
class Study:
    """A hand, its array and its foci.

    Attributes
    ----------
    name : of the scene.
    hand : the true one.
    array : the transducers in the hand's frame.
    pads : names of the places that get a focus.
    folder : where the judge's matrix is kept.
    """

    name: str
    hand: Hand
    array: PhasedArray
    pads: tuple[str, ...]
    folder: Path

    @cached_property
    def stray_points(self) -> Float64[np.ndarray, "stray 3"]:
        """Where stray sound is heard [m]."""
        points = skin_points(self.hand.surface, SPACING)
        scene = Scene(air(celsius=20.0, humidity=0.5), [sound_hard(self.hand.surface)], FREQUENCY)
        far = np.asarray(KDTree(foci(self.hand, self.pads)).query(points)[0]) > scene.wavelength
        return points[far]

    @cached_property
    def judge(self) -> Complex128[np.ndarray, "heard elements"]:
        """Pressure at the foci, and then at the stray points, of each element [Pa], by a solution of its own."""
        kept = self.folder / f"judge-{self.name.replace(' ', '-')}.npz"
        points = np.concatenate([foci(self.hand, self.pads), self.stray_points])
        if kept.exists():
            found = np.load(kept)
            if np.array_equal(found["points"], points) and np.array_equal(found["array"], self.array.positions):
                return found["matrix"]
        target = Target(foci(self.hand, self.pads), quiet=self.stray_points)
        field = BoundaryElement(JUDGING).radiate(_scene(self.hand), target.beacons(quiet=True))
        matrix = transfer_matrix(field, self.array).matrix
        self.folder.mkdir(parents=True, exist_ok=True)
        np.savez(kept, points=points, array=self.array.positions, matrix=matrix)
        return matrix

    @cached_property
    def right(self) -> Complex128[np.ndarray, "heard"]:
        """What is heard of the drive that was made with the right hand, all energy 1 [Pa]."""
        return self.judge @ self.drive(beacons(self.hand, self.pads, RIGHT))

    def drive(self, field: RadiatedField, shift: Float64[np.ndarray, "3"] | None = None) -> Complex128[np.ndarray, "e"]:
        """Make the drive of energy 1 by time reversal for a hand that is believed to be elsewhere by a shift [m]."""
        array = self.array if shift is None else self.array.moved(Pose(np.eye(3), -shift))
        amplitudes = time_reversal(transfer_matrix(field, array), Target(field.sources.positions)).amplitudes
        return amplitudes / np.linalg.norm(amplitudes)

    def outcome(self, error: str, size: float, seed: int, drive: Complex128[np.ndarray, "elements"]) -> Outcome:
        """Judge a drive of energy 1."""
        heard, right, count = np.abs(self.judge @ drive), np.abs(self.right), len(self.pads)
        focus = float(heard[:count].mean())
        stray = float(np.sqrt(np.mean(heard[count:] ** 2) / np.mean(right[count:] ** 2)))
        shares = heard[:count] / right[:count]
        loudest = float(heard[count:].max()) / focus
        return Outcome(
            self.name, error, size, seed, focus / float(right[:count].mean()), float(shares.min()), stray, loudest
        )


def foci(hand: Hand, pads: tuple[str, ...]) -> Float64[np.ndarray, "foci 3"]:
    """Points before named places of a hand [m].

    Parameters
    ----------
    hand : any.
    pads : names of its places.
    """
    return np.array([point + OFF * normal for point, normal in (hand.place(name) for name in pads)])


def beacons(hand: Hand, pads: tuple[str, ...], accuracy: float) -> RadiatedField:
    """Field of beacons in front of the pads of a hand.

    Parameters
    ----------
    hand : right or wrong.
    pads : names of its places.
    accuracy : of the solver.
    """
    return BoundaryElement(accuracy).radiate(_scene(hand), Target(foci(hand, pads)).beacons())


def _scene(hand: Hand) -> Scene:
    return Scene(air(celsius=20.0, humidity=0.5), [sound_hard(hand.surface)], FREQUENCY)


def studies(hands: Path, folder: Path) -> tuple[Study, Study]:
    """Set up a pinch in the paper's box of four boards, and an open hand before four flat ones.

    Parameters
    ----------
    hands : folder with pinch.json and relaxed.json.
    folder : where the judges' matrices are kept.
    """
    pinch = load_hand(hands / "pinch.json").open_to(0.012)
    middle = foci(pinch, ("thumb.pad", "index.pad")).mean(axis=0)
    box = surrounding_box().moved(Pose(np.eye(3), middle + np.array([-0.035, 0.0, 0.0])))
    opened = load_hand(hands / "relaxed.json")
    point, normal = opened.place("palm")
    side = np.cross(normal, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side)
    facing = np.stack([side, np.cross(-normal, side), -normal], axis=1)
    boards = flat_boards(2, 2).moved(Pose(facing, point + 0.2 * normal))
    return (
        Study("pinch", pinch, box, ("thumb.pad", "index.pad"), folder),
        Study("open hand", opened, boards, ("thumb.pad", "middle.pad", "palm"), folder),
    )


def outcomes(study: Study, seeds: int, tell: Callable[[str], None]) -> Iterator[Outcome]:
    """Judge drives with every error, one after the other.

    Parameters
    ----------
    study : the scene.
    seeds : random choices of each size of the errors that need a solution each; there are four times as many where one
        solution serves all.
    tell : is told what is done.
    """
    tell(f"{study.name}: judging")
    target = Target(foci(study.hand, study.pads))
    blind = focus_by_distance(study.array, target, _scene(study.hand).medium, FREQUENCY).amplitudes
    yield study.outcome("no hand at all", 0.0, 0, blind / np.linalg.norm(blind))
    yield from _panels(study, tell)
    yield from _elsewhere(study, 4 * seeds, tell)
    for seed in range(seeds):
        for size in POSES:
            tell(f"{study.name}: fingers bent wrongly by {1e3 * size:g} mm, {seed}")
            wrong = beacons(bent(study.hand, size, seed), study.pads, DRIVING)
            yield study.outcome("fingers bent wrongly [mm]", 1e3 * size, seed, study.drive(wrong))
        for share in SHARES:
            tell(f"{study.name}: radii wrong by {share:.0%}, {seed}")
            wrong = beacons(random_radii(study.hand, share, seed), study.pads, DRIVING)
            yield study.outcome("each radius wrong [%]", 100 * share, seed, study.drive(wrong))


def _panels(study: Study, tell: Callable[[str], None]) -> Iterator[Outcome]:
    """Coarse panels and triangles, hands that are too thick or thin: no choice is random."""
    for accuracy in ACCURACIES:
        tell(f"{study.name}: an accuracy of {accuracy:g}")
        field = beacons(study.hand, study.pads, accuracy)
        edge = np.sqrt(6.0 / field.report.nodes_per_square_wavelength * 4.0 / np.sqrt(3.0))
        yield study.outcome("panels [wavelengths]", float(edge), 0, study.drive(field))
    for edge in TRIANGLES:
        tell(f"{study.name}: triangles of {1e3 * edge:g} mm")
        flat = hand_of_triangles(study.hand, edge)
        scene = Scene(air(celsius=20.0, humidity=0.5), [sound_hard(flat)], FREQUENCY)
        points = foci(study.hand, study.pads)
        deep = np.maximum(scene.depth(points) + 0.2e-3, 0.0)[:, None]  # coarse triangles may hide a focus
        normals = np.array([study.hand.place(name)[1] for name in study.pads])
        field = BoundaryElement(DRIVING).radiate(scene, Target(points + deep * normals).beacons())
        yield study.outcome("triangles [mm]", 1e3 * edge, 0, study.drive(field))
    for share in (*(-share for share in SHARES), *SHARES):
        tell(f"{study.name}: all radii wrong by {share:+.0%}")
        wrong = Hand(study.hand.joints, study.hand.radii * (1.0 + share), study.hand.side)
        yield study.outcome("all radii wrong [%]", 100 * share, 0, study.drive(beacons(wrong, study.pads, DRIVING)))


def _elsewhere(study: Study, seeds: int, tell: Callable[[str], None]) -> Iterator[Outcome]:
    """Whole hands elsewhere: one solution serves them all."""
    field = beacons(study.hand, study.pads, DRIVING)
    for seed in range(seeds):
        tell(f"{study.name}: elsewhere, {seed}")
        for size in SHIFTS:
            drive = study.drive(field, size * random_direction(seed))
            yield study.outcome("whole hand elsewhere [mm]", 1e3 * size, seed, drive)
