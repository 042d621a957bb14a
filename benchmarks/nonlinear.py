"""Steepening at foci: the estimate against the Euler equations, and published measurements.

The reference solves the isentropic Euler equations around an axis, without a small-amplitude
approximation and without code of the package. Its linear pressure is that of a weak source on the
same grid, so that the thin source layer cancels in all ratios.

    python -m benchmarks.nonlinear [fubini | free | wall | box | beyond | published]

``fubini`` and ``published`` take a minute, the others 5 to 30 minutes on one core.
"""

import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.special import j1, jv

import airtact as at
from airtact.evaluation.steepening import Steepening

SOUND_SPEED = 344.0
DENSITY = 1.2
FREQUENCY = 40e3
WAVELENGTH = SOUND_SPEED / FREQUENCY
WAVENUMBER = 2.0 * np.pi / WAVELENGTH
STIFFNESS = DENSITY * SOUND_SPEED**2

# Cells per wavelength. The second harmonic then has 11, and 26 to 36 change it by 1 %.
RESOLUTION = 22
CELL = WAVELENGTH / RESOLUTION
# Cells beyond the grid, as many as the filter needs on each side
GHOSTS = 4
# Width of the absorbing rim [m]
RIM = 10e-3

# Mass source per volume [kg/m³/s] at radii and heights [m], complex
Source = Callable[[np.ndarray, np.ndarray], np.ndarray]

# Discs of radius and distance [m], and linear pressures [Pa]; the first has one AUTD3 board's area
FREE = {
    (0.087, 0.200): (2.0e3, 4.5e3),
    (0.060, 0.060): (2.0e3, 5.0e3, 10e3),
    (0.096, 0.150): (1.5e3, 3.0e3, 6.0e3),
    (0.150, 0.120): (5.0e3, 10e3),
    (0.192, 0.200): (2.0e3, 5.0e3, 9.0e3, 15e3),
}
WALL = {
    (0.060, 0.060): (5.0e3, 10e3, 20e3),
    (0.096, 0.150): (6.0e3, 12e3),
    (0.192, 0.200): (5.0e3, 9.0e3, 15e3, 27e3),
}
# Radius and half height of the cylinder, which has the size of the paper's box
BOX = {(0.070, 0.090): (9.0e3, 15e3, 27e3)}


def main(chosen: list[str]) -> None:
    """Print the chosen rows, or all."""
    for name in chosen or list(ROWS):
        for line in ROWS[name]():
            print(line, flush=True)


@dataclass(frozen=True, eq=False)
class Grid:
    """Cells around the axis from a lowest to a highest z, with rims that absorb unless mirrored."""

    radius: float
    low: float
    high: float
    mirror_low: bool = False
    mirror_high: bool = False
    rim: bool = True

    @property
    def r(self) -> np.ndarray:
        """Radii of the cells [m]."""
        return (np.arange(round(self.radius / CELL)) + 0.5) * CELL

    @property
    def z(self) -> np.ndarray:
        """Heights of the cells [m]."""
        return self.low + (np.arange(round((self.high - self.low) / CELL)) + 0.5) * CELL

    def sponge(self, radius: np.ndarray, height: np.ndarray) -> np.ndarray:
        """Absorption of each cell [1/s]."""
        depths = [radius - self.radius + RIM] if self.rim else []
        if not self.mirror_low:
            depths.append(self.low + RIM - height)
        if not self.mirror_high:
            depths.append(height - self.high + RIM)
        strength = np.zeros_like(radius)
        for depth in depths:
            strength += np.clip(depth / RIM, 0.0, 1.0) ** 2
        return 2.5 * SOUND_SPEED / RIM * strength


def shifted(field: np.ndarray, radial: int = 0, axial: int = 0) -> np.ndarray:
    """Return the cells inside the ghosts, shifted."""
    rows = slice(GHOSTS + radial, field.shape[-2] - GHOSTS + radial)
    columns = slice(GHOSTS + axial, field.shape[-1] - GHOSTS + axial)
    return field[..., rows, columns]


