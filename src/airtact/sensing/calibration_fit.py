"""Least squares for boards, sound speed and gains; see ``calibrate``."""

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np
from jaxtyping import Bool, Complex128, Float64, Int32, Int64
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from airtact.geometry.pose import Pose
from airtact.sensing.transmission import Pairs, Transmission, transmission
from airtact.transducers.layout import PhasedArray

SETTLED = 1e-8
"""Length of a step at which the boards are settled [m]."""

Gains = Complex128[np.ndarray, "elements"]


@dataclass(frozen=True, eq=False)
class ArrayState:
    """Boards, wavenumber and gains, and how they fit.

    Attributes
    ----------
    boards : B boards, of unit gain.
    wavenumber : of the air [1/m].
    reception, emission : (E,) gains.
    between : direct sound of each pair of boards (one, other), one < other.
    model : (E, E) of unit gains, at the receivers from the emitters, 0 where pairs do not count
        [Pa].
    cost : sum of the squares of what is left [Pa²].
    """

    boards: tuple[PhasedArray, ...]
    wavenumber: complex
    reception: Gains
    emission: Gains
    between: dict[tuple[int, int], Transmission]
    model: Pairs
    cost: float
    steps: int = 0
    settled: bool = False


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

    squares: Float64[np.ndarray, "unknowns unknowns"]
    slope: Float64[np.ndarray, "unknowns"]
    units: Float64[np.ndarray, "unknowns"]
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
        parts = [part_of(board, each) for board, each in zip(boards, chosen, strict=True)]
        power = float(np.sum(np.abs(few.measured) ** 2))
        spread = np.repeat([1.2e-3, 0.012], 3)  # standard deviations of boards [m] and angles [rad]
        best = None
        for count in range(48):
            motions = random.normal(size=(len(boards), 6)) * spread * (count > 0)
            motions[0] = 0.0
            faster = 1.0 + 0.006 * random.normal() * (count > 0)
            off = tuple(moved(*each) for each in zip(parts, motions, strict=True))
            here = few.follow(few.start(off, complex(wavenumber.real / faster, wavenumber.imag)))
            best = here if best is None or here.cost < best.cost else best
            if best.cost < enough * power:
                break
        assert best is not None
        found = tuple(
            board.moved(motion_of(before, after))
            for board, before, after in zip(boards, parts, best.boards, strict=True)
        )
        return self.follow(self.start(found, best.wavenumber))

    def start(self, boards: tuple[PhasedArray, ...], wavenumber: complex) -> ArrayState:
        """Fit the gains where the boards are believed to be."""
        ones = np.ones(len(self.measured), dtype=np.complex128)
        return self._state(boards, wavenumber, ones, ones)

    def follow(self, here: ArrayState) -> ArrayState:
        """Take damped Gauss-Newton steps until they settle."""
        damping = 1e-3
        for count in range(1, 31):
            equations = self.information(here)
            diagonal = np.diag(np.diag(equations.squares))
            while True:
                step = -np.linalg.solve(equations.squares + damping * diagonal, equations.slope)
                tried = self._moved(here, step * equations.units)
                length = float(np.linalg.norm(step))
                if tried.cost < here.cost:
                    break
                if length < SETTLED or damping > 1e6:
                    return replace(here, steps=count, settled=length < SETTLED)
                damping *= 6.0
            small = length < SETTLED or tried.cost > (1.0 - 1e-8) * here.cost
            here = replace(tried, steps=count)
            damping *= 0.2
            if small:
                return replace(here, settled=True)
        return here

    def _moved(self, here: ArrayState, step: Float64[np.ndarray, "unknowns"]) -> ArrayState:
        motions = step[:-1].reshape(-1, 6)
        boards = (
            here.boards[0],
            *(moved(*each) for each in zip(here.boards[1:], motions, strict=True)),
        )
        return self._state(boards, here.wavenumber + step[-1], here.reception, here.emission)

    def _state(
        self,
        boards: tuple[PhasedArray, ...],
        wavenumber: complex,
        reception: Gains,
        emission: Gains,
    ) -> ArrayState:
        size = len(boards[0])
        model = np.zeros_like(self.measured)
        between = {}
        for one, two in combinations(range(len(boards)), 2):
            rows, columns = _elements(one, size), _elements(two, size)
            if self.counted[rows, columns].any() or self.counted[columns, rows].any():
                direct = transmission(boards[one], boards[two], wavenumber)
                between[one, two] = direct
                model[rows, columns] = direct.pressures
                model[columns, rows] = direct.pressures.T
        model *= self.counted
        reception, emission = self._gains(model, reception, emission)
        cost = float(np.sum(np.abs(reception[:, None] * emission * model - self.measured) ** 2))
        return ArrayState(boards, wavenumber, reception, emission, between, model, cost)

    def _gains(self, model: Pairs, reception: Gains, emission: Gains) -> tuple[Gains, Gains]:
        """Solve for the gains of receivers and emitters in turn; those that do not count stay."""
        turned = model.conj() * self.measured
        power = np.abs(model) ** 2
        for _ in range(40):
            before = emission
            reception = _shares(turned @ emission.conj(), power @ np.abs(emission) ** 2, reception)
            emission = _shares(reception.conj() @ turned, np.abs(reception) ** 2 @ power, emission)
            if np.linalg.norm(emission - before) < 1e-5 * np.linalg.norm(emission):
                break
        return reception, emission

    def information(self, here: ArrayState) -> Information:
        """Set up the normal equations with exact derivatives, and eliminate the gains."""
        boards, size = here.boards, len(here.boards[0])
        unknowns, elements = 6 * len(boards) + 1, len(self.measured)
        whole = here.reception[:, None] * here.emission
        model = whole * here.model
        left = model - self.measured
        squares, slope = np.zeros((unknowns, unknowns)), np.zeros(unknowns)
        mixed = np.zeros((2, elements, unknowns), dtype=np.complex128)  # of reception, of emission
        for (one, other), between in here.between.items():
            own = np.concatenate([np.arange(6) + 6 * one, np.arange(6) + 6 * other, [unknowns - 1]])
            for rows, columns, slopes in (
                (_elements(one, size), _elements(other, size), between.slopes),
                (_elements(other, size), _elements(one, size), between.slopes.transpose(0, 2, 1)),
            ):
                by = slopes * (whole[rows, columns] * self.counted[rows, columns])
                flat = by.reshape(13, -1)
                squares[np.ix_(own, own)] += np.real(flat.conj() @ flat.T)
                slope[own] += np.real(flat.conj() @ left[rows, columns].reshape(-1))
                along = model[rows, columns].conj() * by
                mixed[0][rows][:, own] += along.sum(axis=2).T
                mixed[1][columns][:, own] += along.sum(axis=1).T
        of_gains = np.concatenate([np.sum(model.conj() * left, axis=axis) for axis in (1, 0)])
        units = _units(boards, here.wavenumber)
        mixed = mixed.reshape(2 * elements, unknowns)[:, 6:] * units
        squares, slope = squares[6:, 6:] * np.outer(units, units), slope[6:] * units
        return _reduced(squares, slope, mixed, of_gains, np.abs(model) ** 2, units, self.groups[1])


