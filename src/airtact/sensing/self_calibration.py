"""Poses of an array's boards, gains of its elements and sound speed, from direct sound.

Elements of boards that face each other receive each other's transmissions. From each element alone,
which codes such as Hadamard's separate, element r receives p_re = ρ_r τ_e T_re: T is the direct
sound between elements of unit gain, τ are the gains by which elements emit and ρ those by which
they receive, which differ by the electronics. For given positions the gains follow by solving
for ρ and τ in turn. Motions of the boards and the sound speed follow by damped Gauss-Newton steps
on what is left once all gains have adapted (variable projection: G. Golub and V. Pereyra, SIAM J.
Numer. Anal. 10, 413, 1973), with exact derivatives.

Board 0 is held, as a motion of the whole array changes nothing. A factor that multiplies all ρ and
divides all τ changes nothing either: both get the same geometric mean and mean phase (with two
boards, in each direction separately). The scale of the array follows from the positions of
elements on their boards, which are taken as exact.
"""

from dataclasses import dataclass, replace
from itertools import permutations
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Complex128, Float64, Int64

from airtact.acoustics.medium import Medium
from airtact.checks import counted, of_kind
from airtact.errors import InvalidInput
from airtact.geometry.pose import Pose
from airtact.printing import one_line
from airtact.sensing.calibration_fit import ArrayFit, ArrayState, Gains, Information, motion_of
from airtact.sensing.echoes import Echoes, check_elements, check_not_clipped
from airtact.sensing.transmission import Pairs, boards_of, facing
from airtact.transducers.calibration import save_calibration
from airtact.transducers.element import check_pattern
from airtact.transducers.layout import PhasedArray, join

MAX_MISFIT = 0.1
"""Largest share of the direct sound that a believed calibration leaves unexplained beyond noise."""

CountedPairs = Bool[np.ndarray, "elements elements"]
"""Whether a receiver and an emitter count."""


@dataclass(frozen=True, eq=False)
class Calibrated:
    """What ``calibrate`` finds of an array.

    Attributes
    ----------
    array : with its boards where they are, and the gains by which the elements emit.
    sound_speed : [m/s].
    motions : of each board, from where it was believed to be to where it is, in the array's frame;
        board 0 stays.
    emission, reception : (E,) gains by which elements emit and receive; 0 for dead ones, and 1 in
        ``reception`` for elements that are no receivers. Their common factor is a convention.
    covariance : (6 B − 5, 6 B − 5) of the translation of the middle of boards 1 to B − 1 [m] and a
        small turn about it [rad], board by board along the array's axes, and last of the sound
        speed [m/s].
    gain_deviation : rms standard deviation of the gains, relative, and so of their phases [rad].
    residual : rms of what is left unexplained over that of the direct sound, noise included.
    misfit : the same beyond noise.
    converged : whether the steps settled and the misfit is at most 0.1. Believe nothing else.
    steps : number of steps taken.
    believed : the array as it was given.
    dead : numbers of elements of which nothing is received.
    """

    array: PhasedArray
    sound_speed: float
    motions: tuple[Pose, ...]
    emission: Complex128[np.ndarray, "elements"]
    reception: Complex128[np.ndarray, "elements"]
    covariance: Float64[np.ndarray, "unknowns unknowns"]
    gain_deviation: float
    residual: float
    misfit: float
    converged: bool
    steps: int
    believed: PhasedArray
    dead: Int64[np.ndarray, "dead"]

    def __repr__(self) -> str:
        position, turn, speed = self.deviation
        return one_line(
            self,
            "converged" if self.converged else "NOT converged",
            f"boards sure to {1e3 * position:.2g} mm and {np.degrees(turn):.2g} degrees",
            f"sound speed {self.sound_speed:.2f} m/s, sure to {speed:.2g}",
            f"residual {self.residual:.2g}, misfit {self.misfit:.2g}",
        )

    @property
    def deviation(self) -> tuple[float, float, float]:
        """Largest standard deviation of boards [m], [rad], and that of the sound speed [m/s]."""
        variances = np.diag(self.covariance)
        boards = variances[:-1].reshape(-1, 2, 3).sum(axis=2).max(axis=0)
        return float(np.sqrt(boards[0])), float(np.sqrt(boards[1])), float(np.sqrt(variances[-1]))

    @property
    def shifts(self) -> Float64[np.ndarray, "boards 3"]:
        """(B, 3) how far the middle of each board is off where it was believed to be [m]."""
        boards = len(self.motions)
        here = self.array.positions.reshape(boards, -1, 3).mean(axis=1)
        return here - self.believed.positions.reshape(boards, -1, 3).mean(axis=1)

    def as_emitted(self, echoes: Echoes) -> Echoes:
        """Scale echoes as if elements received with their gains of emission, as ``locate`` assumes.

        Raises
        ------
        InvalidInput
            "sizes_differ": echoes of another array; "data_missing": leave these out of
            ``receivers`` first.
        """
        check_elements(echoes, self.array, "echoes")
        received = self.reception[echoes.receiving]
        if dead := echoes.receiving[received == 0.0].tolist():
            raise InvalidInput(
                f"{counted(len(dead), 'receiver is', 'receivers are')} dead, first element "
                f"{dead[0]}: leave them out.",
                code="data_missing",
            )
        factor = self.emission[echoes.receiving] / received
        return replace(echoes, pressures=np.asarray(echoes.pressures) * factor[:, None])

    def save(self, path: str | Path) -> None:
        """Write a table of elements (.csv), which the ``calibration`` of a scene file reads.

        Raises
        ------
        InvalidInput
            "unknown_format" for another one than .csv, "not_writable".
        """
        size = len(self.array) // len(self.motions)
        motions = [motion for motion in self.motions for _ in range(size)]
        save_calibration(path, self.emission, motions, self.believed)


