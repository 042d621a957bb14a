"""Radiation pressure on the surfaces of bodies, and the force on the skin around a focus."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex128, Float64, Int64, Real

from airtact.acoustics.medium import Medium
from airtact.acoustics.solvers.bem.quadrature import place_nodes
from airtact.acoustics.solvers.problem import RadiatedField
from airtact.errors import InvalidInput, one_line
from airtact.geometry.panels import panels_of


def radiation_pressure(
    pressure: Complex128[np.ndarray, "points"],
    velocity: Complex128[np.ndarray, "points 3"],
    medium: Medium,
) -> Float64[np.ndarray, "points"]:
    """Return the mean pressure of sound on a sound-hard surface [Pa], positive inward.

    To second order the mean pressure is ⟨p²⟩/(2ρc²) − ρ⟨v²⟩/2. No air crosses a hard surface at
    rest. With peak values the mean pressure is therefore |P|²/(4ρc²) − ρ|U|²/4 (L. V. King, Proc.
    R. Soc. Lond. A 147, 212, 1934; T. Hasegawa, K. Yosioka, J. Acoust. Soc. Am. 46, 1139, 1969).
    A plane wave of pressure p at normal incidence exerts 2⟨p²⟩/(ρc²) on a wall.

    Parameters
    ----------
    pressure : (P,) complex peak value of the total pressure on the surface [Pa].
    velocity : (P, 3) complex peak value of the particle velocity along the surface [m/s].
    medium : the air.

    Returns
    -------
    (P,) mean pressure [Pa].

    Examples
    --------
    >>> air = Medium(sound_speed=343.1, density=1.293)
    >>> wall = radiation_pressure(np.array([2 * 1000 + 0j]), np.zeros((1, 3), dtype=complex), air)
    >>> float(wall[0] / (2 * (1000**2 / 2) / (1.293 * 343.1**2)))
    1.0
    """
    potential = np.abs(pressure) ** 2 / (4.0 * medium.density * medium.sound_speed**2)
    return potential - 0.25 * medium.density * np.sum(np.abs(velocity) ** 2, axis=1)


@dataclass(frozen=True, eq=False)
class RadiationMap:
    """Sound that one drive produces at Q points on the surfaces of all bodies of a scene.

    Attributes
    ----------
    body : (Q,) index of each point's body.
    points, normals, areas : (Q, 3) position [m], (Q, 3) outward normal and (Q,) area [m²] of each
        point.
    pressure : (Q,) total pressure, complex peak value [Pa].
    radiation_pressure : (Q,) mean pressure, positive inward [Pa].
    """

    body: Int64[np.ndarray, "points"]
    points: Float64[np.ndarray, "points 3"]
    normals: Float64[np.ndarray, "points 3"]
    areas: Float64[np.ndarray, "points"]
    pressure: Complex128[np.ndarray, "points"]
    radiation_pressure: Float64[np.ndarray, "points"]

    def __repr__(self) -> str:
        return one_line(self, f"{len(self.points)} points on surfaces")

    def force(self, body: int) -> Float64[np.ndarray, "3"]:
        """Return the force (3,) [N] that the sound exerts on a body; ``body`` is its index."""
        # Pressure acts against the outward normal.
        chosen = self.body == body
        return -(self.areas * self.radiation_pressure)[chosen] @ self.normals[chosen]

    def pad_force(self, focus: Real[np.ndarray, "3"]) -> float:
        """Return the force [N] on the skin within 5 mm of a focus, about the area of a fingertip.

        The force is positive inward, and NaN if the skin is more than 2 mm from the focus.
        """
        nearest = int(np.linalg.norm(self.points - focus, axis=1).argmin())
        # Height of the focus above the tangent plane of the nearest point
        height = float((np.asarray(focus) - self.points[nearest]) @ self.normals[nearest])
        if height > 2e-3:
            return float("nan")
        centre = focus - height * self.normals[nearest]
        pad = np.linalg.norm(self.points - centre, axis=1) < 5e-3
        # The opposite side of a thin finger may also be within the radius.
        pad &= (self.normals @ self.normals[nearest] > 0.0) & (self.body == self.body[nearest])
        return float(np.sum((self.areas * self.radiation_pressure)[pad]))


def radiation_of(field: RadiatedField, excitation: int) -> RadiationMap:
    """Compute the radiation pressure on all surfaces for one excitation of a solved field.

    The function raises ``InvalidInput`` if the scene has no body, if a body is not sound-hard, or
    if the solver does not compute the velocity on a surface.
    """
    scene = field.scene
    if not scene.obstacles:
        raise InvalidInput(
            "the scene has no body, so there is no radiation pressure; add a body.", code="empty"
        )
    for index, obstacle in enumerate(scene.obstacles):
        if obstacle.boundary != "sound_hard":
            raise InvalidInput(
                f"body {index} is {obstacle.boundary}, but radiation pressure can only be "
                "computed on sound_hard bodies.",
                code="not_supported",
            )
    shapes = [obstacle.surface.shape for obstacle in scene.obstacles]
    # Radiation pressure varies over half a wavelength, so the points must be closer than that.
    edge = scene.wavelength / 3.0
    panels = panels_of(shapes, edge, np.empty((0, 3)), smallest=edge)
    nodes = place_nodes(panels.quadratic_triangles, panels.body, panels.deviation)
    # Quadratic panels deviate from the surface; the solver evaluates the field on the panels.
    points = np.array(nodes.points)
    for index, shape in enumerate(shapes):
        on_body = nodes.body == index
        points[on_body] = shape.project(points[on_body])
    pressure = field.at(points)[:, excitation]
    velocity = field.velocity(points)[:, :, excitation]
    # Solvers whose field is valid only away from surfaces return NaN there.
    lost = int(np.sum(~np.isfinite(pressure) | ~np.isfinite(velocity).all(axis=1)))
    if lost:
        raise InvalidInput(
            f"{field.report.solver} returns no pressure or velocity at {lost} of {len(points)} "
            "points of the surfaces. Use BoundaryElement for radiation pressure.",
            code="data_missing",
        )
    return RadiationMap(
        body=nodes.body,
        points=points,
        normals=nodes.normals,
        areas=nodes.weights,
        pressure=pressure,
        radiation_pressure=radiation_pressure(pressure, velocity, scene.medium),
    )
