"""An open hand of 325 cm² in front of four boards, solved for its drive and for its pressures."""

from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from airtact.benching.real_time import Row, judged, to_drive, told
from airtact.benching.scenes import Bodies
from airtact.benching.timing import relative_error, timed
from airtact.benching.truth import Truth
from airtact.hand.hand import Hand, hand_from_joints
from airtact.solvers.bem.solver import BoundaryElement
from airtact.transducers.layout import PhasedArray, surrounding_box
from airtact.transfer import transfer_matrix

AREA = 325e-4
"""Skin of the hand [m²]."""

DRIVE_ACCURACY, ACCURACY = 0.06, 0.03

FINE, COARSER = 0.0015, 0.003
"""Accuracies of the two solutions that are the truth and its own error."""


def scaled(hand: Hand, area: float = AREA) -> Hand:
    """Give a hand of the same pose with another area of skin [m²].

    Parameters
    ----------
    hand : as it is.
    area : wanted.
    """
    for _ in range(3):  # the fillets between fingers do not scale with the joints alone
        size = np.sqrt(area / hand.surface.area)
        hand = hand_from_joints(hand.joints * size, hand.radii * size)
    return hand


@dataclass(frozen=True)
class OpenHand:
    """The hand's rows.

    Attributes
    ----------
    hand : open, of any size.
    folder : where the truth is kept.
    runs : timed runs.
    """

    hand: Hand
    folder: Path
    runs: int = 7

    @cached_property
    def array(self) -> PhasedArray:
        """996 transducers around the hand, all 1.6 times as far off as in the paper's box."""
        box = surrounding_box()
        return PhasedArray(1.6 * box.positions + self._centre, box.normals, box.element)

    @cached_property
    def bodies(self) -> Bodies:
        """The hand with a focus before the pads of its index and its middle finger."""
        hand = scaled(self.hand)
        places = [hand.place(name) for name in ("index.pad", "middle.pad")]
        return Bodies((hand.surface,), np.array([place + 0.5e-3 * normal for place, normal in places]))

    @property
    def _centre(self) -> Float64[np.ndarray, "3"]:
        vertices = self.bodies.surfaces[0].vertices
        return 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))

    @cached_property
    def truth(self) -> Truth:
        """Transfer matrix of a fine solution, and how far a coarser one is from it."""
        file = self.folder / f"open-hand-{FINE}-{COARSER}.npz"
        if not file.exists():
            scene, beacons = self.bodies.scene, self.bodies.target.beacons()
            fine, coarser = (
                transfer_matrix(BoundaryElement(accuracy=accuracy).radiate(scene, beacons), self.array).matrix
                for accuracy in (FINE, COARSER)
            )
            self.folder.mkdir(parents=True, exist_ok=True)
            np.savez(file, matrix=fine, own_error=relative_error(coarser, fine), foci=self.bodies.foci)
        with np.load(file) as kept:
            if not np.allclose(kept["foci"], self.bodies.foci, atol=1e-9):
                raise ValueError(f"{file} is the truth of another hand; delete it.")
            return Truth(kept["matrix"], float(kept["own_error"]))

    def drive_only(self) -> Row:
        """Time the hand where only the drive is wanted."""
        return self._row("open hand of 325 cm², drive only", "0.2 s, correlation 0.995", DRIVE_ACCURACY)

    def pressures(self) -> Row:
        """Time the hand where the pressures are wanted too."""
        return self._row("open hand of 325 cm²", "0.6 s, 3 %", ACCURACY)

    def _row(self, what: str, asked: str, accuracy: float) -> Row:
        job = partial(to_drive, BoundaryElement(accuracy=accuracy, estimate=False), self.bodies, self.array)
        took, made = timed([job] * (self.runs + 1))
        errors = judged(made[-1], self.truth.pressure, self.bodies)
        against = f"against {FINE:.1%} asked, itself {self.truth.own_error:.2%} from {COARSER:.1%}"
        return told(what, asked, took, made, errors, against)