def calibrate(
    echoes: Echoes, array: PhasedArray, medium: Medium, boards: int | None = None
) -> Calibrated:
    """Find boards' poses, elements' gains and the sound speed from direct transmissions.

    Nothing may be between the boards, and nothing may be subtracted. Elements count that face each
    other within 60 degrees on different boards. Boards may be 2 mm and 1 degree off, and the sound
    speed 4 m/s (7 °C).

    Parameters
    ----------
    echoes : transmissions of the empty array, in codes that separate all elements.
    array : with its boards where they are believed to be; its gains are not used.
    medium : the air as it is believed to be; its absorption is taken as given.
    boards : how many of as many elements, one after the other; those of a kind that airtact knows
        unless given.

    Raises
    ------
    InvalidInput
        "sizes_differ", "unknown_name": the array; "given_twice": codes that do not separate the
        elements; "misplaced": elements or boards that face no others; "signal_unusable";
        "pose_not_found": the transmissions do not determine some combination, which is named.

    Examples
    --------
    Two small boards 6 cm apart, the second 0.3 mm off:

    >>> import airtact as at
    >>> from airtact.sensing import hadamard_codes, simulate_transmissions
    >>> facing = at.Pose.turn((1, 0, 0), np.pi, (0, 0.03, 0.06))
    >>> believed = at.transducers.board_array("nano16", [at.Pose.identity(), facing])
    >>> off = at.Pose(np.eye(3), np.array([3e-4, 0, 0]))
    >>> true = at.transducers.board_array("nano16", [at.Pose.identity(), off @ facing])
    >>> codes = hadamard_codes(24)
    >>> received = simulate_transmissions(true, at.air(celsius=20.0), codes, boards=2, noise=80.0)
    >>> calibrated = calibrate(received, believed, at.air(celsius=21.0), boards=2)
    >>> calibrated.converged, f"{1e3 * calibrated.shifts[1, 0]:.2f} mm"
    (True, '0.30 mm')
    """
    of_kind(echoes, Echoes, "the transmissions", "Echoes(codes, pressures)")
    of_kind(array, PhasedArray, "the array", "one such as surrounding_box()")
    of_kind(medium, Medium, "the medium", "air(celsius=20.0)")
    check_elements(echoes, array, "transmissions")
    check_pattern(array.element, medium.wavenumber(echoes.frequency))
    parts = boards_of(array, boards)
    alone, noise = _separated(echoes)
    counted_pairs = _facing_pairs(echoes, parts)
    dead = _dead(alone, counted_pairs, noise)
    counted_pairs[dead] = False
    counted_pairs[:, dead] = False
    _check_linked(alone, counted_pairs, len(parts), noise, dead)
    fit = ArrayFit(np.where(counted_pairs, alone, 0.0), counted_pairs)
    power = float(np.sum(np.abs(fit.measured) ** 2))
    of_noise = noise**2 * int(fit.counted.sum())
    enough = 1.5 * (of_noise / power) + MAX_MISFIT**2
    best = fit.best(tuple(parts), medium.wavenumber(echoes.frequency), enough)
    misfit = float(np.sqrt(max(best.cost - of_noise, 0.0) / max(power - of_noise, 1e-300)))
    equations = fit.information(best)
    # Each element takes two complex gains from the data.
    variance = best.cost / max(int(fit.counted.sum()) - 2 * len(array), 1) / 2.0
    converged = bool(best.settled and misfit <= MAX_MISFIT)
    if converged:
        _check_determined(equations, variance, echoes)
    covariance = variance * np.linalg.pinv(equations.squares, hermitian=True)
    speed = 2 * np.pi * echoes.frequency / best.wavenumber.real
    # From metres to metres, radians, and the sound speed in place of the wavenumber.
    scale = np.append(equations.units[:-1], -equations.units[-1] * speed / best.wavenumber.real)
    emission, reception = _same_mean(fit, best, dead)
    calibrated = join(best.boards).calibrated(emission)
    return Calibrated(
        array=calibrated,
        sound_speed=speed,
        motions=tuple(motion_of(*pair) for pair in zip(parts, best.boards, strict=True)),
        emission=calibrated.gains,
        reception=reception,
        covariance=covariance * np.outer(scale, scale),
        gain_deviation=float(np.sqrt(variance * equations.gain_variance)),
        residual=float(np.sqrt(best.cost / power)),
        misfit=misfit,
        converged=converged,
        steps=best.steps,
        believed=array,
        dead=dead,
    )


