"""A field from another program: complex pressures at nodes, interpolated between the nodes."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Complex128, Float64, Num, Real
from scipy.spatial import Delaunay, KDTree, QhullError

from airtact.acoustics.scene import Scene, check_sources
from airtact.acoustics.solvers.problem import RadiatedField, SolveReport, SurfaceField
from airtact.acoustics.solvers.shared import Mask, Pressures, Vectors
from airtact.acoustics.sources import Monopoles
from airtact.errors import (
    InvalidInput,
    about,
    check_choice,
    check_finite,
    complex_numbers,
    counted,
    in_mm,
    path_of,
    points_of,
    positive,
)
from airtact.files.text_table import TextTable, read_text_table

# Nodes closer together than this count as identical [m].
SAME_NODE = 1e-9


@dataclass(frozen=True, eq=False, repr=False)
class SampledField(RadiatedField):
    """A field from another program, interpolated between the nodes at which it is known.

    ``load_samples`` reads one from a file. A Delaunay triangulation divides the convex hull of the
    nodes into tetrahedra. In each tetrahedron, p·r·e^{-ikr} is interpolated linearly, where k is
    the wavenumber and r the distance from the nearest source, because e^{ikr}/r varies far faster
    than the remaining factor. The tetrahedra also fill the bodies, so do not evaluate the field
    inside bodies. The field is NaN outside the convex hull. Its error is not estimated and is
    reported as NaN.

    Attributes
    ----------
    scene : the scene, without planes, for which the field was computed.
    sources : the ``Monopoles`` that emit the sound, with S excitations.
    report : ``SolveReport`` with the number of nodes; computed, not passed.
    nodes : (N, 3) positions of the nodes in the frame of the scene [m].
    pressures : (N, S) complex peak value of the total pressure at each node for each excitation
        [Pa]; the time factor is e^{-iωt}. An array of shape (N,) is a single excitation.

    Raises
    ------
    InvalidInput
        If shapes do not match, if a number is NaN or infinite, if there are fewer than four nodes,
        if two nodes are less than 1 nm apart, if all nodes lie in one plane, if a source is inside
        a body, or if the scene has a plane.
    """

    report: SolveReport = field(init=False)
    nodes: Real[np.ndarray, "nodes 3"]
    pressures: Num[np.ndarray, "nodes excitations"] | Num[np.ndarray, "nodes"]

    def __post_init__(self) -> None:
        check_sources(self.scene, self.sources)
        nodes = points_of(self.nodes, "nodes")
        pressures = complex_numbers(self.pressures, "pressures")
        if pressures.ndim == 1:
            pressures = pressures[:, None]
        excitations = self.sources.strengths.shape[1]
        if pressures.shape != (len(nodes), excitations):
            raise InvalidInput(
                f"the pressures have shape {pressures.shape}, but {len(nodes)} nodes and "
                f"{excitations} excitations require ({len(nodes)}, {excitations}).",
                code="wrong_shape",
            )
        check_finite(pressures, "pressures")
        pairs = KDTree(nodes).query_pairs(SAME_NODE, output_type="ndarray")
        if len(pairs):
            first, second = pairs[0]
            raise InvalidInput(
                f"{counted(len(pairs), 'pair of nodes has', 'pairs of nodes have')} the same "
                f"position, such as nodes {first} and {second} at {in_mm(nodes[first])}; keep one "
                "node of each pair, or check the scale.",
                nodes[first],
                code="given_twice",
            )
        object.__setattr__(self, "nodes", nodes)
        object.__setattr__(self, "pressures", pressures)
        report = SolveReport(
            solver="SampledField",
            nodes=len(nodes),
            nodes_per_square_wavelength=float("nan"),
            estimated_error=float("nan"),
            settings={"tetrahedra": len(self._tetrahedra.simplices)},
        )
        object.__setattr__(self, "report", report)

    @cached_property
    def _tetrahedra(self) -> Delaunay:
        nodes = self.nodes
        if len(nodes) < 4:
            raise InvalidInput(
                f"there are {len(nodes)} nodes, but interpolation in tetrahedra requires at least "
                "4; use more nodes.",
                code="too_few",
            )
        try:
            return Delaunay(nodes)
        except QhullError:
            # The smallest singular value measures the thickness of the cloud of nodes.
            spread = np.linalg.svd(nodes - nodes.mean(axis=0), compute_uv=False)[-1]
            raise InvalidInput(
                f"the {len(nodes)} nodes lie in one plane, to within "
                f"{1e3 * spread / np.sqrt(len(nodes)):.2g} mm; use nodes that fill a volume.",
                code="misplaced",
            ) from None

    @property
    def on_surface(self) -> SurfaceField:
        """A surface field without points, because the pressure on the bodies is unknown."""
        return SurfaceField.empty(self.sources)

    def _valid(self, points: Vectors) -> Mask:
        return self._simplices(points) >= 0

    def _simplices(self, points: Vectors) -> np.ndarray:
        # A point on the hull counts as inside despite rounding.
        return self._tetrahedra.find_simplex(points, tol=1e-6)

    def _at(self, points: Vectors) -> Pressures:
        pressures = self.nowhere(points)
        number = self._simplices(points)
        inside = np.flatnonzero(number >= 0)
        if not len(inside):
            return pressures
        number = number[inside]
        # Qhull stores the map from points to the first three barycentric coordinates.
        transforms = self._tetrahedra.transform[number]
        three = np.einsum("pij,pj->pi", transforms[:, :3], points[inside] - transforms[:, 3])
        weights = np.column_stack([three, 1.0 - three.sum(axis=1)])
        corners = self._tetrahedra.simplices[number]
        nodes = np.asarray(self.nodes)[corners]
        for column, strengths in enumerate(self.sources.strengths.T):
            at_corners = np.asarray(self.pressures)[corners, column]
            emitting = self.sources.positions[strengths != 0]
            if len(emitting):
                source = emitting[KDTree(emitting).query(nodes.mean(axis=1))[1]]
                # Divided by its wave, the pressure varies slowly, so it can be interpolated.
                at_nodes = np.linalg.norm(nodes - source[:, None], axis=2)
                at_point = np.linalg.norm(points[inside] - source, axis=1)[:, None]
                phase = self.scene.wavenumber * (at_point - at_nodes)
                at_corners = at_corners * at_nodes / at_point * np.exp(1j * phase)
            pressures[inside, column] = np.einsum("pc,pc->p", weights, at_corners)
        return pressures


def load_samples(
    path: str | Path,
    scene: Scene,
    sources: Monopoles,
    time_sign: Literal["e^{-iωt}", "e^{+jωt}"],
    scale: float | None = None,
) -> SampledField:
    """Load a field that another program exported as a text table.

    The table has the columns x, y, z and, for each excitation, one column of complex pressures [Pa]
    such as ``0.5-1.2i`` or two columns named ``..._real`` and ``..._imag``. Each row is a node.
    Lines that begin with % or # are comments; the last one may name the columns, as in COMSOL's
    files. Rows with NaN, which COMSOL writes inside solids, are skipped, and a warning in the
    field's report states their number. If the file contains several frequencies, the columns at the
    frequency of the scene are used.

    Parameters
    ----------
    path : the file with the table.
    scene : the scene for which the field was computed, in the frame of the file.
    sources : the monopoles that emit the sound, with one excitation for each pressure, in the order
        of the columns.
    time_sign : time factor of the pressures, "e^{-iωt}" as in airtact or "e^{+jωt}" as in COMSOL.
        With the latter, the pressures are conjugated on loading.
    scale : length of the file's unit in metres, such as 1e-3 for mm. By default the unit is
        taken from the comment "Length unit"; without that comment it is the metre.

    Returns
    -------
    A ``SampledField`` with the field interpolated between the nodes; it is NaN outside their convex
    hull. If the phases near the sources fit neither time factor, its report contains a warning.

    Raises
    ------
    InvalidInput
        If the file cannot be read, if columns are missing, if the number of pressures per row
        differs from that of the excitations, if no pressure is at the scene's frequency, if nodes
        coincide or lie in one plane, if a number is infinite, if all pressures are 0, or if the
        phases near the sources fit the other time factor better. The error is also raised if a
        column is a level in dB, ``time_sign`` is unknown, or ``scale`` is not above zero or
        contradicts the file's comment.
    """
    path = path_of(path, "the file of samples")
    check_choice(time_sign, "time_sign", ("e^{-iωt}", "e^{+jωt}"))
    table = read_text_table(path)
    with about(path.name):
        scale = _scale_of(table, scale)
    rows = len(table.rows)
    table = table.without_nan()
    left_out = rows - len(table.rows)
    table.require("x", "y", "z")
    nodes = np.stack([table.numbers(name) for name in "xyz"], axis=1)
    names = [name for name in table.names if name not in ("x", "y", "z")]
    with about(path.name):
        names = _of_frequency(names, scene.frequency)
    columns = {name: table.complex_numbers(name) for name in names}
    with about(path.name):
        pressures = _excitations(columns)
        if not pressures.any():
            raise InvalidInput(
                f"all {pressures.size} pressures are 0; check the field that was exported.",
                code="all_zero",
            )
        excitations = sources.strengths.shape[1]
        if pressures.shape[1] != excitations:
            raise InvalidInput(
                f"the table has {counted(pressures.shape[1], 'pressure', 'pressures')} per row "
                f"({'; '.join(names)}), but the sources have "
                f"{counted(excitations, 'excitation', 'excitations')}. Keep one pressure for each "
                "excitation.",
                code="sizes_differ",
            )
        if time_sign == "e^{+jωt}":
            pressures = np.conj(pressures)
        sampled = SampledField(scene, sources, scale * nodes, pressures)
        warnings = _check_sign(sampled, time_sign)
        if left_out:
            warnings += (
                f"{left_out} of {rows} rows of {path.name} contain NaN, as exported inside "
                "solids, and are left out.",
            )
        object.__setattr__(sampled, "report", replace(sampled.report, warnings=warnings))
    return sampled


def _scale_of(table: TextTable, scale: float | None) -> float:
    if scale is not None:
        scale = positive(scale, "the scale of the samples", "metres per unit")
    units = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "µm": 1e-6, "in": 0.0254}
    for comment in table.comments:
        words = comment.replace(",", " ").split()
        if words[:2] == ["Length", "unit"] and words[-1] in units:
            stated = units[words[-1]]
            if scale is not None and abs(scale / stated - 1.0) > 1e-3:
                raise InvalidInput(
                    f"the length unit of the table is {words[-1]}, but scale is {scale:g}. Omit "
                    f"scale, or use {stated:g}.",
                    code="does_not_match",
                )
            return stated
    return 1.0 if scale is None else scale


def _of_frequency(names: Sequence[str], frequency: float) -> list[str]:
    """Return the pressure columns at the scene's frequency; reject levels in decibels."""
    for name in names:
        if "(db)" in name:
            raise InvalidInput(
                f"the column {name} is a level in dB without a phase; export the complex pressure, "
                "which is acpr.p_t in COMSOL.",
                code="does_not_match",
            )
    frequencies = {name: re.search(r"freq=([0-9.e+-]+)", name) for name in names}
    stated = {name: float(match[1]) for name, match in frequencies.items() if match}
    chosen = [name for name in names if abs(stated.get(name, frequency) - frequency) < 0.5]
    if names and not chosen:
        listed = ", ".join(f"{value:g} Hz" for value in sorted(set(stated.values())))
        raise InvalidInput(
            f"the pressures of the table are for {listed}, but the scene is at {frequency:g} Hz. "
            "Export the pressure at the scene's frequency.",
            code="does_not_match",
        )
    return chosen


