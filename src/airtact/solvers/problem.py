"""What every solver takes and gives: a scene and monopoles in, a radiated field out."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from jaxtyping import Bool, Complex128, Float64, Real

from airtact.scene.scene import Scene
from airtact.scene.sources import Monopoles


@dataclass(frozen=True)
class SolveReport:
    """How a field was made, so that a reader can trust or redo it.

    Attributes
    ----------
    solver : name of the method.
    residual : worst relative residual of the linear systems (0 for closed forms).
    iterations : iterations that the slowest right-hand side took.
    nodes : number of unknowns.
    nodes_per_square_wavelength : unknowns per λ² of the bodies' skin (infinite for closed forms).
    estimated_error : relative error of the field away from the skin as the solver itself estimates it.
    seconds : wall time by step [s].
    settings : what the solver was asked for.
    warnings : sentences that a reader of the result must see.
    citations : sources of the method.
    """

    solver: str
    residual: float
    iterations: int
    nodes: int
    nodes_per_square_wavelength: float
    estimated_error: float
    seconds: Mapping[str, float] = field(default_factory=dict)
    settings: Mapping[str, str | float | int] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    citations: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Skin:
    """The bodies' surface as the solver saw it.

    Attributes
    ----------
    points : (Q, 3) points on the skin [m].
    normals : (Q, 3) outward unit normals.
    areas : (Q,) area that each point stands for [m²].
    pressure : (Q, S) total pressure of each of the S sounds there [Pa].
    """

    points: Float64[np.ndarray, "nodes 3"]
    normals: Float64[np.ndarray, "nodes 3"]
    areas: Float64[np.ndarray, "nodes"]
    pressure: Complex128[np.ndarray, "nodes sounds"]


class RadiatedField(Protocol):
    """The sound of some monopoles in a scene, to be heard anywhere outside the bodies."""

    @property
    def scene(self) -> Scene:
        """The scene that was solved."""
        ...

    @property
    def sources(self) -> Monopoles:
        """The monopoles that speak."""
        ...

    @property
    def report(self) -> SolveReport:
        """How the field was made."""
        ...

    @property
    def skin(self) -> Skin:
        """Pressure on the bodies' skin."""
        ...

    def at(self, points: Real[np.ndarray, "points 3"]) -> Complex128[np.ndarray, "points sounds"]:
        """Total pressure [Pa] at points (P, 3) [m] for each of the S sounds; NaN where ``valid`` is False."""
        ...

    def valid(self, points: Real[np.ndarray, "points 3"]) -> Bool[np.ndarray, "points"]:
        """Whether the field exists at points (P, 3): False inside bodies, except filled ones."""
        ...


class Solver(Protocol):
    """A way to compute how sound travels in a scene."""

    def radiate(self, scene: Scene, sources: Monopoles) -> RadiatedField:
        """Solve the scene for the monopoles, one field per independent sound."""
        ...
