"""Sound-hard capsules and spheres by fundamental solutions: a reference that shares no code with the solvers.

The scattered field is a sum of monopoles inside the bodies, fitted by least squares to ∂p/∂n = 0 at
more points of the surface (G. Fairweather, A. Karageorghis, P. A. Martin, Eng. Anal. Bound. Elem.
27, 759, 2003). The error falls fast in depth over spacing as long as the monopoles lie outside the
images of the other body, which for a gap d stand a (1 - e^{-μ}) deep, cosh μ = 1 + d/(2a). So depth
and spacing follow the gap along the surface: fine where bodies come close, coarse elsewhere. The
estimate of its own error comes from a second, coarser fit and from the residual at surface points
that were not fitted.
"""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Complex128, Float64, Int64, Num, Real

from airtact.benching.scenes import Bodies
from airtact.geometry.primitives import Capsule
from airtact.printing import in_short

DEPTH_OF_IMAGES = 0.75  # share of the images' depth at which the monopoles stand
KEPT_DIGITS = 2.5  # decimal digits that the highest azimuthal order that matters may lose on its way to the surface
MOST_MONOPOLES = 4000
FINENESS = 3.0  # monopoles per depth of the fit: three are 0.1 % off beside the two fingers


def pressure_at(
    capsules: Sequence[Capsule],
    wavenumber: complex,
    sources: Real[np.ndarray, "sources 3"],
    receivers: Real[np.ndarray, "receivers 3"],
    wanted: float = 3e-3,
    fineness: float = FINENESS,
) -> tuple[Complex128[np.ndarray, "receivers sources"], float]:
    """Total pressure [Pa] of unit monopoles e^{ikr}/r beside sound-hard capsules (of length 0: spheres) apart.

    By reciprocity the set of points [m] farther from the surfaces becomes the sources, so one of
    the two may touch a surface; the other keeps some centimetres away. From ``fineness`` monopoles
    per depth on, the fit is refined until the estimated error at the worst of the closer points,
    over all the others, is the ``wanted`` one: the relative change from a coarser fit times the
    fraction to which the residual ∂p/∂n at surface points that were not fitted has fallen, but at
    least a tenth of that residual. It is returned too.
    """
    sources_off, receivers_off = (
        min(-capsule.depth(points).max() for capsule in capsules) for points in (sources, receivers)
    )
    if sources_off < receivers_off:
        pressure, error = pressure_at(capsules, wavenumber, receivers, sources, wanted, fineness)
        return pressure.T, error
    coarse = fitted(capsules, wavenumber, sources, fineness / 1.25)
    while True:
        fit = fitted(capsules, wavenumber, sources, fineness)
        pressure, residual = fit.pressure(receivers), fit.residual()
        change = pressure - coarse.pressure(receivers)
        change = float(np.max(np.linalg.norm(change, axis=1) / np.linalg.norm(pressure, axis=1)))
        error = max(change * min(1.0, residual / coarse.residual()), 0.1 * residual)
        if error < wanted or 1.5 * len(fit.monopoles) > MOST_MONOPOLES:
            return pressure, error
        coarse, fineness = fit, 1.25 * fineness


def superposed(
    unit: Complex128[np.ndarray, "points sources"],
    strengths: Complex128[np.ndarray, "sources excitations"] | None,
) -> Complex128[np.ndarray, "points excitations"]:
    """Sum the fields of unit sources by their strengths, or return them alone."""
    return unit if strengths is None else unit @ strengths


def waves(
    points: Real[np.ndarray, "points 3"],
    sources: Real[np.ndarray, "sources 3"],
    wavenumber: complex,
) -> Complex128[np.ndarray, "points sources"]:
    """e^{ikr}/r at (P, 3) points of (N, 3) sources: (P, N)."""
    distance = np.linalg.norm(points[:, None, :] - sources[None, :, :], axis=2)
    return np.exp(1j * wavenumber * distance) / distance


def normal_derivatives(
    points: Real[np.ndarray, "points 3"],
    normals: Real[np.ndarray, "points 3"],
    sources: Real[np.ndarray, "sources 3"],
    wavenumber: complex,
) -> Complex128[np.ndarray, "points sources"]:
    """Differentiate e^{ikr}/r along the normals at (P, 3) points: (P, N)."""
    square = np.zeros((len(points), len(sources)))
    along = np.zeros_like(square)
    for axis in range(3):
        offset = points[:, axis, None] - sources[:, axis]
        square += offset**2
        along += offset * normals[:, axis, None]
    distance = np.sqrt(square)
    return (
        (1j * wavenumber - 1.0 / distance) * np.exp(1j * wavenumber * distance) * (along / square)
    )


