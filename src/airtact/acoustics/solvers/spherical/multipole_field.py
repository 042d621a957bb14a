"""The scattered field as a multipole expansion, evaluated without sums over the surfaces.

Outside the smallest ball around the bodies, the scattered pressure is Σ a_nm h_n(kr) Y_nm, and
orders far above k times the radius of the ball are negligible. The coefficients are computed on a
sphere, and the expansion is tabulated once on interpolation spheres around the bodies. The field is
interpolated between their points: along the angles as a Fourier series by a kernel of few points
(A. H. Barnett, J. Magland, L. af Klinteberg, SIAM J. Sci. Comput. 41 (2019) C479), and along 1/r by
Chebyshev polynomials.

In front of a rigid plane, the field u of the bodies without their images is expanded. The scattered
pressure at x is u(x) + u(x*), where x* is the image of x, plus the pressure of the sources' images.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Complex64, Complex128, Float32, Float64, Int64
from scipy.fft import fft, ifft2
from scipy.special import sph_harm_y_all

from airtact import _kernels
from airtact.acoustics.scene import Scene, before_planes, images_in, with_images
from airtact.acoustics.solvers.problem import RadiatedField, SurfaceField
from airtact.acoustics.solvers.shared import (
    Indices,
    Lengths,
    Mask,
    Points,
    Pressures,
    Vectors,
    available_memory,
    chebyshev_weights,
    monopole_pressure,
    sphere_rule,
)
from airtact.acoustics.solvers.spherical.radial_functions import outgoing_shapes
from airtact.errors import InvalidInput, of_kind
from airtact.timing import Clock, Progress

# Gap between the bodies and the smallest sphere [λ]; some solutions are invalid closer to a body.
MARGIN = 1.0

# Number of grid points along each angle that are used for one interpolated value.
SPREAD = 5


@dataclass(frozen=True, eq=False)
class InterpolationSpheres:
    """Scattered pressure divided by e^{ikr}/r, on concentric spheres around the bodies.

    Attributes
    ----------
    centre : (3,) centre of the spheres [m].
    radius : radius of the smallest sphere [m].
    order : highest order of the expansion.
    values : (A, B, R, S) values for each polar angle, azimuth, radius and excitation. There are 2
        ``order`` + 2 polar angles and twice as many azimuths. Both grids extend a little beyond the
        full range, as padding for the interpolation. For the radii r, the quotients ``radius``/r
        are the Chebyshev points of [0, 1].
    """

    centre: Float64[np.ndarray, "3"]
    radius: float
    order: int
    values: Complex64[np.ndarray, "polar azimuths radii excitations"]

    def at(self, offsets: Vectors, wavenumber: complex) -> Pressures:
        """Return the scattered pressure [Pa] at points (P, 3) relative to the centre [m]."""
        _, azimuths, radii, excitations = self.values.shape
        distance = np.sqrt(np.einsum("pd,pd->p", offsets, offsets))
        step = 2 * np.pi / (azimuths - SPREAD)
        azimuth = np.arctan2(offsets[:, 1], offsets[:, 0]) % (2 * np.pi)
        polar = np.arctan2(np.hypot(offsets[:, 0], offsets[:, 1]), offsets[:, 2])
        first_azimuth, azimuth_weights = _window(azimuth, step)
        first_polar, polar_weights = _window(polar, step)
        strides = np.array([azimuths * radii * excitations, radii * excitations])
        # Divided by its carrier wave, the field varies slowly along r.
        slow = _kernels.interpolate(
            self.values.reshape(-1, excitations),
            first_polar * strides[0] + first_azimuth * strides[1],
            strides,
            polar_weights,
            azimuth_weights,
            chebyshev_weights(1 - 2 * self.radius / distance, radii),
        )
        phase = np.exp(1j * wavenumber * (distance - self.radius))
        return slow * (self.radius / distance * phase)[:, None]


@dataclass(frozen=True, eq=False, repr=False)
class MultipoleField(RadiatedField):
    """A solved field whose scattered part is a multipole expansion.

    Attributes
    ----------
    solved : the original field, used inside the smallest interpolation sphere.
    report : report of the solve, including the error of the expansion.
    errors : (S,) relative error of each excitation, due to both the solution and the expansion.
    """

    solved: RadiatedField
    spheres: InterpolationSpheres
    errors: Float64[np.ndarray, "excitations"]

    @property
    def on_surface(self) -> SurfaceField:
        """Pressure of the original field on the bodies' surfaces."""
        return self.solved.on_surface

    @property
    def ball(self) -> tuple[Float64[np.ndarray, "3"], float]:
        """Centre and radius of the ball around the bodies [m]."""
        return self.spheres.centre, self.spheres.radius - MARGIN * self.scene.wavelength

    def _valid(self, points: Vectors) -> Mask:
        valid = self._expanded(points)
        valid[~valid] = self.solved.valid(points[~valid])
        return valid

    def _at(self, points: Vectors) -> Pressures:
        away = self._expanded(points)
        if away.all():
            return self._away(points)
        out = self.nowhere(points)
        out[away] = self._away(points[away])
        out[~away] = self.solved.at(points[~away])
        return out

    def _scattered_at(self, points: Vectors) -> Pressures:
        if self.scene.planes:  # the expansion omits the images of the sources
            return self.solved.scattered_at(points)
        away = self._expanded(points)
        out = self.nowhere(points)
        out[away] = self.spheres.at(points[away] - self.spheres.centre, self.scene.wavenumber)
        out[~away] = self.solved.scattered_at(points[~away])
        return out

    def error_at(self, points: Points) -> Float64[np.ndarray, "excitations"]:
        """Relative error of each excitation, estimated when the field was expanded."""
        return self.errors

    def _away(self, points: Vectors) -> Pressures:
        planes = self.scene.planes
        emitting = with_images(planes, self.sources)
        offsets = images_in(planes, points) - self.spheres.centre
        scattered = self.spheres.at(offsets, self.scene.wavenumber)
        scattered = scattered.reshape(1 + len(planes), len(points), self.excitations).sum(axis=0)
        return scattered + monopole_pressure(
            points, emitting.positions, emitting.strengths, self.scene.wavenumber, "float64"
        )

    def _expanded(self, points: Vectors) -> Mask:
        """Return a mask of points before all planes and, with their images, outside the spheres."""
        planes = self.scene.planes
        offsets = images_in(planes, points) - self.spheres.centre
        outside = np.einsum("pd,pd->p", offsets, offsets) >= self.spheres.radius**2
        outside = outside.reshape(1 + len(planes), -1).all(axis=0)
        return outside & before_planes(planes, points)


