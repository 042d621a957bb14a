"""Use of the machine: kernel evaluations against its matrix product, peak memory against the matrix of a solve."""

import sys
from functools import partial

import numpy as np

from airtact import _kernels
from airtact.acoustics.solvers.bem.block_matrix import BlockMatrix, blocks_of
from airtact.acoustics.solvers.bem.layer_potentials import NearRule
from airtact.acoustics.solvers.bem.operator import DualSurface, dual_surface
from airtact.acoustics.solvers.bem.quadrature import place_nodes
from airtact.acoustics.solvers.bem.solver import BoundaryElement
from airtact.benching.contest import case_of, run_case
from airtact.benching.real_time import Row
from airtact.benching.scenes import two_fingers
from airtact.benching.timing import Timed, timed

FLOPS = 56
"""Operations of one kernel evaluation, the gradient of a Green's function along a normal."""

PRODUCT = 2048
"""Side of the matrices whose product is timed."""


def kernels_against_product(runs: int = 7) -> list[Row]:
    """Evaluate the far field of a matrix by every compiled variant, a single-precision matrix product beside each."""
    bodies = two_fingers()
    scene = bodies.scene
    panels = BoundaryElement(accuracy=0.02)._panels(scene, bodies.foci)
    nodes = place_nodes(panels.quadratic_triangles, panels.body, panels.deviation)
    surface = dual_surface(nodes, scene.wavenumber, NearRule(1.6, (4, 4)), "float32")
    before, rows = _kernels.active_variant(), []
    try:
        for variant in _kernels.variants():
            _kernels.use_variant(variant)
            rows.append(_kernel_row(variant, surface, runs))
    finally:
        _kernels.use_variant(before)
    return rows


def _kernel_row(variant: str, surface: DualSurface, runs: int) -> Row:
    nodes, shifted = surface.nodes, surface.shifted
    count = len(nodes.points)
    blocks = blocks_of(count)
    matrix = BlockMatrix.empty(count, "bfloat16", np.ones((blocks, blocks), dtype=bool))
    near, near_shifted = (
        _kernels.NearRows(
            np.zeros(points + 1, dtype=np.int64),
            np.zeros(0, dtype=np.int64),
            np.zeros((0, 6), dtype=np.complex128),
        )
        for points in (count, len(shifted))
    )
    layer = nodes.layer(surface.wavenumber)
    fill = partial(
        _kernels.dual_blocks,
        nodes.points,
        shifted,
        layer,
        diagonal=0.5,
        near=near,
        near_shifted=near_shifted,
        whole=matrix.whole,
        out=matrix.blocks,
    )
    fill()  # the pages are touched before the clock starts
    left = np.random.default_rng(0).normal(size=(PRODUCT, PRODUCT)).astype(np.float32)
    products, fills = [], []
    for _ in range(runs):  # in turn, so that both meet the same machine
        products += timed([partial(np.matmul, left, left)] * 2)[0].seconds
        fills += timed([fill] * 2)[0].seconds
    kernels = count * (count + len(shifted)) / Timed(tuple(fills)).median
    product = 2.0 * PRODUCT**3 / Timed(tuple(products)).median
    share = FLOPS * kernels / product
    return Row(
        f"kernel evaluations, {variant}, {FLOPS} flop each, against sgemm",
        "70 % (AVX-512)",
        f"{share:.0%}: {kernels / 1e9:.2f} G/s beside {product / 1e9:.0f} Gflop/s",
        "see the kernels' tests",
        f"{count} nodes, {Timed(tuple(fills))} a matrix",
        {"share": share, "kernels": kernels, "product": product, "seconds": tuple(fills)},
    )


def memory_over_matrix(accuracy: float = 0.0018) -> Row:
    """Solve two fingers in a process of its own, and compare its peak memory with the matrix in single precision."""
    bodies = two_fingers()
    case = case_of(bodies, bodies.foci + [0.0, 0.0, 0.1], 0, accuracy, estimate=True)
    answer = run_case("airtact", sys.executable, case)
    share = answer.peak / (8.0 * answer.unknowns**2)
    return Row(
        "peak memory above the process's base, over the matrix (8 bytes an entry)",
        "1.3, 8k unknowns or more",
        f"{share:.2f}",
        "",
        f"{answer.unknowns} unknowns, matrix {8e-9 * answer.unknowns**2:.2f} GB",
        {"share": share, "unknowns": answer.unknowns},
    )
