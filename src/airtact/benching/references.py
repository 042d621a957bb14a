"""Reference pressures for the bodies of benchmarks, kept in files because they take up to a minute each."""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Complex128, Num, Real

from airtact.benching.scenes import Bodies
from airtact.evaluation.fundamental_solutions import pressure_at
from airtact.printing import in_short


@dataclass(frozen=True, eq=False)
class Reference:
    """Reference pressure [Pa], for bodies without a closed form, and its estimated relative error."""

    pressure: Complex128[np.ndarray, "points excitations"]
    own_error: float

    __repr__ = in_short


def reference_pressure(
    bodies: Bodies,
    sources: Real[np.ndarray, "sources 3"],
    points: Real[np.ndarray, "points 3"],
    folder: Path,
) -> Reference:
    """Return the pressure of unit monopoles beside capsules, read from ``folder`` if it is there.

    The sources are far from the surfaces, the points anywhere outside [m].
    """
    wavenumber, capsules = bodies.scene.wavenumber, bodies.capsules
    settings = str([(c.radius, c.length, wavenumber, 3.0) for c in capsules])
    poses = [part for one in capsules for part in (one.pose.rotation, one.pose.translation)]
    return cached_reference(
        folder,
        settings,
        (*poses, sources, points),
        lambda: Reference(*pressure_at(capsules, wavenumber, sources, points)),
    )


def cached_reference(
    folder: Path,
    settings: str,
    arrays: Sequence[Num[np.ndarray, "..."]],
    compute: Callable[[], Reference],
) -> Reference:
    """Read a reference from a folder, or compute and write it; its file is named by its settings and arrays."""
    digest = hashlib.sha256(settings.encode())
    for array in arrays:
        digest.update(np.ascontiguousarray(array).tobytes())
    file = folder / f"reference-{digest.hexdigest()[:16]}.npz"
    if not file.exists():
        made = compute()
        folder.mkdir(parents=True, exist_ok=True)
        np.savez(file, pressure=made.pressure, own_error=made.own_error)
    with np.load(file) as cached:
        return Reference(cached["pressure"], float(cached["own_error"]))
