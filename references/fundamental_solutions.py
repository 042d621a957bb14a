"""Sound-hard capsules by fundamental solutions: independent of every solver in src.

The scattered field is a sum of monopoles inside the bodies, fitted by least squares to ∂p/∂n = 0 at
more points of the surface (G. Fairweather, A. Karageorghis, P. A. Martin, Eng. Anal. Bound. Elem.
27, 759, 2003). The error falls fast in depth over spacing as long as the monopoles lie outside the
images of the other body, which for a gap d stand a (1 - e^{-μ}) deep, cosh μ = 1 + d/(2a). So depth
and spacing follow the gap along the surface: fine where bodies come close, coarse elsewhere.

``python -m references.fundamental_solutions`` writes the pressures that ``airtact selfcheck``
compares with.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Complex128, Float64, Int64, Real

import airtact
from airtact.errors import in_short
from airtact.geometry.pose import Pose
from airtact.geometry.primitives import Capsule

MAX_MONOPOLES = 4000


def pressure_at(
    capsules: Sequence[Capsule],
    wavenumber: complex,
    sources: Real[np.ndarray, "sources 3"],
    receivers: Real[np.ndarray, "receivers 3"],
    wanted: float = 3e-3,
    fineness: float = 3.0,
) -> tuple[Complex128[np.ndarray, "receivers sources"], float]:
    """Total pressure [Pa] of unit monopoles beside separate capsules, and its estimated error.

    By reciprocity the set of points [m] farther from the surfaces becomes the sources, so one of
    the two may touch a surface; the other stays some centimetres away. Starting with ``fineness``
    monopoles per depth, the fit is refined until the estimated error is the ``wanted`` one: the
    relative change from a coarser fit (at the worst of the closer points, over all the others)
    times the ratio of the residuals ∂p/∂n at surface points that were not fitted, but at least a
    tenth of that residual.
    """
    sources_off = min(-capsule.depth(sources).max() for capsule in capsules)
    receivers_off = min(-capsule.depth(receivers).max() for capsule in capsules)
    if sources_off < receivers_off:
        pressure, error = pressure_at(capsules, wavenumber, receivers, sources, wanted, fineness)
        return pressure.T, error
    coarse = fitted(capsules, wavenumber, sources, fineness / 1.25)
    while True:
        fit = fitted(capsules, wavenumber, sources, fineness)
        pressure = fit.pressure(receivers)
        residual = fit.residual()
        change = np.linalg.norm(pressure - coarse.pressure(receivers), axis=1)
        change = float(np.max(change / np.linalg.norm(pressure, axis=1)))
        error = max(change * min(1.0, residual / coarse.residual()), 0.1 * residual)
        if error < wanted or 1.5 * len(fit.monopoles) > MAX_MONOPOLES:
            return pressure, error
        coarse = fit
        fineness *= 1.25


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
    for axis in range(3):  # an array (P, N, 3) would take too much memory
        offset = points[:, axis, None] - sources[:, axis]
        square += offset**2
        along += offset * normals[:, axis, None]
    distance = np.sqrt(square)
    radial = (1j * wavenumber - 1.0 / distance) * np.exp(1j * wavenumber * distance)
    return radial * (along / square)


def surface_points(
    capsule: Capsule, number: int, start: float = 0.5
) -> tuple[Float64[np.ndarray, "points 3"], Float64[np.ndarray, "points 3"]]:
    """Points spread evenly over a capsule by the golden angle, and their normals."""
    half, radius = capsule.length / 2.0, capsule.radius
    height = (capsule.length + 2.0 * radius) * ((np.arange(number) + start) / number - 0.5)
    azimuth = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(number)
    above = np.sign(height) * np.maximum(np.abs(height) - half, 0.0) / radius
    flat = np.sqrt(1.0 - above**2)
    normals = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), above], axis=1)
    axis = np.stack([0.0 * height, 0.0 * height, height - above * radius], axis=1)
    return capsule.pose.apply(axis + radius * normals), capsule.pose.rotate(normals)


def monopole_depths(
    capsule: Capsule,
    others: Sequence[Capsule],
    points: Real[np.ndarray, "points 3"],
    wavenumber: complex,
) -> Float64[np.ndarray, "points"]:
    """Depth of the monopole under each surface point [m]."""
    # The highest azimuthal order that matters may lose 2.5 digits on its way to the surface.
    share = 1.0 - 10.0 ** (-2.5 / (abs(wavenumber) * capsule.radius + 5.0))
    shares = np.full(len(points), share)
    for other in others:
        gap = np.maximum(-other.depth(points), 1e-6)
        images = 1.0 - np.exp(-np.arccosh(1.0 + gap / (2.0 * capsule.radius)))
        shares = np.minimum(shares, 0.75 * images)
    return shares * capsule.radius


def thinned(
    points: Real[np.ndarray, "points 3"], spacing: Float64[np.ndarray, "points"]
) -> Int64[np.ndarray, "chosen"]:
    """Choose points no two of which are closer than the spacing at the first of them."""
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
    """Strengths [Pa·m] of monopoles inside the bodies, for each of some unit sources outside."""

    capsules: Sequence[Capsule]
    wavenumber: complex
    sources: Real[np.ndarray, "sources 3"]
    monopoles: Float64[np.ndarray, "monopoles 3"]
    strengths: Complex128[np.ndarray, "monopoles sources"]

    __repr__ = in_short

    def pressure(
        self, points: Real[np.ndarray, "points 3"]
    ) -> Complex128[np.ndarray, "points sources"]:
        """Total pressure [Pa] at points (P, 3) outside the bodies."""
        blocks = [
            waves(block, self.sources, self.wavenumber)
            + waves(block, self.monopoles, self.wavenumber) @ self.strengths
            for block in np.array_split(points, 1 + len(points) // 500)
        ]
        return np.concatenate(blocks)

    def residual(self) -> float:
        """Norm of ∂p/∂n at surface points that were not fitted over that of the incident field."""
        defect, incident = 0.0, 0.0
        for capsule in self.capsules:
            surface = surface_points(capsule, 1009, start=0.31)
            arriving = normal_derivatives(*surface, self.sources, self.wavenumber)
            scattered = normal_derivatives(*surface, self.monopoles, self.wavenumber)
            total = arriving + scattered @ self.strengths
            incident += capsule.area * np.linalg.norm(arriving) ** 2
            defect += capsule.area * np.linalg.norm(total) ** 2
        return float(np.sqrt(defect / incident))


def fitted(
    capsules: Sequence[Capsule],
    wavenumber: complex,
    sources: Real[np.ndarray, "sources 3"],
    fineness: float,
) -> Fit:
    """Fit ``fineness`` monopoles per depth to ∂p/∂n = 0 on all surfaces for each source."""
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
    monopoles = np.concatenate(positions)
    surface = np.concatenate(points)
    outward = np.concatenate(normals)
    weights = np.concatenate(sides)[:, None]
    matrix = weights * normal_derivatives(surface, outward, monopoles, wavenumber)
    sizes = np.linalg.norm(matrix, axis=0)
    right = -weights * normal_derivatives(surface, outward, sources, wavenumber)
    strengths = least_squares(matrix / sizes, right) / sizes[:, None]
    return Fit(capsules, wavenumber, sources, monopoles, strengths)


def least_squares(
    matrix: Complex128[np.ndarray, "rows unknowns"], right: Complex128[np.ndarray, "rows columns"]
) -> Complex128[np.ndarray, "unknowns columns"]:
    """Solve least squares by regularised normal equations and one step of refinement."""
    from scipy.linalg import cho_factor, cho_solve
    from scipy.linalg.blas import zherk  # pyright: ignore[reportAttributeAccessIssue]

    matrix = np.asfortranarray(matrix)
    gram = zherk(1.0, matrix, trans=2, lower=1)
    gram[np.diag_indices(len(gram))] += 1e-13 * len(gram)
    factor = cho_factor(gram, lower=True, overwrite_a=True, check_finite=False)
    solution = cho_solve(factor, matrix.conj().T @ right)
    return solution + cho_solve(factor, matrix.conj().T @ (right - matrix @ solution))


def two_spheres() -> dict[str, np.ndarray]:
    """Solve the two spheres of ``airtact selfcheck``: radii of 8 mm and 5 mm, 3 mm apart."""
    beside = Pose(np.eye(3), np.array([16e-3, 0.0, 0.0]))
    spheres = [Capsule(8e-3, 0.0, Pose.identity()), Capsule(5e-3, 0.0, beside)]
    vectors = np.random.default_rng(4).normal(size=(24, 3))
    away = 0.1 * vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    across = np.linspace(-5e-3, 5e-3, 9)[:, None] * [0.0, 0.6, 0.8]
    between = np.array([9.5e-3, 0.0, 0.0]) + across
    wavenumber = airtact.Medium(sound_speed=343.1, density=1.293).wavenumber(40e3)
    pressure, error = pressure_at(spheres, wavenumber, away, between, wanted=1e-3)
    return {"away": away, "between": between, "pressure": pressure, "error": np.array(error)}


if __name__ == "__main__":
    folder = Path(airtact.__file__).parent / "evaluation"
    np.savez_compressed(folder / "two_spheres.npz", **two_spheres())