def multipole_expansion(field: RadiatedField, *, progress: Progress | None = None) -> RadiatedField:
    """Expand the scattered part of a field in outgoing waves, for bodies that move rigidly.

    Use it to update the transfer matrix of moving bodies quickly: solve the field once, for beacons
    (sources at the foci) that move with the bodies, and expand it. By reciprocity, its values at
    the array's elements are the transfer matrix. When the bodies move, move the array in their
    frame instead (``PhasedArray.seen_from``), and evaluate the expanded field again. The time for
    this does not depend on the number of unknowns: 996 elements take about 2 ms. Within a
    wavelength of the smallest ball around the bodies, the original field is evaluated instead. In
    front of a fixed plane, a solve remains valid for all motions that map the plane onto itself
    (``Plane.kept_by``).

    Parameters
    ----------
    field : field from any solver, in a scene with bodies, such as the field of a target's beacons.
    progress : callback that receives the name of each step as it begins.

    Returns
    -------
    A ``RadiatedField``, the same field in expanded form. The ``settings`` of its report contain
    ``expansion_error``, the relative rms difference from ``field`` at 100 random points, for the
    worst excitation. The distances of the points from the centre are 1 to 20 times the radius of
    the expansion's sphere. If the error is above 0.001, the report contains a warning.

    Raises
    ------
    InvalidInput
        If there are no bodies, or if the field is not known everywhere around them.

    Examples
    --------
    >>> import airtact as at
    >>> ball = at.sound_hard(at.sphere(radius=5e-3, edge=2e-3))
    >>> scene = at.Scene(at.Medium(343.1, 1.293), [ball], frequency=40e3)
    >>> source = at.Monopoles(np.array([[0, 0, 0.01]]), np.ones(1))
    >>> beacons = at.SphereSeries().radiate(scene, source)
    >>> moving, elements = at.multipole_expansion(beacons), np.array([[0.0, 0.05, 0.1]])
    >>> bool(abs(moving.at(elements) - beacons.at(elements)) < 1e-3 * abs(beacons.at(elements)))
    True
    """
    of_kind(field, RadiatedField, "the field", "solver.radiate(scene, sources)")
    scene = field.scene
    if not scene.obstacles:
        raise InvalidInput(
            "the scene of the field has no obstacles, so nothing is scattered; evaluate the field "
            "itself.",
            code="empty",
        )
    alone = field.without_images
    if alone is None:
        raise InvalidInput(
            f"{field.report.solver} cannot separate the field of the bodies from that of their "
            "images in a plane; solve with BoundaryElement.",
            code="not_supported",
        )
    clock = Clock(progress)
    with clock.step("expansion", "expanding the field in outgoing waves"):
        centre, radius = ball_of(scene)
        reach = radius * scene.wavenumber.real
        # These are enough orders for an error of 3e-4 with a source on the surface.
        order = int(np.ceil(reach + 3.6 * np.cbrt(reach))) + 2
        count = int(np.ceil(0.3 * reach)) + 5
        smallest = radius + MARGIN * scene.wavelength
        strengths = _coefficients(alone, centre, smallest, order)
        # From the sphere to infinity, the field divided by its carrier wave is smooth in 1/r.
        shrinkings = 0.5 - 0.5 * np.cos(np.pi * (np.arange(count) + 0.5) / count)
        shapes = outgoing_shapes(
            smallest / shrinkings * scene.wavenumber, smallest * scene.wavenumber
        )
        radial = np.stack([next(shapes) for _ in range(order + 1)])
        spheres = InterpolationSpheres(centre, smallest, order, _table(strengths, radial))
    with clock.step("expansion", "comparing the expansion with the field"):
        # Random points do not coincide with the grid of the table. They lie between the smallest
        # sphere and twenty times its radius.
        random = np.random.default_rng(0)
        ways = random.normal(size=(100, 3))
        ways /= np.linalg.norm(ways, axis=1, keepdims=True)
        points = centre + spheres.radius / random.uniform(0.05, 1, (100, 1)) * ways
        points = points[before_planes(scene.planes, points)]
        expanded = MultipoleField(
            scene, field.sources, field.report, field, spheres, np.zeros(field.excitations)
        )
        exact = field.at(points)
        size = np.linalg.norm(exact, axis=0)
        errors = np.linalg.norm(expanded.at(points) - exact, axis=0) / np.where(size > 0, size, 1)
    worst = float(errors.max())
    report = replace(
        field.report,
        seconds={**field.report.seconds, **clock.seconds},
        settings={
            **field.report.settings,
            "expansion_error": worst,
            "expansion_order": spheres.order,
        },
    )
    if worst > 1e-3:
        warning = (
            f"the multipole expansion has an error of {100 * worst:.2g} %, in addition to that of "
            "the solution"
        )
        report = replace(report, warnings=(*report.warnings, warning))
    return replace(expanded, report=report, errors=np.hypot(field.error_at(points), errors))


