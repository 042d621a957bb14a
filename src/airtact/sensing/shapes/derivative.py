"""Echoes of bodies, and how they change when the surfaces move: one solve for any number of motions.

Where a sound-hard surface moves outward by v along its normal, the echo of transmission m at
receiver r changes by

    1/(4π) ∫ v (∇p_m · ∇p_r − k² p_m p_r) dS,

where p_m is the pressure on the surface of the transmission, and p_r that of the receiver, were it
to emit as a monopole of strength 1 (Hadamard's formula for Neumann's condition: J. Sokolowski,
J.-P. Zolésio, Introduction to Shape Optimization, 1992, section 3.2; reciprocity makes the
receiver's field of the adjoint one).
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Complex, Complex64, Complex128, Float64, Int64

from airtact.acoustics.scene import Scene
from airtact.acoustics.solvers.bem.solutions import DirectSolution
from airtact.acoustics.solvers.bem.solver import BoundaryElement
from airtact.acoustics.sources import Monopoles
from airtact.sensing.array_waves import emitted_by_faces, heard_by_faces
from airtact.sensing.echo_model import Received
from airtact.sensing.shapes.smooth import SmoothSurface
from airtact.transducers.layout import PhasedArray


@dataclass(frozen=True, eq=False)
class SolvedEchoes:
    """Echoes of bodies, and the pressures on them from which derivatives follow.

    Attributes
    ----------
    echoes : (R, M) scattered pressure at the receivers [Pa].
    surface : the bodies' surfaces.
    emitted : (3, P, M) pressure [Pa] of each transmission on the surfaces, and its slopes along
        them [Pa/m].
    received : (3, P, R) the same of each receiver as a source of unit strength, over its strength
        [1/m].
    wavenumber : [rad/m].
    """

    echoes: Received
    surface: SmoothSurface
    emitted: Complex64[np.ndarray, "3 points transmissions"]
    received: Complex64[np.ndarray, "3 points receivers"]
    wavenumber: float

    def derivatives(
        self, shifts: Float64[np.ndarray, "points unknowns"]
    ) -> Complex[np.ndarray, "unknowns receivers transmissions"]:
        """Differentiate the echoes by unknowns that move the surfaces outward so far each [m per unit]."""
        parts = np.array([-(self.wavenumber**2), 1.0, 1.0])[:, None, None] / (4.0 * np.pi)
        weighted = (parts * self.emitted).astype(np.complex64)
        by = np.ascontiguousarray(self.received.reshape(-1, self.received.shape[2]).T)
        out = [by @ (weighted * row[:, None]).reshape(len(by.T), -1) for row in self._areas(shifts)]
        return np.stack(out)

    def _areas(self, shifts: Float64[np.ndarray, "points unknowns"]) -> np.ndarray:
        return np.ascontiguousarray((shifts * self.surface.areas[:, None]).T.astype(np.float32))


def solve_echoes(
    solver: BoundaryElement,
    scene: Scene,
    array: PhasedArray,
    codes: Complex128[np.ndarray, "elements transmissions"],
    receivers: Int64[np.ndarray, "receivers"],
) -> SolvedEchoes:
    """Solve bodies for all transmissions and for some receivers as sources; the array is in the bodies' frame."""
    faces, weights = array.face_points.reshape(-1, 3), array.element.weights
    transmissions = codes.shape[1]
    receiving = np.zeros((len(array), len(weights), len(receivers)), dtype=np.complex128)
    receiving[receivers, :, np.arange(len(receivers))] = array.gains[receivers, None] * weights
    strengths = np.concatenate(
        [emitted_by_faces(array, codes), receiving.reshape(len(faces), -1)], axis=1
    )
    solution = solver.direct_solution(scene, Monopoles(faces, strengths))
    sent = Monopoles(faces, strengths[:, :transmissions])
    surface = SmoothSurface.of(solution.surface.nodes)
    smoothed = surface.smoothed(solution.pressure.astype(np.complex64))
    return SolvedEchoes(
        _heard(
            replace(solution, sources=sent, pressure=solution.pressure[:, :transmissions]),
            array,
            receivers,
        ),
        surface,
        smoothed[:, :, :transmissions],
        smoothed[:, :, transmissions:],
        scene.wavenumber.real,
    )


def _heard(
    solution: DirectSolution, array: PhasedArray, receivers: Int64[np.ndarray, "receivers"]
) -> Received:
    """Scattered pressure that receivers get [Pa], the mean over their faces times their gains."""
    faces = array.face_points[receivers].reshape(-1, 3)
    scattered = solution.at(faces, np.zeros(len(faces), dtype=bool), total=False)
    return heard_by_faces(array, receivers, scattered)
