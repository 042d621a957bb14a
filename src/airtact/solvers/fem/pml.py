"""The perfectly matched layer (PML) round the box, which absorbs outgoing sound without reflecting it.

In the layer the coordinates x, y and z are complex, so that a wave decays along them: J.-P. Berenger, J. Comput. Phys.
114 (1994) 185; F. Collino, P. Monk, SIAM J. Sci. Comput. 19 (1998) 2061. The terms are written out here, since
NGSolve's own layer takes twice as long.
"""

from typing import Any

from airtact.solvers.fem.meshing.netgen import CurvedMesh, Expression, ngsolve_library
from airtact.solvers.fem.meshing.volume import Box

THICKNESS = 0.55
"""Thickness of the layer [λ]."""

STRETCH = 1.4
"""Imaginary part of the complex coordinate over the real one."""

NEVER = 1e5
"""A position [λ] that no layer begins beyond."""


def layer_form(
    box: Box, wavelength: float, squared: complex | float, trial: Expression, test: Expression, mesh: CurvedMesh
) -> Expression:
    """Weak form of the Helmholtz equation in the layer.

    Parameters
    ----------
    box : the air inside the layer.
    wavelength : [m].
    squared : square of the wavenumber [1/λ²].
    trial, test : trial and test function.
    mesh : its material ``layer`` is the layer.
    """
    ngsolve = ngsolve_library()
    layer, stretch = ngsolve.dx(definedon=mesh.Materials("layer")), _stretches(box, wavelength)
    volume = stretch[0] * stretch[1] * stretch[2]
    pairs = zip(ngsolve.grad(trial), ngsolve.grad(test), stretch, strict=True)
    form = sum(volume / along**2 * one * other for one, other, along in pairs) * layer
    return form - squared * volume * trial * test * layer


def _stretches(box: Box, wavelength: float) -> list[Any]:
    """Differentiate the complex coordinates along x, y and z; there is no layer beyond a mirror."""
    ngsolve = ngsolve_library()
    low, high = box.low / wavelength, box.high / wavelength
    for mirror in box.mirrors:
        low[mirror.axis] = -NEVER
    along = zip((ngsolve.x, ngsolve.y, ngsolve.z), low.tolist(), high.tolist(), strict=True)
    beyond = [ngsolve.IfPos(x - top, 1, ngsolve.IfPos(bottom - x, 1, 0)) for x, bottom, top in along]
    return [1 + 1j * STRETCH * one for one in beyond]
