"""Direct sound between elements of an array, and its derivatives for motions of the boards.

An element of unit gain emits s Σ_q w_q e^{ikR}/R over the points of its face, where s is the
sensitivity, and receives the mean over its face with the same weights. A small rigid motion of a
board, translation t and rotation ω about its centre m, moves face points x by t + ω × (x − m).
Every derivative is therefore a sum of gradients of e^{ikR}/R over pairs of face points.
"""

from itertools import combinations

import numpy as np
from jaxtyping import Bool, Complex128, Int64, Num

from airtact.acoustics.medium import Medium
from airtact.errors import InvalidInput, check_seed, complex_numbers, of_kind
from airtact.sensing.echoes import Echoes
from airtact.sensing.simulation import noisy
from airtact.transducers.boards import kind_of_array
from airtact.transducers.element import check_pattern
from airtact.transducers.layout import PhasedArray

Pairs = Complex128[np.ndarray, "receivers emitters"]


def transmission(
    receiving: PhasedArray, emitting: PhasedArray, wavenumber: complex
) -> tuple[Pairs, Complex128[np.ndarray, "13 receivers emitters"]]:
    """Sum the direct sound between the faces of all elements of two boards, and its derivatives.

    Returns
    -------
    (R, E) pressures at each receiver from each emitter for unit gains [Pa], and their (13, R, E)
    derivatives. By reciprocity, the pressures also apply in the opposite direction. The derivatives
    are with respect to a translation of the receiving board [Pa/m], a rotation about its centre
    [Pa/rad], the same motions of the emitting board, and the wavenumber [Pa·m].
    """
    weights = receiving.element.weights
    faces = receiving.face_points
    sources = emitting.face_points.reshape(-1, 3)
    emitters = len(emitting)
    count = len(weights)
    pressures = np.empty((len(receiving), emitters), dtype=np.complex128)
    slopes = np.empty((13, *pressures.shape), dtype=np.complex128)
    strengths = receiving.element.sensitivity * np.outer(weights, weights)
    rows = max(1, (1 << 18) // (len(sources) * count))  # limits the memory
    for first in range(0, len(receiving), rows):
        block = slice(first, first + rows)
        points = faces[block].reshape(-1, 3)
        away = points[:, None, :] - sources
        distance = np.sqrt(np.einsum("psd,psd->ps", away, away))
        wave = (
            np.exp(1j * wavenumber * distance).reshape(-1, count, emitters, count)
            * strengths[:, None, :]
        )
        wave = wave.reshape(distance.shape)
        slopes[12, block] = 1j * _summed(wave, count, emitters)
        # The derivative with respect to k, computed above, lacks the factor 1/R.
        wave /= distance
        pressures[block] = _summed(wave, count, emitters)
        slope = (wave * (1j * wavenumber - 1.0 / distance) / distance)[..., None] * away
        for place, arms, sign in (
            (0, (points - receiving.positions.mean(axis=0))[:, None, :], 1.0),
            (6, (sources - emitting.positions.mean(axis=0))[None, :, :], -1.0),
        ):
            for axis in range(3):
                y = (axis + 1) % 3
                z = (axis + 2) % 3
                moment = arms[..., y] * slope[..., z] - arms[..., z] * slope[..., y]
                slopes[place + axis, block] = sign * _summed(slope[..., axis], count, emitters)
                slopes[place + 3 + axis, block] = sign * _summed(moment, count, emitters)
    return pressures, slopes


def _summed(pairs: Complex128[np.ndarray, "points sources"], count: int, emitters: int) -> Pairs:
    return pairs.reshape(-1, count, emitters, count).sum(axis=(1, 3))


def facing(
    receiving: PhasedArray,
    emitting: PhasedArray,
    cosine: float = 0.5,
    nearest: float = 0.02,
) -> Bool[np.ndarray, "receivers emitters"]:
    """Return whether elements of two boards face each other and are not neighbours at an edge.

    The default limits are 60 degrees from the axis and a distance of 20 mm. At larger angles, real
    transducers deviate from pistons.
    """
    away = receiving.positions[:, None, :] - emitting.positions
    distance = np.linalg.norm(away, axis=2)
    ahead = np.einsum("red,ed->re", away, emitting.normals)
    back = -np.einsum("red,rd->re", away, receiving.normals)
    return (np.minimum(ahead, back) >= cosine * distance) & (distance > nearest)


def boards_of(array: PhasedArray, count: int | None = None) -> list[PhasedArray]:
    """Split an array into ``count`` equal boards, by default into boards of a known kind.

    Raises
    ------
    InvalidInput
        If the number of boards is unknown or does not divide the number of elements.
    """
    if count is None:
        count = len((kind_of_array(array.positions, array.normals) or (None, ()))[1])
    if count < 2:
        raise InvalidInput(
            f"it is unknown how the {len(array)} elements are divided into boards; pass the "
            "number of boards (2 or more).",
            code="unknown_name",
        )
    if len(array) % count:
        raise InvalidInput(
            f"{len(array)} elements cannot be divided into {count} equal boards; pass the number "
            "of boards.",
            code="unknown_name",
        )
    return [elements_of(array, rows) for rows in np.split(np.arange(len(array)), count)]


def elements_of(array: PhasedArray, rows: Int64[np.ndarray, "elements"]) -> PhasedArray:
    """Select elements of an array, and set their gains to 1."""
    return PhasedArray(
        array.positions[rows], array.normals[rows], array.element, array.tangents[rows]
    )


def simulate_transmissions(
    array: PhasedArray,
    medium: Medium,
    codes: Num[np.ndarray, "elements transmissions"],
    *,
    boards: int | None = None,
    frequency: float = 40e3,
    reception: Num[np.ndarray, "elements"] | None = None,
    noise: float | None = None,
    seed: int = 0,
) -> Echoes:
    """Compute the direct sound of coded transmissions between the boards of an empty array.

    Elements of the same board do not receive each other, and directional elements do not emit or
    receive behind their faces.

    Parameters
    ----------
    array : the array of boards; its gains apply to emission.
    medium : the air.
    codes : (E, M) codes, as in ``Echoes``.
    boards : number of boards. All boards have the same number of elements, and the array lists them
        one after another. By default the number is inferred from the known kinds of boards.
    frequency : frequency of the sound [Hz].
    reception : (E,) reception gains; by default those of the array.
    noise : signal-to-noise ratio, the rms of the pressures relative to the rms of the added complex
        noise [dB]. None adds no noise.
    seed : seed of the noise, 0 or more.

    Returns
    -------
    The codes and the received pressures (E, M) [Pa].

    Raises
    ------
    InvalidInput
        Under the conditions listed in ``Echoes``, or if the number of gains, the number of boards
        or the noise is invalid.
    """
    of_kind(array, PhasedArray, "the array", "one such as surrounding_box()")
    parts = boards_of(array, boards)
    wavenumber = medium.wavenumber(frequency)
    check_pattern(array.element, wavenumber)
    check_seed(seed)
    received = (
        array.gains if reception is None else complex_numbers(reception, "the gains of reception")
    )
    if len(codes) != len(array) or received.shape != (len(array),):
        raise InvalidInput(
            f"there are {len(codes)} codes and {len(received)} reception gains for {len(array)} "
            "elements. Pass one code and one gain for each element.",
            code="sizes_differ",
        )
    size = len(parts[0])
    pairs = np.zeros((len(array), len(array)), dtype=np.complex128)
    # Omnidirectional elements also emit backwards.
    front = 0.0 if array.element.directional else -1.0
    for first, second in combinations(range(len(parts)), 2):
        # The second board receives; the other direction follows by reciprocity.
        seen = facing(parts[second], parts[first], front, 0.0)
        between = transmission(parts[second], parts[first], wavenumber)[0] * seen
        rows = slice(second * size, (second + 1) * size)
        columns = slice(first * size, (first + 1) * size)
        pairs[rows, columns] = between
        pairs[columns, rows] = between.T
    pressures = received[:, None] * (pairs @ (array.gains[:, None] * codes))
    deviation = None
    if noise is not None:
        pressures, deviation = noisy(pressures, noise, seed)
    return Echoes(codes, pressures, None, frequency, deviation)
