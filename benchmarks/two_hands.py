"""Distance from which one hand's sound on the other may be left out.

A relaxed left hand and its mirror image, 2 x 2 flat boards 200 mm away, foci 1 mm off the palm and the
pads of thumb and index finger of each. Palms face each other, with the boards at their side, or lie side
by side over the boards. The matrix of both hands solved together is compared with that of each hand
solved alone. Printed are the errors of its rows, amplitudes and phases, medians over the foci and largest,
and the pressure at the weakest focus that the drive from hands solved alone keeps, at equal energy.
"""

import numpy as np

import airtact as at
from airtact.drives.gerchberg_saxton import weighted_gerchberg_saxton

PLACES = ("palm", "thumb.pad", "index.pad")

DISTANCES = (0.01, 0.02, 0.03, 0.05, 0.08, 0.12, 0.2)
"""Distances between the skins of both hands [m]."""


def compared(facing: bool, distance: float) -> tuple[float, ...]:
    """Return median and largest error of rows, the root mean square phase error [rad], the kept share."""
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

    return float(np.median(errors)), errors.max(), float(phases), weakest(alone) / weakest(both)


def main() -> None:
    """Print one line for each arrangement and distance."""
    for facing in (True, False):
        for distance in DISTANCES:
            median, most, phase, kept = compared(facing, distance)
            print(
                f"{'palms facing' if facing else 'side by side'}, {1e3 * distance:.0f} mm apart: error "
                f"median {median:.2f}, largest {most:.2f}, phase {phase:.2f} rad; kept {kept:.3f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
