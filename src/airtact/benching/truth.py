"""What the elements of an array really do to foci beside capsules, kept on disk, for a fit takes a minute."""

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Complex128, Real

from airtact.benching.fundamental_solutions import fitted, pressure_at
from airtact.benching.scenes import Bodies
from airtact.printing import in_short

FINENESS = 3.0
"""Monopoles per depth of the fit: three are 0.1 % off beside the two fingers."""


@dataclass(frozen=True, eq=False)
class Truth:
    """Pressure by fundamental solutions.

    Attributes
    ----------
    pressure : (P, N) of unit monopoles or (P, S) of sounds [Pa].
    own_error : its own relative error, as it estimates it.
    """

    pressure: Complex128[np.ndarray, "points sounds"]
    own_error: float

    __repr__ = in_short


def true_pressure(
    bodies: Bodies,
    sources: Real[np.ndarray, "sources 3"],
    points: Real[np.ndarray, "points 3"],
    folder: Path,
    spoken: Complex128[np.ndarray, "sources sounds"] | None = None,
) -> Truth:
    """Pressure at points of unit monopoles beside capsules, or of sounds that they make together.

    Parameters
    ----------
    bodies : capsules.
    sources, points : (N, 3) far from the skins, and (P, 3) anywhere outside [m].
    folder : where truths are kept.
    spoken : (N, S) strengths [Pa·m] of S sounds, if not each source is one.
    """
    wavenumber = bodies.scene.wavenumber
    digest = hashlib.sha256(str([(c.radius, c.length, wavenumber, FINENESS) for c in bodies.capsules]).encode())
    poses = [part for one in bodies.capsules for part in (one.pose.rotation, one.pose.translation)]
    for array in (*poses, sources, points, *([] if spoken is None else [spoken])):
        digest.update(np.ascontiguousarray(array).tobytes())
    file = folder / f"truth-{digest.hexdigest()[:16]}.npz"
    if not file.exists():
        if spoken is None:
            pressure, own = pressure_at(bodies.capsules, wavenumber, sources, points, fineness=FINENESS)
        else:
            fits = [fitted(bodies.capsules, wavenumber, sources, f, spoken) for f in (FINENESS / 1.25, FINENESS)]
            coarse, pressure = (fit.pressure(points) for fit in fits)
            own = float(np.linalg.norm(pressure - coarse) / np.linalg.norm(pressure))
        folder.mkdir(parents=True, exist_ok=True)
        np.savez(file, pressure=pressure, own_error=own)
    with np.load(file) as kept:
        return Truth(kept["pressure"], float(kept["own_error"]))
