"""A scene of bodies and rigid planes, such as a table or a wall, in a medium at one frequency.

Image sources behind a plane produce the reflected field in front of it.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from jaxtyping import Bool, Complex128, Float64, Real

from airtact.acoustics.medium import Medium
from airtact.acoustics.sources import Monopoles
from airtact.acoustics.target import Beacons, Target
from airtact.errors import (
    InvalidInput,
    Vector,
    check_choice,
    check_frequency,
    counted,
    direction_of,
    fixed,
    in_mm,
    millimetres,
    of_kind,
    one_line,
    point_of,
    points_of,
)
from airtact.geometry.checks import NEAREST, approach, check_apart, check_surface
from airtact.geometry.pose import Pose
from airtact.geometry.surface import Surface

# Points up to this distance behind a plane count as lying on it [m].
ON_PLANE = 1e-9

# Smallest distance of a body from a plane [m]. The body and its image are then as far apart as two
# bodies must be.
MIN_GAP = 0.5 * NEAREST


@dataclass(frozen=True, eq=False)
class Plane:
    """An infinite rigid plane. The sound is on the side to which its normal points.

    ``plane`` returns an instance after checking its arguments; pass it to ``Scene``.

    Attributes
    ----------
    point : (3,) any point of the plane, in the frame of the scene [m].
    normal : (3,) unit normal.
    """

    point: Float64[np.ndarray, "3"]
    normal: Float64[np.ndarray, "3"]

    def __repr__(self) -> str:
        return one_line(
            self, f"through {in_mm(self.point)}", f"normal {np.round(self.normal, 3) + 0.0}"
        )

    def height(self, points: Real[np.ndarray, "points 3"]) -> Float64[np.ndarray, "points"]:
        """Return the distance [m] of points (P, 3) from the plane, negative behind it."""
        return (points - self.point) @ self.normal

    def image(self, points: Real[np.ndarray, "points 3"]) -> Float64[np.ndarray, "points 3"]:
        """Return the mirror images (P, 3) of points (P, 3) in the plane [m]."""
        return points - 2.0 * self.height(points)[:, None] * self.normal

    def moved(self, motion: Pose) -> "Plane":
        """Return the plane after a rigid motion."""
        return Plane(fixed(motion.apply(self.point)), fixed(motion.rotate(self.normal)))

    def kept_by(self, motion: Pose) -> bool:
        """Return whether a rigid motion, such as a shift along the plane, maps it onto itself.

        A field solved in front of the plane remains valid if all bodies move in this way.
        """
        turned = motion.rotate(self.normal[None])[0]
        height = self.height(motion.apply(self.point[None]))[0]
        return bool(np.linalg.norm(turned - self.normal) < 1e-9 and abs(height) < ON_PLANE)


def plane(point: Vector, normal: Vector) -> Plane:
    """Build an infinite rigid plane, such as a table or a wall, for ``Scene.planes``.

    On the plane, ∂p/∂n = 0; the sound field exists only in front of it. The field is exact, because
    it is computed with mirror images of the sources and bodies. A point source on the plane
    radiates twice its open-air pressure. A transducer mounted flush with the plane keeps its
    sensitivity, because sensitivities are stated for transducers mounted in a board.

    Parameters
    ----------
    point : (3,) any point of the plane, in the frame of the scene [m].
    normal : (3,) vector of any length that points to the side where the bodies and elements are.
        All of them must be on this side; elements may also lie in the plane.

    Returns
    -------
    The ``Plane``, with a normal of unit length.

    Raises
    ------
    InvalidInput
        If the normal has length 0, or if a number is NaN or infinite.

    Examples
    --------
    >>> table = plane(point=(0, 0, -0.1), normal=(0, 0, 1))
    >>> table.height(np.array([[0.0, 0, 0]])).tolist()
    [0.1]
    """
    point = point_of(point, "the point of a plane")
    return Plane(point, direction_of(normal, "the normal of a plane", code="out_of_range"))


def planes_of(planes: Sequence[Plane], surfaces: Sequence[Surface]) -> tuple[Plane, ...]:
    """Check that a scene has at most one plane, and that no body touches or crosses the plane."""
    if isinstance(planes, Plane) or not isinstance(planes, Iterable):
        raise InvalidInput(
            f"the planes of a scene must be a list such as [plane], not a {type(planes).__name__}.",
            code="wrong_kind",
        )
    planes = tuple(planes)
    for index, plane in enumerate(planes):
        of_kind(plane, Plane, f"plane {index}", "plane(point, normal)")
    if len(planes) > 1:
        # The sum over the images between parallel planes does not converge, and crossing planes
        # form a corner with additional images.
        raise InvalidInput(
            f"the scene has {len(planes)} planes, but at most one is supported; keep only the "
            "plane nearest to the foci.",
            code="too_many",
        )
    for plane in planes:
        for index, surface in enumerate(surfaces):
            nearest = surface.shape.farthest(-plane.normal)
            gap = float(plane.height(nearest[None])[0])
            if gap < MIN_GAP * (1.0 - 1e-6):
                side = "behind" if gap < 0.0 else "in front of"
                raise InvalidInput(
                    f"body {index} reaches {millimetres(abs(gap), 3)} {side} the plane at "
                    f"{in_mm(nearest)}, but it must be at least {1e3 * MIN_GAP:g} mm in front of "
                    "it. Move it away, or reverse the normal of the plane.",
                    nearest,
                    code="bodies_overlap",
                )
    return planes


def images_in(
    planes: Sequence[Plane], points: Real[np.ndarray, "points 3"]
) -> Float64[np.ndarray, "images 3"]:
    """Return points (P, 3) [m], followed by their mirror images if there is a plane."""
    return np.concatenate([points, *(plane.image(points) for plane in planes)])


def with_images(planes: Sequence[Plane], sources: Monopoles) -> Monopoles:
    """Return sources and their images in the plane, if there is one."""
    if not planes:
        return sources
    strengths = np.tile(sources.strengths, (1 + len(planes), 1))
    return Monopoles(images_in(planes, sources.positions), strengths)


def before_planes(
    planes: Sequence[Plane], points: Real[np.ndarray, "points 3"]
) -> Bool[np.ndarray, "points"]:
    """Return a mask of the points (P, 3) that are on or in front of all planes."""
    before = np.ones(len(points), dtype=np.bool_)
    for plane in planes:
        before &= plane.height(points) >= -ON_PLANE
    return before


def check_before_planes(
    planes: Sequence[Plane], points: Real[np.ndarray, "points 3"], name: str
) -> None:
    """Raise an error if one of the points (P, 3) is behind a plane."""
    for plane in planes:
        height = plane.height(points)
        behind = np.flatnonzero(height < -ON_PLANE)
        if len(behind):
            deepest = int(height.argmin())
            raise InvalidInput(
                f"{len(behind)} of {len(points)} {name} points are behind the plane: {name} "
                f"{deepest} at {in_mm(points[deepest])} is {millimetres(-height[deepest], 3)} "
                "behind it. Move it in front of the plane, or reverse the normal of the plane.",
                points[deepest],
                code="behind_plane",
            )


# Points up to this deep in a body count as lying on its surface [m].
CONTACT = 1e-9


@dataclass(frozen=True, eq=False)
class Obstacle:
    """A body of a ``Scene``: its surface, and the boundary condition there.

    Use ``sound_hard``, ``impedance`` or ``filled`` to build it.

    Attributes
    ----------
    surface : closed surface of the body, in the frame of the scene.
    boundary : ``"sound_hard"`` (∂p/∂n = 0), ``"impedance"`` (∂p/∂n + (ik/ratio) p = 0 with n
        outward, for the time factor e^{-iωt}) or ``"filled"`` (another fluid).
    ratio : real or complex impedance Z of the surface relative to ρc of the scene's medium, if
        ``boundary`` is "impedance"; otherwise None. It must be finite and nonzero, and its real
        part must not be negative.
    medium : fluid inside the body if ``boundary`` is "filled", otherwise None.
    board : whether the body consists of reflecting boards of the array, with elements in their
        faces, as built by ``reflecting_boards``; False by default.

    Raises
    ------
    InvalidInput
        If the boundary is unknown, if ``ratio`` or ``medium`` does not fit the boundary, or if the
        ratio is zero, is not finite or has a negative real part.
    """

    surface: Surface
    boundary: Literal["sound_hard", "impedance", "filled"]
    ratio: complex | float | None = None
    medium: Medium | None = None
    board: bool = False

    @property
    def kind(self) -> str:
        """The boundary condition in words."""
        return "reflecting-board" if self.board else self.boundary.replace("_", "-")

    def __repr__(self) -> str:
        return one_line(self, self.kind, repr(self.surface))

    def __post_init__(self) -> None:
        of_kind(
            self.surface,
            Surface,
            "an obstacle's surface",
            "one Surface, such as sphere(...), hand.surface or pinch().surfaces[0]",
        )
        check_choice(self.boundary, "boundary", ("sound_hard", "impedance", "filled"))
        if (self.ratio is not None) != (self.boundary == "impedance") or (
            self.medium is not None
        ) != (self.boundary == "filled"):
            raise InvalidInput(
                f"an obstacle with the boundary {self.boundary} has ratio {self.ratio} and medium "
                f"{self.medium}; set ratio only for impedance boundaries, and medium only for "
                "filled bodies.",
                code="options_clash",
            )
        if self.medium is not None:
            of_kind(
                self.medium, Medium, "the filling of an obstacle", "Medium(sound_speed, density)"
            )
        if self.ratio is None:
            return
        if not isinstance(self.ratio, complex | float | int | np.number):
            raise InvalidInput(
                f"the impedance ratio is {self.ratio!r}, but it must be a number Z/(ρc).",
                code="not_a_number",
            )
        ratio = complex(self.ratio)
        if not np.isfinite(ratio) or ratio == 0.0 or ratio.real < 0.0:
            raise InvalidInput(
                f"the impedance ratio is {ratio:g}, but it must be finite and not zero, and its "
                "real part must not be negative (the surface would emit power).",
                code="out_of_range",
            )
        object.__setattr__(self, "ratio", ratio)


def sound_hard(surface: Surface) -> Obstacle:
    """Build a rigid body, on whose surface ∂p/∂n = 0.

    Parameters
    ----------
    surface : closed surface of the body, in the frame of the scene.

    Returns
    -------
    The body as an ``Obstacle``, for use in ``Scene.obstacles``. ``BoundaryElement`` and
    ``FiniteElement`` support it; ``SphereSeries`` supports a single sphere.

    Raises
    ------
    InvalidInput
        If ``surface`` is not a ``Surface``.
    """
    return Obstacle(surface, "sound_hard")


def impedance(surface: Surface, ratio: complex | float) -> Obstacle:
    """Build a body with a locally reacting surface, ∂p/∂n + (ik/ratio) p = 0 with n outward.

    Such a surface absorbs part of the sound, like felt or foam. With a ratio of 1, it absorbs plane
    waves at normal incidence completely; with a large ratio, it reflects like ``sound_hard``.

    Parameters
    ----------
    surface : closed surface of the body, in the frame of the scene.
    ratio : relative impedance Z/(ρc), where Z is the pressure divided by the particle velocity into
        the surface, for the time factor e^{-iωt}. It must be finite and not zero, and its real part
        must not be negative. ``BoundaryElement`` and ``FiniteElement`` support such bodies;
        ``SphereSeries`` supports a single sphere.

    Returns
    -------
    The body as an ``Obstacle``, for use in ``Scene.obstacles``.

    Raises
    ------
    InvalidInput
        If the ratio is zero or not finite, or if its real part is negative, because the surface
        would then emit power.
    """
    return Obstacle(surface, "impedance", ratio=ratio)


def filled(surface: Surface, medium: Medium) -> Obstacle:
    """Build a body filled with a fluid, which sound can enter.

    ``FiniteElement`` supports such bodies; ``SphereSeries`` supports a single sphere. Other solvers
    raise ``InvalidInput``.

    Parameters
    ----------
    surface : closed surface of the body, in the frame of the scene.
    medium : fluid in the body, such as ``Medium(sound_speed, density)``. Pressure and normal
        velocity are continuous at the surface.

    Returns
    -------
    The body as an ``Obstacle``, for use in ``Scene.obstacles``.

    Raises
    ------
    InvalidInput
        If an argument has the wrong type.
    """
    return Obstacle(surface, "filled", medium=medium)


@dataclass(frozen=True, eq=False)
class Scene:
    """Bodies in a medium at one frequency.

    The coordinates of the bodies are in one frame, whose origin and axes are arbitrary. It is
    called the frame of the scene, of the bodies or of the obstacles.

    Attributes
    ----------
    medium : fluid around the bodies.
    obstacles : list of the bodies, as built by ``sound_hard``, ``impedance`` or ``filled``. They
        must be at least 0.3 mm apart, except that reflecting boards may touch each other. Empty for
        open air.
    frequency : frequency of the sound [Hz], 1 kHz to 1 MHz.
    planes : list with at most one rigid plane, such as a table (see ``plane``), at least 0.15 mm
        from all bodies; empty if only the bodies reflect sound.

    Raises
    ------
    InvalidInput
        If the frequency is outside its range, or so low that every body is smaller than 1/50 of a
        wavelength; if a body is more than 10 m from the origin of the frame, too close to another
        body or to the plane, or intersects itself; if the absorption exceeds 1 Np per wavelength;
        if there are several planes; or if an argument has the wrong type.

    Examples
    --------
    >>> f"{Scene(Medium(343.1, 1.293), [], frequency=40e3).wavelength * 1e3:.2f} mm"
    '8.58 mm'
    """

    medium: Medium
    obstacles: Sequence[Obstacle] = ()
    frequency: float = 40e3
    planes: Sequence[Plane] = ()

    def __repr__(self) -> str:
        bodies = "open air"
        if self.obstacles:
            kinds = ", ".join(sorted({obstacle.kind for obstacle in self.obstacles}))
            bodies = counted(len(self.obstacles), f"{kinds} body", "bodies")
        return one_line(
            self,
            bodies,
            counted(len(self.planes), "rigid plane", "rigid planes") if self.planes else "",
            f"{1e-3 * self.frequency:g} kHz",
            f"wavelength {millimetres(self.wavelength, 3)}",
        )

    def __post_init__(self) -> None:
        of_kind(
            self.medium, Medium, "the medium of a scene", "air() or Medium(sound_speed, density)"
        )
        object.__setattr__(self, "frequency", check_frequency(self.frequency))
        object.__setattr__(self, "obstacles", _obstacles_of(self.obstacles))
        self._check_units()
        for obstacle in self.obstacles:
            check_surface(obstacle.surface)
        # The boards of an array may touch each other.
        check_apart([obstacle.surface for obstacle in self.obstacles if not obstacle.board])
        _check_off_boards(self.obstacles)
        surfaces = [obstacle.surface for obstacle in self.obstacles]
        object.__setattr__(self, "planes", planes_of(self.planes, surfaces))

    def _check_units(self) -> None:
        extent = max((obstacle.surface.extent for obstacle in self.obstacles), default=np.inf)
        if extent < self.wavelength / 50.0:  # smaller bodies hardly change the field
            raise InvalidInput(
                f"the largest body spans {extent * 1e3:.3g} mm, which is less than 1/50 of the "
                f"wavelength of {self.wavelength * 1e3:.4g} mm at {self.frequency:g} Hz: is the "
                "frequency in kHz? Use hertz.",
                code="out_of_range",
            )
        for index, obstacle in enumerate(self.obstacles):
            # Checking one vertex is enough, because a body in millimetres is far beyond this limit.
            distance = math.hypot(*obstacle.surface.vertices[obstacle.surface.triangles[0, 0]])
            if distance > 10.0:
                raise InvalidInput(
                    f"body {index} is {distance:.4g} m from the origin, but at most 10 m is "
                    "allowed: is it in millimetres? Use metres.",
                    code="not_in_metres",
                )
        decay = self.medium.absorption * self.wavelength
        if decay > 1.0:
            raise InvalidInput(
                f"an absorption of {self.medium.absorption:g} Np/m leaves only "
                f"{np.exp(-decay):.2g} of the sound after one wavelength: is it in dB/km? Divide "
                "it by 8686.",
                code="out_of_range",
            )

    @property
    def boards(self) -> tuple[int, ...]:
        """Indices of the obstacles that are reflecting boards of the array."""
        return tuple(index for index, obstacle in enumerate(self.obstacles) if obstacle.board)

    @cached_property
    def wavenumber(self) -> complex:
        """Wavenumber [1/m], whose imaginary part is the absorption."""
        return self.medium.wavenumber(self.frequency)

    @cached_property
    def wavelength(self) -> float:
        """Wavelength [m]."""
        return self.medium.wavelength(self.frequency)

    def depth(
        self, points: Real[np.ndarray, "points 3"], within: float = np.inf
    ) -> Float64[np.ndarray, "points"]:
        """Return how deep [m] each of P points (P, 3) lies inside the bodies.

        The depth (P,) is negative outside all bodies, and -inf if there are no bodies. If a point
        is inside several bodies, the largest of its depths in them is returned. For each point,
        bodies whose bounding box is more than ``within`` [m] away are ignored.

        The method raises ``InvalidInput`` if the points have the wrong shape, or are NaN or
        infinite.
        """
        points = points_of(points, "points", least=0)
        depth = np.full(len(points), -np.inf)
        for obstacle in self.obstacles:
            surface = obstacle.surface
            if np.isinf(within):
                depth = np.maximum(depth, surface.depth(points))
                continue
            extremes = surface.shape.extreme_points()
            off = np.maximum(extremes.min(axis=0) - points, points - extremes.max(axis=0))
            close = (off < within).all(axis=1)
            depth[close] = np.maximum(depth[close], surface.depth(points[close]))
        return depth


def _obstacles_of(obstacles: Sequence[Obstacle]) -> tuple[Obstacle, ...]:
    if isinstance(obstacles, Obstacle | Surface) or not isinstance(obstacles, Iterable):
        raise InvalidInput(
            "the obstacles of a scene must be a list such as [sound_hard(surface)], not a "
            f"{type(obstacles).__name__}.",
            code="wrong_kind",
        )
    obstacles = tuple(obstacles)
    for index, obstacle in enumerate(obstacles):
        of_kind(obstacle, Obstacle, f"obstacle {index}", "sound_hard(surface)")
    return obstacles


def _check_off_boards(obstacles: Sequence[Obstacle]) -> None:
    boards = [obstacle for obstacle in obstacles if obstacle.board]
    for index, obstacle in enumerate(obstacles):
        for board in boards:
            if obstacle.board:
                continue
            # Rounding errors must not reject a body at exactly this distance.
            contact = approach(obstacle.surface, board.surface, NEAREST * (1.0 - 1e-9))
            if contact is not None:
                gap = "intersects"
                if contact.gap > CONTACT:
                    gap = f"is {millimetres(contact.gap, 3)} from"
                raise InvalidInput(
                    f"body {index} {gap} a reflecting board at {in_mm(contact.position)}, but it "
                    f"must be at least {1e3 * NEAREST:g} mm away: move the body or the array.",
                    contact.position,
                    code="bodies_overlap",
                )


def admittances(scene: Scene) -> Complex128[np.ndarray, "bodies"]:
    """Return ρc/Z of each body's surface, which is 0 unless its boundary is "impedance"."""
    of_kind(scene, Scene, "the scene", "Scene(medium, obstacles, frequency)")
    ratios = [obstacle.ratio for obstacle in scene.obstacles]
    return np.array([0.0 if ratio is None else 1.0 / ratio for ratio in ratios], np.complex128)


