"""Bodies and their images in rigid planes: the bodies are solved for, both carry the field."""

from collections.abc import Sequence
from dataclasses import fields, replace

import numpy as np
from jaxtyping import Complex128, Shaped

from airtact.acoustics.planes import Plane
from airtact.acoustics.solvers.bem.operator import DualSurface
from airtact.acoustics.solvers.bem.quadrature import RULE_POINTS, Nodes, place_nodes

# A reflected panel needs corners 0 and 2 exchanged for its normal to be outward. Corner 1 stays,
# and with it the three nodes that share a second collocation point.
_MIRRORED = np.array([2, 1, 0, 4, 3, 5])
_TURNED_RULE = np.stack([RULE_POINTS[:, 0], 1 - RULE_POINTS.sum(axis=1)], axis=1)
# Node of a panel for each node of its image
_NODE_ORDER = np.linalg.norm(_TURNED_RULE[:, None] - RULE_POINTS, axis=2).argmin(axis=1)


def surface_with_images(surface: DualSurface, planes: Sequence[Plane]) -> DualSurface:
    """Return the surface of the bodies followed by that of their images."""
    for plane in planes:
        nodes = surface.nodes
        panels = nodes.quadratic_triangles
        # the images count as further bodies
        mirrored = plane.image(panels.reshape(-1, 3)).reshape(panels.shape)[:, _MIRRORED]
        bodies = nodes.body[::6]
        all_nodes = place_nodes(
            np.concatenate([panels, mirrored]),
            body=np.concatenate([bodies, bodies + bodies.max() + 1]),
            deviation=np.zeros(2 * len(panels)),
            admittance=np.tile(nodes.admittance, 2),
        )
        surface = replace(
            surface,
            nodes=replace(all_nodes, contact=np.tile(nodes.contact, 2)),
            shifted=np.concatenate([surface.shifted, plane.image(surface.shifted)]),
        )
    return surface


def values_with_images(
    values: Complex128[np.ndarray, "nodes excitations"], planes: Sequence[Plane]
) -> Complex128[np.ndarray, "all excitations"]:
    """Return values at the nodes, such as the pressure, followed by those of the images."""
    for _ in planes:
        by_panel = values.reshape(-1, 6, values.shape[1])
        values = np.concatenate([values, by_panel[:, _NODE_ORDER].reshape(values.shape)])
    return values


def surface_without_images(surface: DualSurface, planes: Sequence[Plane]) -> DualSurface:
    """Return the surface of the bodies alone."""
    arrays = {
        field.name: without_images(getattr(surface.nodes, field.name), planes)
        for field in fields(surface.nodes)
    }
    return replace(surface, nodes=Nodes(**arrays), shifted=without_images(surface.shifted, planes))


def without_images(
    values: Shaped[np.ndarray, "all ..."], planes: Sequence[Plane]
) -> Shaped[np.ndarray, "nodes ..."]:
    """Return the values of the bodies alone, which stand before those of their images."""
    return values[: len(values) >> len(planes)]
