"""Poses of an array's boards, gains of its elements and sound speed from direct sound.

Elements on boards that face each other receive each other's transmissions. Codes such as Hadamard
codes separate the emitters. Element r receives p_re = ρ_r τ_e T_re from element e. T is the direct
sound between elements of unit gain, τ are the emission gains, and ρ are the reception gains. The
two gains of an element differ because of the electronics. For given positions, alternating least
squares yield ρ and τ. The Levenberg-Marquardt method finds the motions of the boards and the sound
speed from the residual with optimal gains (variable projection: G. Golub and V. Pereyra, SIAM J.
Numer. Anal. 10, 413, 1973), with exact derivatives.

Board 0 is fixed, because a motion of the whole array changes nothing. Multiplying all ρ and
dividing all τ by a common factor changes nothing either, so both are scaled to the same mean (with
two boards, separately for each direction). The scale of the array follows from the positions of
the elements on their boards; these positions are assumed to be exact.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations, permutations
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Complex128, Float64, Int32, Int64
from scipy.linalg import solve
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial.transform import Rotation

from airtact.acoustics.medium import Medium
from airtact.errors import InvalidInput, counted, of_kind, one_line
from airtact.geometry.pose import Pose, nearest_motion
from airtact.sensing.echoes import Echoes, check_elements, check_not_clipped
from airtact.sensing.transmission import Pairs, boards_of, elements_of, facing, transmission
from airtact.transducers.calibration import save_calibration
from airtact.transducers.element import check_pattern
from airtact.transducers.layout import PhasedArray, join

# Largest misfit of a converged calibration: the relative residual in excess of the noise.
MAX_MISFIT = 0.1

# Whether each pair of receiver and emitter is used.
CountedPairs = Bool[np.ndarray, "elements elements"]

Gains = Complex128[np.ndarray, "elements"]
Step = Float64[np.ndarray, "unknowns"]
Squares = Float64[np.ndarray, "unknowns unknowns"]


@dataclass(frozen=True, eq=False)
class Calibrated:
    """Calibration of an array of E elements on B boards, as returned by ``calibrate``.

    Attributes
    ----------
    array : the array at the estimated poses of its boards, with the emission gains; use it in place
        of ``believed``.
    sound_speed : estimated speed of sound [m/s].
    motions : B poses that map the assumed positions of each board's elements to the estimated ones,
        in the array's frame. Board 0 does not move, because a motion of the whole array cannot be
        measured.
    emission, reception : (E,) complex ratio of the pressure that each element emits, or reports,
        to that of an element with the nominal sensitivity; 0 for dead elements, and 1 in
        ``reception`` for elements that do not receive. Only their products can be measured, so both
        are scaled to the same mean (with two boards, separately for each direction).
    covariance : (6 B − 5, 6 B − 5) covariance for boards 1 to B − 1 and for the sound speed [m/s],
        which comes last. The six entries of a board are the translation of its centre [m] and a
        small rotation about the centre [rad], along the array's axes.
    gain_deviation : rms of the relative standard deviations of the gains, which equals the rms of
        the standard deviations of their phases [rad].
    residual : rms of the difference between modelled and measured pressures, including noise,
        divided by the rms of the direct sound.
    misfit : ``residual`` without the contribution of noise. A large value indicates that the
        pressures do not fit the model.
    converged : whether the iteration converged with a misfit of at most 0.1. If False, do not
        use the result.
    steps : number of iteration steps.
    believed : the array with the assumed poses, as passed to ``calibrate``.
    dead : indices of the elements that emit or receive less than a tenth of the median signal; they
        are left out of the fit.
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
            f"boards ± {1e3 * position:.2g} mm and {np.degrees(turn):.2g} degrees",
            f"sound speed {self.sound_speed:.2f} ± {speed:.2g} m/s",
            f"residual {self.residual:.2g}, misfit {self.misfit:.2g}",
        )

    @property
    def deviation(self) -> tuple[float, float, float]:
        """Standard deviations of the boards' poses and of the sound speed.

        The tuple contains the largest deviation of a board's position [m], the largest deviation of
        a board's rotation [rad], and the deviation of the sound speed [m/s].
        """
        variances = np.diag(self.covariance)
        boards = variances[:-1].reshape(-1, 2, 3).sum(axis=2).max(axis=0)
        return float(np.sqrt(boards[0])), float(np.sqrt(boards[1])), float(np.sqrt(variances[-1]))

    @property
    def shifts(self) -> Float64[np.ndarray, "boards 3"]:
        """(B, 3) displacement [m] of the centre of each board from its assumed position."""
        boards = len(self.motions)
        here = self.array.positions.reshape(boards, -1, 3).mean(axis=1)
        return here - self.believed.positions.reshape(boards, -1, 3).mean(axis=1)

    def as_emitted(self, echoes: Echoes) -> Echoes:
        """Return the echoes that would be measured if elements received with their emission gains.

        ``locate`` assumes equal emission and reception gains.

        Raises
        ------
        InvalidInput
            If the echoes belong to another array, or if receivers are dead.
        """
        check_elements(echoes, self.array, "echoes")
        received = self.reception[echoes.receiving]
        if dead := echoes.receiving[received == 0.0].tolist():
            raise InvalidInput(
                f"{counted(len(dead), 'receiver is', 'receivers are')} dead; the first is element "
                f"{dead[0]}. Omit them from the receivers of the echoes.",
                code="data_missing",
            )
        factor = self.emission[echoes.receiving] / received
        return replace(echoes, pressures=np.asarray(echoes.pressures) * factor[:, None])

    def save(self, path: str | Path) -> None:
        """Write a calibration table of the elements (.csv), which scene files can refer to.

        An existing file is replaced.

        Raises
        ------
        InvalidInput
            If the file name does not end in .csv or the file cannot be written.
        """
        size = len(self.array) // len(self.motions)
        motions = [motion for motion in self.motions for _ in range(size)]
        save_calibration(path, self.emission, motions, self.believed)


