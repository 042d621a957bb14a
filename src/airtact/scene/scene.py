"""A scene: bodies in a medium at one frequency."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float64, Real

from airtact.conventions import InvalidInput
from airtact.scene.geometry import Surface
from airtact.scene.guards import place, points_of, positive
from airtact.scene.medium import Medium
from airtact.scene.surface_checks import check_apart, check_surface

CONTACT = 1e-9
"""Points up to this deep in a body stand on its skin [m]."""


@dataclass(frozen=True, eq=False)
class Obstacle:
    """A body and what its skin does to sound; built by ``sound_hard``, ``impedance`` and ``filled``.

    Attributes
    ----------
    surface : its skin.
    boundary : ``"sound_hard"`` (∂p/∂n = 0), ``"impedance"`` (∂p/∂n + (ik/ratio) p = 0) or ``"filled"`` (another fluid).
    ratio : Z/(ρc) of an impedance, else None.
    medium : what fills it, else None.
    """

    surface: Surface
    boundary: Literal["sound_hard", "impedance", "filled"]
    ratio: complex | None = None
    medium: Medium | None = None

    def __post_init__(self) -> None:
        """Check that the boundary has what it needs and no more."""
        wanted = {"sound_hard": (False, False), "impedance": (True, False), "filled": (False, True)}
        if self.boundary not in wanted:
            raise InvalidInput(f"boundary is {self.boundary!r}, but it is one of {', '.join(wanted)}.")
        given = (self.ratio is not None, self.medium is not None)
        if given != wanted[self.boundary]:
            raise InvalidInput(
                f"an obstacle of boundary {self.boundary} has ratio {self.ratio} and medium {self.medium}, but an "
                "impedance takes a ratio, a filled one a medium, and none takes both."
            )
        if self.ratio is None:
            return
        ratio = complex(self.ratio)
        if not np.isfinite(ratio) or ratio == 0.0 or ratio.real < 0.0:
            raise InvalidInput(
                f"the impedance ratio is {ratio:g}, but it must be finite, not zero, and its real part not negative "
                "(the skin would give off power)."
            )
        object.__setattr__(self, "ratio", ratio)


def sound_hard(surface: Surface) -> Obstacle:
    """Build a body that no sound enters.

    Parameters
    ----------
    surface : its skin.
    """
    return Obstacle(surface, "sound_hard")


def impedance(surface: Surface, ratio: complex) -> Obstacle:
    """Build a body with a locally reacting skin: ∂p/∂n + (ik/ratio) p = 0, n outward.

    Parameters
    ----------
    surface : its skin.
    ratio : Z/(ρc), with a real part that is not negative.

    Raises
    ------
    InvalidInput
        When the ratio is zero, not finite, or gives off power.
    """
    return Obstacle(surface, "impedance", ratio=ratio)


def filled(surface: Surface, medium: Medium) -> Obstacle:
    """Build a body of another fluid.

    Parameters
    ----------
    surface : its skin.
    medium : what is inside.
    """
    return Obstacle(surface, "filled", medium=medium)


@dataclass(frozen=True, eq=False)
class Scene:
    """What is in the air, at one frequency.

    Attributes
    ----------
    medium : what sound travels in.
    obstacles : the bodies, which do not touch.
    frequency : [Hz], above zero.

    Raises
    ------
    InvalidInput
        When the frequency is not above zero, a surface crosses itself or two bodies overlap.

    Examples
    --------
    >>> f"{Scene(Medium(343.1, 1.293), [], frequency=40e3).wavelength * 1e3:.2f} mm"
    '8.58 mm'
    """

    medium: Medium
    obstacles: Sequence[Obstacle]
    frequency: float = 40e3

    def __post_init__(self) -> None:
        """Check the frequency and the bodies."""
        object.__setattr__(self, "frequency", positive(self.frequency, "frequency", "Hz"))
        object.__setattr__(self, "obstacles", tuple(self.obstacles))
        for obstacle in self.obstacles:
            check_surface(obstacle.surface)
        check_apart([obstacle.surface for obstacle in self.obstacles])

    @property
    def wavenumber(self) -> complex:
        """Wavenumber with absorption [1/m]."""
        return self.medium.wavenumber(self.frequency)

    @property
    def wavelength(self) -> float:
        """Wavelength [m]."""
        return self.medium.wavelength(self.frequency)

    def depth(self, points: Real[np.ndarray, "points 3"]) -> Float64[np.ndarray, "points"]:
        """How deep points lie in a body [m]: the largest over all bodies, negative outside, -inf when there are none.

        Parameters
        ----------
        points : (P, 3) [m].
        """
        depth = np.full(len(points), -np.inf)
        for obstacle in self.obstacles:
            depth = np.maximum(depth, obstacle.surface.depth(points))
        return depth


def check_outside(scene: Scene, points: Real[np.ndarray, "points 3"], what: str) -> None:
    """Refuse points inside bodies; on the skin (up to 1e-9 m deep) is allowed.

    Parameters
    ----------
    scene : the bodies.
    points : (P, 3) [m].
    what : what one point is, for the sentence: "focus", "transducer".

    Raises
    ------
    InvalidInput
        With how many lie inside, the deepest one and how deep it is.
    """
    given = points_of(np.asarray(points), f"{what} points")
    depth = scene.depth(given)
    inside = np.flatnonzero(depth > CONTACT)
    if len(inside):
        deepest = int(depth.argmax())
        raise InvalidInput(
            f"{len(inside)} of {len(given)} {what} points lie inside a body: {what} {deepest} at "
            f"{place(given[deepest])} is {depth[deepest] * 1e3:.3g} mm deep; move it out or the body away."
        )
