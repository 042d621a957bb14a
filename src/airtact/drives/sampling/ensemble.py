"""The transfer matrices of sampled hands, from one solve where they move rigidly.

Warmer air scales the wavenumber by s. The field is then the one that was solved with all lengths
scaled by s, the bodies among them: the array is evaluated at distances scaled about the middle of
the foci, which neglects that bodies and distances of foci would change by 1 − s, 0.2 % for each
kelvin, and that absorption changes. Against solves of a pinch in air that is 2 K (5 K) warmer the
matrix is 1.3 % (3.2 %) off in a box, 0.9 % (2.3 %) before flat boards, of 24 to 138 % without
scaling, and the pressure of a drive at the weakest focus 0.2 % (0.4 %) at most
(``benchmarks/robust.py warmer``).

Elements count by the pressure at their centres times their directivity towards each focus; what a
nominal element has beyond that is carried along. Against the mean over their faces that is 0.1 %
off for 2 mm and 3 degrees before flat boards, 1 % in a box.

The points are scrambled Sobol points, the factors of the elements pseudo-random numbers; both
follow from the seed.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Complex128, Int64

from airtact.acoustics.scene import Scene
from airtact.acoustics.solvers.problem import RadiatedField, Solver
from airtact.acoustics.uncertainty import Uncertainty
from airtact.checks import check_seed, counted, of_kind
from airtact.drives.drive import Drive, check_drive
from airtact.drives.sampling.draws import gains
from airtact.drives.sampling.evaluation import Sampled
from airtact.drives.transfer import TransferMatrix, transfer_matrix
from airtact.errors import InvalidInput
from airtact.geometry.pose import Pose
from airtact.printing import one_line
from airtact.transducers.boards import kind_of_array
from airtact.transducers.layout import PhasedArray

MOST_SAMPLES = 10_000
"""Largest number of samples; more are a slip."""

AIR_SPEEDS = 300.0, 370.0
"""Speeds of sound that are those of air [m/s]."""


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class TransferEnsemble(TransferMatrix):
    """The transfer matrix as it should be, and those of S sampled hands; ``ensemble`` makes it.

    It serves wherever a ``TransferMatrix`` does, as the nominal one. ``robust`` makes drives for
    all samples.

    Attributes
    ----------
    geometry : (S, F, E) the matrix of each sample with the nominal gains of the elements [Pa].
    gains : (S, E) factor of each element in each sample, or None where it is 1.
    uncertainty : what the samples were drawn from.
    seed : of the samples.
    left_out : number of samples that cannot be, such as hands that a transducer would reach into.

    Raises
    ------
    InvalidInput
        As ``TransferMatrix``, or the samples are none or of another shape.
    """

    geometry: Complex128[np.ndarray, "samples foci elements"]
    gains: Complex128[np.ndarray, "samples elements"] | None = None
    uncertainty: Uncertainty = field(default_factory=Uncertainty)
    seed: int = 0
    left_out: int = 0

    def __repr__(self) -> str:
        foci, elements = self.matrix.shape
        left = f"{self.left_out} left out" * bool(self.left_out)
        return one_line(
            self,
            counted(len(self.geometry), "sample", "samples"),
            counted(foci, "focus", "foci"),
            counted(elements, "element", "elements"),
            left,
        )

    def __post_init__(self) -> None:
        super().__post_init__()
        shape = np.shape(self.geometry)
        if len(shape) != 3 or shape[0] == 0 or shape[1:] != self.matrix.shape:
            raise InvalidInput(
                f"the samples have shape {shape}, but matrices of {self.matrix.shape} need (samples, "
                f"{self.matrix.shape[0]}, {self.matrix.shape[1]}), with 1 sample or more.",
                code="wrong_shape",
            )
        for array in (self.geometry, self.gains):
            if array is not None:
                array.flags.writeable = False

    def of_rows(self, chosen: Int64[np.ndarray, "rows"]) -> "TransferEnsemble":
        """Return some of the rows, of all samples."""
        foci = None if self.foci is None else self.foci[chosen]
        return replace(
            self, matrix=self.matrix[chosen], foci=foci, geometry=self.geometry[:, chosen]
        )

    @property
    def matrices(self) -> Complex128[np.ndarray, "samples foci elements"]:
        """(S, F, E) the matrix of each sample [Pa]."""
        return self.geometry if self.gains is None else self.geometry * self.gains[:, None, :]

    def pressures(self, drive: Drive) -> Complex128[np.ndarray, "samples foci"]:
        """Return the complex pressure (S, F) at each focus of each sample under a drive [Pa].

        Raises
        ------
        InvalidInput
            If the drive is for another number of elements.
        """
        check_drive(drive, "the drive")
        self.pressure(drive)  # raises for another number of elements
        if self.gains is None:
            return self.geometry @ drive.amplitudes
        return np.einsum("sfe,se->sf", self.geometry, self.gains * drive.amplitudes)


def ensemble(
    beacons: RadiatedField,
    array: PhasedArray,
    uncertainty: Uncertainty,
    samples: int = 64,
    seed: int = 0,
    *,
    solver: Solver | None = None,
) -> TransferEnsemble:
    """Compute the transfer matrices of hands, air and transducers as they may be, by an uncertainty.

    A hand that is off as a whole needs no new solve: the array is evaluated from where it then is,
    in the multipole expansion of the beacons. Without ``solver``, each focus of a body that is off
    by itself, or along its skin, is evaluated as if all bodies moved with it; with ``solver``, each
    sample is solved with its bodies where they are, in milliseconds by
    ``BoundaryElement().factorised(scene, refined=target.points)``. Warmer air scales the
    wavenumber. Before a rigid plane one solve serves hands that are off along it; ``solver`` solves
    all others.

    Parameters
    ----------
    beacons : field of unit beacons in the foci, ``solver.radiate(scene, target.beacons())``.
    array : the transducers in the obstacles' frame.
    uncertainty : standard deviations of what is in doubt.
    samples : number of them, 1 to 10 000; a power of 2 spreads best.
    seed : of the random numbers, 0 or more.
    solver : solves each sample where bodies move by themselves or foci are off along the skin, and
        before a plane.

    Returns
    -------
    The nominal matrix and those of the samples. Samples that cannot be, in which an element or a focus is inside a body
    or something is behind a face, are left out and counted.

    Raises
    ------
    InvalidInput
        As ``transfer_matrix``; "out_of_range": of samples or seed; "empty"; "not_converged": a plane needs
        the solver; "empty", "does_not_match", "empty": what is in doubt is not there.

    Examples
    --------
    >>> import airtact as at
    >>> scene, target = at.Scene(at.air(), [], frequency=40e3), at.Target(np.zeros((1, 3)))
    >>> beacons = at.FreeField().radiate(scene, target.beacons())
    >>> ensemble(beacons, at.surrounding_box(), Uncertainty(position=1e-3), samples=16)
    TransferEnsemble(16 samples, 1 focus, 996 elements)
    """
    of_kind(uncertainty, Uncertainty, "the uncertainty", "Uncertainty(position=1e-3, rotation=2.0)")
    check_counts(samples, seed)
    nominal = transfer_matrix(beacons, array)
    check_doubts(uncertainty, beacons.scene, array)
    sampled = Sampled.of(beacons, array, nominal.matrix, uncertainty, solver)
    kept = [one for one in sampled.matrices(sampled.draw(samples, seed)) if one is not None]
    if not kept:
        raise InvalidInput(
            f"all {samples} samples are left out, in which an element reaches into a body, or something is behind a "
            "face; give smaller deviations or move the array away.",
            code="empty",
        )
    known = {
        name: getattr(nominal, name) for name in ("matrix", "estimated_error", "foci", "wavelength")
    }
    known |= {
        "gains": gains(uncertainty, len(kept), seed, len(array)),
        "left_out": samples - len(kept),
    }
    return TransferEnsemble(**known, geometry=np.stack(kept), uncertainty=uncertainty, seed=seed)


def matrices_at(
    beacons: RadiatedField,
    array: PhasedArray,
    poses: Iterable[Pose],
    slower: float = 1.0,
    solver: Solver | None = None,
) -> Iterator[Complex128[np.ndarray, "foci elements"] | None]:
    """Transfer matrix (F, E) of a hand that is moved rigidly by each pose, its foci along with it [Pa].

    ``slower`` scales the wavenumber, for warmer air. It is None where an element would reach into a
    body, or something is behind a face. Before a plane ``solver`` solves each pose that is off
    another way than along it. Raises as ``transfer_matrix``, and "not_converged".
    """
    sampled = Sampled.of(
        beacons, array, transfer_matrix(beacons, array).matrix, Uncertainty(), solver
    )
    return sampled.matrices(sampled.at_rest(pose, slower) for pose in poses)


def check_counts(samples: int, seed: int) -> None:
    """Raise "out_of_range" for a number of samples or a seed that cannot be."""
    if (
        not isinstance(samples, int | np.integer)
        or isinstance(samples, bool)
        or not 1 <= samples <= MOST_SAMPLES
    ):
        raise InvalidInput(
            f"the number of samples is {samples!r}, but it must be a whole number from 1 to {MOST_SAMPLES}.",
            code="out_of_range",
        )
    check_seed(seed)


def check_doubts(uncertainty: Uncertainty, scene: Scene, array: PhasedArray) -> None:
    """Raise "does_not_match", "empty" or "empty": something is in doubt that scene or array do not have."""
    speed = scene.medium.sound_speed
    if (uncertainty.temperature or uncertainty.humidity) and not AIR_SPEEDS[
        0
    ] <= speed <= AIR_SPEEDS[1]:
        raise InvalidInput(
            f"temperature or humidity are in doubt, but a medium with {speed:g} m/s is not air; leave them 0.",
            code="does_not_match",
        )
    if uncertainty.along_skin and not scene.obstacles:
        raise InvalidInput(
            f"foci are {1e3 * uncertainty.along_skin:g} mm off along the skin, but the scene has 0 bodies; leave it 0.",
            code="empty",
        )
    on_boards = uncertainty.board_position or uncertainty.board_rotation
    if on_boards and kind_of_array(array.positions, array.normals) is None:
        raise InvalidInput(
            f"boards are in doubt, but the {len(array)} elements are not laid out as boards; leave it 0.",
            code="empty",
        )