def _excitations(
    columns: Mapping[str, Complex128[np.ndarray, "nodes"]],
) -> Complex128[np.ndarray, "nodes excitations"]:
    excitations = []
    for name, values in columns.items():
        stem, _, part = name.rpartition("_")
        if part == "imag" and f"{stem}_real" in columns:
            continue  # joined with its real part
        if part in ("real", "imag"):
            imaginary = f"{stem}_imag"
            if part == "imag" or imaginary not in columns:
                raise InvalidInput(
                    f"column {name} has no matching _real or _imag column. Export both parts.",
                    code="data_missing",
                )
            values = np.real(values) + 1j * np.real(columns[imaginary])
        excitations.append(values)
    if not excitations:
        raise InvalidInput(
            "the table has no column with pressures; name one column pressure, or two columns "
            "pressure_real and pressure_imag.",
            code="data_missing",
        )
    return np.stack(excitations, axis=1)


def _check_sign(sampled: SampledField, time_sign: str) -> tuple[str, ...]:
    """Check that the phase increases away from the sources; warn if it fits neither sign."""
    # Around a source in open air, the fits to the correct and the wrong sign are 1 and near 0;
    # around sources on bodies they are 0.57 to 1 and up to 0.16.
    stated, opposite = _fits(sampled)
    if opposite > max(1.5 * stated, 0.4):
        raise InvalidInput(
            f"time_sign is {time_sign}, but around the sources the pressures fit the other sign "
            f"{opposite / stated:.2g} times better. Use the other sign, or check the positions of "
            "the sources and the unit of length.",
            code="does_not_match",
        )
    if stated > 0.4:
        return ()
    return (
        f"around the sources the pressures fit neither time sign (agreement {stated:.2g} and "
        f"{opposite:.2g}; 1 is perfect): check the scale, the frequency, the medium and the "
        "positions of the sources.",
    )


def _fits(sampled: SampledField) -> Float64[np.ndarray, "2"]:
    """Return how well the phases near the sources fit outgoing and incoming waves, 0 to 1 each."""
    thinned = slice(None, None, len(sampled.nodes) // 20_000 + 1)  # enough to determine the phases
    nodes = sampled.nodes[thinned]
    pressures = np.asarray(sampled.pressures)[thinned]
    fits = np.zeros(2)
    total = 0.0
    for column in range(sampled.sources.strengths.shape[1]):
        for source in np.flatnonzero(sampled.sources.strengths[:, column]):
            distance = np.linalg.norm(nodes - sampled.sources.positions[source], axis=1)
            # Nodes within 3 wavelengths are used, but at least 1,000.
            reach = max(3.0 * sampled.scene.wavelength, np.sort(distance)[:1000][-1])
            near = (distance <= reach) & (distance > SAME_NODE)
            level = pressures[near, column] * distance[near]
            phase = np.exp(1j * sampled.scene.wavenumber.real * distance[near])
            # The sum is large only if the phase follows that of the wave.
            fits += np.abs([np.vdot(phase, level), np.vdot(phase.conj(), level)])
            total += np.abs(level).sum()
    return fits / total if total else fits
