"""What one body does to sound, kept: its own matrix is inverted once, and it is heard through few of its nodes.

Seen from some distance, the nodes of a body hear and speak through a few of them, its skeleton, to any accuracy: all
other nodes are combinations of those, whatever stands outside. Which nodes, and the combinations, follow from monopoles
on a surface round the body (the proxy surface).

Source: P. G. Martinsson and V. Rokhlin, "A fast direct solver for boundary integral equations in two dimensions",
Journal of Computational Physics 205 (2005) 1.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
import scipy.linalg
from jaxtyping import Complex, Complex128, Float64, Int32, Int64, Num
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist

from airtact import _kernels
from airtact.printing import in_short
from airtact.solvers.bem.layer_potentials import double_layer_transposed
from airtact.solvers.bem.operator import DualSurface, assemble
from airtact.solvers.bem.quadrature import Nodes

SECOND_LAYER = 2.5
"""How much farther off than the first the second half of the proxy monopoles stands."""

SKETCHED = 12
"""Random combinations of the proxies for each square wavelength of skin to begin with; twice as many until a few are
left over."""

CHECKED = 64
"""Proxies, and points beside the skin, from which the kept scattering is checked."""

BESIDE = 0.06
"""Wavelengths off the skin where the latter stand: half a millimetre at 40 kHz in air."""

FIRST, TIGHTER, TRIES = 0.3, 0.4, 4
"""Tolerance of the first skeletons as a share of the error wanted, how much less each next one has, and how many there
may be."""

GROUPS_AT_ONCE = 100
"""Points inside, and three times as many nodes, that hear the proxies at once."""

LEFT_OVER = 0.7
"""Share of the combinations that a skeleton may need at most."""


@dataclass(frozen=True, eq=False)
class ReducedBody:
    """One body in its own frame, as its skeletons hear and speak.

    Attributes
    ----------
    surface : where and how the dual-surface equation of this body alone is written down.
    reach : nothing nearer to a node than this is heard through the skeleton [m].
    hears, speaks : (R,) and (Q,) the nodes of both skeletons.
    solved : (R, M) the transposed solution as the skeleton hears it, from the right-hand side.
    scatters : (R, Q) the same from a right-hand side known at the speaking skeleton: the scattering matrix.
    error : relative error of the scattering against all nodes, to points as near as the reach, from there and from
        beside the skin.
    tree : the nodes, for distances.
    """

    surface: DualSurface
    reach: float
    hears: Int64[np.ndarray, "hearing"]
    speaks: Int64[np.ndarray, "speaking"]
    solved: Complex[np.ndarray, "hearing nodes"]
    scatters: Complex[np.ndarray, "hearing speaking"]
    error: float
    tree: KDTree

    __repr__ = in_short

    @property
    def hearing(self) -> Float64[np.ndarray, "both 3"]:
        """Where the hearing skeleton listens (2 R, 3) [m]: its nodes, then the points inside that belong to them."""
        surface = self.surface
        return np.concatenate([surface.nodes.points[self.hears], surface.shifted[self.hears // _kernels.sharing]])

    @property
    def speaking(self) -> tuple[Float64[np.ndarray, "speaking 3"], Float64[np.ndarray, "speaking 3"]]:
        """Where the speaking skeleton speaks (Q, 3) [m], and its normals times area [m²]."""
        nodes = self.surface.nodes
        return nodes.points[self.speaks], nodes.weighted_normals[self.speaks]


def reduced_body(surface: DualSurface, reach: float, wanted: float) -> ReducedBody:
    """Invert a body's own matrix and find its skeletons, larger ones until they are right.

    Parameters
    ----------
    surface : the dual-surface equation of the body alone.
    reach : distance beyond which the body is heard through its skeletons [m].
    wanted : relative error that the skeletons may leave.
    """
    tree = KDTree(surface.nodes.points)
    proxies = _proxies(surface.nodes, tree, reach)
    matrix = assemble(surface, "float64" if surface.precision == "float64" else "float32").dense()
    factors = scipy.linalg.lu_factor(matrix, overwrite_a=True, check_finite=False)
    checks = _checks(surface, proxies, factors)
    tolerance, part = FIRST * wanted, None
    for _ in range(TRIES):
        part = _kept(surface, reach, tree, proxies, factors, tolerance, checks)
        if part.error <= wanted:
            break
        tolerance *= TIGHTER
    assert part is not None
    return part


def _kept(
    surface: DualSurface,
    reach: float,
    tree: KDTree,
    proxies: Float64[np.ndarray, "proxies 3"],
    factors: tuple[Complex[np.ndarray, "nodes nodes"], Int32[np.ndarray, "nodes"]],
    tolerance: float,
    checks: "_Checks",
) -> ReducedBody:
    """Find skeletons to a tolerance, and what that leaves of the scattering."""
    kind = factors[0].dtype.type
    area = float(surface.nodes.weights.sum()) * (surface.wavenumber.real / (2 * np.pi)) ** 2
    count = min(math.ceil(SKETCHED * (area + 4)), len(proxies))
    hears, hearing = _skeleton(partial(_heard_by, surface, proxies), len(proxies), count, tolerance, kind)
    speaks, speaking = _skeleton(partial(_spoken_to, surface, proxies), len(proxies), count, tolerance, kind)
    solved = np.ascontiguousarray(scipy.linalg.lu_solve(factors, hearing.T.astype(kind), check_finite=False).T)
    scatters = solved @ speaking.T.astype(kind)
    error = checks.error(hears, speaks, solved, scatters)
    return ReducedBody(surface, reach, hears, speaks, solved, scatters, error, tree)


@dataclass(frozen=True, eq=False)
class _Checks:
    """Sound from points as near as the reach and from points beside the skin, scattered to other points at the reach.

    Attributes
    ----------
    far, near : (M, C) right-hand sides of the transposed equation for both kinds of points.
    listening : (M, L) how the nodes are heard.
    exact_far, exact_near : (C, L) what all nodes together scatter.
    """

    far: Complex128[np.ndarray, "nodes far"]
    near: Complex128[np.ndarray, "nodes near"]
    listening: Complex128[np.ndarray, "nodes listening"]
    exact_far: Complex128[np.ndarray, "far listening"]
    exact_near: Complex128[np.ndarray, "near listening"]

    def error(
        self,
        hears: Int64[np.ndarray, "hearing"],
        speaks: Int64[np.ndarray, "speaking"],
        solved: Complex[np.ndarray, "hearing nodes"],
        scatters: Complex[np.ndarray, "hearing speaking"],
    ) -> float:
        """Relative error that skeletons leave, the larger of both kinds."""
        heard = self.listening[hears]
        pairs = (
            (self.exact_far, (scatters @ self.far[speaks]).T @ heard),
            (self.exact_near, (solved @ self.near).T @ heard),
        )
        return max(float(np.linalg.norm(kept - exact) / np.linalg.norm(exact)) for exact, kept in pairs)


def _checks(
    surface: DualSurface,
    proxies: Float64[np.ndarray, "proxies 3"],
    factors: tuple[Complex[np.ndarray, "nodes nodes"], Int32[np.ndarray, "nodes"]],
) -> _Checks:
    nodes, wavelength = surface.nodes, 2 * np.pi / surface.wavenumber.real
    some, beside = (np.arange(0, count, -(-count // CHECKED)) for count in (len(proxies), len(nodes.points)))
    listening = _heard_by(surface, proxies[some - len(proxies) // 2], np.eye(len(some)))
    close = nodes.points[beside] + BESIDE * wavelength * nodes.normals[beside]
    far, near = (_spoken_to(surface, points, np.eye(len(points))) for points in (proxies[some], close))
    exact = [scipy.linalg.lu_solve(factors, one, trans=1, check_finite=False).T @ listening for one in (far, near)]
    return _Checks(far, near, listening, *exact)


def _proxies(nodes: Nodes, tree: KDTree, reach: float) -> Float64[np.ndarray, "proxies 3"]:
    """Monopoles all round the body: off every node, and farther off every second one."""
    near = nodes.points + reach * nodes.normals
    far = nodes.points[::2] + SECOND_LAYER * reach * nodes.normals[::2]
    everywhere = np.concatenate([near, far])
    return everywhere[tree.query(everywhere, distance_upper_bound=0.95 * reach)[0] > 0.95 * reach]


def _heard_by(
    surface: DualSurface, proxies: Float64[np.ndarray, "proxies 3"], strengths: Num[np.ndarray, "proxies some"]
) -> Complex128[np.ndarray, "nodes some"]:
    """Right-hand sides of the direct equation that the proxies cause."""
    points, sharing = surface.nodes.points, _kernels.sharing
    kind = np.complex64 if surface.precision == "float32" else np.complex128
    strengths = strengths.astype(kind)
    heard = np.empty((len(points), strengths.shape[1]), dtype=np.complex128)
    for begin in range(0, len(points), sharing * GROUPS_AT_ONCE):
        rows = slice(begin, begin + sharing * GROUPS_AT_ONCE)
        groups = slice(begin // sharing, begin // sharing + GROUPS_AT_ONCE)
        inside = np.repeat(_open_air(surface.shifted[groups], proxies, surface.wavenumber), sharing, axis=0)
        heard[rows] = (_open_air(points[rows], proxies, surface.wavenumber) - 1j * inside).astype(kind) @ strengths
    return heard


def _open_air(
    points: Float64[np.ndarray, "points 3"], proxies: Float64[np.ndarray, "proxies 3"], wavenumber: complex
) -> Complex128[np.ndarray, "points proxies"]:
    """Pressure e^{ikr}/r of each proxy by itself."""
    distance = cdist(points, proxies)
    return np.exp(1j * wavenumber * distance) / distance


def _spoken_to(
    surface: DualSurface, proxies: Float64[np.ndarray, "proxies 3"], strengths: Num[np.ndarray, "proxies some"]
) -> Complex128[np.ndarray, "nodes some"]:
    """How the pressure at the nodes is heard by the proxies: right-hand sides of the transposed equation."""
    rule, precision = surface.near_rule, surface.precision
    return double_layer_transposed(
        proxies, surface.nodes, strengths.astype(np.complex128), surface.wavenumber, rule, precision
    )


def _skeleton(
    mixed: Callable[[np.ndarray], np.ndarray],
    proxies: int,
    count: int,
    tolerance: float,
    kind: type[np.complexfloating],
) -> tuple[Int64[np.ndarray, "skeleton"], Complex128[np.ndarray, "skeleton nodes"]]:
    """Nodes of which all others are combinations, and those combinations.

    ``mixed`` gives what the nodes have to do with random strengths of the proxies: an interpolative decomposition of a
    random sketch (E. Liberty, F. Woolfe, P. G. Martinsson, V. Rokhlin, M. Tygert, PNAS 104 (2007) 20167).
    """
    random = np.random.default_rng(0)
    while True:
        sketch = mixed(random.standard_normal((proxies, count)) + 1j * random.standard_normal((proxies, count)))
        decomposed = scipy.linalg.qr(sketch.T.astype(kind), mode="r", pivoting=True, check_finite=False)
        upper, order = np.asarray(decomposed[0]), np.asarray(decomposed[-1])
        size = np.abs(np.diag(upper))
        rank = int(np.count_nonzero(size > tolerance * size[0]))
        if rank <= LEFT_OVER * count or count >= min(proxies, len(sketch)):
            break
        count = min(2 * count, proxies)
    combinations = np.empty((rank, len(sketch)), dtype=np.complex128)
    combinations[:, order[:rank]] = np.eye(rank)
    combinations[:, order[rank:]] = scipy.linalg.solve_triangular(upper[:rank, :rank], upper[:rank, rank:])
    return order[:rank].astype(np.int64), combinations
