"""Pressures and target strengths that packages by other people computed, of spheres and a prolate spheroid.

The files beside the references say which package, and ``benchmarks/truth_by_others.py`` makes them
again.
"""

import json

import numpy as np
import pytest

import airtact as at
from airtact.geometry.primitives import Capsule
from paths import ROOT
from references import axisymmetric, relative, two_spheres

SPHERES = json.loads((ROOT / "tests/references/acoustotreams.json").read_text())
STRENGTHS = json.loads((ROOT / "tests/references/echosms.json").read_text())
AIR = at.Medium(SPHERES["sound_speed"], 1.2)
WATER = at.Medium(STRENGTHS["sound_speed"], STRENGTHS["density"])
FAR = 1000.0
"""Distance of source and receiver from the body [m]: the sound arrives as a plane wave."""


BROADSIDE = np.array([[1.0, 0.0, 0.0]])


def shapes(case: dict) -> list[Capsule]:
    placed = zip(case["radii"], case["centres"], strict=True)
    return [Capsule(radius, 0.0, at.Pose(np.eye(3), np.array(centre))) for radius, centre in placed]


@pytest.mark.parametrize("case", SPHERES["cases"], ids=lambda case: f"{len(case['radii'])} spheres")
@pytest.mark.parametrize("accuracy", [0.01, 0.001])
def test_two_and_three_spheres_are_what_acoustotreams_says(case, accuracy) -> None:
    true = np.array(case["real"]) + 1j * np.array(case["imaginary"])
    assert case["own_error"] < 2e-5
    surfaces = [at.sphere(one.radius, one.radius / 2).moved(one.pose) for one in shapes(case)]
    scene = at.Scene(
        AIR, [at.sound_hard(surface) for surface in surfaces], frequency=SPHERES["frequency"]
    )
    sources = at.Monopoles(np.array(SPHERES["sources"]), np.eye(len(SPHERES["sources"])))
    field = at.BoundaryElement(accuracy=accuracy).radiate(scene, sources)
    assert relative(field.at(np.array(SPHERES["receivers"])), true) < 1.5 * accuracy


def test_the_multipoles_of_two_spheres_are_what_acoustotreams_says() -> None:
    case = SPHERES["cases"][0]
    wavenumber = AIR.wavenumber(SPHERES["frequency"])
    sources, receivers = np.array(SPHERES["sources"]), np.array(SPHERES["receivers"])
    found, own = two_spheres.pressure_at(shapes(case), wavenumber, sources, receivers)
    assert own < 1e-5
    assert relative(found, np.array(case["real"]) + 1j * np.array(case["imaginary"])) < 2e-5


def backscattered(
    surface: at.Surface, frequency: float, directions: np.ndarray, accuracy: float
) -> np.ndarray:
    """Amplitudes [m] of the sound scattered back to where plane waves come from."""
    scene = at.Scene(WATER, [at.sound_hard(surface)], frequency=frequency)
    places = FAR * directions
    solver = at.BoundaryElement(accuracy=accuracy, precision="float64")
    field = solver.radiate(scene, at.Monopoles(places, np.eye(len(places))))
    return np.abs(np.diag(field.scattered_at(places))) * FAR**2


def amplitudes(strengths: list[float]) -> np.ndarray:
    return 10 ** (np.array(strengths) / 20)


def test_a_rigid_sphere_has_the_target_strengths_of_echosms() -> None:
    known = STRENGTHS["sphere"]
    ball, toward = at.sphere(known["radius"], known["radius"] / 4), np.array([[0.0, 0.0, 1.0]])
    found = [backscattered(ball, frequency, toward, 0.001)[0] for frequency in known["frequencies"]]
    np.testing.assert_allclose(found, amplitudes(known["strengths"]), rtol=0.008)


def spheroid(edge: float) -> at.Surface:
    major, minor = STRENGTHS["spheroid"]["semi_axes"]
    return axisymmetric.surface(axisymmetric.spheroid(minor, major), edge)


@pytest.mark.slow
def test_a_rigid_spheroid_of_70_by_10_mm_has_the_target_strengths_of_echosms() -> None:
    known, body = STRENGTHS["spheroid"], spheroid(3e-3)
    found = [
        backscattered(body, frequency, BROADSIDE, 0.003)[0] for frequency in known["frequencies"]
    ]
    np.testing.assert_allclose(found, amplitudes(known["strengths"]), rtol=0.01)
    angle = np.radians(known["angles"])
    ways = np.stack([np.sin(angle), 0 * angle, np.cos(angle)], axis=1)
    true = amplitudes(known["strengths_at_angles"])
    np.testing.assert_allclose(
        backscattered(body, 38e3, ways, 0.003), true, atol=0.003 * true.max()
    )
    # the tips of finer panels keep a thousandth
    found = backscattered(spheroid(1.5e-3), known["frequencies"][1], BROADSIDE, 0.001)
    np.testing.assert_allclose(found, amplitudes(known["strengths"][1:2]), rtol=0.001)