def surface_points(
    capsule: Capsule, number: int, start: float = 0.5
) -> tuple[Float64[np.ndarray, "points 3"], Float64[np.ndarray, "points 3"]]:
    """Spread points over a capsule by the golden angle (equal steps of z are equal areas), with their normals."""
    height = (capsule.length + 2.0 * capsule.radius) * ((np.arange(number) + start) / number - 0.5)
    azimuth = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(number)
    above = (
        np.sign(height) * np.maximum(np.abs(height) - capsule.length / 2.0, 0.0) / capsule.radius
    )
    flat = np.sqrt(1.0 - above**2)
    normals = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), above], axis=1)
    axis = np.stack([0.0 * height, 0.0 * height, height - above * capsule.radius], axis=1)
    return capsule.pose.apply(axis + capsule.radius * normals), capsule.pose.rotate(normals)


def monopole_depths(
    capsule: Capsule,
    others: Sequence[Capsule],
    points: Real[np.ndarray, "points 3"],
    wavenumber: complex,
) -> Float64[np.ndarray, "points"]:
    """Depth of the monopole under each surface point [m]."""
    share = np.full(
        len(points), 1.0 - 10.0 ** (-KEPT_DIGITS / (abs(wavenumber) * capsule.radius + 5.0))
    )
    for other in others:
        gap = np.maximum(-other.depth(points), 1e-6)
        images = 1.0 - np.exp(-np.arccosh(1.0 + gap / (2.0 * capsule.radius)))
        share = np.minimum(share, DEPTH_OF_IMAGES * images)
    return share * capsule.radius


def thinned(
    points: Real[np.ndarray, "points 3"], spacing: Float64[np.ndarray, "points"]
) -> Int64[np.ndarray, "chosen"]:
    """Choose a subset of points no two of which are closer than the spacing at the first of them."""
    from scipy.spatial import KDTree

    tree = KDTree(points)
    free = np.ones(len(points), dtype=bool)
    chosen = []
    for index in range(len(points)):
        if free[index]:
            chosen.append(index)
            free[tree.query_ball_point(points[index], spacing[index])] = False
    return np.array(chosen)