def ball_of(scene: Scene) -> tuple[Float64[np.ndarray, "3"], float]:
    """Return the centre and radius [m] of a nearly minimal ball that encloses the bodies.

    The centre moves toward the farthest point in decreasing steps (M. Bădoiu, K. L. Clarkson, SODA
    (2003) 801).
    """
    corners = np.unique(
        np.concatenate([obstacle.surface.corners.reshape(-1, 3) for obstacle in scene.obstacles]),
        axis=0,
    )
    centre = corners.mean(axis=0)
    for step in range(2, 50):
        farthest = corners[np.linalg.norm(corners - centre, axis=1).argmax()]
        centre = centre + (farthest - centre) / step
    return centre, float(np.linalg.norm(corners - centre, axis=1).max())


def _coefficients(
    field: RadiatedField, centre: Float64[np.ndarray, "3"], radius: float, order: int
) -> Complex128[np.ndarray, "orders degrees excitations"]:
    """Return coefficients of the waves Y_nm h_n(kr)/h_n(k radius), m = 0, 1, ... -2, -1."""
    directions, weights = sphere_rule(order)
    points = (centre + radius * directions).reshape(-1, 3)
    scattered = field.at(points) - field._incident(points)
    unknown = int((~np.isfinite(scattered)).any(axis=1).sum())
    if unknown:
        raise InvalidInput(
            f"the field is not known at {unknown} of {len(points)} points {1e3 * radius:.3g} mm "
            "from the middle of the bodies. Use a field that is known everywhere around the "
            "bodies.",
            code="data_missing",
        )
    scattered = scattered.reshape(order + 1, 2 * order + 1, -1)
    series = np.asarray(fft(scattered, axis=1))
    polar = np.arccos(directions[:, 0, 2])
    harmonics = np.real(sph_harm_y_all(order, order, polar, np.zeros(order + 1)))
    return np.einsum("nmj,j,jms->nms", harmonics, weights, series, optimize=True)


