"""Echoes as a receiving array would measure them, from any solver: with noise, direct sound and dead receivers."""

import numpy as np
from jaxtyping import Bool, Complex128, Int64, Integer, Num
from scipy.spatial.distance import cdist

from airtact.acoustics.scene import Scene, check_no_planes
from airtact.acoustics.solvers.problem import Solver
from airtact.acoustics.sources import Monopoles
from airtact.checks import between, check_seed, of_kind
from airtact.errors import InvalidInput
from airtact.sensing.array_waves import array_waves, direct_sound, emitted_by_faces, heard_by_faces
from airtact.sensing.echoes import Echoes
from airtact.sensing.scattering import ScatteringMatrix, check_own
from airtact.transducers.layout import PhasedArray
from airtact.transducers.placement import check_placement

LARGEST_RATIO = 300.0
"""Largest ratio in decibels."""


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
    """Compute the echoes of coded transmissions, and spoil them as a measurement is spoilt.

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
        As ``Echoes`` and ``transfer_matrix``; "bodies_overlap"; "sizes_differ": codes of another array;
        "does_not_match": the scattering matrix is of another scene; "out_of_range": of noise, subtraction, dead, ring_down
        or seed; "link_failed": all elements ring when the echoes come.

    Examples
    --------
    >>> import airtact as at
    >>> scene = at.Scene(at.air(celsius=20.0), [at.sound_hard(at.sphere(radius=5e-3, edge=2e-3))])
    >>> array, codes = at.autd3_board(at.Pose(np.eye(3), np.array([0, 0, -0.15]))), at.sensing.random_codes(249, 4)
    >>> simulate_echoes(at.BoundaryElement(accuracy=0.05, estimate=False), scene, array, codes, noise=20.0)
    Echoes(249 elements, 4 transmissions, 249 receivers, 40000 Hz)
    """
    of_kind(
        made_by,
        Solver | ScatteringMatrix,
        "what echoes are made by",
        "a solver or a scattering matrix",
    )
    check_placement(scene, array)
    given, receiving = _checked(array, codes, receivers, seed)
    pressures = _scattered(made_by, scene, array, given)[receiving]
    valid = None if ring_down is None else received_after(ring_down, scene, array, given)[receiving]
    random, size = np.random.default_rng(seed), _rms(pressures, valid)
    if subtraction is not None:
        rest = ratio_of(subtraction, "the subtraction of direct sound") * direct_sound(
            array, scene.wavenumber, given
        )
        pressures = pressures + rest[receiving] * normal_noise(random, pressures.shape)
    pressures[np.isin(receiving, _dead(dead, len(array)))] = 0.0
    deviation = None if noise is None else size * ratio_of(noise, "the noise")
    pressures += (deviation or 0.0) * normal_noise(random, pressures.shape)
    return Echoes(given, pressures, receiving, scene.frequency, deviation, valid)


def received_after(
    ring_down: float,
    scene: Scene,
    array: PhasedArray,
    codes: Complex128[np.ndarray, "elements transmissions"],
) -> Bool[np.ndarray, "elements transmissions"]:
    """Whether an element is silent in a transmission, or its first echo comes after it has rung down, (E, M)."""
    ring_down = between(
        ring_down, 0.0, 1.0, "the ring-down", "s", "is it in milliseconds? Give seconds."
    )
    corners = np.unique(
        np.concatenate([one.surface.corners.reshape(-1, 3) for one in scene.obstacles]), axis=0
    )
    away = cdist(array.positions, corners)
    emits = codes != 0
    first = np.stack([(away + away[some].min(axis=0)).min(axis=1) for some in emits.T], axis=1)
    return ~emits | (first >= ring_down * scene.medium.sound_speed)


def _rms(
    pressures: Complex128[np.ndarray, "receivers transmissions"],
    valid: Bool[np.ndarray, "receivers transmissions"] | None,
) -> float:
    some = pressures if valid is None else pressures[valid]
    return float(np.linalg.norm(some) / np.sqrt(max(some.size, 1)))


def _checked(
    array: PhasedArray,
    codes: Num[np.ndarray, "elements transmissions"],
    receivers: Integer[np.ndarray, "receivers"] | None,
    seed: int,
) -> tuple[Complex128[np.ndarray, "elements transmissions"], Int64[np.ndarray, "receivers"]]:
    """Return the codes and the numbers of the receivers, checked."""
    if len(codes) != len(array):
        raise InvalidInput(
            f"the codes are for {len(codes)} elements, and the array has {len(array)}.",
            code="sizes_differ",
        )
    check_seed(seed)
    count = len(array) if receivers is None else len(receivers)
    checked = Echoes(codes, np.zeros((count, codes.shape[1])), receivers)
    return np.asarray(checked.codes), checked.receiving


def _scattered(
    made_by: Solver | ScatteringMatrix,
    scene: Scene,
    array: PhasedArray,
    codes: Complex128[np.ndarray, "elements transmissions"],
) -> Complex128[np.ndarray, "elements transmissions"]:
    """Scattered pressure that each element receives [Pa]."""
    if isinstance(made_by, ScatteringMatrix):
        check_own(made_by, scene)
        return array_waves(made_by, array, made_by.order).echo(made_by, codes)
    faces = array.face_points.reshape(-1, 3)
    check_no_planes(scene, "a simulation of echoes")
    field = made_by.radiate(scene, Monopoles(faces, emitted_by_faces(array, codes)))
    return heard_by_faces(array, np.arange(len(array)), field.scattered_at(faces))


def ratio_of(decibels: float, what: str) -> float:
    """Amplitude of the rest relative to that of echoes so many decibels above it."""
    slip = "it is how far the echoes, or the direct sound, stand above the rest."
    return 10.0 ** (-between(decibels, -LARGEST_RATIO, LARGEST_RATIO, what, "dB", slip) / 20.0)


def normal_noise(
    random: np.random.Generator, shape: tuple[int, ...]
) -> Complex128[np.ndarray, "receivers transmissions"]:
    """Complex normal numbers of unit mean square."""
    return (random.normal(size=shape) + 1j * random.normal(size=shape)) / np.sqrt(2.0)


def _dead(given: Integer[np.ndarray, "dead"] | None, elements: int) -> Integer[np.ndarray, "dead"]:
    numbers = np.zeros(0, dtype=np.int64) if given is None else np.asarray(given)
    wrong = numbers[(numbers < 0) | (numbers >= elements)]
    if len(wrong):
        raise InvalidInput(
            f"the dead element {wrong[0]} is none of {elements}: 0 to {elements - 1}.",
            code="out_of_range",
        )
    return numbers