def check_outside(scene: Scene, points: Real[np.ndarray, "points 3"], name: str) -> None:
    """Raise an error if points lie in a body or behind a plane.

    The message calls each point ``name``, such as "focus" or "transducer".
    """
    points = points_of(points, f"{name} points")
    of_kind(scene, Scene, "the scene", "Scene(medium, obstacles, frequency)")
    check_not_inside(scene.depth(points, within=scene.wavelength), points, name)
    check_before_planes(scene.planes, points, name)


def check_not_inside(
    depth: Float64[np.ndarray, "points"], points: Float64[np.ndarray, "points 3"], name: str
) -> None:
    """Raise an error if a point lies inside a body, more than ``CONTACT`` [m] deep."""
    count = int((depth > CONTACT).sum())
    if count:
        deepest = int(depth.argmax())
        count_note = f", the deepest of {count}" if count > 1 else ""
        raise InvalidInput(
            f"{name} {deepest} at {in_mm(points[deepest])} is {depth[deepest] * 1e3:.3g} mm inside "
            f"a body{count_note}. Move this point out of the body, or move the body away.",
            points[deepest],
            code="inside_body",
        )


def check_sources(scene: Scene, sources: Monopoles, planes: bool = False) -> None:
    """Raise an error if the sources have the wrong type, or if one is in a body or behind a plane.

    In messages, the sources made by ``Target.beacons`` are called foci. ``planes`` is True if the
    solver supports planes.
    """
    of_kind(scene, Scene, "the scene", "Scene(medium, obstacles, frequency)")
    beacons = (
        "target.beacons()" if isinstance(sources, Target) else "Monopoles(positions, strengths)"
    )
    of_kind(sources, Monopoles, "the source of the scene", beacons)
    if not planes:
        check_no_planes(scene, "this solver")
    check_outside(scene, sources.positions, "focus" if isinstance(sources, Beacons) else "source")


def check_no_planes(scene: Scene, solver: str) -> None:
    """Raise an error if ``solver`` does not support the scene's planes or boards."""
    if of_kind(scene, Scene, "the scene", "Scene(medium, obstacles, frequency)").planes:
        raise InvalidInput(
            f"the scene has {counted(len(scene.planes), 'plane', 'planes')}, which {solver} does "
            "not support: remove the planes, or solve with BoundaryElement (FreeField if there "
            "are no bodies).",
            code="not_supported",
        )
    check_no_boards(scene, solver)


def check_no_boards(scene: Scene, solver: str) -> None:
    """Raise an error if ``solver`` does not support the reflecting boards of the scene."""
    if scene.boards:
        raise InvalidInput(
            "the scene has "
            f"{counted(len(scene.boards), 'reflecting board', 'reflecting boards')}, which "
            f"{solver} does not support: remove the boards from the obstacles, or solve with "
            "BoundaryElement.",
            code="not_supported",
        )
