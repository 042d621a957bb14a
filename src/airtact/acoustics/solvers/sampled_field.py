"""A field computed elsewhere: nodes and complex pressures from a CSV or VTU file, interpolated between the nodes."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Complex128, Float64, Int64, Num, Real
from scipy.spatial import Delaunay, KDTree, QhullError

from airtact.acoustics.scene import Scene, check_sources
from airtact.acoustics.solvers.arrays import (
    Barycentric,
    Indices,
    Mask,
    Points,
    Pressures,
    SourcePoints,
    Vectors,
)
from airtact.acoustics.solvers.problem import RadiatedField, SolveReport, SurfaceField, receivers
from airtact.acoustics.solvers.tetrahedra import Tetrahedra
from airtact.acoustics.sources import STANDS_ON, Monopoles, nearest_source
from airtact.checks import check_finite, in_mm, points_of, positive
from airtact.errors import InvalidInput, about
from airtact.files.text_table import read_text_table
from airtact.files.vtu import nodes_of_vtu

TimeSign = Literal["e^{-iωt}", "e^{+jωt}"]

NEARBY, FEWEST = 3.0, 1000
"""At least so many nodes, within this many wavelengths of a source, show the sign of time and the unit of length."""

LOOKED_AT = 20_000
"""About so many of the nodes are used for that."""

CLEAR, LEAST = 1.5, 0.4
"""How many times better another sign or length must fit than the stated one, and how well, to be believed."""

UNITS = (1.0, 0.01, 1e-3, 1e-6, 0.0254, 0.3048)
"""Metres in the units that a file may have lengths in."""

REPEATED = 1e-9
"""Nodes nearer than this are one [m]."""

_Cells = Int64[np.ndarray, "tetrahedra 4"] | None
_Samples = tuple[
    Float64[np.ndarray, "nodes 3"], Complex128[np.ndarray, "nodes excitations"], _Cells
]


@dataclass(frozen=True, eq=False)
class SampledField(RadiatedField):
    """A field given by its pressure at nodes, interpolated between them; NaN outside the cells.

    Inside a cell it interpolates p·r·e^{-ikr} linearly, with r the distance from the source nearest
    to the middle of the cell, because the phase of e^{ikr}/r varies far faster than the rest.
    Without ``tetrahedra`` the cells fill the hull of the nodes, bodies included: do not use points
    inside a body. The error is not estimated (NaN).

    Attributes
    ----------
    scene : what the field was computed for.
    sources : the monopoles that emit it.
    nodes : (N, 3) [m].
    pressures : (N, S) for each of the S excitations of the sources, as e^{-iωt}; (N,) is one
        excitation [Pa].
    tetrahedra : (T, 4) nodes of each cell; None to join the nodes by Delaunay's tetrahedra.

    Raises
    ------
    InvalidInput
        Shapes that do not match, NaN or infinity, fewer than four nodes, repeated ones, nodes in one plane, or cells
        that name nodes which are not there.
    """

    scene: Scene
    sources: Monopoles
    nodes: Real[np.ndarray, "nodes 3"]
    pressures: Num[np.ndarray, "nodes excitations"] | Num[np.ndarray, "nodes"]
    tetrahedra: _Cells = None
    report: SolveReport = field(init=False)

    __repr__ = RadiatedField.__repr__

    def __post_init__(self) -> None:
        """Check the samples, and join them where they come without cells."""
        check_sources(self.scene, self.sources)
        nodes = points_of(self.nodes, "nodes")
        pressures = np.asarray(self.pressures, dtype=np.complex128)
        pressures = pressures[:, None] if pressures.ndim == 1 else pressures
        excitations = self.sources.strengths.shape[1]
        if pressures.shape != (len(nodes), excitations):
            raise InvalidInput(
                f"the pressures have shape {pressures.shape}, but {len(nodes)} nodes and sources of {excitations} "
                f"excitations ask for ({len(nodes)}, {excitations}).",
                code="wrong_shape",
            )
        check_finite(pressures, "pressures")
        _check_repeated(nodes)
        object.__setattr__(self, "nodes", nodes)
        object.__setattr__(self, "pressures", pressures)
        report = SolveReport(
            solver="SampledField",
            nodes=len(nodes),
            nodes_per_square_wavelength=float("nan"),
            estimated_error=float("nan"),
            settings={
                "cells": "Delaunay" if self.tetrahedra is None else "mesh",
                "tetrahedra": len(self._cells),
            },
        )
        object.__setattr__(self, "report", report)

    @cached_property
    def _cells(self) -> Int64[np.ndarray, "tetrahedra 4"]:
        """Cells that are not flat."""
        cells = self.tetrahedra
        if cells is None:
            if len(self.nodes) < 4:
                raise InvalidInput(
                    f"there are {len(self.nodes)} nodes, but a tetrahedron has 4; give more.",
                    code="too_few",
                )
            cells = _delaunay(np.asarray(self.nodes, dtype=np.float64))
        elif cells.ndim != 2 or cells.shape[1] != 4:
            raise InvalidInput(
                f"the tetrahedra have shape {cells.shape}, but T cells of four nodes have (T, 4).",
                code="wrong_shape",
            )
        elif cells.size and not (cells.min() >= 0 and cells.max() < len(self.nodes)):
            raise InvalidInput(
                f"the tetrahedra name nodes {cells.min()} to {cells.max()}, but the {len(self.nodes)} nodes have the "
                f"numbers 0 to {len(self.nodes) - 1}.",
                code="out_of_range",
            )
        four = self.nodes[cells]
        edges = four[:, 1:] - four[:, :1]
        size = np.linalg.norm(edges, axis=2).max(axis=1)
        return cells[np.abs(np.linalg.det(edges)) > 1e-6 * size**3]

    @cached_property
    def _search(self) -> Tetrahedra:
        corners = np.asarray(self.nodes)[self._cells]
        return Tetrahedra(corners, np.zeros((len(corners), 6, 3)))

    @property
    def on_surface(self) -> SurfaceField:
        """Arrays of length 0: the nodes do not show where the surfaces of the bodies are."""
        return SurfaceField.empty(self.sources)

    def valid(self, points: Points) -> Mask:
        """Whether points (P, 3) [m] lie in a cell: nothing is known beyond the samples."""
        return self._holding(points_of(points, "points", least=0))[0] >= 0

    def at(self, points: Points) -> Pressures:
        """Total pressure [Pa] at points (P, 3) [m], as ``RadiatedField.at``."""
        points = receivers(points, self.sources)
        emitting = [self.sources.positions[strength != 0] for strength in self.sources.strengths.T]
        return self._interpolated(points, np.asarray(self.pressures), emitting)

    def scattered_at(self, points: Points) -> Pressures:
        """Scattered pressure [Pa] at points (P, 3) [m], as ``RadiatedField.scattered_at``.

        The open-air pressure is subtracted at the nodes, and what remains is interpolated after
        division by e^{ikr}/r of the nearest body's middle.
        """
        points = points_of(points, "points", least=0)
        found = self._interpolated(
            points, self._scattered, [self._middles] * self.sources.strengths.shape[1]
        )
        distance, source = nearest_source(points, self.sources, STANDS_ON)
        on = np.flatnonzero(distance < STANDS_ON)
        found[on[self.scene.depth(self.sources.positions[source[on]]) > -STANDS_ON]] = np.nan
        return found

    @cached_property
    def _middles(self) -> Float64[np.ndarray, "bodies 3"]:
        """Middles of the bodies that sound does not enter [m]."""
        hollow = [
            one.surface.vertices.mean(axis=0)
            for one in self.scene.obstacles
            if one.boundary != "filled"
        ]
        return np.array(hollow).reshape(-1, 3)

    @cached_property
    def _scattered(self) -> Complex128[np.ndarray, "nodes excitations"]:
        """Scattered pressure at the nodes [Pa]; not finite at a node that stands on a source."""
        return np.asarray(self.pressures) - self._incident(np.asarray(self.nodes))

    def _interpolated(
        self,
        points: Vectors,
        values: Complex128[np.ndarray, "nodes excitations"],
        centres: Sequence[SourcePoints],
    ) -> Pressures:
        """Interpolate each excitation after division by e^{ikr}/r of the centre nearest to its cell, if any."""
        number, weights = self._holding(points)
        inside = np.flatnonzero(number >= 0)
        corners, weights = self._cells[number[inside]], weights[inside]
        nodes, found = (
            np.asarray(self.nodes)[corners],
            np.full((len(points), values.shape[1]), np.nan + 0j),
        )
        for column, around in enumerate(centres):
            pressures = values[corners, column]
            if not len(around) or not len(inside):
                found[inside, column] = np.einsum("pc,pc->p", weights, pressures)
                continue
            centre = around[KDTree(around).query(nodes.mean(axis=1))[1]]
            at_nodes = np.linalg.norm(nodes - centre[:, None], axis=2)
            at_point = np.linalg.norm(points[inside] - centre, axis=1)
            divided = (
                pressures
                * at_nodes
                * np.exp(1j * self.scene.wavenumber * (at_point[:, None] - at_nodes))
            )
            found[inside, column] = np.einsum("pc,pc->p", weights, divided) / at_point
        return found

    def _holding(self, points: Points) -> tuple[Indices, Barycentric]:
        number, weights = self._search.holding(points)
        return np.where(weights.min(axis=1) < -1e-6, -1, number), weights


def _delaunay(nodes: Float64[np.ndarray, "nodes 3"]) -> Int64[np.ndarray, "tetrahedra 4"]:
    try:
        return Delaunay(nodes).simplices.astype(np.int64)
    except QhullError:
        thin = np.linalg.svd(nodes - nodes.mean(axis=0), compute_uv=False)[-1] / np.sqrt(len(nodes))
        raise InvalidInput(
            f"the {len(nodes)} nodes lie in one plane, to {1e3 * thin:.2g} mm, and hold no tetrahedron; give nodes "
            "that fill a space.",
            code="bodies_overlap",
        ) from None


def load_samples(
    path: str | Path, scene: Scene, sources: Monopoles, time_sign: TimeSign, scale: float = 1.0
) -> SampledField:
    """Load a field that another program computed.

    A CSV file has the columns x, y, z, and for each excitation a column of complex numbers such as
    ``0.5-1.2i``, or two named ``..._real`` and ``..._imag``; lines that begin with % or # are
    comments, the last of which may name the columns, as COMSOL writes them. A VTU file has point
    data of the same kind, and its tetrahedra are used.

    Parameters
    ----------
    path : the file.
    scene : what was computed.
    sources : the monopoles that emit it, one excitation for each pressure column.
    time_sign : "e^{-iωt}" as here, or "e^{+jωt}" as COMSOL, whose pressures are conjugated.
    scale : metres per unit of the file's lengths.

    Raises
    ------
    InvalidInput
        The file cannot be read, columns are missing, nodes repeated or in one plane, numbers NaN or pressures all 0, or
        the phases beside the sources contradict ``time_sign`` or ``scale``.
    """
    path = Path(path)
    if time_sign not in ("e^{-iωt}", "e^{+jωt}"):
        raise InvalidInput(
            f"time_sign is {time_sign!r}, but it must be 'e^{{-iωt}}', or 'e^{{+jωt}}' as in COMSOL.",
            code="unknown_key",
        )
    scale = positive(scale, "the scale of the samples", "metres per unit")
    nodes, pressures, cells = _read_vtu(path) if path.suffix.lower() == ".vtu" else _read_csv(path)
    with about(path.name):
        if not pressures.any():
            raise InvalidInput(
                f"all {pressures.size} pressures are 0; export a field that is not.",
                code="all_zero",
            )
        pressures = np.conj(pressures) if time_sign == "e^{+jωt}" else pressures
        sampled = SampledField(scene, sources, scale * nodes, pressures, cells)
        warning = _check_contradiction(sampled, time_sign, scale)
        object.__setattr__(sampled, "report", replace(sampled.report, warnings=warning))
    return sampled


def _check_contradiction(sampled: SampledField, time_sign: str, scale: float) -> tuple[str, ...]:
    """Check that the phase grows away from the sources, and as fast as it must; warn where neither can be seen.

    Around a source in open air all fits are 1 or near 0; around sources on bodies 0.57 to 1 and up
    to 0.16.
    """
    stated, other = _fits(sampled, 1.0)
    if other > max(CLEAR * stated, LEAST):
        raise InvalidInput(
            f"time_sign is {time_sign}, but round the sources the pressures fit the other one {other / stated:.2g} "
            "times better; state the other sign, or check where the sources stand and what a unit of length is.",
            code="does_not_match",
        )
    if stated > LEAST:
        return ()
    lengths = np.concatenate([np.array(UNITS), scale * np.geomspace(0.2, 5.0, 330)])
    fits = np.array([_fits(sampled, length / scale).max() for length in lengths])
    best = int(fits.argmax())
    if fits[best] > max(CLEAR * stated, LEAST):
        raise InvalidInput(
            f"the scale is {scale:.4g} metres per unit, but round the sources the phases vary as if it were "
            f"{lengths[best]:.3g} (a fit of {fits[best]:.2f} instead of {stated:.2f}); state that scale, or check the "
            "frequency, the medium and where the sources stand.",
            code="does_not_match",
        )
    return (
        f"the samples do not show the sign of time (a fit of {stated:.2g} against {other:.2g}); {time_sign} was stated",
    )


def _fits(sampled: SampledField, longer: float) -> Float64[np.ndarray, "2"]:
    """How well the phases around the sources fit waves that leave and waves that arrive, from 0 to 1.

    The positions of the nodes are multiplied by ``longer``.
    """
    some = slice(None, None, len(sampled.nodes) // LOOKED_AT + 1)
    nodes, pressures = longer * sampled.nodes[some], np.asarray(sampled.pressures)[some]
    fits, most = np.zeros(2), 0.0
    for column in range(sampled.sources.strengths.shape[1]):
        for source in np.flatnonzero(sampled.sources.strengths[:, column]):
            away = np.linalg.norm(nodes - sampled.sources.positions[source], axis=1)
            reach = max(
                NEARBY * sampled.scene.wavelength, np.sort(away)[: min(FEWEST, len(away))][-1]
            )
            near = (away <= reach) & (away > REPEATED)
            level = pressures[near, column] * away[near]
            phase = np.exp(1j * sampled.scene.wavenumber.real * away[near])
            fits += np.abs([np.vdot(phase, level), np.vdot(phase.conj(), level)])
            most += np.abs(level).sum()
    return fits / most if most else fits


def _check_repeated(nodes: Float64[np.ndarray, "nodes 3"]) -> None:
    pairs = KDTree(nodes).query_pairs(REPEATED, output_type="ndarray")
    if len(pairs):
        one, other = pairs[0]
        raise InvalidInput(
            f"{len(pairs)} pairs of nodes have the same position, nodes {one} and {other} at {in_mm(nodes[one])}; "
            "keep one of each, or check the scale.",
            nodes[one],
            code="given_twice",
        )


def _read_csv(path: Path) -> _Samples:
    table = read_text_table(path)
    table.require(*"xyz")
    positions = np.stack([table.numbers(name) for name in "xyz"], axis=1)
    columns = {
        name: table.complex_numbers(name) for name in table.names if name not in ("x", "y", "z")
    }
    with about(path.name):
        return positions, _excitations(columns), None


def _read_vtu(path: Path) -> _Samples:
    points, columns, cells = nodes_of_vtu(path)
    with about(path.name):
        return points, _excitations(columns), cells


def _excitations(
    columns: dict[str, Complex128[np.ndarray, "nodes"]],
) -> Complex128[np.ndarray, "nodes excitations"]:
    """Join real and imaginary columns; the others are complex by themselves."""
    found = []
    for name, values in columns.items():
        stem, _, part = name.rpartition("_")
        if part == "imag" and f"{stem}_real" in columns:
            continue
        if part in ("real", "imag"):
            other = f"{stem}_{'imag' if part == 'real' else 'real'}"
            if other not in columns:
                raise InvalidInput(
                    f"it has 1 column {name} without its other half, {other}.",
                    code="data_missing",
                )
            found.append(np.real(values) + 1j * np.real(columns[other]))
        else:
            found.append(values)
    if not found:
        raise InvalidInput(
            "it has 0 columns of pressure; name them pressure, or pressure_real and pressure_imag.",
            code="data_missing",
        )
    return np.stack(found, axis=1)