@dataclass(frozen=True, eq=False)
class ArrayState:
    """State of the fit of an array: boards, wavenumber, gains and the remaining residual.

    Attributes
    ----------
    boards : B boards with unit gains.
    wavenumber : wavenumber of the sound [1/m].
    reception, emission : (E,) gains of the elements as receivers and as emitters.
    slopes : derivatives of the direct sound between boards, for each pair (first, second) with
        first < second.
    model : (E, E) pressure at the receivers from the emitters for unit gains [Pa]; 0 for unused
        pairs.
    cost : sum of the squared residuals [Pa²].
    steps : number of iteration steps.
    settled : whether the iteration converged.
    """

    boards: tuple[PhasedArray, ...]
    wavenumber: complex
    reception: Gains
    emission: Gains
    slopes: dict[tuple[int, int], Complex128[np.ndarray, "13 rows columns"]]
    model: Complex128[np.ndarray, "elements elements"]
    cost: float
    steps: int = 0
    settled: bool = False


@dataclass(frozen=True, eq=False)
class ArrayFit:
    """Least-squares fit of an array to the pressures (E, E) at each receiver from each emitter.

    ``counted`` marks the pairs of elements that are used.
    """

    measured: Pairs
    counted: CountedPairs

    @cached_property
    def groups(self) -> Int32[np.ndarray, "2 elements"]:
        """(2, E) group number of each receiver and emitter; the gains of groups are independent.

        Two boards form two groups: emission by the first with reception by the second, and the
        reverse.
        """
        none = np.zeros_like(self.counted)
        linked = np.block([[none, self.counted], [self.counted.T, none]])
        return connected_components(csr_matrix(linked), directed=False)[1].reshape(2, -1)

    def best(
        self, boards: tuple[PhasedArray, ...], wavenumber: complex, enough: float
    ) -> ArrayState:
        """Fit a few elements per board from several starts, then all elements from the best result.

        Phases are ambiguous by 2π, so a start with an error of half a wavelength may lead to a
        wrong minimum.
        """
        random = np.random.default_rng(0)
        size = len(boards[0])
        # The starts are compared with 48 elements per board; 48 starts suffice for errors of 2 mm.
        chosen = [np.sort(random.permutation(size)[:48]) for _ in boards]
        rows = np.concatenate([size * board + each for board, each in enumerate(chosen)])
        few = ArrayFit(self.measured[np.ix_(rows, rows)], self.counted[np.ix_(rows, rows)])
        parts = [elements_of(*board) for board in zip(boards, chosen, strict=True)]
        power = float(np.sum(np.abs(few.measured) ** 2))
        spread = np.repeat([1.2e-3, 0.012], 3)  # standard deviations of boards [m] and angles [rad]
        best = None
        for count in range(48):
            # The first start is the given array. Board 0 is the same in all starts.
            motions = random.normal(size=(len(boards), 6)) * spread * (count > 0)
            motions[0] = 0.0
            faster = 1.0 + 0.006 * random.normal() * (count > 0)
            start = tuple(moved(*part) for part in zip(parts, motions, strict=True))
            here = few.follow(start, complex(wavenumber.real / faster, wavenumber.imag))
            best = here if best is None or here.cost < best.cost else best
            if best.cost < enough * power:
                break
        assert best is not None
        start = tuple(
            board.moved(Pose(*nearest_motion(before.positions, after.positions)))
            for board, before, after in zip(boards, parts, best.boards, strict=True)
        )
        return self.follow(start, best.wavenumber)

    def follow(self, boards: tuple[PhasedArray, ...], wavenumber: complex) -> ArrayState:
        """Fit by damped Gauss-Newton steps, starting from the given boards and wavenumber."""
        ones = np.ones(len(self.measured), dtype=np.complex128)
        here = self._state(boards, wavenumber, ones, ones)
        units = _units(boards, wavenumber)
        squares, slope = self.equations(here, units)
        damping = 1e-3
        for count in range(1, 61):
            step = -np.linalg.solve(squares + damping * np.diag(np.diag(squares)), slope)
            motions = (step * units)[:-1].reshape(-1, 6)
            moving = [moved(*board) for board in zip(here.boards[1:], motions, strict=True)]
            faster = here.wavenumber + step[-1] * units[-1]
            tried = self._state((boards[0], *moving), faster, here.reception, here.emission)
            improvement = 1.0 - tried.cost / max(here.cost, 1e-300)
            here = tried if improvement > 0.0 else here
            if np.linalg.norm(step) < 1e-8 or damping > 1e6 or 0.0 < improvement < 1e-8:
                return replace(here, steps=count, settled=True)
            if improvement > 0.0:
                squares, slope = self.equations(here, units)
            # After a successful step the next step is closer to Gauss-Newton.
            damping *= 0.2 if improvement > 0.0 else 6.0
        return replace(here, steps=60)

    def _state(
        self,
        boards: tuple[PhasedArray, ...],
        wavenumber: complex,
        reception: Gains,
        emission: Gains,
    ) -> ArrayState:
        size = len(boards[0])
        model = np.zeros_like(self.measured)
        slopes = {}
        for first, second in combinations(range(len(boards)), 2):
            rows = _elements(first, size)
            columns = _elements(second, size)
            if self.counted[rows, columns].any() or self.counted[columns, rows].any():
                direct, slopes[first, second] = transmission(
                    boards[first], boards[second], wavenumber
                )
                model[rows, columns] = direct
                model[columns, rows] = direct.T
        model *= self.counted
        # The gains follow from alternating least squares; unused gains stay the same.
        turned = model.conj() * self.measured
        power = np.abs(model) ** 2
        for _ in range(40):
            before = emission
            # Each half is an independent least-squares problem for every receiver or emitter.
            reception = _shares(turned @ emission.conj(), power @ np.abs(emission) ** 2, reception)
            emission = _shares(reception.conj() @ turned, np.abs(reception) ** 2 @ power, emission)
            if np.linalg.norm(emission - before) < 1e-5 * np.linalg.norm(emission):
                break
        cost = float(np.sum(np.abs(reception[:, None] * emission * model - self.measured) ** 2))
        return ArrayState(boards, wavenumber, reception, emission, slopes, model, cost)

    def equations(self, here: ArrayState, units: Step) -> tuple[Squares, Step]:
        """Return the normal matrix and half the gradient of the cost, after eliminating the gains.

        The unknowns are the motions of all boards except the first, and the wavenumber. Each
        unknown is divided by its entry in ``units``.
        """
        size = len(here.boards[0])
        elements = len(self.measured)
        unknowns = 6 * len(here.boards) + 1
        gains = here.reception[:, None] * here.emission
        model = gains * here.model
        residual = model - self.measured
        squares = np.zeros((unknowns, unknowns))
        slope = np.zeros(unknowns)
        # Coupling of the logarithms of the gains to the unknowns, reception first.
        mixed = np.zeros((2, elements, unknowns), dtype=np.complex128)
        for (first, second), between in here.slopes.items():
            indices = np.r_[6 * first : 6 * first + 6, 6 * second : 6 * second + 6, unknowns - 1]
            pair = _elements(first, size), _elements(second, size)
            # Both directions have the same direct sound, by reciprocity.
            for (rows, columns), slopes in (
                (pair, between),
                (pair[::-1], np.swapaxes(between, 1, 2)),
            ):
                by = slopes * (gains[rows, columns] * self.counted[rows, columns])
                flat = by.reshape(13, -1)
                squares[np.ix_(indices, indices)] += np.real(flat.conj() @ flat.T)
                slope[indices] += np.real(flat.conj() @ residual[rows, columns].reshape(-1))
                along = model[rows, columns].conj() * by
                mixed[0][rows][:, indices] += along.sum(axis=2).T
                mixed[1][columns][:, indices] += along.sum(axis=1).T
        of_gains = np.concatenate([np.sum(model.conj() * residual, axis=axis) for axis in (1, 0)])
        # Board 0 is fixed, so its six unknowns are omitted.
        mixed = np.column_stack([mixed.reshape(2 * elements, unknowns)[:, 6:] * units, of_gains])
        # The equations of the gains, with reception first, are the same for log magnitudes (real
        # parts) and phases (imaginary parts).
        parts = np.concatenate([mixed.real, mixed.imag], axis=1)
        power = np.abs(model) ** 2
        diagonal = np.concatenate([power.sum(axis=1), power.sum(axis=0)])
        typical = diagonal.mean()
        gain_squares = np.block([[np.zeros_like(power), power], [power.T, np.zeros_like(power)]])
        gain_squares += np.diag(np.where(diagonal > 0.0, diagonal, typical))
        # They are singular, because each group has an arbitrary common factor.
        groups = self.groups.reshape(-1)
        signs = np.repeat([1.0, -1.0], len(power))
        for group in np.unique(groups):
            common = signs * (groups == group)
            gain_squares += np.outer(common, common) * typical / np.count_nonzero(common)
        solved = solve(gain_squares, parts, assume_a="pos")
        both = parts.T @ solved
        count = unknowns - 5
        eliminated = both[:count, :count] + both[count:, count:]
        squares = squares[6:, 6:] * np.outer(units, units) - eliminated[:-1, :-1]
        return squares, slope[6:] * units - eliminated[:-1, -1]


