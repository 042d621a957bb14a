"""The Helmholtz equation in its weak form, and what the boundaries add to its right-hand sides.

The paper's equation (8), divided by the density of the air and 4π, in wavelengths: find p with

    ∫ w (∇p · ∇v − k² p v) dV − ∮ (ik/ratio) p v dS = L(v),

w being 1 in air and the ratio of the densities in a filled body. A monopole G(x, y) = e^{ikr}/r
makes the scattered pressure with the right-hand side

    L_y(v) = ∮ (w_d ∂G/∂n + w_s G) v dS + ∫_body w_v G v dV,

and by the symmetry of the form L_y(p) is also the scattered pressure, times 4π, that a total
pressure p makes at y (Kirchhoff and Helmholtz): n points out of the body, w_d = 1 − w, w_s =
ik/ratio, w_v = −w (k² − k_body²).

In the perfectly matched layer (PML) round the box, which absorbs outgoing sound without reflecting
it, the coordinates are complex, so that a wave decays along them: J.-P. Berenger, J. Comput. Phys.
114 (1994) 185; F. Collino, P. Monk, SIAM J. Sci. Comput. 19 (1998) 2061. Its terms are written out,
since NGSolve's own layer takes twice as long.
"""

from typing import Any

import numpy as np
from jaxtyping import Complex128

from airtact.acoustics.scene import Scene
from airtact.acoustics.solvers.fem.meshing.netgen import (
    CurvedMesh,
    Expression,
    FiniteSpace,
    ngsolve_library,
)
from airtact.acoustics.solvers.fem.meshing.volume import Box

THICKNESS = 0.55
"""Thickness of the layer [λ]."""

STRETCH = 1.4
"""Imaginary part of the complex coordinate over the real one."""

NEVER = 1e5
"""A position [λ] that no layer begins beyond."""


def weak_form(scene: Scene, box: Box, mesh: CurvedMesh, space: FiniteSpace) -> Expression:
    """Left-hand side, as a symbolic form of NGSolve's."""
    ngsolve = ngsolve_library()
    trial, test = space.TnT()
    squared = _plain(complex(scene.wavenumber * scene.wavelength) ** 2)
    inside = ngsolve.dx(definedon=mesh.Materials("air|body.*"))
    weights, squares = {}, {}
    for body, obstacle in enumerate(scene.obstacles):
        if obstacle.medium is not None:
            ratio, inner = _filling(scene, body)
            weights[f"body{body}"], squares[f"body{body}"] = ratio, _plain(ratio * inner)
    form = mesh.MaterialCF(weights, default=1.0) * ngsolve.grad(trial) * ngsolve.grad(test) * inside
    form -= mesh.MaterialCF(squares, default=squared) * trial * test * inside
    form += _layer_form(box, scene.wavelength, squared, trial, test, mesh)
    for body, obstacle in enumerate(scene.obstacles):
        if obstacle.ratio is not None:
            factor = -1j * np.sqrt(complex(squared)) / obstacle.ratio
            form += factor * trial * test * ngsolve.ds(f"surface{body}")
    return form


def _layer_form(
    box: Box,
    wavelength: float,
    squared: complex | float,
    trial: Expression,
    test: Expression,
    mesh: CurvedMesh,
) -> Expression:
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
    beyond = [
        ngsolve.IfPos(x - top, 1, ngsolve.IfPos(bottom - x, 1, 0)) for x, bottom, top in along
    ]
    return [1 + 1j * STRETCH * one for one in beyond]


def boundary_weights(scene: Scene) -> Complex128[np.ndarray, "3 bodies"]:
    """Weights w_d, w_s and w_v of each body."""
    weights = np.zeros((3, len(scene.obstacles)), dtype=np.complex128)
    weights[0] = 1.0
    wavenumber = scene.wavenumber * scene.wavelength
    for body, obstacle in enumerate(scene.obstacles):
        if obstacle.ratio is not None:
            weights[1, body] = 1j * wavenumber / obstacle.ratio
        if obstacle.medium is not None:
            ratio, inner = _filling(scene, body)
            weights[0, body], weights[2, body] = 1 - ratio, -ratio * (wavenumber**2 - inner)
    return weights


def _filling(scene: Scene, body: int) -> tuple[float, complex]:
    """Density of the air over that of the filling, and the square of the filling's wavenumber [1/λ²]."""
    medium = scene.obstacles[body].medium
    assert medium is not None
    return scene.medium.density / medium.density, complex(
        medium.wavenumber(scene.frequency) * scene.wavelength
    ) ** 2


def _plain(number: complex) -> complex | float:
    """Return a real number as float: NGSolve is quicker with it."""
    return number if number.imag else number.real
