"""Run one case with bempp-cl, in its own environment: ``python bempp_script.py case.npz answer.npz``.

Galerkin with continuous linear elements, Burton-Miller, OpenCL (or Numba, where the case says so),
GMRES to 1e-3 in the strong form, one beacon in each focus. No part of airtact is imported.
"""

# pyright: reportMissingImports=false

import sys
import time
from importlib.metadata import version

import numpy as np

TOLERANCE = 1e-3


def main(case_file: str, answer_file: str) -> None:
    """Time assembly, GMRES and evaluation on a mesh, as many times as the case asks, after one on a small mesh."""
    import bempp_cl.api as bempp
    from bempp_cl.api.operators.boundary import helmholtz, sparse
    from bempp_cl.api.operators.potential.helmholtz import double_layer
    from peak_memory import write_answer

    case = np.load(case_file)
    bempp.DEFAULT_DEVICE_INTERFACE = str(case.get("device", "opencl"))
    wavenumber = float(case["wavenumber"])
    coupling = 1j / wavenumber

    @bempp.callable(complex=True, jit=True, parameterized=True)
    def arriving(point, normal, domain, result, given):
        """Evaluate p + i/k ∂p/∂n of a unit monopole at ``given[:3]``, ``given[3]`` being k."""
        x, y, z = point[0] - given[0].real, point[1] - given[1].real, point[2] - given[2].real
        distance = np.sqrt(x * x + y * y + z * z)
        k = given[3].real
        pressure = np.exp(1j * k * distance) / distance
        along = (x * normal[0] + y * normal[1] + z * normal[2]) / distance
        result[0] = pressure * (1 + (1j / k) * (1j * k - 1 / distance) * along)

    def solve(vertices, triangles):
        began = time.perf_counter()
        space = bempp.function_space(bempp.Grid(vertices.T, triangles.T), "P", 1)
        identity = sparse.identity(space, space, space)
        system = 0.5 * identity - helmholtz.double_layer(space, space, space, wavenumber)
        system = system + coupling * helmholtz.hypersingular(space, space, space, wavenumber)
        scattered = double_layer(space, case["elements"].T, wavenumber)
        rows = []
        for focus in case["foci"]:
            given = np.array([*focus, wavenumber], dtype=np.complex128)
            right = bempp.GridFunction(space, fun=arriving, function_parameters=given)
            pressure, failed = bempp.linalg.gmres(
                system, right, tol=TOLERANCE, use_strong_form=True
            )
            if failed:
                raise RuntimeError(f"GMRES of bempp-cl stopped with {failed}")
            offset = np.linalg.norm(case["elements"] - focus, axis=1)
            rows.append(np.exp(1j * wavenumber * offset) / offset + scattered.evaluate(pressure)[0])
        return np.array(rows), time.perf_counter() - began, space.global_dof_count

    solve(case["warm_vertices"], case["warm_triangles"])
    write_answer(answer_file, case, solve, "bempp-cl " + version("bempp-cl"))


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2])
