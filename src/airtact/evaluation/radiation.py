"""Radiation pressure on the surfaces of bodies, and the force on the skin round a focus."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Complex128, Float64, Int64, Real

from airtact.acoustics.medium import Medium
from airtact.acoustics.solvers.bem.quadrature import place_nodes
from airtact.acoustics.solvers.problem import RadiatedField, SolveReport
from airtact.errors import InvalidInput, in_mm, positive
from airtact.geometry.mesh.arrays import QuadraticTriangles
from airtact.geometry.panels import panels_of
from airtact.printing import one_line

PAD_RADIUS = 5e-3
"""Radius of the pad round a focus [m]; a fingertip has about 1 cm²."""


def radiation_pressure(
    pressure: Complex128[np.ndarray, "points"],
    velocity: Complex128[np.ndarray, "points 3"],
    medium: Medium,
) -> Float64[np.ndarray, "points"]:
    """Return the mean pressure of sound on a sound-hard surface [Pa], inwards where positive.

    To second order the mean pressure is ⟨p²⟩/(2ρc²) − ρ⟨v²⟩/2, and no air crosses a hard surface at
    rest, so that with peak values it is |P|²/(4ρc²) − ρ|U|²/4 (L. V. King, Proc. R. Soc. Lond. A
    147, 212, 1934; T. Hasegawa, K. Yosioka, J. Acoust. Soc. Am. 46, 1139, 1969). Before a wall that
    a plane wave p meets squarely it is 2⟨p²⟩/(ρc²).

    Parameters
    ----------
    pressure : (P,) total complex pressure on the surface, peak [Pa].
    velocity : (P, 3) total complex particle velocity along the surface, peak [m/s].
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
class Pad:
    """The piece of skin round a focus.

    Attributes
    ----------
    centre : (3,) the point of the skin nearest the focus [m].
    area : [m²].
    force : of the sound on it [N], into the skin where positive.
    """

    centre: Float64[np.ndarray, "3"]
    area: float
    force: float


@dataclass(frozen=True, eq=False)
class RadiationMap:
    """Sound on the surfaces of all bodies of a scene under one drive.

    Attributes
    ----------
    quadratic_triangles : (T, 6, 3) panels of the surfaces [m]; panel t has the points 6 t to 6 t +
        5.
    body : (T,) the body of each panel.
    points, normals, areas : (Q, 3) [m], (Q, 3) outward and (Q,) [m²] of each point.
    pressure : (Q,) total peak pressure [Pa].
    velocity : (Q, 3) total peak particle velocity, along the surface [m/s].
    radiation_pressure : (Q,) mean pressure inwards [Pa].
    report : how the solver came to it.
    """

    quadratic_triangles: QuadraticTriangles
    body: Int64[np.ndarray, "panels"]
    points: Float64[np.ndarray, "points 3"]
    normals: Float64[np.ndarray, "points 3"]
    areas: Float64[np.ndarray, "points"]
    pressure: Complex128[np.ndarray, "points"]
    velocity: Complex128[np.ndarray, "points 3"]
    radiation_pressure: Float64[np.ndarray, "points"]
    report: SolveReport

    def __repr__(self) -> str:
        strongest = np.nanmax(np.abs(self.pressure), initial=0.0)
        return one_line(
            self, f"{len(self.points)} points on surfaces", f"at most {strongest:.0f} Pa"
        )

    def force(self, body: int) -> Float64[np.ndarray, "3"]:
        """(3,) force of the sound on a body, by its number [N]."""
        count = int(self.body.max()) + 1
        if not 0 <= body < count:
            raise InvalidInput(
                f"there is no body {body}; the scene has bodies 0 to {count - 1}.",
                code="unknown_name",
            )
        # Six quadrature points on each panel. Pressure acts against the outward normal.
        chosen = np.repeat(self.body, 6) == body
        return -(self.areas * self.radiation_pressure)[chosen] @ self.normals[chosen]

    def pad(self, focus: Real[np.ndarray, "3"], radius: float = PAD_RADIUS) -> Pad | None:
        """Return the skin round a focus with the force on it; None if the skin is over 2 mm away.

        Parameters
        ----------
        focus : (3,) [m].
        radius : how far the pad reaches from the point of the skin nearest the focus [m].

        Raises
        ------
        InvalidInput
            If the radius is not positive, or too small to hold a point of the skin.
        """
        radius = positive(radius, "the radius of a pad", "m")
        chosen, centre = self.around(focus, radius)
        if centre is None:
            return None
        # A radius below the distance of the quadrature points would give a force of 0.
        if not chosen.any():
            nearest = np.linalg.norm(self.points - centre, axis=1).min()
            raise InvalidInput(
                f"a pad of {1e3 * radius:.3g} mm round the focus at {in_mm(np.asarray(focus))} "
                f"holds no point of the skin, the nearest being {1e3 * nearest:.3g} mm away; give "
                "a larger radius.",
                code="out_of_range",
            )
        force = float(np.sum((self.areas * self.radiation_pressure)[chosen]))
        return Pad(centre, float(self.areas[chosen].sum()), force)

    def around(
        self, focus: Real[np.ndarray, "3"], radius: float
    ) -> tuple[Bool[np.ndarray, "points"], Float64[np.ndarray, "3"] | None]:
        """Return which points belong to the pad round a focus (Q,), and its centre (3,).

        The centre is None where the skin is far away.
        """
        away = np.linalg.norm(self.points - focus, axis=1)
        nearest = int(away.argmin())
        # The nearest skin is below the focus, in the tangent plane of the nearest node.
        height = float((np.asarray(focus) - self.points[nearest]) @ self.normals[nearest])
        # A focus over 2 mm from the skin has no pad.
        if height > 2e-3:
            return np.zeros(len(away), dtype=bool), None
        centre = focus - height * self.normals[nearest]
        body = np.repeat(self.body, 6)
        # The opposite side of a thin finger may also be within the radius.
        facing = self.normals @ self.normals[nearest] > 0.0
        within = np.linalg.norm(self.points - centre, axis=1) < radius
        return within & facing & (body == body[nearest]), centre


