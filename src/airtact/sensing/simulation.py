"""Codes, and simulated echoes of coded transmissions with the faults of a measurement."""

import numpy as np
from jaxtyping import Bool, Complex128, Float64, Integer, Num
from scipy.linalg import hadamard
from scipy.spatial.distance import cdist

from airtact.acoustics.scene import Scene, check_no_planes
from airtact.acoustics.solvers.problem import Solver
from airtact.acoustics.sources import Monopoles
from airtact.errors import InvalidInput, between, check_seed, of_kind
from airtact.sensing.echo_model import array_waves
from airtact.sensing.echoes import Codes, Echoes, check_numbers
from airtact.sensing.scattering import ScatteringMatrix, check_own
from airtact.transducers.layout import PhasedArray
from airtact.transducers.placement import check_placement


def single_codes(elements: int) -> Codes:
    """One element alone in each of E transmissions, (E, E): the identity.

    Raises
    ------
    InvalidInput
        "out_of_range": of elements.
    """
    return np.eye(_count(elements, "elements"), dtype=np.complex128)


def hadamard_codes(elements: int, transmissions: int | None = None) -> Codes:
    """Signs from the rows of a Hadamard matrix; all elements emit in every transmission.

    Parameters
    ----------
    elements : E.
    transmissions : M, from 1 to the next power of 2 at or above E, which is taken unless given;
        with that many, each element's part can be separated, at the noise of E transmissions of it
        alone.

    Returns
    -------
    (E, M) codes of 1 and −1.

    Raises
    ------
    InvalidInput
        "out_of_range": of elements or transmissions.
    """
    # Sylvester's construction needs a power of 2; rows beyond the elements are left out.
    size = 1 << (_count(elements, "elements") - 1).bit_length()
    count = size if transmissions is None else _count(transmissions, "transmissions", size)
    return hadamard(size)[:elements, :count].astype(np.complex128)


def random_codes(
    elements: int,
    transmissions: int,
    seed: int = 0,
    parts: Integer[np.ndarray, "elements"] | None = None,
) -> Codes:
    """All elements at full scale with random phases, the same for the same seed.

    Parameters
    ----------
    elements, transmissions : E and M.
    seed : of the random numbers, 0 or more.
    parts : (E,) number of the part that each element belongs to, such as its board: the parts emit
        in turn, one in each transmission, and the others can receive while it rings. All emit
        together unless given.

    Returns
    -------
    (E, M) codes of magnitude 1, or 0 where a part is silent.

    Raises
    ------
    InvalidInput
        "out_of_range": of elements, transmissions or seed; "sizes_differ": not one part for each
        element.

    Examples
    --------
    >>> random_codes(996, 16).shape
    (996, 16)
    """
    shape = _count(elements, "elements"), _count(transmissions, "transmissions")
    check_seed(seed)
    codes = np.exp(2j * np.pi * np.random.default_rng(seed).random(shape))
    if parts is None:
        return codes
    if len(parts) != elements:
        raise InvalidInput(
            f"{len(parts)} parts are given for {elements} elements; give one each.",
            code="sizes_differ",
        )
    names = np.unique(parts)
    emitting = names[np.arange(transmissions) % len(names)]
    return np.where(np.asarray(parts)[:, None] == emitting, codes, 0.0)


def _count(count: int, name: str, largest: int = 4096) -> int:
    if not isinstance(count, int | np.integer) or not 1 <= count <= largest:
        raise InvalidInput(
            f"codes need a whole number of {name} from 1 to {largest}, not {count!r}.",
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
    subtraction: float | None = None,
    dead: Integer[np.ndarray, "dead"] | None = None,
    ring_down: float | None = None,
    seed: int = 0,
) -> Echoes:
    """Compute the echoes of coded transmissions, with the faults of a measurement.

    An element receives the mean of the scattered pressure over its face, times its gain. The array
    reflects nothing.

    Parameters
    ----------
    made_by : a solver, which solves for each code, or the scattering matrix of the scene, which
        takes milliseconds.
    scene : the bodies.
    array : the E transducers in the obstacles' frame, see ``PhasedArray.seen_from``.
    codes : (E, M), as of ``Echoes``.
    receivers : numbers of the elements that receive; all of them unless given.
    noise : rms of the echoes over that of added complex noise [dB]; none unless given.
    subtraction : how far the sound that arrives directly from each other element is suppressed
        [dB], the rest having a random phase; perfectly unless given.
    dead : numbers of elements that receive noise only.
    ring_down : time from the beginning of a transmission until an element that emits in it can
        receive [s]: where its first echo comes sooner, the pressure is not ``Echoes.valid``. At
        once unless given.
    seed : of the random numbers, 0 or more.

    Raises
    ------
    InvalidInput
        As ``Echoes`` and ``transfer_matrix``; "bodies_overlap"; "sizes_differ": codes of another
        array; "does_not_match": the scattering matrix is of another scene; "out_of_range": noise,
        subtraction, dead, ring_down or seed; "link_failed": all elements ring when the echoes come.

    Examples
    --------
    >>> import airtact as at
    >>> scene = at.Scene(at.air(celsius=20.0), [at.sound_hard(at.sphere(radius=5e-3, edge=2e-3))])
    >>> array = at.autd3_board(at.Pose(np.eye(3), np.array([0, 0, -0.15])))
    >>> solver = at.BoundaryElement(accuracy=0.05, estimate=False)
    >>> simulate_echoes(solver, scene, array, random_codes(249, 4), noise=20.0)
    Echoes(249 elements, 4 transmissions, 249 receivers, 40000 Hz)
    """
    solvers = Solver | ScatteringMatrix
    of_kind(made_by, solvers, "what echoes are made by", "a solver or a scattering matrix")
    check_placement(scene, array)
    if len(codes) != len(array):
        raise InvalidInput(
            f"the codes are for {len(codes)} elements, and the array has {len(array)}.",
            code="sizes_differ",
        )
    check_seed(seed)
    count = len(array) if receivers is None else len(receivers)
    # Echoes checks codes and receivers before anything is solved.
    checked = Echoes(codes, np.zeros((count, codes.shape[1])), receivers)
    drives = np.asarray(checked.codes)
    receiving = checked.receiving
    if isinstance(made_by, ScatteringMatrix):
        check_own(made_by, scene)
        pressures = array_waves(made_by, array, made_by.order).echo(made_by, drives)
    else:
        pressures = _solved_echoes(made_by, scene, array, drives)
    pressures = pressures[receiving]
    valid = None
    received = pressures
    if ring_down is not None:
        valid = _received_after(ring_down, scene, array, drives)[receiving]
        received = pressures[valid]
    rms = float(np.linalg.norm(received) / np.sqrt(max(received.size, 1)))
    random = np.random.default_rng(seed)
    if subtraction is not None:
        rest = ratio_of(subtraction, "the subtraction of direct sound")
        direct = rest * direct_sound(array, scene.wavenumber, drives)
        pressures = pressures + direct[receiving] * normal_noise(random, pressures.shape)
    if dead is not None:
        check_numbers(np.asarray(dead), len(array), "the dead element")
        pressures[np.isin(receiving, dead)] = 0.0
    deviation = None if noise is None else rms * ratio_of(noise, "the noise")
    pressures += (deviation or 0.0) * normal_noise(random, pressures.shape)
    return Echoes(drives, pressures, receiving, scene.frequency, deviation, valid)


