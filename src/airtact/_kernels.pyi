"""Types of the compiled loops; src/kernels/kernels.hpp documents each."""

import numpy as np

def variants() -> list[str]: ...
def active_variant() -> str: ...
def use_variant(name: str) -> None: ...

lanes: int
sharing: int
word_of_element: int

def dual_blocks_bfloat16(
    targets: np.ndarray,
    shifted: np.ndarray,
    points: np.ndarray,
    normals: np.ndarray,
    single: np.ndarray,
    k: complex,
    diagonal: float,
    first: np.ndarray,
    panel: np.ndarray,
    excess: np.ndarray,
    first_shifted: np.ndarray,
    panel_shifted: np.ndarray,
    excess_shifted: np.ndarray,
    whole_first: np.ndarray,
    whole_column: np.ndarray,
    out: np.ndarray,
) -> None: ...
def dual_low_rank_bfloat16(
    targets: np.ndarray,
    shifted: np.ndarray,
    points: np.ndarray,
    normals: np.ndarray,
    single: np.ndarray,
    k: complex,
    far_first: np.ndarray,
    far_column: np.ndarray,
    tolerance: float,
    count: np.ndarray,
    begin: np.ndarray,
    out: np.ndarray,
) -> int: ...
def dual_product_bfloat16(
    whole_first: np.ndarray,
    whole_column: np.ndarray,
    blocks: np.ndarray,
    far_first: np.ndarray,
    far_column: np.ndarray,
    count: np.ndarray,
    begin: np.ndarray,
    terms: np.ndarray,
    v: np.ndarray,
    transposed: bool,
    out: np.ndarray,
) -> None: ...

dual_blocks_float32 = dual_blocks_bfloat16
dual_low_rank_float32 = dual_low_rank_bfloat16
dual_product_float32 = dual_product_bfloat16
dual_blocks_float64 = dual_blocks_bfloat16
dual_low_rank_float64 = dual_low_rank_bfloat16
dual_product_float64 = dual_product_bfloat16

def double_layer_matrix_float32(
    targets: np.ndarray,
    sources: np.ndarray,
    normals: np.ndarray,
    single: np.ndarray,
    k: complex,
    out: np.ndarray,
) -> None: ...

double_layer_matrix_float64 = double_layer_matrix_float32

def apply_transposed_float32(
    targets: np.ndarray,
    sources: np.ndarray,
    normals: np.ndarray,
    single: np.ndarray,
    strength: np.ndarray,
    k: complex,
    out: np.ndarray,
) -> None: ...

apply_transposed_float64 = apply_transposed_float32

def dual_matrix_float32(
    targets: np.ndarray,
    inside: np.ndarray,
    sources: np.ndarray,
    normals: np.ndarray,
    single: np.ndarray,
    k: complex,
    out: np.ndarray,
) -> None: ...

dual_matrix_float64 = dual_matrix_float32

def few_products_float32(
    matrix: np.ndarray, vectors: np.ndarray, transposed: bool, out: np.ndarray
) -> None: ...

few_products_float64 = few_products_float32

def few_rounded_products(
    matrix: np.ndarray, scales: np.ndarray, vectors: np.ndarray, transposed: bool, out: np.ndarray
) -> None: ...
def krylov_step_float32(
    bases: np.ndarray,
    rotations: np.ndarray,
    right: np.ndarray,
    triangles: np.ndarray,
    inverses: np.ndarray,
    weights: np.ndarray,
    squares: np.ndarray,
) -> None: ...

krylov_step_float64 = krylov_step_float32

def apply_double_layer_float32(
    targets: np.ndarray,
    sources: np.ndarray,
    normals: np.ndarray,
    single: np.ndarray,
    density: np.ndarray,
    k: complex,
    least: float,
    out: np.ndarray,
) -> None: ...

apply_double_layer_float64 = apply_double_layer_float32

def apply_monopoles_float32(
    targets: np.ndarray, sources: np.ndarray, strength: np.ndarray, k: complex, out: np.ndarray
) -> None: ...

apply_monopoles_float64 = apply_monopoles_float32

def near_excess_float32(
    targets: np.ndarray,
    first: np.ndarray,
    panel: np.ndarray,
    quadratic_triangles: np.ndarray,
    contact: np.ndarray,
    sources: np.ndarray,
    normals: np.ndarray,
    single: np.ndarray,
    nodal: np.ndarray,
    k: complex,
    least: float,
    gauss_nodes: np.ndarray,
    gauss_weights: np.ndarray,
    largest: int,
    angular: int,
    radial: int,
    out: np.ndarray,
) -> None: ...

near_excess_float64 = near_excess_float32