def _separated(echoes: Echoes) -> tuple[Pairs, float]:
    """Pressures (E, E) at each receiver from each element alone, and their rms noise [Pa]."""
    codes = np.asarray(echoes.codes)
    squares = codes @ codes.conj().T
    power = np.diag(np.diag(squares))
    smallest = 1e-6  # ratio of eigenvalues of codes that separate the elements
    # The eigenvalues of a thousand elements take a second; Hadamard's codes need none.
    orthogonal = np.abs(squares - power).max() < smallest * np.abs(power).max()
    values = np.real(np.diag(squares)) if orthogonal else np.linalg.eigvalsh(squares)
    separated = int(np.sum(values > smallest * values.max()))
    if separated < len(codes):
        raise InvalidInput(
            f"{counted(codes.shape[1], 'transmission separates', 'transmissions separate')} "
            f"{separated} of {len(codes)} elements, and calibration needs each by itself: transmit "
            f"the codes hadamard_codes({len(codes)}).",
            code="given_twice",
        )
    inverse = np.diag(1.0 / np.diag(squares)) if orthogonal else np.linalg.inv(squares)
    alone = np.zeros((len(codes), len(codes)), dtype=np.complex128)
    alone[echoes.receiving] = np.asarray(echoes.pressures) @ codes.conj().T @ inverse
    return alone, (echoes.noise or 0.0) * float(np.sqrt(np.mean(np.real(np.diag(inverse)))))


def _facing_pairs(echoes: Echoes, boards: list[PhasedArray]) -> CountedPairs:
    """Which receivers face which emitters on another board; raise "signal_unusable"."""
    size = len(boards[0])
    total = len(echoes.codes)
    pairs = np.zeros((total, total), dtype=bool)
    for first, second in permutations(range(len(boards)), 2):
        rows = slice(first * size, (first + 1) * size)
        columns = slice(second * size, (second + 1) * size)
        pairs[rows, columns] = facing(boards[first], boards[second])
    pairs[np.setdiff1d(np.arange(total), echoes.receiving)] = False
    receives = pairs[echoes.receiving] @ (np.asarray(echoes.codes) != 0.0)
    check_not_clipped(np.abs(np.asarray(echoes.pressures))[receives])
    return pairs