def _received_after(
    ring_down: float, scene: Scene, array: PhasedArray, codes: Codes
) -> Bool[np.ndarray, "elements transmissions"]:
    """Whether an element is silent in a transmission, or has rung down before its echo."""
    slip = "is it in milliseconds? Give seconds."
    ring_down = between(ring_down, 0.0, 1.0, "the ring-down", "s", slip)
    # The path to the bodies and back is that to their nearest corner, from the nearest emitter.
    corners = [body.surface.corners.reshape(-1, 3) for body in scene.obstacles]
    away = cdist(array.positions, np.unique(np.concatenate(corners), axis=0))
    emits = codes != 0
    paths = [(away + away[emitting].min(axis=0)).min(axis=1) for emitting in emits.T]
    return ~emits | (np.stack(paths, axis=1) >= ring_down * scene.medium.sound_speed)


def _solved_echoes(solver: Solver, scene: Scene, array: PhasedArray, codes: Codes) -> Codes:
    """Scattered pressure that each element receives [Pa], by a solve for each code."""
    check_no_planes(scene, "a simulation of echoes")
    faces = array.face_points.reshape(-1, 3)
    weights = array.element.weights
    gains = (array.element.sensitivity * array.gains)[:, None, None] * weights[:, None]
    strengths = (gains * codes[:, None, :]).reshape(-1, codes.shape[1])
    # By reciprocity an element receives with the weights that it emits with.
    scattered = solver.radiate(scene, Monopoles(faces, strengths)).scattered_at(faces)
    over_faces = scattered.reshape(len(array), len(weights), -1)
    return array.gains[:, None] * np.einsum("q,rqm->rm", weights, over_faces)


def direct_sound(
    array: PhasedArray, wavenumber: complex, codes: Codes
) -> Float64[np.ndarray, "elements transmissions"]:
    """Root of the summed squares of the pressures [Pa] that each element receives from all others.

    In open air, each by its distance and the far patterns of both elements. An element with a front
    neither emits nor receives behind its face; neighbours in the plane of its face count as at 90
    degrees.
    """
    offsets = array.positions[:, None, :] - array.positions[None, :, :]
    distance = np.linalg.norm(offsets, axis=-1)
    np.fill_diagonal(distance, 1.0)
    # Powers are summed, as the phases of what subtraction leaves are random.
    power = np.exp(-2 * wavenumber.imag * distance) / distance**2
    np.fill_diagonal(power, 0.0)
    if array.element.directional:
        angles = np.radians(np.arange(91.0))
        along = np.stack([np.sin(angles), 0 * angles, np.cos(angles)], axis=1)
        pattern = np.abs(array.element.far_pattern(along, wavenumber.real)) ** 2
        # Emitters by their angle to the receiver, receivers by theirs to the emitter.
        for cosine in (
            np.einsum("red,ed->re", offsets, array.normals) / distance,
            np.einsum("red,rd->re", -offsets, array.normals) / distance,
        ):
            towards = np.interp(cosine, np.cos(angles[::-1]), pattern[::-1])
            power *= np.where(cosine < -1e-9, 0.0, towards)
    gains = np.abs(array.gains) ** 2
    power *= array.element.sensitivity**2 * gains[:, None] * gains
    return np.sqrt(power @ np.abs(codes) ** 2)


def ratio_of(decibels: float, name: str) -> float:
    """Amplitude ratio of a disturbance to the echoes, from their distance in decibels."""
    slip = "it is how far the echoes, or the direct sound, stand above the rest."
    return 10.0 ** (-between(decibels, -300.0, 300.0, name, "dB", slip) / 20.0)


def normal_noise(
    random: np.random.Generator, shape: tuple[int, ...]
) -> Complex128[np.ndarray, "receivers transmissions"]:
    """Complex normal numbers of unit mean square."""
    return (random.normal(size=shape) + 1j * random.normal(size=shape)) / np.sqrt(2.0)
