"""Transmission codes, and simulated echoes of coded transmissions with noise."""

import numpy as np
from jaxtyping import Complex128, Integer, Num
from scipy.linalg import hadamard

from airtact.acoustics.scene import Scene, check_no_planes
from airtact.acoustics.solvers.problem import Solver
from airtact.acoustics.sources import Monopoles
from airtact.errors import InvalidInput, between, check_seed, of_kind
from airtact.sensing.echo_model import EchoModel
from airtact.sensing.echoes import Codes, Echoes
from airtact.sensing.scattering import ScatteringMatrix, check_own
from airtact.transducers.layout import PhasedArray
from airtact.transducers.placement import check_placement


def hadamard_codes(elements: int, transmissions: int | None = None) -> Codes:
    """Return the signs of a Hadamard matrix as codes; all elements emit in every transmission.

    Parameters
    ----------
    elements : number of elements E.
    transmissions : number of transmissions M. The default and maximum is the smallest power of 2
        that is at least E. With this number the elements can be separated, and the noise is as low
        as if each element emitted alone E times.

    Returns
    -------
    (E, M) codes of 1 and −1.

    Raises
    ------
    InvalidInput
        If ``elements`` or ``transmissions`` is out of range.
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
    """Return codes of random phases at full scale for all elements.

    Parameters
    ----------
    elements, transmissions : number of elements E and of transmissions M.
    seed : seed of the random numbers, 0 or more.

    Returns
    -------
    (E, M) codes of magnitude 1.

    Raises
    ------
    InvalidInput
        If ``elements``, ``transmissions`` or ``seed`` is out of range.

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

    An element receives the mean scattered pressure over its face, times its gain. The array itself
    does not reflect sound.

    Parameters
    ----------
    made_by : a solver, which solves for each code; or the scattering matrix of the scene, which
        reduces the computation to milliseconds.
    scene : the bodies.
    array : the E transducers in the obstacles' frame; see ``PhasedArray.seen_from``.
    codes : (E, M) codes, as in ``Echoes``.
    receivers : indices of the receiving elements; by default all elements.
    noise : signal-to-noise ratio, the rms of the echoes relative to the rms of the added complex
        noise [dB]. None adds no noise.
    seed : seed of the random numbers, 0 or more.

    Returns
    -------
    The codes and the scattered pressures (R, M) at the receivers [Pa].

    Raises
    ------
    InvalidInput
        Under the conditions listed in ``Echoes`` and ``transfer_matrix``, if an element is inside
        the ball around the bodies, if the codes belong to another array, if the scattering matrix
        belongs to another scene, or if ``noise`` or ``seed`` is out of range.

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
    of_kind(made_by, solvers, "made_by", "a solver or a scattering matrix")
    check_placement(scene, array)
    if len(codes) != len(array):
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
        pressures = EchoModel.of(made_by, array, drives, receiving).echoes()
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
    deviation = None
    if noise is not None:
        pressures, deviation = noisy(pressures, noise, seed)
    return Echoes(drives, pressures, receiving, scene.frequency, deviation)


def noisy(
    pressures: Num[np.ndarray, "receivers transmissions"], decibels: float, seed: int
) -> tuple[Complex128[np.ndarray, "receivers transmissions"], float]:
    """Add normal noise ``decibels`` below the pressures; return the sum and the rms noise [Pa]."""
    decibels = between(
        decibels, -300.0, 300.0, "the noise", "dB", "it is the ratio of the echoes to the noise."
    )
    deviation = 10.0 ** (-decibels / 20.0) * float(np.sqrt(np.mean(np.abs(pressures) ** 2)))
    random = np.random.default_rng(seed)
    parts = random.normal(size=(2, *pressures.shape)) / np.sqrt(2.0)
    return pressures + deviation * (parts[0] + 1j * parts[1]), deviation
