"""How good a hand's mesh must be: what wrong poses, shapes, panels and delays cost at the true hand.

Every drive is made with a hand that is wrong in one way, aimed at the pads where that hand has
them. A verification solution evaluates it on the true hand: beacons at the true foci and at points
all over the true skin are solved once for each scene, which serves any number of drives. All drives
have the same energy. Pressures are relative to those of the drive that is made with the right hand
on panels of the same size; the errors of coarse panels are relative to a drive on panels smaller
than those of the verification solution.
"""

import argparse
import csv
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, fields
from functools import cached_property, partial
from itertools import product
from pathlib import Path

import numpy as np
from jaxtyping import Complex128, Float64
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from airtact import _kernels
from airtact.acoustics.medium import air
from airtact.acoustics.scene import Scene, sound_hard
from airtact.acoustics.solvers.bem.solver import BoundaryElement
from airtact.acoustics.solvers.problem import RadiatedField
from airtact.acoustics.target import Target
from airtact.acoustics.target_points import surface_points
from airtact.drives.linear_methods import time_reversal
from airtact.drives.transfer import focus_by_distance, transfer_matrix
from airtact.geometry.pose import Pose
from airtact.geometry.surface import Surface
from airtact.hands.files import load_hand
from airtact.hands.hand import Hand
from airtact.hands.joints import CHAINS
from airtact.hands.skin_mesh import even_skin
from airtact.transducers.layout import PhasedArray, flat_boards, surrounding_box

FREQUENCY = 40e3
"""Of the sound [Hz]."""

SPEED = 0.5
"""Of a hand that has moved on by the time that its drive is emitted [m/s]."""

OFF = 0.5e-3
"""Foci stand so far off the pads [m]."""

CLEAR = 0.2e-3
"""At least so far off a mesh of triangles [m]."""

BOX = 1.6
"""How many times as far off as in the paper's box the boards stand: a whole hand is to fit wherever it is believed."""

POSES = (0.5e-3, 1e-3, 2e-3, 3e-3, 5e-3)
"""Errors of the pose [m]."""

SHIFTS = (*POSES, 7.5e-3, 10e-3, 15e-3, 20e-3)
"""How far a whole hand is elsewhere [m]: by error, or by delay times ``SPEED``."""

SHARES = (0.05, 0.1, 0.15, 0.2)
"""Errors of radii over the radii."""

ACCURACIES = (0.02, 0.05, 0.1, 0.2, 0.3)
"""Of the solver, whose panels grow with them."""

TRIANGLES = (4e-3, 6e-3, 8e-3, 10e-3, 11e-3)
"""Edges of the triangles of a mesh that stands for the hand [m]; meshes of longer ones cross themselves."""


@dataclass(frozen=True)
class Outcome:
    """What one drive gives at the true hand.

    Attributes
    ----------
    scene : "pinch" or "open hand".
    error : what is wrong.
    size : by how much, in the unit in the error's name.
    seed : of the random choice.
    focus : pressure in the foci, their mean, over that of the drive with the right hand.
    worst : the same of the focus that loses most.
    side_lobes : root mean square of the pressure on the skin away from the foci, over that of the
        right drive.
    largest : the largest of it over the mean of the foci, both of this drive.
    """

    scene: str
    error: str
    size: float
    seed: int
    focus: float
    worst: float
    side_lobes: float
    largest: float


@dataclass(frozen=True)
class Case:
    """A drive that is wrong in one way.

    Attributes
    ----------
    error, size, seed : as in ``Outcome``.
    drive : makes it, of energy 1.
    panels : whether it is compared with the drive on the finest panels, not with that on panels as
        large as its own.
    """

    error: str
    size: float
    seed: int
    drive: Callable[[], Complex128[np.ndarray, "elements"]]
    panels: bool = False


