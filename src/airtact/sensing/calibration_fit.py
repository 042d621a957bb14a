"""Least squares for boards, sound speed and gains; see ``calibrate``."""

from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np
from jaxtyping import Bool, Complex128, Float64, Int32, Int64
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from airtact.geometry.pose import Pose
from airtact.sensing.gauss_newton import Iterate, Squares, Step, descend
from airtact.sensing.transmission import Pairs, Transmission, transmission
from airtact.transducers.layout import PhasedArray

Gains = Complex128[np.ndarray, "elements"]


@dataclass(frozen=True, eq=False)
class ArrayState(Iterate):
    """Boards, wavenumber and gains, and how they fit.

    Attributes
    ----------
    boards : B boards, of unit gain.
    wavenumber : of the air [1/m].
    reception, emission : (E,) gains.
    between : direct sound of each pair of boards (first, second), first < second.
    model : (E, E) of unit gains, at the receivers from the emitters, 0 where pairs do not count
        [Pa].
    """

    boards: tuple[PhasedArray, ...]
    wavenumber: complex
    reception: Gains
    emission: Gains
    between: dict[tuple[int, int], Transmission]
    model: Pairs


@dataclass(frozen=True, eq=False)
class Information:
    """Normal equations of the boards' motions and the wavenumber, once the gains have adapted.

    Attributes
    ----------
    squares : (6 B − 5, 6 B − 5), in metres: turns times ``arm``, the wavenumber as metres of a
        path.
    slope : (6 B − 5,) half the slope of the cost.
    units : (6 B − 5,) by which a step in metres becomes one in metres, radians and 1/m.
    gain_variance : mean of the diagonal of the inverse of the gains' own equations, relative.
    """

    squares: Squares
    slope: Step
    units: Step
    gain_variance: float