def radiation_of(field: RadiatedField, excitation: int) -> RadiationMap:
    """Compute the radiation pressure on all surfaces for one excitation of a solved field.

    It raises ``InvalidInput`` if there is no body, one is not sound-hard, or the velocity on a
    surface is not known.
    """
    scene = field.scene
    if not scene.obstacles:
        raise InvalidInput(
            "the scene has no obstacle, so there is no surface to press on.", code="empty"
        )
    for index, obstacle in enumerate(scene.obstacles):
        if obstacle.boundary != "sound_hard":
            raise InvalidInput(
                f"body {index} is {obstacle.boundary}, but radiation pressure is computed on "
                "sound_hard bodies only.",
                code="not_supported",
            )
    shapes = [obstacle.surface.shape for obstacle in scene.obstacles]
    # Radiation pressure varies over half a wavelength.
    edge = scene.wavelength / 3.0
    panels = panels_of(shapes, edge, np.empty((0, 3)), smallest=edge)
    nodes = place_nodes(panels.quadratic_triangles, panels.body, panels.deviation)
    # Quadratic panels deviate from the surface; the solver evaluates pressure and velocity on it.
    points = np.array(nodes.points)
    for index, shape in enumerate(shapes):
        on_body = nodes.body == index
        points[on_body] = shape.project(points[on_body])
    pressure = field.at(points)[:, excitation]
    velocity = field.velocity(points)[:, :, excitation]
    # Solvers that only know the field away from surfaces return NaN on them.
    lost = int(np.sum(~np.isfinite(pressure) | ~np.isfinite(velocity).all(axis=1)))
    if lost:
        raise InvalidInput(
            f"{field.report.solver} returns no pressure or velocity at {lost} of {len(points)} "
            "points of the surfaces; take BoundaryElement for radiation pressure.",
            code="data_missing",
        )
    return RadiationMap(
        quadratic_triangles=panels.quadratic_triangles,
        body=panels.body,
        points=points,
        normals=nodes.normals,
        areas=nodes.weights,
        pressure=pressure,
        velocity=velocity,
        radiation_pressure=radiation_pressure(pressure, velocity, scene.medium),
        report=field.report,
    )
