"""Bodies before a rigid plane: against two mirrored bodies, what the plane costs, and reciprocity.

The series of two spheres is truth for a sphere; a hand is held against itself and its image solved
as two bodies, on the same panels, because a mesh that is rebuilt from mirrored triangles is another
body.

    python -m benchmarks.planes [sphere | hand | cost | reciprocity | palm |
    live]
"""

import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

import numpy as np

import airtact as at
from airtact.acoustics.solvers.bem.solutions import assemble, transposed_right_side
from airtact.acoustics.solvers.shared import gmres
from airtact.hands.hand import hand_from_joints
from airtact.live.drives.factors import OpenAir, PartSolver
from airtact.live.scene import foci_on
from references import before_a_plane
from references.motions import pinch_pose

AIR = at.Medium(sound_speed=343.1, density=1.293)
TABLE = at.plane((0, 0, 0), (0, 0, 1))
RADIUS = 8e-3
HEIGHTS = (0.2e-3, 0.5e-3, 1e-3, 2e-3, 5e-3, 10e-3, 40e-3)
"""Of the sphere over the plane [m]."""

RUNS = 5


def main(chosen: list[str]) -> None:
    """Print the rows that are chosen, or all."""
    for name in chosen or list(ROWS):
        for line in ROWS[name]():
            print(line, flush=True)


def sphere_rows() -> Iterator[str]:
    """Yield the error of a sphere at each height, in the field and on the plane, over 8 points of each."""
    random = np.random.default_rng(0)
    away = random.uniform((-0.1, -0.1, 0.001), (0.1, 0.1, 0.12), (40, 3))
    on = np.concatenate([random.uniform(-0.06, 0.06, (7, 2)), [[0.003, 0.001]]])
    on = np.concatenate([on, np.zeros((8, 1))], axis=1)
    for height in HEIGHTS:
        ball = at.sphere(RADIUS, RADIUS, centre=(0, 0, height + RADIUS))
        scene = at.Scene(AIR, [at.sound_hard(ball)], planes=[TABLE])
        free = away[-scene.depth(away) > 0.01][:8]
        beside = np.array(
            [[0.0, RADIUS + 0.5e-3, height + RADIUS], [0.0, 0.0, height + 2 * RADIUS + 1e-3]]
        )
        sources = np.concatenate([[[0.03, 0.02, 0.06], [0.04, 0.0, 0.0]], beside])
        points = np.concatenate([free, on])
        field = at.BoundaryElement(accuracy=0.01).radiate(
            scene, at.Monopoles(sources, np.eye(len(sources)))
        )
        exact, own = before_a_plane.sphere_pressure(scene, sources, points)
        found = field.at(points)
        errors = [relative(found[some], exact[some]) for some in (slice(0, 8), slice(8, None))]
        each = ", ".join(
            f"{relative(found[8:, one, None], exact[8:, one, None]):.2%}"
            for one in range(len(sources))
        )
        yield (
            f"sphere {1e3 * height:g} mm over a plane, 1 % asked: {errors[0]:.2%} in the field, {errors[1]:.2%} on the "
            f"plane ({each} from each source; {field.report.nodes} unknowns, "
            f"estimated {field.report.estimated_error:.2%}; series {own:.0e})"
        )


def open_hand(lift: float) -> at.Surface:
    """Return the open hand of the examples, palm down, its lowest point so far over the table [m]."""
    return hand_and_palm(lift)[0]


def hand_and_palm(lift: float) -> tuple[at.Surface, np.ndarray]:
    """Return the open hand, palm down, so far over the table, and a point 1 mm before the middle of its palm [m]."""
    hand = at.load_hand(at.example("open_hand").parent / "hands/relaxed.json")
    palm, normal = hand.place("palm")
    turn = at.Pose.turn(*_turn_down(normal))
    turned = hand.surface.moved(turn)
    lowest = turned.shape.farthest(np.array([0.0, 0.0, -1.0]))[2]
    middle = turned.vertices.mean(axis=0)
    move = at.Pose(np.eye(3), np.array([-middle[0], -middle[1], lift - lowest]))
    return turned.moved(move), move.apply(turn.apply((palm + 1e-3 * normal)[None]))[0]