@dataclass(frozen=True, eq=False)
class Study:
    """A hand, its array and its foci.

    Attributes
    ----------
    name : of the scene.
    hand : the true one.
    array : the transducers in the hand's frame.
    pads : names of the places that get a focus.
    folder : of the files of the matrix of the verification solution.
    verifying, right, driving : accuracies of the verification solution, of the drive on the finest
        panels, and of all drives that are not about panels.
    spacing : of the points of the skin where side lobes are evaluated [m], but within a wavelength
        of a focus.
    """

    name: str
    hand: Hand
    array: PhasedArray
    pads: tuple[str, ...]
    folder: Path
    verifying: float = 0.03
    right: float = 0.02
    driving: float = 0.2
    spacing: float = 20e-3

    @cached_property
    def side_lobe_points(self) -> Float64[np.ndarray, "points 3"]:
        """Points on the skin where side lobes are evaluated [m]."""
        points = surface_points(self.hand.surface, self.spacing)
        scene = _scene(self.hand.surface)
        far = np.asarray(KDTree(foci(self.hand, self.pads)).query(points)[0]) > scene.wavelength
        return points[far]

    @cached_property
    def reference(self) -> Complex128[np.ndarray, "points elements"]:
        """Pressure of each element [Pa] at the foci, and then at the side-lobe points, by the verification solution."""
        kept = self.folder / f"reference-{self.name.replace(' ', '-')}.npz"
        points = np.concatenate([foci(self.hand, self.pads), self.side_lobe_points])
        if kept.exists():
            found = np.load(kept)
            if np.array_equal(found["points"], points) and np.array_equal(
                found["array"], self.array.positions
            ):
                return found["matrix"]
        target = Target(foci(self.hand, self.pads), suppression_points=self.side_lobe_points)
        field = BoundaryElement(self.verifying).radiate(
            _scene(self.hand.surface), target.beacons(suppression=True)
        )
        matrix = transfer_matrix(field, self.array).matrix
        self.folder.mkdir(parents=True, exist_ok=True)
        np.savez(kept, points=points, array=self.array.positions, matrix=matrix)
        return matrix

    @cached_property
    def right_pressures(self) -> Float64[np.ndarray, "panels points"]:
        """Pressures of the drives of energy 1 for the right hand [Pa]: on usual panels, and on the finest."""
        return np.abs(
            np.stack([self.reference @ self.drive(field) for field in (self.believed, self.finest)])
        )

    @cached_property
    def finest(self) -> RadiatedField:
        """Field of the beacons at the right hand on the finest panels."""
        return beacons(self.hand, self.pads, self.right)

    @cached_property
    def believed(self) -> RadiatedField:
        """Field of the beacons at the right hand, from which the drives of hands that are elsewhere are made."""
        return beacons(self.hand, self.pads, self.driving)

    def blind(self) -> Complex128[np.ndarray, "elements"]:
        """Make the drive of energy 1 for the pads in free space, without the hand."""
        target = Target(foci(self.hand, self.pads))
        medium = _scene(self.hand.surface).medium
        amplitudes = focus_by_distance(self.array, target, medium, FREQUENCY).amplitudes
        return amplitudes / np.linalg.norm(amplitudes)

    def drive(
        self, field: RadiatedField, shift: Float64[np.ndarray, "3"] | None = None
    ) -> Complex128[np.ndarray, "elements"]:
        """Make the drive of energy 1 by time reversal.

        Parameters
        ----------
        field : of beacons at a hand.
        shift : (3,) by which that hand is believed to be elsewhere [m], or None.
        """
        array = self.array if shift is None else self.array.moved(Pose(np.eye(3), -shift))
        amplitudes = time_reversal(
            transfer_matrix(field, array), Target(field.sources.positions)
        ).amplitudes
        return amplitudes / np.linalg.norm(amplitudes)

    def outcome(self, case: Case) -> Outcome:
        """Make the drive of a case and evaluate it on the true hand."""
        found, right = np.abs(self.reference @ case.drive()), self.right_pressures[int(case.panels)]
        count = len(self.pads)
        focus = float(found[:count].mean())
        return Outcome(
            scene=self.name,
            error=case.error,
            size=case.size,
            seed=case.seed,
            focus=focus / float(right[:count].mean()),
            worst=float((found[:count] / right[:count]).min()),
            side_lobes=float(np.sqrt(np.mean(found[count:] ** 2) / np.mean(right[count:] ** 2))),
            largest=float(found[count:].max()) / focus,
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
    return BoundaryElement(accuracy).radiate(
        _scene(hand.surface), Target(foci(hand, pads)).beacons()
    )


def _scene(surface: Surface) -> Scene:
    return Scene(air(celsius=20.0, humidity=0.5), [sound_hard(surface)], FREQUENCY)


def studies(hands: Path, folder: Path) -> tuple[Study, Study]:
    """Set up a pinch in a box of four boards, wider than the paper's, and an open hand before four flat ones.

    Parameters
    ----------
    hands : folder with pinch.json and relaxed.json.
    folder : of the files of the matrices of the verification solutions.
    """
    pinch = load_hand(hands / "pinch.json").open_to(0.012)
    middle = 0.5 * (pinch.joints.min(axis=0) + pinch.joints.max(axis=0))
    box = surrounding_box()
    box = PhasedArray(BOX * box.positions + middle, box.normals, box.element)
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


def cases(study: Study, seeds: int) -> Iterator[Case]:
    """List every error that is tried.

    Parameters
    ----------
    study : the scene.
    seeds : random choices of each size of the errors that need a solution each; there are four
        times as many where one solution serves all.
    """
    yield Case("no hand at all", 0.0, 0, study.blind, panels=True)
    for seed, size in product(range(4 * seeds), SHIFTS):
        shift = size * random_direction(seed)
        yield Case("whole hand elsewhere [mm]", 1e3 * size, seed, partial(_elsewhere, study, shift))
    for accuracy in ACCURACIES:
        yield Case("panels [accuracy]", accuracy, 0, partial(_coarse, study, accuracy), panels=True)
    for share in (*(-share for share in SHARES), *SHARES):
        wrong = partial(scaled_radii, study.hand, share)
        yield Case("all radii wrong [%]", 100 * share, 0, partial(_wrong, study, wrong))
    for seed in range(seeds):
        for size in POSES:
            wrong = partial(bent, study.hand, size, seed)
            yield Case("fingers bent wrongly [mm]", 1e3 * size, seed, partial(_wrong, study, wrong))
        for share in SHARES:
            wrong = partial(random_radii, study.hand, share, seed)
            yield Case("each radius wrong [%]", 100 * share, seed, partial(_wrong, study, wrong))
    for edge in TRIANGLES:
        yield Case("triangles [mm]", 1e3 * edge, 0, partial(_triangles, study, edge), panels=True)


def _wrong(study: Study, hand: Callable[[], Hand]) -> Complex128[np.ndarray, "elements"]:
    return study.drive(beacons(hand(), study.pads, study.driving))


def _coarse(study: Study, accuracy: float) -> Complex128[np.ndarray, "elements"]:
    known = {study.right: study.finest, study.driving: study.believed}
    return study.drive(known.get(accuracy) or beacons(study.hand, study.pads, accuracy))


def _elsewhere(study: Study, shift: Float64[np.ndarray, "3"]) -> Complex128[np.ndarray, "elements"]:
    return study.drive(study.believed, shift)


def _triangles(study: Study, edge: float) -> Complex128[np.ndarray, "elements"]:
    """Drive of a mesh of triangles; a focus inside them moves out along the pad's normal."""
    scene = _scene(hand_of_triangles(study.hand, edge))
    points = foci(study.hand, study.pads)
    normals = np.array([study.hand.place(name)[1] for name in study.pads])
    points = points + np.maximum(scene.depth(points) + CLEAR, 0.0)[:, None] * normals
    return study.drive(BoundaryElement(study.driving).radiate(scene, Target(points).beacons()))


TURNED = 3
"""Joints of each finger that are turned, from its root on."""

FINEST, PASSES = 6e-3, 8
"""Edge of the triangles that coarser ones are made from [m], in so many passes."""


def random_direction(seed: int) -> Float64[np.ndarray, "3"]:
    """Choose a direction (3,) uniformly on the sphere.

    Parameters
    ----------
    seed : of the choice.
    """
    vector = np.random.default_rng(seed).normal(size=3)
    return vector / np.linalg.norm(vector)


def bent(hand: Hand, size: float, seed: int) -> Hand:
    """Turn the joints of all fingers by chance, bones keeping their lengths.

    Parameters
    ----------
    hand : right.
    size : root mean square distance by which the five tips are elsewhere afterwards [m].
    seed : of the choice.
    """
    turns = np.random.default_rng(seed).normal(size=(len(CHAINS), TURNED, 3))
    tips = [chain[-1] for chain in CHAINS]
    scale = 0.0 if size == 0.0 else 1e-3
    for _ in range(6 if size else 0):  # nearly proportional: a few steps find it
        away = np.linalg.norm(_turned(hand, scale * turns)[tips] - hand.joints[tips], axis=1)
        scale *= size / float(np.sqrt(np.mean(away**2)))
    return Hand(_turned(hand, scale * turns), hand.radii, hand.side)


def _turned(
    hand: Hand, turns: Float64[np.ndarray, "fingers turned 3"]
) -> Float64[np.ndarray, "25 3"]:
    joints = hand.joints.copy()
    for chain, finger in zip(CHAINS, turns, strict=True):
        first = len(chain) - 1 - TURNED
        for joint, turn in enumerate(finger, start=first):
            outer = list(chain[joint + 1 :])
            root = joints[chain[joint]]
            joints[outer] = root + Rotation.from_rotvec(turn).apply(joints[outer] - root)
    return joints


def random_radii(hand: Hand, share: float, seed: int) -> Hand:
    """Make the radius of every joint wrong by chance.

    Parameters
    ----------
    hand : right.
    share : root mean square error over the radii.
    seed : of the choice.
    """
    errors = np.random.default_rng(seed).normal(size=len(hand.radii))
    errors *= share / np.sqrt(np.mean(errors**2))
    return Hand(hand.joints, hand.radii * np.exp(errors), hand.side)


def scaled_radii(hand: Hand, share: float) -> Hand:
    """Make all radii too large or too small.

    Parameters
    ----------
    hand : right.
    share : by how much of the radius, negative for too small.
    """
    return Hand(hand.joints, hand.radii * (1.0 + share), hand.side)


def hand_of_triangles(hand: Hand, edge: float) -> Surface:
    """Mesh a hand with triangles of one size whose corners alone lie on it, as a file has them.

    Parameters
    ----------
    hand : right.
    edge : of the triangles [m], however much the skin bends.
    """
    hulls = hand.shape.hulls
    skin = even_skin(hulls, min(edge, FINEST))
    vertices, triangles = skin.vertices, skin.triangles
    for _ in range(PASSES):
        most = 2 * len(vertices)
        counts = np.array([len(vertices), len(triangles)])
        vertices = np.concatenate([vertices, np.zeros((most - counts[0], 3))])
        triangles = np.concatenate([triangles, np.zeros((2 * most - counts[1], 3), dtype=np.int64)])
        _kernels.even_pass(vertices, np.full(most, edge), triangles, counts, False, 1.0, 0.5)
        vertices, triangles = hulls.project(vertices[: counts[0]]), triangles[: counts[1]].copy()
    return Surface(vertices, triangles)


ROOT = Path(__file__).parent.parent
KEPT = ROOT / "out/hand_quality"
COLUMNS = [field.name for field in fields(Outcome)]


def read(path: Path) -> list[Outcome]:
    if not path.exists():
        return []
    with path.open() as lines:
        return [
            Outcome(
                row["scene"],
                row["error"],
                float(row["size"]),
                int(row["seed"]),
                *map(float, list(row.values())[4:]),
            )
            for row in csv.DictReader(lines)
        ]


def write(path: Path, outcomes: list[Outcome]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="") as lines:
        table = csv.DictWriter(lines, COLUMNS, lineterminator="\n")
        table.writeheader()
        for outcome in outcomes:
            row = asdict(outcome)
            table.writerow(
                row | {name: f"{row[name]:.5g}" for name in COLUMNS if isinstance(row[name], float)}
            )


def outcomes_of(study: Study, seeds: int) -> list[Outcome]:
    kept = KEPT / f"{study.name.replace(' ', '-')}.csv"
    done = read(kept)
    seen = {(one.error, one.size, one.seed) for one in done}
    for case in cases(study, seeds):
        if (case.error, float(f"{case.size:.5g}"), case.seed) in seen:
            continue
        began = time.perf_counter()
        done.append(study.outcome(case))
        write(kept, done)
        seconds = time.perf_counter() - began
        print(
            f"{study.name}, {case.error}, {case.size:g}, {case.seed}: {done[-1].focus:.3f}, {seconds:.1f} s",
            flush=True,
        )
    return done


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--scene", choices=("pinch", "open hand"))
    asked = parser.parse_args()
    found = []
    for study in studies(ROOT / "src/airtact/setup/examples/hands", KEPT):
        if asked.scene in (None, study.name):
            found += outcomes_of(study, asked.seeds)
    if asked.scene is None:
        from benchmarks.hand_quality_figure import answers, draw_quality

        write(ROOT / "docs/hand-mesh-quality.csv", found)
        draw_quality(found).savefig(ROOT / "docs/hand-mesh-quality.png", dpi=110)
        print("\n".join(answers(found)))


if __name__ == "__main__":
    main()
