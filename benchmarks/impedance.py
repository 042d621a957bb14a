"""Locally reacting bodies by boundary elements: against series and finite elements, their cost, reciprocity, and skin.

python -m benchmarks.impedance [sphere | plate | cost | reciprocity | skin]
"""

import sys
import time
from collections.abc import Iterator

import numpy as np

import airtact as at
from benchmarks.accuracy import PAPER_AIR, directions, one_each
from benchmarks.planes import open_hand, relative

RATIOS = (0.5, 2.0, 2 + 2j, 20.0)
K = PAPER_AIR.wavenumber(40e3).real
RADII = {"8 mm": 8e-3, "20 mm": 20e-3, "j0": np.pi / K, "j1": 4.493409 / K, "j3": 6.98793 / K}
"""The interior of the last three resonates."""

SKIN = 1.6e6 / 415
"""Impedance of soft tissue over that of air (F. A. Duck, Physical Properties of Tissue, 1990, chapter 4)."""

RUNS = 3


def main(chosen: list[str]) -> None:
    """Print the rows that are chosen, or all."""
    for name in chosen or list(ROWS):
        for line in ROWS[name]():
            print(line, flush=True)


def body_of(surface: at.Surface, ratio: complex | None) -> at.acoustics.Obstacle:
    """Return a body of an impedance, or a sound-hard one."""
    return at.sound_hard(surface) if ratio is None else at.impedance(surface, ratio)


def sphere_rows() -> Iterator[str]:
    """Yield the error of spheres against their series: 6 sources 0.5 mm off and 6 sources 30 mm off, 1 % asked."""
    for name, radius in RADII.items():
        for ratio in (None, *RATIOS):
            scene = at.Scene(PAPER_AIR, [body_of(at.sphere(radius, radius), ratio)])
            sources = np.concatenate(
                [directions(6, 1) * (radius + 0.5e-3), directions(6, 2) * (radius + 0.03)]
            )
            found, exact = (
                one.radiate(scene, one_each(sources))
                for one in (at.BoundaryElement(), at.SphereSeries())
            )
            away, near = directions(60, 3) * (radius + 0.05), directions(60, 4) * (radius + 2e-3)
            errors = [relative(found.at(at_), exact.at(at_)) for at_ in (away, near)]
            yield (
                f"sphere of {name}, ratio {ratio}: {errors[0]:.2%} at 50 mm, {errors[1]:.2%} at 2 mm off, the worst of "
                f"12 sources ({found.report.nodes} unknowns, {found.report.iterations} iterations, estimated "
                f"{found.report.estimated_error:.2%})"
            )


def plate_rows() -> Iterator[str]:
    """Yield the difference of both solvers for a plate of 20 x 20 x 2 mm, the source 5 mm off it and receivers away.

    "Both ways" is with source and receivers changed about.
    """
    plate = _plate()
    source, away = np.array([[0.002, 0.001, 0.006]]), directions(40, 3) * 0.1
    for ratio in (None, 0.5, 2.0, 2 + 2j):
        scene = at.Scene(PAPER_AIR, [body_of(plate, ratio)])
        field = at.FiniteElement(order=4).radiate(scene, one_each(source)).at(away)
        for asked in (0.01, 0.003):
            solver = at.BoundaryElement(asked)
            forth = solver.radiate(scene, one_each(source)).at(away)
            back = solver.radiate(scene, one_each(away)).at(source).T
            yield (
                f"plate, ratio {ratio}, {asked:.1%} asked: {relative(forth, field):.2%} from finite elements, "
                f"{relative(back, field):.2%} the other way"
            )


def _plate() -> at.Surface:
    import trimesh

    box = trimesh.creation.box((0.02, 0.02, 0.002))
    return at.Surface(np.asarray(box.vertices), np.asarray(box.faces))


def cost_rows() -> Iterator[str]:
    """Yield processor time of a hand's solve for two foci over that of the sound-hard hand, 1 and 3 % asked."""
    hand = open_hand(20e-3)
    lowest = hand.shape.farthest(np.array([0.0, 0.0, -1.0]))
    target = at.Target(np.array([lowest - [0, 0, 1e-3], lowest - [0.01, 0.0, 2e-3]]))
    for asked in (0.03, 0.01):
        solver, taken, unknowns = at.BoundaryElement(asked), {}, {}
        for ratio in (None, SKIN, 20.0, 2 + 1j, 0.5):
            scene = at.Scene(PAPER_AIR, [body_of(hand, ratio)])
            solver.radiate(scene, target.beacons())  # panels are kept
            times = []
            for _ in range(RUNS):
                begun = time.process_time()
                unknowns[ratio] = solver.radiate(scene, target.beacons()).report.nodes
                times.append(time.process_time() - begun)
            taken[ratio] = min(times)
            yield (
                f"hand, ratio {ratio}, {asked:.0%} asked: {unknowns[ratio]} unknowns, {taken[ratio]:.2f} s of a "
                f"processor, {taken[ratio] / taken[None]:.2f} times the sound-hard one"
            )


def reciprocity_rows() -> Iterator[str]:
    """Yield how far a field changes when sources and points change places, about a short lined finger and a plane."""
    here, there = directions(3, 1) * 0.018 + [0, 0, 0.03], directions(4, 2) * 0.03 + [0, 0, 0.035]
    finger = at.capsule((-0.01, 0, 0.03), (0.01, 0, 0.03), 6e-3, 3e-3)
    for planes in ([], [at.plane((0, 0, 0), (0, 0, 1))]):
        scene = at.Scene(PAPER_AIR, [at.impedance(finger, 1.5 + 0.5j)], planes=planes)
        for asked in (0.03, 0.01, 0.003):
            worst = []
            for estimate in (True, False):
                solver = at.BoundaryElement(asked, estimate=estimate)
                forth = solver.radiate(scene, one_each(here)).at(there)
                back = solver.radiate(scene, one_each(there)).at(here).T
                worst.append(np.abs(forth - back).max() / np.abs(forth).mean())
            yield (
                f"reciprocity of a lined finger, {len(planes)} planes, {asked:.1%} asked: {worst[0]:.1e} at worst, "
                f"{worst[1]:.1e} without an estimate"
            )


def skin_rows() -> Iterator[str]:
    """Yield what the impedance of skin changes in the transfer matrix of a finger before a board."""
    finger = at.capsule((-0.012, 0, 0), (0.012, 0, 0), 8e-3, 4e-3)
    target = at.Target(np.array([[0, 0, -8.5e-3], [0.01, 0, -9e-3]]))
    array = at.autd3_board(at.Pose(np.eye(3), np.array([-0.09, -0.07, -0.2])))
    rigid, skin = (
        at.transfer_matrix(
            at.BoundaryElement(0.003).radiate(
                at.Scene(PAPER_AIR, [body_of(finger, ratio)]), target.beacons()
            ),
            array,
        ).matrix
        for ratio in (None, SKIN)
    )
    yield f"finger of skin, ratio {SKIN:.0f}: its transfer matrix is {relative(skin.T, rigid.T):.1e} from a rigid one's"


ROWS = {
    "sphere": sphere_rows,
    "plate": plate_rows,
    "cost": cost_rows,
    "reciprocity": reciprocity_rows,
    "skin": skin_rows,
}


if __name__ == "__main__":
    main(sys.argv[1:])