def slope(field: np.ndarray, axis: int) -> np.ndarray:
    """Return the derivative of sixth order along r (0) or z (1)."""
    total = np.zeros_like(shifted(field))
    for step, weight in ((1, 3 / 4), (2, -3 / 20), (3, 1 / 60)):
        to = (step, 0) if axis == 0 else (0, step)
        total += np.float32(weight / CELL) * (shifted(field, *to) - shifted(field, -to[0], -to[1]))
    return total


def pressure_of(density: np.ndarray) -> np.ndarray:
    """Excess pressure [Pa] by excess density, the series of ((1 + s)^1.4 − 1)/1.4."""
    s = density / np.float32(DENSITY)
    series = s * (1.0 + s * (0.2 + s * (-0.04 + s * 0.016)))
    return np.float32(STIFFNESS) * series


class Euler:
    """Density, radial and axial momentum on a grid, driven by a mass source."""

    def __init__(self, grid: Grid, source: Source) -> None:
        self.grid = grid
        radius, height = np.meshgrid(grid.r, grid.z, indexing="ij")
        self.source = source(radius, height).astype(np.complex64)
        self.sponge = grid.sponge(radius, height).astype(np.float32)
        self.over_r = (1.0 / radius).astype(np.float32)
        rows, columns = radius.shape
        self.state = np.zeros((3, rows + 2 * GHOSTS, columns + 2 * GHOSTS), np.float32)

    def fill_ghosts(self, state: np.ndarray) -> None:
        """Mirror at the axis and at rigid walls; copy elsewhere, where the rim absorbs."""
        g = GHOSTS
        state[:, :g] = state[:, 2 * g - 1 : g - 1 : -1]
        state[1, :g] *= -1.0
        state[:, -g:] = state[:, -g - 1 : -g]
        state[:, :, :g] = state[:, :, g : g + 1]
        state[:, :, -g:] = state[:, :, -g - 1 : -g]
        if self.grid.mirror_low:
            state[:, :, :g] = state[:, :, 2 * g - 1 : g - 1 : -1]
            state[2, :, :g] *= -1.0
        if self.grid.mirror_high:
            state[:, :, -g:] = state[:, :, -g - 1 : -2 * g - 1 : -1]
            state[2, :, -g:] *= -1.0

    def rates(self, state: np.ndarray, moment: float) -> np.ndarray:
        """Rates of change at a moment [s]: ∂ρ/∂t = q − ∇·m, ∂m/∂t = −∇·(m m/ρ) − ∇p."""
        self.fill_ghosts(state)
        density, radial, axial = state
        over_density = 1.0 / (density + np.float32(DENSITY))
        pressure = pressure_of(density)
        cross = radial * axial * over_density
        square = radial * radial * over_density
        fluxes = (
            (radial, axial, radial),
            (pressure + square, cross, square),
            (cross, pressure + axial * axial * over_density, cross),
        )
        rates = -self.sponge * shifted(state)
        for rate, (along_r, along_z, over_r) in zip(rates, fluxes, strict=True):
            rate -= slope(along_r, 0) + slope(along_z, 1) + shifted(over_r) * self.over_r
        # The source starts within four periods.
        ramp = np.sin(min(1.0, moment * FREQUENCY / 4.0) * np.pi / 2.0) ** 2
        turn = np.exp(-2j * np.pi * FREQUENCY * moment) * ramp
        rates[0] += (self.source * np.complex64(turn)).real
        return rates

    def step(self, moment: float, duration: float) -> None:
        """Advance by one step of the classical Runge-Kutta method."""
        stage = self.state.copy()
        total = np.zeros_like(shifted(self.state))
        for weight, ahead, reached in ((1, 0.5, 0.0), (2, 0.5, 0.5), (2, 1.0, 0.5), (1, 0.0, 1.0)):
            rates = self.rates(stage, moment + reached * duration)
            total += np.float32(weight * duration / 6.0) * rates
            shifted(stage)[...] = shifted(self.state) + np.float32(ahead * duration) * rates
        shifted(self.state)[...] += total

    def smooth(self) -> None:
        """Damp what the grid cannot carry, by a filter of eighth order."""
        self.fill_ghosts(self.state)
        rough = np.float32(2 * 70 / 256) * shifted(self.state)
        for k, weight in ((1, -56 / 256), (2, 28 / 256), (3, -8 / 256), (4, 1 / 256)):
            around = shifted(self.state, k) + shifted(self.state, -k)
            around += shifted(self.state, 0, k) + shifted(self.state, 0, -k)
            rough += np.float32(weight) * around
        shifted(self.state)[...] -= np.float32(0.2) * rough

    def harmonics(self, duration: float, count: int = 3) -> np.ndarray:
        """Run for a duration [s]; return the first harmonics on the axis in its last 4 periods.

        They are (count, heights) complex pressures [Pa].
        """
        steps = int(np.ceil(SOUND_SPEED / FREQUENCY / (0.8 * CELL)))  # Courant number 0.8
        step = 1.0 / FREQUENCY / steps
        last = int(duration * FREQUENCY) * steps
        total = np.zeros((count, len(self.grid.z)), dtype=np.complex128)
        for index in range(last):
            self.step(index * step, step)
            if index % 2 == 0:
                self.smooth()
            if index >= last - 4 * steps:
                pressure = pressure_of(shifted(self.state)[0, 0]).astype(np.float64)
                turns = np.arange(1, count + 1) * 2.0 * np.pi * FREQUENCY * (index + 1) * step
                total += np.exp(1j * turns)[:, None] * pressure / (2 * steps)
        return total


