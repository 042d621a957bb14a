"""Simulated echoes and direct sound of coded transmissions, and derivatives of the direct sound.

An element of unit gain emits s Σ_q w_q e^{ikR}/R over the points of its face, where s is the
sensitivity, and receives the mean over its face with the same weights. A small rigid motion of a
board, translation t and rotation ω about its centre m, moves face points x by t + ω × (x − m).
Every derivative is therefore a sum of gradients of e^{ikR}/R over pairs of face points.
"""

from itertools import combinations

import numpy as np
from jaxtyping import Bool, Complex128, Int64, Integer, Num
from scipy.linalg import hadamard

from airtact.acoustics.medium import Medium
from airtact.acoustics.scene import Scene, check_no_planes
from airtact.acoustics.solvers.problem import Solver
from airtact.acoustics.sources import Monopoles
from airtact.errors import InvalidInput, between, check_seed, complex_numbers, of_kind, shaped
from airtact.sensing.echo_model import EchoModel
from airtact.sensing.echoes import Codes, Echoes
from airtact.sensing.scattering import ScatteringMatrix, check_own
from airtact.transducers.boards import kind_of_array
from airtact.transducers.element import check_pattern
from airtact.transducers.layout import PhasedArray
from airtact.transducers.placement import check_placement

Pairs = Complex128[np.ndarray, "receivers emitters"]


