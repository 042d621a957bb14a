"""Distance from which one hand's sound on the other may be left out.

A relaxed left hand and its mirror image, 2 x 2 flat boards 200 mm away, foci 1 mm off the palm and the
pads of thumb and index finger of each. Palms face each other, with the boards at their side, or lie side
by side over the boards. The matrix of both hands solved together is compared with that of each hand
solved alone. Printed are the errors of its rows, amplitudes and phases, medians over the foci and largest,
and the pressure at the weakest focus that the drive from hands solved alone keeps, at equal energy;
after it, what drives of the live loop during touch keep, from distances and from the solver for skin,
and the processor time of its solution. Every drive has the same amplitude at all elements, so equal
energy is the same as full scale.
"""

import time

import numpy as np

import airtact as at
from airtact.drives.gerchberg_saxton import weighted_gerchberg_saxton
from airtact.live.drives.factors import OpenAir
from airtact.live.drives.skin_solver import SkinRequest, SkinSolver
from airtact.live.scene import SIDES, LiveScene

PLACES = ("palm", "thumb.pad", "index.pad")

DISTANCES = (0.01, 0.02, 0.03, 0.05, 0.08, 0.12, 0.2)
"""Distances between the skins of both hands [m]."""


def compared(facing: bool, distance: float) -> tuple[float, ...]:
    """Return errors of rows, the root mean square phase error [rad], kept shares, and a time [ms]."""
    left = at.load_hand(at.example("relaxed.json"))
    _, palm = left.places["palm"]
    fingers = left.joints[9] - left.joints[0]
    across = np.cross(palm, fingers)
    # The right hand is the mirror image in a plane half the distance away from the skin. Side by side,
    # thumbs are next to each other.
    normal = palm if facing else across * np.sign((left.joints[4] - left.joints[0]) @ across)
    normal = normal / np.linalg.norm(normal)
    skin = left.surface.vertices
    height = float((skin @ normal).max()) + 0.5 * distance
    joints = left.joints - 2.0 * np.outer(left.joints @ normal - height, normal)
    right = at.Hand(joints, left.radii, "right" if left.side == "left" else "left")
    middle = left.joints.mean(axis=0)
    middle = middle + (height - middle @ normal) * normal
    towards = -across if facing else palm
    array = at.flat_boards(2, 2).facing(
        tuple(middle), tuple(towards / np.linalg.norm(towards)), 0.2
    )
    hands = (left, right)
    foci = [np.array([hand.focus(place, 1e-3) for place in PLACES]) for hand in hands]
    air = at.air(celsius=22)
    solver = at.BoundaryElement(accuracy=0.03, estimate=False)

    def solved(bodies: tuple[at.Hand, ...], points: np.ndarray) -> np.ndarray:
        scene = at.Scene(air, [at.sound_hard(hand.surface) for hand in bodies], frequency=40e3)
        return at.transfer_matrix(solver.radiate(scene, at.Target(points).beacons()), array).matrix

    every = np.concatenate(foci)
    both = solved(hands, every)
    alone = np.concatenate(
        [solved((hand,), points) for hand, points in zip(hands, foci, strict=True)]
    )
    errors = np.linalg.norm(alone - both, axis=1) / np.linalg.norm(both, axis=1)
    phases = np.sqrt(np.average(np.angle(alone / both) ** 2, weights=np.abs(both) ** 2))

    def weakest(matrix: np.ndarray) -> float:
        drive = weighted_gerchberg_saxton(at.TransferMatrix(matrix, np.nan), at.Target(every))
        return float(np.abs(both @ drive.amplitudes).min() / np.linalg.norm(drive.amplitudes))

    nothing = np.zeros(0)
    live = LiveScene(air, 40e3, array, left.side, left.radii, (), nothing, both=True)
    joints_of = {hand.side: hand.joints for hand in hands}
    still = {side: np.zeros((25, 3)) for side in joints_of}
    owners = np.repeat([SIDES.index(hand.side) for hand in hands], len(PLACES))
    asked = SkinRequest(0.0, 0.0, joints_of, still, every, owners)
    skin = SkinSolver(live)
    skin.solved((asked, joints_of), 0.0)  # meshes the hands
    begun = time.process_time()
    factors = skin.solved((asked, joints_of), 0.0)
    seconds = time.process_time() - begun
    assert factors is not None
    rows = OpenAir(live).rows(every)
    return (
        float(np.median(errors)),
        errors.max(),
        float(phases),
        weakest(alone) / weakest(both),
        weakest(rows) / weakest(both),
        weakest(rows * factors.factors) / weakest(both),
        1e3 * seconds,
    )


def main() -> None:
    """Print one line for each arrangement and distance."""
    for facing in (True, False):
        for distance in DISTANCES:
            median, most, phase, kept, straight, live, spent = compared(facing, distance)
            print(
                f"{'palms facing' if facing else 'side by side'}, {1e3 * distance:.0f} mm apart: error "
                f"median {median:.2f}, largest {most:.2f}, phase {phase:.2f} rad; kept {kept:.3f}; "
                f"live: distances {straight:.3f}, solved {live:.3f} in {spent:.0f} ms",
                flush=True,
            )


if __name__ == "__main__":
    main()
