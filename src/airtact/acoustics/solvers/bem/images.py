"""Bodies and their images in rigid planes: one is solved for, both carry the field."""

from collections.abc import Sequence
from dataclasses import fields, replace

import numpy as np
from jaxtyping import Complex128, Int64, Shaped

from airtact.acoustics.planes import Plane
from airtact.acoustics.solvers.bem.operator import DualSurface
from airtact.acoustics.solvers.bem.quadrature import RULE_POINTS, Nodes, place_nodes

TURNED = np.array([2, 1, 0, 4, 3, 5])
"""Nodes of a panel in the order that the image has: corners 0 and 2 change places, so that its normal is outward."""


def _order_of_nodes() -> Int64[np.ndarray, "6"]:
    """Node of a panel for each node of its image; corner 1 stays, and with it the three nodes that share a point."""
    turned = np.stack([RULE_POINTS[:, 0], 1 - RULE_POINTS.sum(axis=1)], axis=1)
    return np.linalg.norm(turned[:, None] - RULE_POINTS, axis=2).argmin(axis=1)


ORDER = _order_of_nodes()


def surface_with_images(surface: DualSurface, planes: Sequence[Plane]) -> DualSurface:
    """Return the surface of the bodies followed by that of their images."""
    for plane in planes:
        shifted = np.concatenate([surface.shifted, plane.image(surface.shifted)])
        surface = replace(surface, nodes=_with_image(surface.nodes, plane), shifted=shifted)
    return surface


def values_with_images(
    values: Complex128[np.ndarray, "nodes sounds"], planes: Sequence[Plane]
) -> Complex128[np.ndarray, "all sounds"]:
    """Return what the nodes of the bodies have, such as the pressure, followed by what those of the images have."""
    for _ in planes:
        mirrored = values.reshape(-1, len(ORDER), values.shape[1])[:, ORDER].reshape(values.shape)
        values = np.concatenate([values, mirrored])
    return values


def surface_without_images(surface: DualSurface, planes: Sequence[Plane]) -> DualSurface:
    """Return the surface of the bodies alone, from one that that of their images follows."""
    part = {
        one.name: _own(getattr(surface.nodes, one.name), planes) for one in fields(surface.nodes)
    }
    return replace(surface, nodes=Nodes(**part), shifted=_own(surface.shifted, planes))


def values_without_images(
    values: Complex128[np.ndarray, "all sounds"], planes: Sequence[Plane]
) -> Complex128[np.ndarray, "nodes sounds"]:
    """Return what the nodes of the bodies alone have."""
    return _own(values, planes)


def _own(
    values: Shaped[np.ndarray, "all ..."], planes: Sequence[Plane]
) -> Shaped[np.ndarray, "own ..."]:
    return values[: len(values) >> len(planes)]


def _with_image(nodes: Nodes, plane: Plane) -> Nodes:
    panels = nodes.quadratic_triangles
    mirrored = plane.image(panels.reshape(-1, 3)).reshape(panels.shape)[:, TURNED]
    bodies = nodes.body[::6]
    both = np.concatenate([panels, mirrored]), np.concatenate([bodies, bodies + bodies.max() + 1])
    placed = place_nodes(*both, np.zeros(2 * len(panels)), np.tile(nodes.admittance, 2))
    return replace(placed, contact=np.tile(nodes.contact, 2))