@dataclass(frozen=True, eq=False)
class ArrayFit:
    """Pressures (E, E) at each receiver from each emitter, and which of them count."""

    measured: Pairs
    counted: Bool[np.ndarray, "elements elements"]

    @cached_property
    def groups(self) -> Int32[np.ndarray, "2 elements"]:
        """Group of each receiver and each emitter; gains of different groups cannot be compared.

        Two boards alone make two groups, what the first emits and the second receives, and the
        reverse.
        """
        none = np.zeros_like(self.counted)
        linked = np.block([[none, self.counted], [self.counted.T, none]])
        return connected_components(csr_matrix(linked), directed=False)[1].reshape(2, -1)

    def best(
        self, boards: tuple[PhasedArray, ...], wavenumber: complex, enough: float
    ) -> ArrayState:
        """Find the best of several starts by a few elements of each board, then fit all elements.

        Phases are known up to whole turns, so that a start which is off by half a wavelength may
        lead elsewhere.
        """
        random = np.random.default_rng(0)
        size = len(boards[0])
        # 48 elements of each board compare starts; 48 starts find boards that are 2 mm off.
        chosen = [np.sort(random.permutation(size)[:48]) for _ in boards]
        rows = np.concatenate([size * board + each for board, each in enumerate(chosen)])
        few = ArrayFit(self.measured[np.ix_(rows, rows)], self.counted[np.ix_(rows, rows)])
        parts = [_part_of(board, rows) for board, rows in zip(boards, chosen, strict=True)]
        power = float(np.sum(np.abs(few.measured) ** 2))
        spread = np.repeat([1.2e-3, 0.012], 3)  # standard deviations of boards [m] and angles [rad]
        best = None
        for count in range(48):
            # The first start is the believed array, which board 0 keeps in all of them.
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
            board.moved(motion_of(before, after))
            for board, before, after in zip(boards, parts, best.boards, strict=True)
        )
        return self.follow(start, best.wavenumber)

    def follow(self, boards: tuple[PhasedArray, ...], wavenumber: complex) -> ArrayState:
        """Take damped Gauss-Newton steps from where the boards are believed to be."""

        def equations(here: ArrayState) -> tuple[Squares, Step, Step]:
            information = self.information(here)
            return information.squares, information.slope, np.diag(information.squares)

        def move(here: ArrayState, step: Step) -> ArrayState:
            step = step * _units(here.boards, here.wavenumber)
            motions = step[:-1].reshape(-1, 6)
            others = [moved(*board) for board in zip(here.boards[1:], motions, strict=True)]
            boards = (here.boards[0], *others)
            return self._state(boards, here.wavenumber + step[-1], here.reception, here.emission)

        ones = np.ones(len(self.measured), dtype=np.complex128)
        start = self._state(boards, wavenumber, ones, ones)
        return descend(start, equations, move, steps=30, settled=1e-8, flat=1e-8)

    def _state(
        self,
        boards: tuple[PhasedArray, ...],
        wavenumber: complex,
        reception: Gains,
        emission: Gains,
    ) -> ArrayState:
        """Fit the gains to boards and wavenumber, from gains nearby."""
        size = len(boards[0])
        model = np.zeros_like(self.measured)
        between = {}
        for first, second in combinations(range(len(boards)), 2):
            rows = _elements(first, size)
            columns = _elements(second, size)
            if self.counted[rows, columns].any() or self.counted[columns, rows].any():
                direct = transmission(boards[first], boards[second], wavenumber)
                between[first, second] = direct
                model[rows, columns] = direct.pressures
                model[columns, rows] = direct.pressures.T
        model *= self.counted
        reception, emission = self._gains(model, reception, emission)
        cost = float(np.sum(np.abs(reception[:, None] * emission * model - self.measured) ** 2))
        return ArrayState(boards, wavenumber, reception, emission, between, model, cost=cost)

    def _gains(self, model: Pairs, reception: Gains, emission: Gains) -> tuple[Gains, Gains]:
        """Solve for the gains of receivers and emitters in turn; those that do not count stay."""
        turned = model.conj() * self.measured
        power = np.abs(model) ** 2
        for _ in range(40):
            before = emission
            # Each half is a least-squares problem of its own for every receiver or emitter.
            reception = _shares(turned @ emission.conj(), power @ np.abs(emission) ** 2, reception)
            emission = _shares(reception.conj() @ turned, np.abs(reception) ** 2 @ power, emission)
            if np.linalg.norm(emission - before) < 1e-5 * np.linalg.norm(emission):
                break
        return reception, emission

    def information(self, here: ArrayState) -> Information:
        """Set up the normal equations with exact derivatives, and eliminate the gains."""
        size = len(here.boards[0])
        elements = len(self.measured)
        unknowns = 6 * len(here.boards) + 1
        gains = here.reception[:, None] * here.emission
        model = gains * here.model
        residual = model - self.measured
        squares = np.zeros((unknowns, unknowns))
        slope = np.zeros(unknowns)
        mixed = np.zeros((2, elements, unknowns), dtype=np.complex128)  # of reception, of emission
        for (first, second), between in here.between.items():
            of_first = np.arange(6) + 6 * first
            of_second = np.arange(6) + 6 * second
            indices = np.concatenate([of_first, of_second, [unknowns - 1]])
            pair = _elements(first, size), _elements(second, size)
            # Both directions have the same direct sound, by reciprocity.
            for (rows, columns), slopes in (
                (pair, between.slopes),
                (pair[::-1], between.slopes.transpose(0, 2, 1)),
            ):
                by = slopes * (gains[rows, columns] * self.counted[rows, columns])
                flat = by.reshape(13, -1)
                squares[np.ix_(indices, indices)] += np.real(flat.conj() @ flat.T)
                slope[indices] += np.real(flat.conj() @ residual[rows, columns].reshape(-1))
                along = model[rows, columns].conj() * by
                mixed[0][rows][:, indices] += along.sum(axis=2).T
                mixed[1][columns][:, indices] += along.sum(axis=1).T
        of_gains = np.concatenate([np.sum(model.conj() * residual, axis=axis) for axis in (1, 0)])
        units = _units(here.boards, here.wavenumber)
        # The first six unknowns go: board 0 is held.
        mixed = mixed.reshape(2 * elements, unknowns)[:, 6:] * units
        squares = squares[6:, 6:] * np.outer(units, units)
        slope = slope[6:] * units
        return _reduced(squares, slope, mixed, of_gains, np.abs(model) ** 2, units, self.groups[1])