def transmission(
    receiving: PhasedArray, emitting: PhasedArray, wavenumber: complex
) -> tuple[Pairs, Complex128[np.ndarray, "13 receivers emitters"]]:
    """Compute the direct sound between all elements of two boards, and its derivatives.

    Returns
    -------
    (R, E) pressure at each receiver due to each emitter for unit gains [Pa], and its derivatives
    (13, R, E). By reciprocity, the pressures also apply in the opposite direction. The derivatives
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
    """Return a mask (R, E) of the pairs of elements on two boards that face each other.

    By default, the line between the two elements is at most 60 degrees from the axis of each,
    because real transducers deviate from pistons at larger angles. The elements are more than
    ``nearest`` [m] apart, which excludes neighbours where the boards meet at an edge.
    """
    away = receiving.positions[:, None, :] - emitting.positions
    distance = np.linalg.norm(away, axis=2)
    ahead = np.einsum("red,ed->re", away, emitting.normals)
    back = -np.einsum("red,rd->re", away, receiving.normals)
    return (np.minimum(ahead, back) >= cosine * distance) & (distance > nearest)


def boards_of(array: PhasedArray, count: int | None = None) -> list[PhasedArray]:
    """Split an array into ``count`` equal boards, by default as many as its kind of board implies.

    Raises
    ------
    InvalidInput
        If no count is given and the kind of the boards is unknown. If the elements cannot be
        divided into boards of equal size.
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
            f"{len(array)} elements cannot be divided into {count} equal boards; pass the correct "
            "number of boards.",
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
    """Compute the direct sound of coded transmissions between the boards, without bodies.

    The result is a test case for ``calibrate``. All elements emit and receive at the same time. The
    pressure received by an element is the mean over its face, multiplied by its reception gain.
    Elements of the same board do not receive sound from each other, and directional elements do not
    emit or receive behind their faces.

    Parameters
    ----------
    array : the array of two or more boards; its E gains apply to emission.
    medium : the air.
    codes : (E, M) complex amplitude that each element emits in each of M transmissions, of
        magnitude at most 1 (full scale), such as ``hadamard_codes``.
    boards : number of boards, all with the same number of elements. The array must contain the
        elements board by board. By default, the number is inferred, which requires boards of a
        known kind (see ``Board``).
    frequency : frequency of the sound [Hz], 1 kHz to 1 MHz.
    reception : (E,) complex reception gains; by default the gains of the array.
    noise : signal-to-noise ratio [dB], -300 to 300: the rms of the pressures relative to the rms
        magnitude of the added complex noise. None adds no noise.
    seed : seed of the noise, an integer of at least 0.

    Returns
    -------
    ``Echoes`` with the codes, the received pressures (E, M) [Pa] and the rms of the noise [Pa].

    Raises
    ------
    InvalidInput
        If the number of rows of codes or the number of gains differs from the number of elements,
        if a transmission is silent, if the array cannot be divided into this number of boards (or
        no number is given, and their kind is unknown), or if a parameter is outside its range.
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
    pressures, deviation = noisy(pressures, noise, seed)
    return Echoes(codes, pressures, None, frequency, deviation)


def hadamard_codes(elements: int, transmissions: int | None = None) -> Codes:
    """Return codes of 1 and −1 from a Hadamard matrix, for ``Echoes`` and ``simulate_echoes``.

    All elements emit at full scale in every transmission.

    Parameters
    ----------
    elements : number of elements E, 1 to 4096.
    transmissions : number of transmissions M, from 1 to the smallest power of 2 that is at least E,
        which is the default. With the default, the codes of all elements are orthogonal. The
        response to a single element is then the mean over the transmissions of the received
        pressure times the element's code, and its noise is as low as if this element alone had
        emitted M times. With fewer transmissions, the codes are not orthogonal, and this mean also
        contains responses to other elements.

    Returns
    -------
    (E, M) amplitude of each element in each transmission, 1 or −1, as complex numbers.

    Raises
    ------
    InvalidInput
        If ``elements`` or ``transmissions`` is outside its range.
    """
    # Sylvester's construction needs a power of 2; rows beyond the elements are dropped.
    size = 1 << (_count(elements, "elements") - 1).bit_length()
    count = size if transmissions is None else _count(transmissions, "transmissions", size)
    return hadamard(size)[:elements, :count].astype(np.complex128)


def random_codes(
    elements: int,
    transmissions: int,
    seed: int = 0,
) -> Codes:
    """Return codes with random phases, for ``Echoes`` and ``simulate_echoes``.

    All elements emit at full scale in every transmission, with independent phases that are uniform
    over 2π. Unlike ``hadamard_codes``, they are not orthogonal. They suit few transmissions.

    Parameters
    ----------
    elements, transmissions : number of elements E and of transmissions M, each 1 to 4096.
    seed : seed of the random numbers, an integer of at least 0; 0 by default.

    Returns
    -------
    (E, M) complex amplitude of each element in each transmission, of magnitude 1.

    Raises
    ------
    InvalidInput
        If ``elements``, ``transmissions`` or ``seed`` is outside its range.

    Examples
    --------
    >>> random_codes(996, 16).shape
    (996, 16)
    """
    shape = _count(elements, "elements"), _count(transmissions, "transmissions")
    check_seed(seed)
    return np.exp(2j * np.pi * np.random.default_rng(seed).random(shape))


def _count(count: int, name: str, largest: int = 4096) -> int:
    if not isinstance(count, int | np.integer) or not 1 <= count <= largest:
        raise InvalidInput(
            f"the number of {name} is {count!r}; use an integer from 1 to {largest}.",
            code="out_of_range",
        )
    return int(count)


def simulate_echoes(
    made_by: Solver | ScatteringMatrix,
    scene: Scene,
    array: PhasedArray,
    codes: Num[np.ndarray, "elements transmissions"],
    *,
    receivers: Integer[np.ndarray, "receivers"] | None = None,
    noise: float | None = None,
    seed: int = 0,
) -> Echoes:
    """Compute the echoes of coded transmissions, with measurement noise.

    All elements emit at the same time. The pressure received by an element is the mean of the
    scattered pressure over its face, multiplied by its gain; the direct sound is not included. The
    array itself does not reflect sound. ``locate`` takes the result.

    Parameters
    ----------
    made_by : a solver, which computes the field for each code; or the ``ScatteringMatrix`` of the
        scene, with which the computation only takes milliseconds.
    scene : the bodies, without planes and reflecting boards.
    array : the E transducers in the frame of the bodies; see ``PhasedArray.seen_from``.
    codes : (E, M) complex amplitude that each element emits in each of M transmissions, of
        magnitude at most 1 (full scale), such as ``random_codes``.
    receivers : (R,) indices of the receiving elements; by default all elements.
    noise : signal-to-noise ratio [dB], -300 to 300: the rms of the echoes relative to the rms
        magnitude of the added complex noise. None adds no noise.
    seed : seed of the noise, an integer of at least 0.

    Returns
    -------
    ``Echoes`` with the codes, the scattered pressures (R, M) at the receivers [Pa] and the rms of
    the noise [Pa].

    Raises
    ------
    InvalidInput
        If the number of rows of codes differs from the number of elements, if a code exceeds full
        scale, or if a transmission is silent. If a receiver does not exist or is listed twice. If
        elements overlap each other or a body, or, with a scattering matrix, are inside the ball
        around the bodies. If the scattering matrix belongs to another scene, or the solver does not
        support the scene. If ``noise`` or ``seed`` is outside its range.
    NotConverged
        If ``made_by`` stops before it converges.

    Examples
    --------
    >>> import airtact as at
    >>> scene = at.Scene(at.air(celsius=20.0), [at.sound_hard(at.sphere(radius=5e-3, edge=2e-3))])
    >>> array = at.autd3_board(at.Pose(np.eye(3), np.array([0, 0, -0.15])))
    >>> solver = at.BoundaryElement(accuracy=0.05, estimate=False)
    >>> simulate_echoes(solver, scene, array, random_codes(249, 4), noise=20.0)
    Echoes(249 elements, 4 transmissions, 249 receivers, 40000 Hz)
    """
    of_kind(made_by, Solver | ScatteringMatrix, "made_by", "a solver or a scattering matrix")
    check_placement(scene, array)
    if len(shaped(codes, (-1, -1), "codes")) != len(array):
        raise InvalidInput(
            f"the codes are for {len(codes)} elements, but the array has {len(array)}; use one "
            "row of codes for each element.",
            code="sizes_differ",
        )
    check_seed(seed)
    count = len(array) if receivers is None else len(receivers)
    # Echoes checks the codes and receivers before anything is solved.
    checked = Echoes(codes, np.zeros((count, codes.shape[1])), receivers)
    drives = np.asarray(checked.codes)
    receiving = checked.receiving
    if isinstance(made_by, ScatteringMatrix):
        check_own(made_by, scene)
        pressures = EchoModel.of(made_by, array, drives, receiving).echoes(np.zeros(6))
    else:
        check_no_planes(scene, "a simulation of echoes")
        faces = array.face_points.reshape(-1, 3)
        weights = array.element.weights
        gains = (array.element.sensitivity * array.gains)[:, None, None] * weights[:, None]
        strengths = (gains * drives[:, None, :]).reshape(-1, drives.shape[1])
        scattered = made_by.radiate(scene, Monopoles(faces, strengths)).scattered_at(faces)
        # By reciprocity an element receives with the same weights with which it emits.
        over_faces = scattered.reshape(len(array), len(weights), -1)
        received = array.gains[:, None] * np.einsum("q,rqm->rm", weights, over_faces)
        pressures = received[receiving]
    pressures, deviation = noisy(pressures, noise, seed)
    return Echoes(drives, pressures, receiving, scene.frequency, deviation)


def noisy(
    pressures: Num[np.ndarray, "receivers transmissions"], decibels: float | None, seed: int
) -> tuple[Complex128[np.ndarray, "receivers transmissions"], float | None]:
    """Add Gaussian noise to pressures; return the noisy pressures and the rms noise [Pa].

    The rms noise is ``decibels`` dB below the rms pressure. If ``decibels`` is None, no noise is
    added and the rms noise is None.
    """
    pressures = pressures.astype(np.complex128)
    if decibels is None:
        return pressures, None
    slip = "it is the ratio of the echoes to the noise."
    decibels = between(decibels, -300.0, 300.0, "the noise", "dB", slip)
    deviation = 10.0 ** (-decibels / 20.0) * float(np.sqrt(np.mean(np.abs(pressures) ** 2)))
    parts = np.random.default_rng(seed).normal(size=(2, *pressures.shape)) / np.sqrt(2.0)
    return pressures + deviation * (parts[0] + 1j * parts[1]), deviation
