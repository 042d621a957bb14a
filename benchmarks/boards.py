"""Boards that reflect: the paper's box, a palm over a board and a table, reciprocity, and thickness.

    python -m benchmarks.boards [box | picture | palm | reciprocity | thickness]

``box`` solves the paper's pinch in its box of four boards, and again with smaller panels; ``box
0.03`` takes another accuracy than 5 %. ``picture`` draws what drives make there.
"""

import resource
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import airtact as at
from benchmarks.planes import hand_and_palm, relative

AIR = at.air(celsius=20)
PICTURE = Path(__file__).resolve().parents[1] / "docs/boards-that-reflect.png"

TABLE_BELOW = 20e-3
"""The table is so far under the faces of the board [m]: its feet."""


def main(chosen: list[str]) -> None:
    """Print the rows that are chosen, or all."""
    numbers = [float(one) for one in chosen if one[0].isdigit()]
    for name in [one for one in chosen if not one[0].isdigit()] or list(ROWS):
        for line in ROWS[name](*numbers):
            print(line, flush=True)


def box_rows(accuracy: float = 0.05) -> Iterator[str]:
    """Yield what the paper's box of reflecting boards takes, how right it is, and what the boards change.

    The box is solved a second time with panels for 0.4 of the error.
    """
    array, apart, scene, target = paper_box()
    begun, used = time.perf_counter(), time.process_time()
    field = at.BoundaryElement(accuracy, estimate=False).radiate(scene, target.beacons())
    known = at.transfer_matrix(field, array)
    took, cpu = time.perf_counter() - begun, time.process_time() - used
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    yield (
        f"pinch in the box of four reflecting boards, {accuracy:.0%} asked: {field.report.nodes} unknowns, "
        f"{field.report.iterations} iterations, {took:.0f} s ({cpu:.0f} s of processor), {memory:.2f} GiB at most"
    )
    unknown = at.transfer_matrix(at.BoundaryElement(0.01).radiate(apart, target.beacons()), array)
    transfers = {
        "distances": at.open_air_matrix(apart, array, target),
        "fingers": unknown,
        "fingers and boards": known,
    }
    yield from _kept_lines(transfers, target)
    finer = at.BoundaryElement(0.4 * accuracy, estimate=False).radiate(scene, target.beacons())
    off = relative(known.matrix.T, at.transfer_matrix(finer, array).matrix.T)
    yield f"the transfer matrix is {off:.1%} from that of {0.4 * accuracy:.1%} asked, {finer.report.nodes} unknowns"


def paper_box() -> tuple[at.PhasedArray, at.Scene, at.Scene, at.Target]:
    """Make the paper's box, scenes of its fingers without and with the boards, and a focus 1 mm before each pad."""
    pinch, array = at.pinch(), at.surrounding_box()
    fingers = [at.sound_hard(surface) for surface in pinch.surfaces]
    scenes = at.Scene(AIR, fingers), at.Scene(AIR, [*fingers, *at.reflecting_boards(array)])
    return array, *scenes, at.Target(pinch.pads + 1e-3 * pinch.normals)


def _kept_lines(transfers: dict[str, at.TransferMatrix], target: at.Target) -> Iterator[str]:
    """Yield the pressure at the weaker pad of drives that know more and more, where the boards reflect and not."""
    known, unknown = transfers["fingers and boards"], transfers["fingers"]
    for method in (at.time_reversal, at.best):
        for name, transfer in transfers.items():
            whole = method(transfer, target).amplitudes
            held = whole / np.abs(whole).max(), whole / np.linalg.norm(whole), whole / np.abs(whole)
            there, here = (
                [np.abs(one.matrix @ drive).min() for drive in held] for one in (known, unknown)
            )
            words = ", ".join(
                f"{one:.0f} ({other:.0f})" for one, other in zip(there, here, strict=True)
            )
            yield (
                f"{method.__name__} that knows {name}, boards that reflect (that do not): {words} Pa at equal peak, "
                "energy and by phases alone"
            )


def picture_rows(accuracy: float = 0.05) -> Iterator[str]:
    """Solve what drives make in the box of reflecting boards, and draw docs/boards-that-reflect.png."""
    array, apart, scene, target = paper_box()
    quick = at.BoundaryElement(accuracy, estimate=False)
    known, unknown = (
        at.transfer_matrix(quick.radiate(one, target.beacons()), array) for one in (scene, apart)
    )
    drives = {
        "knows the fingers": at.best(unknown, target),
        "and the boards": at.best(known, target),
    }
    solver = at.BoundaryElement(accuracy)
    played = at.compare(scene, array, drives, target, solver=solver)
    alone = at.compare(apart, array, {"blind": drives["knows the fingers"]}, target, solver=solver)
    yield f"forwards in the box: {np.round(played.pressures['equal peak']).tolist()} Pa, {played.report.nodes} unknowns"
    figure, axes = plt.subplots(1, 3, figsize=(15, 4.2), layout="constrained")
    shown = (alone, 0), (played, 0), (played, 1)
    titles = (
        "boards that do not reflect",
        "boards reflect, drive does not know it",
        "boards reflect, drive knows it",
    )
    for ax, (made, drive), title in zip(axes, shown, titles, strict=True):
        at.plot.field(made, target, drive=drive, plane="xz", ax=ax)
        ax.set_title(title)
    figure.savefig(PICTURE, dpi=90)