def _table(
    strengths: Complex128[np.ndarray, "orders degrees excitations"],
    radial: Complex128[np.ndarray, "orders radii"],
) -> Complex64[np.ndarray, "polar azimuths radii excitations"]:
    """Sum the waves on the spheres, at the doubled number of angles that the kernel requires."""
    orders, degrees = strengths.shape[:2]
    around = degrees + 1  # polar angles of a full turn over both poles
    polar = 2 * np.pi * np.arange(orders + 1) / around
    harmonics = np.real(sph_harm_y_all(orders - 1, orders - 1, polar, np.zeros(len(polar))))
    half = np.einsum("nmj,nr,nms->mjrs", harmonics, radial, strengths, optimize=True)
    parity = (-1.0) ** np.abs(np.fft.fftfreq(degrees, 1 / degrees).round())
    # A function on the sphere that is continued over the poles is periodic in both angles.
    back = parity[:, None, None, None] * half[:, -2:0:-1]  # f(-θ, φ) = f(θ, φ + π)
    series = np.asarray(fft(np.concatenate([half, back], axis=1), axis=1, norm="forward"))
    fine = 2 * around
    size = 16 * fine**2 * int(np.prod(series.shape[2:]))
    free = available_memory()
    if size > 0.5 * free:
        raise InvalidInput(
            f"an expansion of {orders} orders needs {size / 2**30:.2g} GiB, but only "
            f"{free / 2**30:.2g} GiB of memory are free. Evaluate the field itself, or solve for "
            "fewer sources.",
            code="too_little_memory",
        )
    wide = np.zeros((fine, fine, *series.shape[2:]), dtype=np.complex64)
    polar_orders = np.fft.fftfreq(around, 1 / around).astype(int)
    azimuth_orders = np.fft.fftfreq(degrees, 1 / degrees).round().astype(int)
    # The kernel's transform is divided out here, because interpolation multiplies by it.
    scale = 1 / np.outer(_transform(polar_orders, fine), _transform(azimuth_orders, fine))
    wide[np.ix_(polar_orders, azimuth_orders)] = np.moveaxis(series, 0, 1) * scale[:, :, None, None]
    table = np.asarray(ifft2(wide, axes=(0, 1), norm="forward", overwrite_x=True))
    # Rows and columns are repeated beyond the ends, so that a window never wraps around.
    rows, columns = (
        np.arange(-(SPREAD // 2), count + (SPREAD + 1) // 2) % fine for count in (around, fine)
    )
    return np.ascontiguousarray(table[np.ix_(rows, columns)])


def _window(angles: Lengths, step: float) -> tuple[Indices, Float32[np.ndarray, "points spread"]]:
    """Return the first of the grid points used for each angle, and the weights of these points."""
    position = angles / step
    first = np.ceil(position - SPREAD / 2).astype(np.int64)
    off = (position - first)[:, None] - np.arange(SPREAD)
    return first + SPREAD // 2, _kernel(off).astype(np.float32)


def _kernel(off: Float64[np.ndarray, "*shape"]) -> Float64[np.ndarray, "*shape"]:
    """Return the weight exp(β √(1 - x²)) of a grid point at a distance of x steps.

    The sharpness β is chosen for tables with twice as many points as the expansion requires.
    """
    root = np.sqrt(np.maximum(1 - (2 * off / SPREAD) ** 2, 0))
    return np.exp(2.3 * SPREAD * (root - 1))


def _transform(
    frequencies: Int64[np.ndarray, "frequencies"], fine: int
) -> Float64[np.ndarray, "frequencies"]:
    nodes, weights = np.polynomial.legendre.leggauss(60)
    off = 0.5 * SPREAD * nodes
    waves = np.cos(2 * np.pi / fine * frequencies[:, None] * off)
    return 0.5 * SPREAD * waves @ (weights * _kernel(off))