def apply_in_cells(
    targets: np.ndarray,
    first: np.ndarray,
    centres: np.ndarray,
    reach: float,
    inside: bool,
    sources: np.ndarray,
    normals: np.ndarray | None,
    single: np.ndarray,
    density: np.ndarray,
    wavenumber: complex,
    least: float,
    out: np.ndarray,
) -> None: ...
def surface_integral(
    points: np.ndarray,
    sources: np.ndarray,
    normals: np.ndarray,
    monopoles: np.ndarray,
    dipoles: np.ndarray,
    k: complex,
    out: np.ndarray,
) -> None: ...
def normal_derivative(
    points: np.ndarray,
    normals: np.ndarray,
    sources: np.ndarray,
    strength: np.ndarray,
    k: complex,
    out: np.ndarray,
) -> None: ...
def detoured_waves(
    centres: np.ndarray,
    foci: np.ndarray,
    elements: np.ndarray,
    straight: np.ndarray,
    waves: np.ndarray,
    k: float,
    out: np.ndarray,
) -> None: ...
def interpolate(
    table: np.ndarray,
    first: np.ndarray,
    steps: np.ndarray,
    u: np.ndarray,
    v: np.ndarray,
    w: np.ndarray,
    out: np.ndarray,
) -> None: ...
def chebyshev_sum_float32(
    values: np.ndarray, columns: np.ndarray, rows: np.ndarray, factors: np.ndarray, x: np.ndarray
) -> None: ...

chebyshev_sum_float64 = chebyshev_sum_float32

def near_pairs(
    targets: np.ndarray, centres: np.ndarray, reach: np.ndarray
) -> tuple[np.ndarray, np.ndarray]: ...
def panel_distances(
    panels: np.ndarray, points: np.ndarray, within: float, distance: np.ndarray
) -> None: ...
def mark_blocks(
    first: np.ndarray, panel: np.ndarray, targets: int, panels: int, met: np.ndarray
) -> None: ...
def place_nodes(
    panels: np.ndarray,
    rule: np.ndarray,
    weights: np.ndarray,
    points: np.ndarray,
    normals: np.ndarray,
    areas: np.ndarray,
    centres: np.ndarray,
    radii: np.ndarray,
) -> None: ...
def block_order(points: np.ndarray, each: int, order: np.ndarray) -> None: ...
def closest_on_panels(
    targets: np.ndarray,
    quadratic_triangles: np.ndarray,
    order: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    panel: np.ndarray,
    reference: np.ndarray,
    distance: np.ndarray,
) -> None: ...
def gerchberg_saxton(
    real: np.ndarray,
    imag: np.ndarray,
    rows: np.ndarray,
    wanted: np.ndarray,
    foci_iterations: int,
    iterations: int,
    weighted: bool,
    sources: np.ndarray,
    worst: np.ndarray,
    drives: np.ndarray,
) -> None: ...
def near_integrals(
    single_layer: bool,
    targets: np.ndarray,
    pair_target: np.ndarray,
    pair_panel: np.ndarray,
    panels: np.ndarray,
    contact: np.ndarray,
    k: complex,
    nodes: np.ndarray,
    weights: np.ndarray,
    largest: int,
    angular: int,
    radial: int,
    out: np.ndarray,
    distance: np.ndarray,
    reference: np.ndarray,
) -> None: ...
def hull_distances(
    points: np.ndarray, balls: np.ndarray, parts: np.ndarray, out: np.ndarray
) -> None: ...
def blended_distance(
    points: np.ndarray,
    balls: np.ndarray,
    parts: np.ndarray,
    blend: np.ndarray,
    apart: np.ndarray,
    carve: float,
    reach: float,
    distance: np.ndarray,
    gradient: np.ndarray,
    bend: np.ndarray,
    facing: np.ndarray,
    nearest: np.ndarray,
) -> None: ...
def hull_gaps(
    points: np.ndarray,
    balls: np.ndarray,
    parts: np.ndarray,
    blend: np.ndarray,
    camera: np.ndarray,
    facing: float,
    distance: np.ndarray,
    gradients: np.ndarray,
    hull: np.ndarray,
) -> None: ...
def project_on_hulls(
    points: np.ndarray,
    balls: np.ndarray,
    parts: np.ndarray,
    blend: np.ndarray,
    apart: np.ndarray,
    reach: float,
    most: int,
    longest: float,
    on_surface: float,
    stride: float,
    halvings: int,
) -> None: ...
def grade_sizes(
    vertices: np.ndarray, triangles: np.ndarray, grading: float, rounds: int, sizes: np.ndarray
) -> None: ...
def even_pass(
    vertices: np.ndarray,
    sizes: np.ndarray,
    triangles: np.ndarray,
    counts: np.ndarray,
    keep: bool,
    needle: float,
    share: float,
) -> None: ...