def _turn_down(direction: np.ndarray) -> tuple[tuple[float, float, float], float]:
    """Axis and angle [rad] that turn a direction to -z."""
    axis = np.cross(direction, [0.0, 0.0, -1.0])
    angle = np.arctan2(np.linalg.norm(axis), -direction[2])
    x, y, z = (axis / np.linalg.norm(axis)).tolist()
    return (x, y, z), float(angle)


def hand_rows() -> Iterator[str]:
    """Yield how far a hand over a table is from itself and its image solved as two bodies, on the same panels."""
    random = np.random.default_rng(1)
    on = np.concatenate([random.uniform(-0.08, 0.08, (30, 2)), np.zeros((30, 1))], axis=1)
    around = np.array([0.0, 0.0, 0.1]) + 0.25 * _upper(random.normal(size=(40, 3)))
    sources = np.array([[0.01, 0.02, 0.0], [0.15, 0.05, 0.3]])
    both, strengths = (
        np.concatenate([sources, sources * [1, 1, -1]]),
        np.tile(np.eye(2, dtype=complex), (2, 1)),
    )
    solver = at.BoundaryElement(accuracy=0.01)
    for lift in (2e-3, 20e-3):
        scene = at.Scene(AIR, [at.sound_hard(open_hand(lift))], planes=[TABLE])
        field = solver.radiate(scene, at.Monopoles(sources, np.eye(2)))
        matrix = assemble(field.surface, "float32", 0.002)
        right, _ = transposed_right_side(field.surface, both, strengths)
        sides = np.ascontiguousarray(right.T, dtype=np.complex64)
        solved = gmres(lambda vectors, matrix=matrix: matrix.times(vectors, True), sides, 1e-4)
        twice = replace(field, density=solved.solution.T.astype(np.complex128))
        apart = [
            relative(field.transposed.at(points), twice.transposed.at(points))
            for points in (around, on)
        ]
        yield (
            f"hand {1e3 * lift:g} mm over a table, 1 % asked, against it and its image as two bodies: "
            f"{apart[0]:.2%} around, {apart[1]:.2%} on the table ({field.report.nodes} and {matrix.count} unknowns)"
        )


def _upper(vectors: np.ndarray) -> np.ndarray:
    vectors = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    return vectors * np.sign(vectors[:, 2:] + 0.3)


def _matrix(scene: at.Scene, target: at.Target, array: at.PhasedArray) -> at.TransferMatrix:
    return at.transfer_matrix(
        at.BoundaryElement(accuracy=0.01).radiate(scene, target.beacons()), array
    )


def cost_rows() -> Iterator[str]:
    """Yield the time of a solve with a plane over that without it, two foci, transfer matrix of a board included."""
    array = at.autd3_board(at.Pose(np.eye(3), np.array([-0.09, -0.07, 0.0])))
    for lift in (20e-3, 200e-3):
        body = open_hand(lift)
        lowest = body.shape.farthest(np.array([0.0, 0.0, -1.0]))
        target = at.Target(np.array([lowest - [0, 0, 1e-3], lowest - [0.01, 0.0, 2e-3]]))
        taken = {}
        for name, planes in (("without", []), ("with", [TABLE])):
            scene = at.Scene(AIR, [at.sound_hard(body)], planes=planes)
            taken[name] = seconds(partial(_matrix, scene, target, array))
        yield (
            f"hand {1e3 * lift:g} mm over a board in a table, 2 foci, 1 % asked: {taken['without']:.2f} s without the "
            f"plane, {taken['with']:.2f} s with it, {taken['with'] / taken['without']:.2f} times (median of {RUNS})"
        )


def palm_rows() -> Iterator[str]:
    """Yield what a drive for a palm keeps of its pressure that does not know the table its board is let into.

    Both drives are at full scale.
    """
    for lift in (50e-3, 100e-3, 195e-3, 200e-3, 205e-3):
        body, focus = hand_and_palm(lift)
        array = at.autd3_board(
            at.Pose(np.eye(3), np.array([focus[0] - 0.086, focus[1] - 0.066, 0.0]))
        )
        target, solver = at.Target(focus[None]), at.BoundaryElement(accuracy=0.03)
        fields = [
            solver.radiate(at.Scene(AIR, [at.sound_hard(body)], planes=planes), target.beacons())
            for planes in ([], [TABLE])
        ]
        without, known = (at.transfer_matrix(field, array) for field in fields)
        blind, best = (np.abs(known.pressure(at.best(one, target))[0]) for one in (without, known))
        yield (
            f"palm, the hand {1e3 * lift:g} mm over a board in a table: a drive that does not know the table keeps "
            f"{blind / best:.1%} of {best:.0f} Pa"
        )