def palm_rows(accuracy: float = 0.05) -> Iterator[str]:
    """Yield what a board and a table under it change for a palm, over half a wavelength and at other heights."""
    table = at.plane((0, 0, -TABLE_BELOW), (0, 0, 1))
    for lift in (50e-3, 100e-3, 195.7e-3, 197.85e-3, 200e-3, 202.15e-3, 204.3e-3):
        hand, focus = hand_and_palm(lift)
        array = at.autd3_board(
            at.Pose(np.eye(3), np.array([focus[0] - 0.086, focus[1] - 0.066, 0.0]))
        )
        boards, target = at.reflecting_boards(array), at.Target(focus[None])
        body, solver = at.sound_hard(hand), at.BoundaryElement(accuracy, estimate=True)
        matrices = [
            at.transfer_matrix(
                solver.radiate(at.Scene(AIR, bodies, planes=planes), target.beacons()), array
            )
            for bodies, planes in (([body], []), ([body, *boards], []), ([body, *boards], [table]))
        ]
        blind = at.best(matrices[0], target)
        words = []
        for name, matrix in zip(("board", "board and table"), matrices[1:], strict=True):
            best, kept = (
                np.abs(matrix.pressure(one))[0] for one in (at.best(matrix, target), blind)
            )
            words.append(
                f"with the {name} {best:.0f} Pa, of which a drive that knows neither keeps {kept / best:.1%}"
            )
        alone = np.abs(matrices[0].pressure(blind))[0]
        yield f"palm, the hand {1e3 * lift:g} mm over a board: {alone:.0f} Pa without reflections; {'; '.join(words)}"


def reciprocity_rows() -> Iterator[str]:
    """Yield how far forward solves of elements in a board are from what its beacons read, over bodies and a plane."""
    array = at.autd3_board()
    points = np.array([[0.05, 0.05, 0.06], [0.12, 0.03, 0.1], [0.086, 0.066, 0.15]])
    ball = at.impedance(at.sphere(8e-3, 3e-3, centre=(0.09, 0.07, 0.04)), 2 + 1j)
    for planes in ([], [at.plane((0, 0, -TABLE_BELOW), (0, 0, 1))]):
        scene = at.Scene(AIR, [ball, *at.reflecting_boards(array)], planes=planes)
        chosen = np.random.default_rng(0).normal(size=(len(array), 2)) @ [1, 1j]
        drive = at.Drive(chosen / np.abs(chosen).max())
        for asked in (0.05, 0.02, 0.01):
            solver = at.BoundaryElement(asked)
            read = at.transfer_matrix(
                solver.radiate(scene, at.Target(points).beacons()), array
            ).pressure(drive)
            made = at.field_map(scene, array, drive, points, solver=solver)
            yield (
                f"reciprocity of a board and a lined ball, {len(planes)} planes, {asked:.1%} asked: "
                f"{np.abs(read - made).max() / np.abs(made).max():.1e} at worst"
            )


def thickness_rows() -> Iterator[str]:
    """Yield what another thickness of the board changes in its transfer matrix, and the board itself."""
    array = at.autd3_board()
    target = at.Target(np.array([[0.086, 0.066, 0.15], [0.03, 0.02, 0.1]]))
    plain = at.open_air_matrix(at.Scene(AIR, []), array, target).matrix
    found = {}
    for thickness in (8.7e-3, 1.6e-3, 6e-3, 12e-3):
        scene = at.Scene(AIR, at.reflecting_boards(array, thickness))
        found[thickness] = at.transfer_matrix(
            at.BoundaryElement(0.02).radiate(scene, target.beacons()), array
        ).matrix
        first = found[8.7e-3]
        off = relative(found[thickness].T, plain.T), relative(found[thickness].T, first.T)
        yield (
            f"an AUTD3 board {1e3 * thickness:g} mm thick: its transfer matrix is {off[0]:.2%} from that of a baffle "
            f"without end, {off[1]:.2%} from that at 8.7 mm"
        )


ROWS = {
    "box": box_rows,
    "picture": picture_rows,
    "palm": palm_rows,
    "reciprocity": reciprocity_rows,
    "thickness": thickness_rows,
}


if __name__ == "__main__":
    main(sys.argv[1:])