def layer(offset: np.ndarray) -> np.ndarray:
    """Return a thin source layer of unit integral, by the distance from its middle [m]."""
    width = 1.2 * CELL
    return np.exp(-0.5 * (offset / width) ** 2) / (np.sqrt(2.0 * np.pi) * width)


def face(beyond: np.ndarray, angle: np.ndarray, length: np.ndarray) -> np.ndarray:
    """Elements with the pattern of AUTD3's transducers, up to a soft edge, in phase at the focus."""
    x = np.maximum(WAVENUMBER * 4e-3 * np.sin(angle), 1e-9)
    edge = 0.5 * (1.0 - np.tanh(beyond / (1.5 * CELL)))
    return edge * 2.0 * j1(x) / x * np.exp(-1j * WAVENUMBER * length)


def disc(radius: float, distance: float) -> Source:
    """Make a flat disc at z = 0 that focuses on the axis at a distance [m]."""

    def source(r: np.ndarray, z: np.ndarray) -> np.ndarray:
        length = np.hypot(r, distance)
        return layer(z) * face(r - radius, np.arctan2(r, distance), length)

    return source


def barrel(radius: float, half: float) -> Source:
    """Make the wall of a cylinder around z = 0 that focuses on its centre."""

    def source(r: np.ndarray, z: np.ndarray) -> np.ndarray:
        length = np.hypot(radius, z)
        return layer(r - radius) * face(np.abs(z) - half, np.arctan2(np.abs(z), radius), length)

    return source


def reference(kind: str, size: tuple[float, float]) -> Iterator[tuple[float, float, float]]:
    """Yield linear pressure, fundamental and second harmonic at the focus [Pa] for each level."""
    first, second = size
    if kind == "box":
        grid = Grid(first + RIM + 5e-3, 0.0, second + RIM + 4e-3, mirror_low=True)
        source = barrel(first, second)
        duration = 2.0 * np.hypot(first, second) / SOUND_SPEED + 12.0 / FREQUENCY
        focus = 0.0
    else:
        wall = kind == "wall"
        # The wall is between two cells.
        focus = round(second / CELL) * CELL if wall else second
        below = -round((RIM + 2e-3) / CELL) * CELL
        above = focus if wall else focus + 30e-3 + RIM
        grid = Grid(first + RIM + 2e-3, below, above, mirror_high=wall)
        source = disc(first, focus)
        duration = np.hypot(focus, first) / SOUND_SPEED + 10.0 / FREQUENCY
    cell = int(np.argmin(np.abs(grid.z - focus)))

    def at_focus(scale: float) -> np.ndarray:
        return np.abs(Euler(grid, scaled_by(scale, source)).harmonics(duration)[:, cell])

    weak = 1e-4
    linear = at_focus(weak)[0] / weak
    for pressure in {"free": FREE, "wall": WALL, "box": BOX}[kind][size]:
        harmonics = at_focus(pressure / linear)
        yield pressure, float(harmonics[0]), float(harmonics[1])


