"""Types of the compiled loops; src/kernels/kernels.hpp documents each."""

import numpy as np

def variants() -> list[str]: ...
def active_variant() -> str: ...
def use_variant(name: str) -> None: ...

lanes: int
sharing: int
word_of_element: int

class Layer:
    """A double layer with the single layer of yielding surfaces, or monopoles without normals."""

    def __init__(
        self,
        points: np.ndarray,
        normals: np.ndarray | None,
        single: np.ndarray,
        wavenumber: complex,
    ) -> None: ...

class Panels:
    """Curved panels, and the distance below which a point counts as lying on each."""

    def __init__(self, quadratic_triangles: np.ndarray, contact: np.ndarray) -> None: ...

class NearQuadrature:
    """Gauss-Legendre rules of 1 to ``largest`` points on [0, 1], one after another."""

    def __init__(
        self, nodes: np.ndarray, weights: np.ndarray, largest: int, angular: int, radial: int
    ) -> None: ...

class NearRows:
    """Near panels of each target, and the corrections to the entries of their six nodes."""

    first: np.ndarray
    panel: np.ndarray
    excess: np.ndarray
    def __init__(self, first: np.ndarray, panel: np.ndarray, excess: np.ndarray) -> None: ...

class Pairs:
    """Pairs of blocks of a matrix."""

    first: np.ndarray
    column: np.ndarray
    def __init__(self, first: np.ndarray, column: np.ndarray) -> None: ...

class FarBlocks(Pairs):
    """Blocks that are low-rank: their ranks, and where their factors begin."""

    ranks: np.ndarray
    begin: np.ndarray
    def __init__(
        self, first: np.ndarray, column: np.ndarray, ranks: np.ndarray, begin: np.ndarray
    ) -> None: ...

class Cells:
    """Points sorted into cells, and the distance from a cell's centre that is near."""

    def __init__(
        self, points: np.ndarray, first: np.ndarray, centres: np.ndarray, reach: float
    ) -> None: ...

class KrylovSpaces:
    """The state of GMRES for several right-hand sides."""

    right: np.ndarray
    triangles: np.ndarray
    weights: np.ndarray
    squares: np.ndarray
    def __init__(
        self,
        rotations: np.ndarray,
        right: np.ndarray,
        triangles: np.ndarray,
        inverses: np.ndarray,
        weights: np.ndarray,
        squares: np.ndarray,
    ) -> None: ...

def dual_blocks(
    targets: np.ndarray,
    shifted: np.ndarray,
    layer: Layer,
    diagonal: float,
    near: NearRows,
    near_shifted: NearRows,
    whole: Pairs,
    out: np.ndarray,
) -> None: ...
def dual_low_rank(
    targets: np.ndarray,
    shifted: np.ndarray,
    layer: Layer,
    far: FarBlocks,
    tolerance: float,
    factors: np.ndarray,
) -> int: ...
def dual_product(
    whole: Pairs,
    blocks: np.ndarray,
    far: FarBlocks,
    factors: np.ndarray,
    vectors: np.ndarray,
    transposed: bool,
) -> np.ndarray: ...
def double_layer_matrix(targets: np.ndarray, layer: Layer, precision: str) -> np.ndarray: ...
def dual_matrix(
    targets: np.ndarray, inside: np.ndarray, layer: Layer, precision: str
) -> np.ndarray: ...
def apply_transposed(
    targets: np.ndarray, layer: Layer, strengths: np.ndarray, precision: str
) -> np.ndarray: ...
def apply_double_layer(
    targets: np.ndarray, layer: Layer, density: np.ndarray, least: float, precision: str
) -> np.ndarray: ...
def apply_monopoles(
    targets: np.ndarray,
    sources: np.ndarray,
    strengths: np.ndarray,
    wavenumber: complex,
    precision: str,
) -> np.ndarray: ...
def apply_distant(
    targets: Layer, sources: np.ndarray, density: np.ndarray, error: float
) -> np.ndarray: ...
def apply_in_cells(
    cells: Cells, inside: bool, layer: Layer, density: np.ndarray, least: float
) -> np.ndarray: ...
def few_products(matrix: np.ndarray, vectors: np.ndarray, transposed: bool) -> np.ndarray: ...
def few_rounded_products(
    matrix: np.ndarray, scales: np.ndarray, vectors: np.ndarray, transposed: bool
) -> np.ndarray: ...
def invert_blocks(blocks: np.ndarray) -> None: ...
def krylov_step(bases: np.ndarray, spaces: KrylovSpaces) -> None: ...
def near_excess(
    targets: np.ndarray,
    rows: NearRows,
    panels: Panels,
    layer: Layer,
    nodal: np.ndarray,
    least: float,
    quadrature: NearQuadrature,
    precision: str,
) -> None: ...
def near_integrals(
    single_layer: bool,
    targets: np.ndarray,
    pair_target: np.ndarray,
    pair_panel: np.ndarray,
    panels: Panels,
    wavenumber: complex,
    quadrature: NearQuadrature,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]: ...
def chebyshev_sum(
    values: np.ndarray, columns: np.ndarray, rows: np.ndarray, factors: np.ndarray, x: np.ndarray
) -> None: ...
def surface_integral(
    points: np.ndarray,
    sources: np.ndarray,
    normals: np.ndarray,
    monopoles: np.ndarray,
    dipoles: np.ndarray,
    k: complex,
) -> np.ndarray: ...
def normal_derivative(
    points: np.ndarray, normals: np.ndarray, sources: np.ndarray, strength: np.ndarray, k: complex
) -> np.ndarray: ...
def detoured_waves(
    centres: np.ndarray,
    foci: np.ndarray,
    elements: np.ndarray,
    straight: np.ndarray,
    waves: np.ndarray,
    k: float,
) -> np.ndarray: ...
def interpolate(
    table: np.ndarray,
    first: np.ndarray,
    steps: np.ndarray,
    u: np.ndarray,
    v: np.ndarray,
    w: np.ndarray,
) -> np.ndarray: ...
def near_pairs(
    targets: np.ndarray, centres: np.ndarray, reach: np.ndarray
) -> tuple[np.ndarray, np.ndarray]: ...
def panel_distances(panels: np.ndarray, points: np.ndarray, within: float) -> np.ndarray: ...
def mark_blocks(
    first: np.ndarray, panel: np.ndarray, targets: int, panels: int, met: np.ndarray
) -> None: ...
def place_nodes(
    panels: np.ndarray, rule: np.ndarray, weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]: ...
def block_order(points: np.ndarray, each: int) -> np.ndarray: ...
def closest_on_panels(
    targets: np.ndarray,
    quadratic_triangles: np.ndarray,
    order: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    sides: np.ndarray,
    within: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]: ...
def gerchberg_saxton(
    real: np.ndarray,
    imag: np.ndarray,
    rows: np.ndarray,
    wanted: np.ndarray,
    foci_iterations: int,
    iterations: int,
    weighted: bool,
    start: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]: ...
def hull_distances(points: np.ndarray, balls: np.ndarray, parts: np.ndarray) -> np.ndarray: ...
def blended_distance(
    points: np.ndarray,
    balls: np.ndarray,
    parts: np.ndarray,
    blend: np.ndarray,
    apart: np.ndarray,
    carve: float,
    reach: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]: ...
def hull_gaps(
    points: np.ndarray,
    balls: np.ndarray,
    parts: np.ndarray,
    blend: np.ndarray,
    camera: np.ndarray | None,
    facing: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]: ...
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