@dataclass(frozen=True, eq=False)
class Fit:
    """Monopoles inside the bodies with their strengths [Pa·m], and the problem that they were fitted to.

    Without ``source_strengths`` the sources are unit sources, each an excitation of its own.
    """

    capsules: Sequence[Capsule]
    wavenumber: complex
    sources: Real[np.ndarray, "sources 3"]
    source_strengths: Complex128[np.ndarray, "sources excitations"] | None
    monopoles: Float64[np.ndarray, "monopoles 3"]
    strengths: Complex128[np.ndarray, "monopoles excitations"]

    __repr__ = in_short

    def pressure(
        self, points: Real[np.ndarray, "points 3"]
    ) -> Complex128[np.ndarray, "points excitations"]:
        """Total pressure [Pa] at points (P, 3) outside the bodies."""
        blocks = [
            superposed(waves(part, self.sources, self.wavenumber), self.source_strengths)
            + waves(part, self.monopoles, self.wavenumber) @ self.strengths
            for part in np.array_split(points, 1 + len(points) // 500)
        ]
        return np.concatenate(blocks)

    def residual(self) -> float:
        """Norm of ∂p/∂n at surface points that were not fitted over that of the incident field."""
        defect, incident = 0.0, 0.0
        for capsule in self.capsules:
            points, normals = surface_points(capsule, 1009, start=0.31)
            arriving = superposed(
                normal_derivatives(points, normals, self.sources, self.wavenumber),
                self.source_strengths,
            )
            total = (
                arriving
                + normal_derivatives(points, normals, self.monopoles, self.wavenumber)
                @ self.strengths
            )
            incident += capsule.area * np.linalg.norm(arriving) ** 2
            defect += capsule.area * np.linalg.norm(total) ** 2
        return float(np.sqrt(defect / incident))


def fitted(
    capsules: Sequence[Capsule],
    wavenumber: complex,
    sources: Real[np.ndarray, "sources 3"],
    fineness: float,
    source_strengths: Complex128[np.ndarray, "sources excitations"] | None = None,
) -> Fit:
    """Fit monopoles, ``fineness`` of them per depth, to ∂p/∂n = 0 on all surfaces; unit sources by default."""
    positions, points, normals, sides = [], [], [], []
    for capsule in capsules:
        others = [other for other in capsules if other is not capsule]
        sample, _ = surface_points(capsule, 2000)
        finest = monopole_depths(capsule, others, sample, wavenumber).min() / fineness
        surface, outward = surface_points(capsule, min(60_000, int(5.0 * capsule.area / finest**2)))
        depth = monopole_depths(capsule, others, surface, wavenumber)
        spacing = np.minimum(depth / fineness, np.pi / abs(wavenumber) / fineness)
        inner = surface - depth[:, None] * outward
        positions.append(inner[thinned(inner, spacing)])
        chosen = thinned(surface, 0.9 * spacing)
        points.append(surface[chosen])
        normals.append(outward[chosen])
        sides.append(spacing[chosen])
    monopoles, surface, outward = (
        np.concatenate(positions),
        np.concatenate(points),
        np.concatenate(normals),
    )
    weights = np.concatenate(sides)[:, None]
    matrix = weights * normal_derivatives(surface, outward, monopoles, wavenumber)
    sizes = np.linalg.norm(matrix, axis=0)
    right = -weights * superposed(
        normal_derivatives(surface, outward, sources, wavenumber), source_strengths
    )
    strengths = least_squares(matrix / sizes, right) / sizes[:, None]
    return Fit(capsules, wavenumber, sources, source_strengths, monopoles, strengths)


def least_squares(
    matrix: Complex128[np.ndarray, "rows unknowns"], right: Complex128[np.ndarray, "rows columns"]
) -> Complex128[np.ndarray, "unknowns columns"]:
    """Solve least squares with unit columns by regularised normal equations and one step of refinement."""
    from scipy.linalg import cho_factor, cho_solve
    from scipy.linalg.blas import zherk  # pyright: ignore[reportAttributeAccessIssue]

    matrix = np.asfortranarray(matrix)
    gram = zherk(1.0, matrix, trans=2, lower=1)
    gram[np.diag_indices(len(gram))] += 1e-13 * len(gram)
    factor = cho_factor(gram, lower=True, overwrite_a=True, check_finite=False)
    found = cho_solve(factor, matrix.conj().T @ right)
    return found + cho_solve(factor, matrix.conj().T @ (right - matrix @ found))


@dataclass(frozen=True, eq=False)
class Reference:
    """Reference pressure [Pa], for bodies without a closed form, and its relative error by its own estimate."""

    pressure: Complex128[np.ndarray, "points excitations"]
    own_error: float

    __repr__ = in_short


def reference_pressure(
    bodies: Bodies,
    sources: Real[np.ndarray, "sources 3"],
    points: Real[np.ndarray, "points 3"],
    folder: Path,
    strengths: Complex128[np.ndarray, "sources excitations"] | None = None,
) -> Reference:
    """Return the pressure of monopoles beside capsules, read from ``folder`` where it was computed before.

    The sources are far from the surfaces, the points anywhere outside [m]. Without strengths of
    excitations [Pa·m] they are unit monopoles, each an excitation of its own.
    """
    wavenumber, capsules = bodies.scene.wavenumber, bodies.capsules

    def compute() -> Reference:
        if strengths is None:
            return Reference(*pressure_at(capsules, wavenumber, sources, points))
        fits = [
            fitted(capsules, wavenumber, sources, f, strengths) for f in (FINENESS / 1.25, FINENESS)
        ]
        coarse, pressure = (fit.pressure(points) for fit in fits)
        return Reference(
            pressure, float(np.linalg.norm(pressure - coarse) / np.linalg.norm(pressure))
        )

    settings = str([(c.radius, c.length, wavenumber, FINENESS) for c in capsules])
    poses = [part for one in capsules for part in (one.pose.rotation, one.pose.translation)]
    arrays = (*poses, sources, points, *([] if strengths is None else [strengths]))
    return cached_reference(folder, settings, arrays, compute)


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