def _reduced(
    squares: Squares,
    slope: Step,
    mixed: Complex128[np.ndarray, "gains unknowns"],
    of_gains: Complex128[np.ndarray, "gains"],
    power: Float64[np.ndarray, "elements elements"],
    units: Step,
    groups: Int32[np.ndarray, "elements"],
) -> Information:
    """Eliminate log magnitudes and phases of all gains, whose equations are the same and real."""
    elements = len(power)
    typical = power.sum() / elements
    receiving = power.sum(axis=1)
    emitting = power.sum(axis=0)
    counts = emitting > 0.0
    weight = 1.0 / np.where(receiving > 0.0, receiving, typical)
    # Schur complement of the receivers, whose own block is diagonal.
    schur = np.diag(np.where(counts, emitting, typical)) - (power.T * weight) @ power
    # It is singular: a factor multiplies all that a group emits and divides all that it receives.
    for group in np.unique(groups):
        common = counts & (groups == group)
        schur += np.outer(common, common) * typical / max(common.sum(), 1)
    inverse = np.linalg.inv(schur)
    spread = np.empty((elements, len(slope)))
    # Real parts belong to log magnitudes, imaginary parts to phases.
    for part, right in ((np.real(mixed), np.real(of_gains)), (np.imag(mixed), np.imag(of_gains))):
        sides = np.column_stack([part, right])
        of_emission = inverse @ (sides[elements:] - power.T @ (weight[:, None] * sides[:elements]))
        of_reception = weight[:, None] * (sides[:elements] - power @ of_emission)
        solved = part.T @ np.concatenate([of_reception, of_emission])
        squares = squares - solved[:, :-1]
        slope = slope - solved[:, -1]
        spread = of_emission[:, :-1]
    inner = np.sum((spread @ np.linalg.pinv(squares, hermitian=True)) * spread, axis=1)
    return Information(squares, slope, units, float(np.mean((np.diag(inverse) + inner)[counts])))


def _part_of(board: PhasedArray, rows: Int64[np.ndarray, "rows"]) -> PhasedArray:
    return PhasedArray(
        board.positions[rows], board.normals[rows], board.element, board.tangents[rows]
    )


def motion_of(before: PhasedArray, after: PhasedArray) -> Pose:
    """Find the rigid motion of a board."""
    frames = [
        np.stack(
            [board.tangents[0], np.cross(board.normals[0], board.tangents[0]), board.normals[0]]
        )
        for board in (before, after)
    ]
    turn = frames[1].T @ frames[0]
    return Pose(turn, after.positions.mean(axis=0) - turn @ before.positions.mean(axis=0))


def moved(board: PhasedArray, motion: Float64[np.ndarray, "6"]) -> PhasedArray:
    """Move the middle of a board, and turn it about that by less than a turn."""
    middle = board.positions.mean(axis=0)
    angle = float(np.linalg.norm(motion[3:]))
    turn = Pose.turn(motion[3:], angle).rotation if angle > 0.0 else np.eye(3)
    return board.moved(Pose(turn, middle - turn @ middle + motion[:3]))


def _units(boards: tuple[PhasedArray, ...], wavenumber: complex) -> Step:
    """Factors from steps in metres to metres, radians and 1/m of about the same effect."""
    middles = np.stack([board.positions.mean(axis=0) for board in boards])
    arm = float(np.sqrt(np.mean([np.var(board.positions, axis=0).sum() for board in boards])))
    distance = float(np.linalg.norm(middles[:, None] - middles, axis=2).max())
    of_boards = np.tile([1.0] * 3 + [1.0 / arm] * 3, len(boards) - 1)
    return np.append(of_boards, wavenumber.real / distance)


def _shares(upper: Gains, lower: Float64[np.ndarray, "elements"], otherwise: Gains) -> Gains:
    return np.where(lower > 0.0, upper / np.where(lower > 0.0, lower, 1.0), otherwise)


def _elements(board: int, size: int) -> slice:
    return slice(board * size, (board + 1) * size)