def live_rows() -> Iterator[str]:
    """Yield what drives of the live loop keep for a hand that pinches over a table, a board standing beside it.

    The hand does not move, so that nothing but the table tells the drives apart; it is solved with
    the table.
    """
    hand = hand_from_joints(*pinch_pose(), side="left").open_to(0.02)
    low, middle = hand.surface.corners.reshape(-1, 3).min(axis=0), hand.pads[:2].mean(axis=0)
    for lift in (20e-3, 40e-3, 80e-3, 160e-3):
        table = at.plane((0, 0, low[2] - lift), (0, 0, 1))
        at_board = (middle[0] - 0.09, low[1] - 0.1, table.point[2] + 0.14)
        array = at.autd3_board(at.Pose.turn((1, 0, 0), -np.pi / 2, at_board))
        places, offsets = ("thumb.pad", "index.pad"), np.full(2, 1e-3)
        without = at.live.LiveScene(at.air(), 40e3, array, "left", hand.radii, places, offsets)
        target = at.Target(foci_on(hand, without))
        scene = at.Scene(
            without.medium, [at.sound_hard(hand.surface)], frequency=40e3, planes=[table]
        )
        exact = at.transfer_matrix(
            at.BoundaryElement(accuracy=0.02).radiate(scene, target.beacons()), array
        )
        best = _at_weakest(exact, at.best(exact, target).amplitudes)
        shares = []
        for known in (replace(without, planes=(table,)), without):
            for part in ("hand", "phalanges"):
                factors = PartSolver(known).meshed(hand.joints, part, 0.0).factors
                rows = known.with_images.folded(OpenAir(known).rows(target.points) * factors)
                drive = at.weighted_gerchberg_saxton(at.TransferMatrix(rows, float("nan")), target)
                shares.append(_at_weakest(exact, drive.amplitudes) / best)
        words = "whole hand {:.3f}, phalanges {:.3f} (without the table {:.3f}, {:.3f})".format(
            *shares
        )
        yield f"live, a hand {1e3 * lift:g} mm over a table: of the attainable pressure {words} are kept"


def _at_weakest(exact: at.TransferMatrix, amplitudes: np.ndarray) -> float:
    """Pressure at the weakest focus over the root of the energy."""
    return float(np.abs(exact.matrix @ amplitudes).min() / np.linalg.norm(amplitudes))


def reciprocity_rows() -> Iterator[str]:
    """Yield the difference of the field when sources and points change places, over a ball and the plane."""
    pairs = np.array([[0.04, 0.0, 0.0], [0.02, -0.03, 0.05], [-0.03, 0.02, 0.02], [0.0, 0.05, 0.0]])
    ball = at.sphere(RADIUS, RADIUS, centre=(0, 0, 1e-3 + RADIUS))
    scene = at.Scene(AIR, [at.sound_hard(ball)], planes=[TABLE])
    for asked in (0.03, 0.01, 0.003):
        worst = 0.0
        for one in range(4):
            for other in range(one):
                there, back = (
                    at.BoundaryElement(asked)
                    .radiate(scene, at.Monopoles(pairs[[a]], np.ones(1)))
                    .at(pairs[[b]])[0, 0]
                    for a, b in ((one, other), (other, one))
                )
                worst = max(worst, abs(there - back) / abs(there))
        yield f"reciprocity of a ball 1 mm over a plane, {asked:.1%} asked: {worst:.1e} at worst"


def relative(found: np.ndarray, exact: np.ndarray) -> float:
    """Largest error of an excitation, over its points together."""
    return float((np.linalg.norm(found - exact, axis=0) / np.linalg.norm(exact, axis=0)).max())


def seconds(solve: Callable[[], object]) -> float:
    """Median time of some runs [s]."""
    taken = []
    solve()  # panels are kept
    for _ in range(RUNS):
        begun = time.perf_counter()
        solve()
        taken.append(time.perf_counter() - begun)
    return float(np.median(taken))


ROWS = {
    "sphere": sphere_rows,
    "hand": hand_rows,
    "cost": cost_rows,
    "reciprocity": reciprocity_rows,
    "palm": palm_rows,
    "live": live_rows,
}


if __name__ == "__main__":
    main(sys.argv[1:])