def estimate(kind: str, size: tuple[float, float]) -> tuple[Steepening, float, float]:
    """Return the package's steepening at the focus, the linear pressure [Pa] and the time [s]."""
    first, second = size
    spacing = 5e-3
    if kind == "box":
        angle = np.arange(0.0, 2.0 * np.pi, spacing / first)
        height = np.arange(-second, second, spacing) + spacing / 2.0
        angle, z = (values.ravel() for values in np.meshgrid(angle, height))
        positions = np.stack([first * np.cos(angle), first * np.sin(angle), z], axis=1)
        normals = -np.stack([np.cos(angle), np.sin(angle), 0.0 * z], axis=1)
        focus = np.zeros((1, 3))
    else:
        side = np.arange(-first, first, spacing) + spacing / 2.0
        x, y = (values.ravel() for values in np.meshgrid(side, side))
        inside = np.hypot(x, y) < first
        positions = np.stack([x, y, 0.0 * x], axis=1)[inside]
        normals = np.tile([0.0, 0.0, 1.0], (len(positions), 1))
        focus = np.array([[0.0, 0.0, second]])
    array = at.PhasedArray(positions, normals, element=at.piston(4e-3, points=12))
    planes = [at.plane(focus[0], (0, 0, -1))] if kind == "wall" else []
    scene = at.Scene(at.Medium(SOUND_SPEED, DENSITY), [], planes=planes)
    lengths = np.linalg.norm(positions - focus, axis=1)
    drive = at.Drive(np.exp(-1j * WAVENUMBER * lengths))
    started = time.perf_counter()
    result = at.evaluate(scene, array, drive, at.Target(focus), solver=at.FreeField())
    assert result.steepening is not None
    return result.steepening, float(result.magnitudes[0]), time.perf_counter() - started


def compared(kind: str) -> Iterator[str]:
    """Yield the estimate beside the reference for all arrays of a kind."""
    for size in {"free": FREE, "wall": WALL, "box": BOX}[kind]:
        effect, pressure, seconds = estimate(kind, size)
        for linear, fundamental, second in reference(kind, size):
            scaled = effect.scaled(linear / pressure)
            kept = fundamental / linear
            share = second / fundamental
            yield (
                f"{kind} {1e3 * size[0]:.0f} x {1e3 * size[1]:.0f} mm, {1e-3 * linear:.1f} kPa: "
                f"fundamental {scaled.kept[0]:.3f} (Euler {kept:.3f}, "
                f"{scaled.kept[0] / kept - 1.0:+.1%}, stated {scaled.error[0]:.1%}), second "
                f"harmonic {scaled.second_harmonic[0]:.3f} (Euler {share:.3f}, "
                f"{scaled.second_harmonic[0] / share - 1.0:+.1%}); {1e3 * seconds:.0f} ms"
            )


def beyond() -> Iterator[str]:
    """Yield the effect of steepening on the level beyond a focus, where a head may be."""
    for radius, distance, pressure, top in (
        (0.060, 0.060, 10e3, 0.15),
        (0.087, 0.150, 3.0e3, 0.33),
    ):
        # The widening beam must not reach the rim, which would change the field on the axis.
        widest = radius * max(1.0, top / distance - 1.0)
        grid = Grid(widest + RIM + 2e-3, -RIM - 2e-3, top + RIM + 2e-3)
        duration = np.hypot(top, radius) / SOUND_SPEED + 10.0 / FREQUENCY
        source = disc(radius, distance)
        weak = np.abs(Euler(grid, scaled_by(1e-4, source)).harmonics(duration)[0]) / 1e-4
        scale = pressure / weak[np.argmin(np.abs(grid.z - distance))]
        strong = np.abs(Euler(grid, scaled_by(scale, source)).harmonics(duration)[0])
        # The level at a head is the largest one, so compare the loudest points from each height on.
        # Sound between the lobes of the axis is quiet.
        below = grid.z < top
        loudest = [
            np.maximum.accumulate(pressures[below][::-1])[::-1]
            for pressures in (strong, scale * weak)
        ]
        away = grid.z[below] > distance + 0.03
        change = 20.0 * np.log10(loudest[0] / loudest[1])[away]
        yield (
            f"disc of {1e3 * radius:.0f} mm focusing at {1e3 * distance:.0f} mm, "
            f"{1e-3 * pressure:.0f} kPa: steepening changes the largest level from 30 mm beyond the "
            f"focus to {1e3 * top:.0f} mm by {change.min():+.2f} to {change.max():+.2f} dB"
        )


