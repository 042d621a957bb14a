"""Transfer matrices of a rigid hand in given poses, as an ensemble computes those of its samples."""

from collections.abc import Iterable, Iterator

import numpy as np

import airtact as at
from airtact.acoustics.uncertainty import Draw
from airtact.drives.transfer_ensemble import _Sampler


def matrices_at(
    beacons: at.acoustics.RadiatedField,
    array: at.PhasedArray,
    poses: Iterable[at.Pose],
    slower: float = 1.0,
    solver: at.acoustics.Solver | None = None,
) -> Iterator[np.ndarray | None]:
    """Yield the (F, E) transfer matrix [Pa] for each pose, with the wavenumber times ``slower``.

    None is yielded for impossible poses. In front of a plane, ``solver`` computes a new solution
    for each pose that changes the hand's position relative to the plane.
    """
    nominal = at.transfer_matrix(beacons, array).matrix
    sampler = _Sampler.of(beacons, array, nominal, at.Uncertainty(), solver)
    still = (at.Pose.identity(),) * len(sampler.groups)
    unshifted = np.zeros((len(beacons.sources.positions), 2))
    return sampler.matrices(Draw(pose, still, unshifted, slower) for pose in poses)
