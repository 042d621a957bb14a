"""What a pose of the bodies leaves unexplained of echoes, receiver by receiver."""

import numpy as np
from jaxtyping import Float64

from airtact.geometry.pose import Pose
from airtact.sensing.array_waves import array_waves
from airtact.sensing.echoes import Echoes, check_elements
from airtact.sensing.scattering import ScatteringMatrix
from airtact.transducers.layout import PhasedArray


def unexplained(
    echoes: Echoes, scattering: ScatteringMatrix, array: PhasedArray, pose: Pose
) -> Float64[np.ndarray, "receivers"]:
    """Return what the model leaves unexplained at each receiver, noise included, over the rms of all echoes.

    Parameters
    ----------
    echoes : measured, less what the empty array receives.
    scattering : of the bodies.
    array : the transducers in their own frame, in the order of the codes.
    pose : of the bodies, from their frame to the array's, such as ``Located.pose``.

    Returns
    -------
    (R,) root mean square over the transmissions; NaN where a receiver received none. About 1.4 everywhere for a pose
    that explains nothing, and the share of noise for one that explains all.

    Raises
    ------
    InvalidInput
        "sizes_differ": echoes of another array; "bodies_overlap": an element stands among the bodies.

    Examples
    --------
    >>> import airtact as at
    >>> scene = at.Scene(at.air(celsius=20.0), [at.sound_hard(at.sphere(radius=5e-3, edge=2e-3))])
    >>> array, codes = at.surrounding_box(), at.sensing.random_codes(996, 4)
    >>> scattering = at.scattering_matrix(at.SphereSeries(), scene)
    >>> echoes = at.simulate_echoes(scattering, scene, array, codes, noise=40.0)
    >>> bool(unexplained(echoes, scattering, array, at.Pose.identity()).max() < 0.03)
    True
    """
    check_elements(echoes, array, "echoes")
    waves = array_waves(scattering, array.seen_from(pose), scattering.order)
    expected = waves.echo(scattering, np.asarray(echoes.codes))[echoes.receiving]
    received = (
        np.ones(expected.shape, dtype=bool) if echoes.valid is None else np.asarray(echoes.valid)
    )
    pressures = np.asarray(echoes.pressures)
    off = np.sum(np.abs(np.where(received, pressures - expected, 0.0)) ** 2, axis=1)
    count = received.sum(axis=1)
    mean = np.divide(off, count, out=np.full(len(off), np.nan), where=count > 0)
    return np.sqrt(mean / np.mean(np.abs(pressures[received]) ** 2))