def calibrate(
    echoes: Echoes, array: PhasedArray, medium: Medium, boards: int | None = None
) -> Calibrated:
    """Estimate the poses of boards, the gains of elements and the sound speed from direct sound.

    The array's elements both emit and receive. The space between the boards must be empty, and the
    echoes must include the direct sound. Only pairs of elements on different boards that face each
    other within 60 degrees are used. The given poses may be wrong by up to 2 mm and 1 degree, and
    the sound speed by up to 4 m/s (7 °C). Board 0 stays in place and defines the frame.

    Parameters
    ----------
    echoes : ``Echoes`` of the array without bodies: all E elements emit, and all or some receive.
        The codes must separate all elements, as those of ``hadamard_codes`` do, which takes at
        least E transmissions.
    array : the E elements with the assumed poses of the boards; its gains are ignored.
    medium : the assumed air, from which the sound speed starts; its absorption is not corrected.
    boards : number of boards, at least 2, all with the same number of elements. The array must
        contain the elements board by board. By default, the number is inferred, which requires
        boards of a known kind.

    Returns
    -------
    A ``Calibrated`` with the corrected array, the gains and the sound speed, and their
    uncertainties. Use it only if its attribute ``converged`` is True. It may be False if the poses
    or the sound speed are wrong by more than stated above.

    Raises
    ------
    InvalidInput
        If the echoes and the array have different numbers of elements, or the number of boards is
        unknown. If the codes do not separate the elements. If an element, or a whole board, does
        not face any element of another board. If the signal is too weak or clipped. If the
        transmissions do not determine all poses and the sound speed.

    Examples
    --------
    Two small boards 6 cm apart; the assumed position of the second is wrong by 0.3 mm:

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
    units = _units(best.boards, best.wavenumber)
    squares, _ = fit.equations(best, units)
    # The two complex gains of each element reduce the degrees of freedom.
    variance = best.cost / max(int(fit.counted.sum()) - 2 * len(array), 1) / 2.0
    converged = bool(best.settled and misfit <= MAX_MISFIT)
    if converged:
        _check_determined(squares, variance, echoes)
    covariance = variance * np.linalg.pinv(squares, hermitian=True)
    speed = 2 * np.pi * echoes.frequency / best.wavenumber.real
    # Convert the unknowns to metres and radians, and the wavenumber to the sound speed.
    scale = np.append(units[:-1], -units[-1] * speed / best.wavenumber.real)
    emission, reception = _same_mean(fit, best, dead)
    # Fisher information of each gain with the other unknowns fixed, which have little influence.
    emitted = np.sum(np.abs(best.reception[:, None] * best.emission * best.model) ** 2, axis=0)
    calibrated = join(best.boards).calibrated(emission)
    return Calibrated(
        array=calibrated,
        sound_speed=speed,
        motions=tuple(
            Pose(*nearest_motion(before.positions, after.positions))
            for before, after in zip(parts, best.boards, strict=True)
        ),
        emission=calibrated.gains,
        reception=reception,
        covariance=covariance * np.outer(scale, scale),
        gain_deviation=float(np.sqrt(variance * np.mean(1.0 / emitted[emitted > 0.0]))),
        residual=float(np.sqrt(best.cost / power)),
        misfit=misfit,
        converged=converged,
        steps=best.steps,
        believed=array,
        dead=dead,
    )


def _separated(echoes: Echoes) -> tuple[Pairs, float]:
    # Return the (E, E) pressures at each receiver from each element alone, and their noise [Pa].
    codes = np.asarray(echoes.codes)
    values, vectors = np.linalg.eigh(codes @ codes.conj().T)
    separated = int(np.sum(values > 1e-6 * values.max()))
    if separated < len(codes):
        raise InvalidInput(
            "the codes of "
            f"{counted(codes.shape[1], 'transmission separate', 'transmissions separate')} only "
            f"{separated} of {len(codes)} elements, but calibration must separate all. Use "
            f"hadamard_codes({len(codes)}) as codes.",
            code="too_few",
        )
    inverse = vectors / values @ vectors.conj().T
    alone = np.zeros((len(codes), len(codes)), dtype=np.complex128)
    alone[echoes.receiving] = np.asarray(echoes.pressures) @ codes.conj().T @ inverse
    return alone, (echoes.noise or 0.0) * float(np.sqrt(np.mean(np.real(np.diag(inverse)))))


def _facing_pairs(echoes: Echoes, boards: list[PhasedArray]) -> CountedPairs:
    # Return which receivers face which emitters on another board.
    size = len(boards[0])
    total = len(echoes.codes)
    pairs = np.zeros((total, total), dtype=bool)
    for first, second in permutations(range(len(boards)), 2):
        seen = facing(boards[first], boards[second])
        pairs[_elements(first, size), _elements(second, size)] = seen
    pairs[np.setdiff1d(np.arange(total), echoes.receiving)] = False
    receives = pairs[echoes.receiving] @ (np.asarray(echoes.codes) != 0.0)
    check_not_clipped(np.abs(np.asarray(echoes.pressures))[receives])
    return pairs


def _dead(alone: Pairs, pairs: CountedPairs, noise: float) -> Int64[np.ndarray, "dead"]:
    # Return the elements that emit, or receive, less than a tenth of the median.
    power = np.where(pairs, np.abs(alone) ** 2, 0.0)
    dead = []
    for axis in (0, 1):
        count = pairs.sum(axis=axis)
        size = np.sqrt(np.maximum(power.sum(axis=axis) / np.maximum(count, 1) - noise**2, 0.0))
        # Few elements are dead, so the median is typical.
        typical = np.median(size[count > 0]) if count.any() else 0.0
        dead.append(np.flatnonzero((count > 0) & (size < 0.1 * typical)))
    return np.union1d(*dead)


def _check_linked(
    alone: Pairs, pairs: CountedPairs, boards: int, noise: float, dead: Int64[np.ndarray, "dead"]
) -> None:
    by_boards = pairs.reshape(boards, -1, boards, len(pairs) // boards).any(axis=(1, 3))
    group = connected_components(by_boards, directed=False)[1]
    if group.any():
        raise InvalidInput(
            f"board {group.argmax()} of {boards} does not face another board within 60 degrees, or "
            "has no working elements, so its pose cannot be found. Remove it from the array.",
            code="misplaced",
        )
    silent = np.setdiff1d(np.flatnonzero(~pairs.any(axis=0)), dead)
    if len(silent):
        raise InvalidInput(
            f"{counted(len(silent), 'element faces', 'elements face')} no receiver on another "
            f"board within 60 degrees; the first is element {silent[0]}. Remove them from the "
            "array, or add receivers.",
            code="misplaced",
        )
    rms = float(np.sqrt(np.mean(np.abs(alone[pairs]) ** 2)))
    if rms == 0.0 or rms < 1.05 * noise:
        raise InvalidInput(
            f"the direct sound of one element has an rms of {rms:.3g} Pa, hardly more than the "
            f"noise of {noise:.3g} Pa. Do not subtract the direct sound, and use more or longer "
            "transmissions.",
            code="signal_unusable",
        )


def _check_determined(squares: Squares, variance: float, echoes: Echoes) -> None:
    values, vectors = np.linalg.eigh(squares)
    # A standard deviation of 1 mm is the limit.
    if values[0] > 1e-12 * values[-1] and variance < values[0] * 1e-3**2:
        return
    boards = range(1, 1 + len(values) // 6)
    names = [f"the {kind} of board {board}" for board in boards for kind in ("position", "angles")]
    names.append("the sound speed")
    shares = np.append(np.linalg.norm(vectors[:-1, 0].reshape(-1, 3), axis=1), abs(vectors[-1, 0]))
    involved = [name for name, share in zip(names, shares, strict=True) if share > 0.3]
    deviation = 1e3 * np.sqrt(variance / max(values[0], 1e-12 * values[-1]))
    raise InvalidInput(
        f"the pressures at {counted(len(echoes.pressures), 'receiver', 'receivers')} do not "
        f"determine {' together with '.join(involved)}: the standard deviation is {deviation:.2g} "
        "mm, but at most 1 mm is allowed. Use more receivers, reduce the noise, or remove boards.",
        code="pose_not_found",
    )


def _same_mean(
    fit: ArrayFit, state: ArrayState, dead: Int64[np.ndarray, "dead"]
) -> tuple[Gains, Gains]:
    # Scale the emission and reception gains of each group to equal means.
    emission = state.emission.copy()
    reception = state.reception.copy()
    receives = fit.counted.any(axis=1)
    emits = fit.counted.any(axis=0)
    for group in np.unique(fit.groups[1][emits]):
        emitters = emits & (fit.groups[1] == group)
        receivers = receives & (fit.groups[0] == group)
        factor = np.sqrt(reception[receivers].mean() / emission[emitters].mean())
        emission[emitters] *= factor
        reception[receivers] /= factor
    reception[~receives] = 1.0
    emission[dead] = 0.0
    reception[dead] = 0.0
    reception.flags.writeable = False
    return emission, reception


def moved(board: PhasedArray, motion: Float64[np.ndarray, "6"]) -> PhasedArray:
    """Translate a board [m], and rotate it about its centre [rad]."""
    middle = board.positions.mean(axis=0)
    turn = Rotation.from_rotvec(motion[3:]).as_matrix()
    return board.moved(Pose(turn, middle - turn @ middle + motion[:3]))


def _units(boards: tuple[PhasedArray, ...], wavenumber: complex) -> Step:
    # Return steps in metres, radians and 1/m that change the model about equally.
    middles = np.stack([board.positions.mean(axis=0) for board in boards])
    arm = float(np.sqrt(np.mean([np.var(board.positions, axis=0).sum() for board in boards])))
    distance = float(np.linalg.norm(middles[:, None] - middles, axis=2).max())
    of_boards = np.tile([1.0] * 3 + [1.0 / arm] * 3, len(boards) - 1)
    return np.append(of_boards, wavenumber.real / distance)


def _shares(upper: Gains, lower: Float64[np.ndarray, "elements"], otherwise: Gains) -> Gains:
    return np.where(lower > 0.0, upper / np.where(lower > 0.0, lower, 1.0), otherwise)


def _elements(board: int, size: int) -> slice:
    return slice(board * size, (board + 1) * size)