def scaled_by(factor: float, source: Source) -> Source:
    """Multiply a source by a factor."""
    return lambda r, z: factor * source(r, z)


def fubini() -> Iterator[str]:
    """Yield harmonics of a plane wave over its linear pressure, and Fubini's 2 J_n(nσ)/(nσ)."""
    grid = Grid(12 * CELL, 0.0, 130e-3, rim=False)
    start = 15e-3

    def harmonics(pressure: float) -> np.ndarray:
        # A layer of mass radiates to both sides.
        strength = 2.0 * pressure / SOUND_SPEED
        euler = Euler(grid, lambda _r, z: strength * layer(z - start) + 0j)
        return np.abs(euler.harmonics(0.55e-3))

    weak = harmonics(1.0)[0]
    for pressure in (1000.0, 3000.0):
        strong = harmonics(pressure)
        for height in (40e-3, 70e-3, 100e-3):
            cell = int(np.argmin(np.abs(grid.z - height)))
            linear = pressure * weak[cell]
            shock = 1.2 * WAVENUMBER * linear * (grid.z[cell] - start) / STIFFNESS
            orders = np.arange(1, 4)
            exact = 2.0 * jv(orders, orders * shock) / (orders * shock)
            yield (
                f"plane wave, {linear:.0f} Pa, σ = {shock:.2f}: harmonics "
                f"{np.round(strong[:, cell] / linear, 4)}, Fubini {np.round(exact, 4)}"
            )


def published() -> Iterator[str]:
    """Yield published measurements of 40 kHz transducers and arrays beside computed values."""
    yield from makers_curve()
    # Pro-Wave 400PT120 (www.prowave.com.tw/english/products/ut/ep/40pt12.htm): 85 degrees between
    # -6 dB, typically, and at least 115 dB at 0.3 m for 10 V rms.
    pattern = pattern_of(at.piston(4.5e-3), np.arange(0.0, 90.0, 0.1))
    width = 2.0 * 0.1 * int(np.argmax(pattern < 0.501))
    yield f"piston of 4.5 mm: {width:.0f} degrees between -6 dB (published 85 degrees)"
    least = 20e-6 * 10 ** (115 / 20) * np.sqrt(2.0) * 0.3
    yield f"sensitivity: {at.monopole().sensitivity:.2f} Pa·m (published at least {least:.2f})"
    # T. Hoshi et al., IEEE Trans. Haptics 3, 155 (2010): 324 transducers, 16 mN, 20 mm. The
    # abstract states no geometry: 18 x 18 at 10 mm, 200 mm away are assumed.
    side = (np.arange(18) - 8.5) * 10e-3
    width, force = focal_spot(side, side, 0.2, wall=True)
    yield f"324 transducers at 200 mm: focus {1e3 * width:.1f} mm between minima (published 20 mm)"
    yield f"force on a wall within 10 mm: {1e3 * force:.1f} mN at 4.38 Pa·m (published 16 mN)"
    # S. Suzuki et al., IEEE Trans. Haptics 14, 740 (2021): nine AUTD3 boards focus 500 mm away with
    # the size of the theory, 2 λ R/D between minima.
    x = (np.arange(54) - 26.5) * 10.16e-3
    y = (np.arange(42) - 20.5) * 10.16e-3
    width, _ = focal_spot(x, y, 0.5, wall=False)
    theory = 2.0 * WAVELENGTH * 0.5 / (54 * 10.16e-3)
    yield f"nine boards at 500 mm: focus {1e3 * width:.1f} mm, theory {1e3 * theory:.1f} mm"


