"""Places of boards: time of a search, how near the winner is to a longer search, gain over the median, other arrays.

python -m benchmarks.placing [time | search | median | arrays]
"""

import sys
import time
from collections.abc import Iterator
from itertools import pairwise

import numpy as np

import airtact as at


def main(chosen: list[str]) -> None:
    """Print the rows that are chosen, or all."""
    for name in chosen or list(ROWS):
        for line in ROWS[name]():
            print(line, flush=True)


def time_rows() -> Iterator[str]:
    """Yield the time of a tenth of 10,000 layouts of two boards for five poses of a hand."""
    setup = at.read_scene("pinch_pose")
    hand = at.load_hand(at.example("pinch.json"))
    hands = [hand.open_to(1e-3 * gap) for gap in (8, 10, 12, 14, 16)]
    steps: list[tuple[str, float, float]] = []

    def report(step: str) -> None:
        steps.append((step, time.perf_counter(), time.process_time()))

    result = at.place(setup, 2, hands=hands, tries=1000, refine=0, progress=report)
    report("end")
    for (step, wall, processor), (_, end, last) in pairwise(steps):
        yield f"{step}: {end - wall:.0f} s, {last - processor:.0f} s of processor time"
    index = next(i for i, (step, *_) in enumerate(steps) if step.startswith("trying"))
    wall, processor = (steps[index + 1][i] - steps[index][i] for i in (1, 2))
    yield (
        f"{len(result.layouts)} layouts of 2 boards, 5 hands: 10,000 take {10 * wall / 60:.1f} min, "
        f"{10 * processor / 60:.1f} min of processor time (600 s on two processors asked)"
    )


def search_rows() -> Iterator[str]:
    """Yield the winner of searches of one, two and four boards, and of ten times the search."""
    for name, boards in (("pinch", 1), ("pinch", 2), ("pinch", 4), ("open_hand", 2)):
        setup = at.read_scene(name)
        short, long = (at.place(setup, boards, tries=tries) for tries in (1000, 10_000))
        ratio = short.layouts[0].weakest / long.layouts[0].weakest
        yield f"{name}, {boards} boards, 1,000 layouts: {ratio:.3f} of 10,000 (0.98 asked); {short}"


def median_rows() -> Iterator[str]:
    """Yield the best layout over the median one, for the pinch and the open hand."""
    for name in ("pinch", "pinch_pose", "open_hand"):
        for boards in (1, 2):
            result = at.place(at.read_scene(name), boards)
            best = result.layouts[0].weakest
            yield (
                f"{name}, {boards} boards: {best:,.0f} Pa, {best / result.median:.2f} of the median "
                f"(1.5 asked), {result.verified / best:.3f} by a finer solve"
            )


def array_rows() -> Iterator[str]:
    """Yield the paper's box, the best flat 2 x 2 and the best four boards around the pinch."""
    setup = at.read_scene("pinch")
    beacons = at.multipole_expansion(setup.solver.radiate(setup.scene, setup.target.beacons()))
    flat = []
    middle = setup.target.points.mean(axis=0)
    # The lowest fingertip is 0.15 m away from above, the others are clear of the hand too.
    for direction in np.concatenate([np.eye(3), -np.eye(3)]):
        array = at.flat_boards(2, 2).facing(middle, tuple(direction), 0.2)
        transfer = at.transfer_matrix(beacons, array)
        drive = at.best(transfer, setup.target)
        flat.append(np.abs(transfer.pressure(drive)).min())
    four = at.place(setup, 4, distance=(0.15, 0.25))
    near = at.place(setup, 4, distance=(0.05, 0.25))
    yield (
        f"996 transducers around the pinch: the paper's box at 70 mm {four.present:,.0f} Pa; flat 2 x 2 at 0.2 m from 6 sides "
        f"{min(flat):,.0f} to {max(flat):,.0f} Pa; four boards placed 0.15 m off {four.layouts[0].weakest:,.0f} Pa, "
        f"0.05 m off {near.layouts[0].weakest:,.0f} Pa"
    )
    hand = at.read_scene("open_hand")
    result = at.place(hand, 4)
    yield (
        f"996 transducers, open hand: flat 2 x 2 at 0.2 m {result.present:,.0f} Pa; four boards placed 0.15 m off "
        f"{result.layouts[0].weakest:,.0f} Pa"
    )


ROWS = {"time": time_rows, "search": search_rows, "median": median_rows, "arrays": array_rows}

if __name__ == "__main__":
    main(sys.argv[1:])