def _reduced(
    squares: Float64[np.ndarray, "unknowns unknowns"],
    slope: Float64[np.ndarray, "unknowns"],
    mixed: Complex128[np.ndarray, "gains unknowns"],
    of_gains: Complex128[np.ndarray, "gains"],
    power: Float64[np.ndarray, "elements elements"],
    units: Float64[np.ndarray, "unknowns"],
    groups: Int32[np.ndarray, "elements"],
) -> Information:
    """Eliminate log magnitudes and phases of all gains, whose equations are the same and real."""
    elements, typical = len(power), power.sum() / len(power)
    receiving, emitting = power.sum(axis=1), power.sum(axis=0)
    counts = emitting > 0.0
    weight = 1.0 / np.where(receiving > 0.0, receiving, typical)
    own = np.diag(np.where(counts, emitting, typical)) - (power.T * weight) @ power
    for component in np.unique(
        groups
    ):  # a factor that multiplies all it emits and divides all it receives
        common = counts & (groups == component)
        own += np.outer(common, common) * typical / max(common.sum(), 1)
    inverse = np.linalg.inv(own)
    spread = np.empty((elements, len(slope)))
    for part, right in ((np.real(mixed), np.real(of_gains)), (np.imag(mixed), np.imag(of_gains))):
        whole = np.column_stack([part, right])
        of_emission = inverse @ (whole[elements:] - power.T @ (weight[:, None] * whole[:elements]))
        of_reception = weight[:, None] * (whole[:elements] - power @ of_emission)
        solved = part.T @ np.concatenate([of_reception, of_emission])
        squares, slope, spread = (
            squares - solved[:, :-1],
            slope - solved[:, -1],
            of_emission[:, :-1],
        )
    inner = np.sum((spread @ np.linalg.pinv(squares, hermitian=True)) * spread, axis=1)
    return Information(squares, slope, units, float(np.mean((np.diag(inverse) + inner)[counts])))


def part_of(board: PhasedArray, some: Int64[np.ndarray, "some"]) -> PhasedArray:
    """Return some elements of a board."""
    return PhasedArray(
        board.positions[some], board.normals[some], board.element, board.tangents[some]
    )


def motion_of(before: PhasedArray, after: PhasedArray) -> Pose:
    """Find the rigid motion of a board."""
    frames = [
        np.stack([one.tangents[0], np.cross(one.normals[0], one.tangents[0]), one.normals[0]])
        for one in (before, after)
    ]
    turn = frames[1].T @ frames[0]
    return Pose(turn, after.positions.mean(axis=0) - turn @ before.positions.mean(axis=0))


def moved(board: PhasedArray, motion: Float64[np.ndarray, "6"]) -> PhasedArray:
    """Move the middle of a board, and turn it about that by less than a turn."""
    return board.moved(motion_about(board.positions.mean(axis=0), motion))


def motion_about(middle: Float64[np.ndarray, "3"], motion: Float64[np.ndarray, "6"]) -> Pose:
    """Return a translation and a turn vector about a point as a pose."""
    angle = float(np.linalg.norm(motion[3:]))
    turn = Pose.turn(motion[3:], angle).rotation if angle > 0.0 else np.eye(3)
    return Pose(turn, middle - turn @ middle + motion[:3])


def _units(boards: tuple[PhasedArray, ...], wavenumber: complex) -> Float64[np.ndarray, "unknowns"]:
    """Factors from steps in metres to metres, radians and 1/m of about the same effect."""
    middles = np.stack([one.positions.mean(axis=0) for one in boards])
    arm = float(np.sqrt(np.mean([np.var(one.positions, axis=0).sum() for one in boards])))
    way = float(np.linalg.norm(middles[:, None] - middles, axis=2).max())
    return np.concatenate(
        [np.tile([1.0] * 3 + [1.0 / arm] * 3, len(boards) - 1), [wavenumber.real / way]]
    )


def _shares(upper: Gains, lower: Float64[np.ndarray, "elements"], otherwise: Gains) -> Gains:
    return np.where(lower > 0.0, upper / np.where(lower > 0.0, lower, 1.0), otherwise)


def _elements(board: int, size: int) -> slice:
    return slice(board * size, (board + 1) * size)