def makers_curve() -> Iterator[str]:
    """Yield the pattern of AUTD3's transducer beside the curve of its maker, and its effect."""
    # Nippon Ceramic T4010A1, 0 to 80 degrees in steps of 10, as read from the data sheet by the
    # table in AUTD3's software (S. Suzuki, autd3, directivity)
    degrees = np.arange(0.0, 90.0, 10.0)
    decibels = np.array([0.0, 0.0, 0.0, -1.0, -3.0, -6.0, -9.0, -12.0, -14.0])
    curve = CubicSpline(degrees, 10.0 ** (decibels / 20.0))
    board = at.transducers.board_array("autd3")
    difference = 20.0 * np.log10(pattern_of(board.element, degrees)) - decibels
    yield f"T4010A1 at 0 to 80 degrees: piston minus curve {np.round(difference, 1)} dB"
    above = board.positions.mean(axis=0)
    for name, array, focus in (
        ("one AUTD3 board, 200 mm away", board, above + [0.0, 0.0, 0.2]),
        ("one AUTD3 board, 500 mm away", board, above + [0.0, 0.0, 0.5]),
        ("the paper's box", at.surrounding_box(), np.zeros(3)),
    ):
        rays = focus - array.positions
        lengths = np.linalg.norm(rays, axis=1)
        angles = np.degrees(np.arccos(np.sum(rays * array.normals, axis=1) / lengths))
        ratio = np.sum(pattern_of(board.element, angles) / lengths) / np.sum(
            curve(angles) / lengths
        )
        yield f"{name}: pressure of pistons over that with the curve {ratio:.3f}"


def pattern_of(element: at.transducers.Element, degrees: np.ndarray) -> np.ndarray:
    """Return the far pressure at angles from the axis, relative to that on the axis."""
    phases = WAVENUMBER * np.outer(np.sin(np.radians(degrees)), element.points[:, 0])
    return np.abs(np.exp(1j * phases) @ element.weights)


def focal_spot(x: np.ndarray, y: np.ndarray, distance: float, *, wall: bool) -> tuple[float, float]:
    """Return the width between minima [m] and the force on a rigid wall within 10 mm [N]."""
    grid = np.meshgrid(x, y, indexing="ij")
    positions = np.stack([grid[0].ravel(), grid[1].ravel(), np.zeros(len(x) * len(y))], axis=1)
    normals = np.tile([0.0, 0.0, 1.0], (len(positions), 1))
    array = at.PhasedArray(positions, normals, element=at.piston(4.5e-3))
    focus = np.array([[0.0, 0.0, distance]])
    planes = [at.plane(focus[0], (0, 0, -1))] if wall else []
    scene = at.Scene(at.Medium(SOUND_SPEED, DENSITY), [], planes=planes)
    drive = at.focus_by_distance(array, at.Target(focus), scene.medium, FREQUENCY)
    result = at.evaluate(scene, array, drive, at.Target(focus), solver=at.FreeField())
    across = np.linspace(0.0, 40e-3, 401)
    line = focus + across[:, None] * [1.0, 0.0, 0.0]
    pressure = np.abs(at.field_map(scene, array, drive, line, solver=at.FreeField()))
    first = int(np.flatnonzero(np.diff(pressure) > 0.0)[0])
    # The mean pressure on a wall is |P|²/(4ρc²), without the small part of the velocity.
    near = across <= 10e-3
    ring = 2.0 * np.pi * across * (across[1] - across[0])
    force = float(np.sum((pressure**2 * ring)[near]) / (4.0 * STIFFNESS))
    assert result.steepening is not None
    return 2.0 * across[first], force * float(0.5 + 0.5 * result.steepening.kept[0] ** 2)


ROWS: dict[str, Callable[[], Iterator[str]]] = {
    "fubini": fubini,
    "published": published,
    "free": lambda: compared("free"),
    "wall": lambda: compared("wall"),
    "box": lambda: compared("box"),
    "beyond": beyond,
}


if __name__ == "__main__":
    main(sys.argv[1:])