def _dead(alone: Pairs, pairs: CountedPairs, noise: float) -> Int64[np.ndarray, "dead"]:
    """Elements that emit, or receive, less than a tenth of the median."""
    power = np.where(pairs, np.abs(alone) ** 2, 0.0)
    dead = []
    for axis in (0, 1):
        count = pairs.sum(axis=axis)
        size = np.sqrt(np.maximum(power.sum(axis=axis) / np.maximum(count, 1) - noise**2, 0.0))
        typical = np.median(size[count > 0]) if count.any() else 0.0
        dead.append(np.flatnonzero((count > 0) & (size < 0.1 * typical)))
    return np.union1d(*dead)


def _check_linked(
    alone: Pairs, pairs: CountedPairs, boards: int, noise: float, dead: Int64[np.ndarray, "dead"]
) -> None:
    """Raise "misplaced" or "signal_unusable"."""
    by_boards = pairs.reshape(boards, -1, boards, len(pairs) // boards).any(axis=(1, 3))
    # The power of I + links has a non-zero entry for each board that a path leads to.
    paths = np.linalg.matrix_power(np.eye(boards) + by_boards + by_boards.T, boards)
    unlinked = np.flatnonzero(paths[0] == 0)
    if len(unlinked):
        raise InvalidInput(
            f"board {unlinked[0]} of {boards} faces no other within 60 degrees, or none of its "
            "elements receives or is received, so its place cannot be found. Leave it out of the "
            "array.",
            code="misplaced",
        )
    silent = np.setdiff1d(np.flatnonzero(~pairs.any(axis=0)), dead)
    if len(silent):
        raise InvalidInput(
            f"{counted(len(silent), 'element faces', 'elements face')} no receiver on another "
            f"board within 60 degrees, first element {silent[0]}: their gains cannot be found.",
            code="misplaced",
        )
    rms = float(np.sqrt(np.mean(np.abs(alone[pairs]) ** 2)))
    if rms == 0.0 or rms < 1.05 * noise:
        raise InvalidInput(
            f"each element alone arrives with {rms:.3g} Pa rms, hardly more than the noise of "
            f"{noise:.3g} Pa: no direct sound is left in the transmissions. Subtract nothing, and "
            "transmit more or longer.",
            code="signal_unusable",
        )


def _check_determined(equations: Information, variance: float, echoes: Echoes) -> None:
    """Raise "pose_not_found" where a combination of unknowns is not determined."""
    values, vectors = np.linalg.eigh(equations.squares)
    # A combination known to better than 1 mm is determined.
    if values[0] > 1e-12 * values[-1] and variance < values[0] * 1e-3**2:
        return
    boards = range(1, 1 + len(values) // 6)
    names = [f"the {kind} of board {board}" for board in boards for kind in ("position", "angles")]
    names.append("the sound speed")
    shares = np.append(np.linalg.norm(vectors[:-1, 0].reshape(-1, 3), axis=1), abs(vectors[-1, 0]))
    involved = [name for name, share in zip(names, shares, strict=True) if share > 0.3]
    deviation = 1e3 * np.sqrt(variance / max(values[0], 1e-12 * values[-1]))
    raise InvalidInput(
        f"{counted(len(echoes.pressures), 'receiver', 'receivers')} of {len(echoes.codes)} "
        f"elements do not determine {' together with '.join(involved)}: known to {deviation:.2g} "
        "mm only. Give more receivers or less noise, or leave boards out.",
        code="pose_not_found",
    )


def _same_mean(
    fit: ArrayFit, state: ArrayState, dead: Int64[np.ndarray, "dead"]
) -> tuple[Gains, Gains]:
    """Gains of emission and reception with a common factor in each group that makes both alike."""
    emission = state.emission.copy()
    reception = state.reception.copy()
    receives = fit.counted.any(axis=1)
    emits = fit.counted.any(axis=0)
    for group in np.unique(fit.groups[1][emits]):
        emitters = emits & (fit.groups[1] == group)
        receivers = receives & (fit.groups[0] == group)
        size, phase = (
            mean(reception[receivers]) - mean(emission[emitters])
            for mean in (
                lambda gains: np.mean(np.log(np.abs(gains))),
                lambda gains: np.angle(np.sum(gains)),
            )
        )
        factor = np.exp(0.5 * size + 0.5j * phase)
        emission[emitters] *= factor
        reception[receivers] /= factor
    reception[~receives] = 1.0
    emission[dead] = 0.0
    reception[dead] = 0.0
    reception.flags.writeable = False
    return emission, reception
