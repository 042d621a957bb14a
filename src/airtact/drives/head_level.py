"""Sound pressure level at a head, and the cap on amplitudes that keeps it below the limit."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Complex, Float64, Num, Real

from airtact.acoustics.solvers.shared import monopole_pressure
from airtact.acoustics.target_points import even_directions
from airtact.drives.frame import Frame, frame_at, share_under_cap
from airtact.errors import InvalidInput, complex_numbers
from airtact.transducers.element import DEFAULT_SENSITIVITY
from airtact.transducers.levels import Levels

MAX_HEAD_LEVEL = 110.0
"""Occupational limit for the one-third-octave band at 40 kHz [dB SPL].

Most organisations agree on it (C. Q. Howard, C. H. Hansen, A. C. Zander, J. Occup. Health Saf.
Aust. N. Z. 21, 253 (2005))."""

NO_SAFETY_ASSESSMENT = (
    "This is not a safety assessment: the head itself is not in the scene, the sensitivity of the "
    "elements is not calibrated, and the effects of ultrasound in air on people are little known "
    "(ICNIRP 2024, 10.1097/HP.0000000000001800, calls the evidence limited; "
    f"{MAX_HEAD_LEVEL:g} dB at 40 kHz is the usual occupational limit: C. Q. Howard et al., J. "
    "Occup. Health Saf. Aust. N. Z. 21, 253, 2005)."
)
"""The note that accompanies every level at a head."""


def sound_pressure_level(pressure: Num[np.ndarray, "points"]) -> Float64[np.ndarray, "points"]:
    """Return the sound pressure level [dB SPL], 20 log10 of the rms pressure relative to 20 µPa.

    The rms pressure of a pure tone is its peak pressure divided by √2.

    Parameters
    ----------
    pressure : (P,) peak pressures of a tone [Pa], real or complex.

    Returns
    -------
    (P,) levels [dB SPL]; -inf where the pressure is 0, without a warning.

    Examples
    --------
    >>> sound_pressure_level(np.array([np.sqrt(2.0), np.sqrt(2.0) * 20e-6])).round(2).tolist()
    [93.98, 0.0]
    """
    with np.errstate(divide="ignore"):
        return 20.0 * np.log10(
            np.abs(complex_numbers(pressure, "pressures")) / np.sqrt(2.0) / 20e-6
        )


def pressures_around(
    positions: Real[np.ndarray, "elements 3"],
    drives: Complex[np.ndarray, "frames elements"],
    sensitivity: float,
    wavenumber: float,
    distance: float = 0.5,
) -> tuple[float, float]:
    """Return the largest pressures [Pa] on a sphere ``distance`` [m] outside an array.

    Every element is assumed to radiate equally in all directions in open air, with a peak pressure
    of ``sensitivity`` [Pa·m]. Real transducers radiate less to the rear, and bodies redirect the
    sound, so the result is suitable for a warning but does not replace a measurement.

    Returns
    -------
    The largest peak pressure in any frame, and the largest rms pressure over all frames.
    """
    middle = (positions.min(axis=0) + positions.max(axis=0)) / 2.0
    radius = float(np.linalg.norm(positions - middle, axis=1).max()) + distance

    def pressures(directions: Real[np.ndarray, "directions 3"]) -> Float64[np.ndarray, "two any"]:
        points = middle + radius * directions
        frames = np.abs(monopole_pressure(points, positions, drives.T, wavenumber, "float32"))
        return np.stack([frames.max(axis=1), np.sqrt(np.mean(frames**2, axis=1))])

    directions = even_directions(2000)
    coarse = pressures(directions)
    # A beam may be narrower than the angle between two directions. The 12 largest pressures are
    # therefore refined with 100 directions each, up to one angle step away.
    steps = (
        even_directions(100)[None]
        * np.sqrt(4.0 * np.pi / len(directions))
        * np.linspace(0.2, 1.0, 100)[None, :, None]
    )
    around = (directions[np.argsort(coarse[0])[-12:], None] + steps).reshape(-1, 3)
    around /= np.linalg.norm(around, axis=1, keepdims=True)
    peak, average = np.maximum(coarse.max(axis=1), pressures(around).max(axis=1))
    return sensitivity * float(peak), sensitivity * float(average)


@dataclass(frozen=True, eq=False)
class HeadLevel:
    """Sound pressure level at a head 0.5 m from an array in open air.

    ``at(cap)`` returns the level of the loudest drive (the peak level) and that of the mean power
    of all drives [dB SPL] if the amplitudes are limited to a cap (1 is full scale). Both levels are
    the highest on a sphere around the middle of the array, 0.5 m outside the farthest element.
    ``safe_cap()`` returns 1 if the peak level at full scale is at most ``MAX_HEAD_LEVEL``, 110 dB
    SPL. Otherwise it returns a cap at which the peak level does not exceed this limit, usually
    about a tenth below the largest such cap. It raises ``InvalidInput`` if the boards cannot be
    turned down that far, for example because they only switch elements on and off.

    Elements are assumed to radiate equally in all directions. The level ignores nonlinear
    steepening, which is negligible at ``MAX_HEAD_LEVEL`` and therefore does not affect
    ``safe_cap``. Beyond a focus, steepening at full scale lowers the level at loud points and
    raises it at quieter points (``python -m benchmarks.nonlinear beyond``).

    Attributes
    ----------
    drives : (N, E) complex amplitudes of the drives that are played in turn; 1 is full scale. If
        there are more than 32, only the 32 with the most power are evaluated.
    positions : (E, 3) positions of the elements, in any frame [m].
    levels : amplitude and phase levels of the boards, to which the drives are rounded.
    wavenumber : wavenumber of the sound, without absorption [rad/m].
    sensitivity : peak pressure of an element at full scale, 1 m away on its axis [Pa·m].
    factors : factors from 0 to 1 of an amplitude modulation; every drive is multiplied by every
        factor. By default, there is no modulation.
    """

    drives: Complex[np.ndarray, "frames elements"]
    positions: Real[np.ndarray, "elements 3"]
    levels: Levels
    wavenumber: float
    sensitivity: float = DEFAULT_SENSITIVITY
    factors: tuple[float, ...] = (1.0,)

    @property
    def strongest(self) -> Complex[np.ndarray, "frames elements"]:
        """The 32 most powerful drives."""
        # These drives determine the level around the array; evaluating thousands would take
        # minutes.
        powers = np.linalg.norm(self.drives, axis=1)
        return self.drives[np.argsort(-powers, kind="stable")[:32]]

    def frames(self, cap: float) -> list[Frame]:
        """Return the frames of the most powerful drives, limited by a cap."""
        share = share_under_cap(self.drives, self.levels, cap)
        return [
            frame_at(drive, self.levels, share * factor)
            for drive in self.strongest
            for factor in self.factors
        ]

    def at(self, cap: float) -> tuple[float, float]:
        """Return the peak and average level [dB SPL] for a cap from 0 to 1, or -inf in silence."""
        played = np.stack([frame.drive().amplitudes for frame in self.frames(cap)])
        pressures = pressures_around(self.positions, played, self.sensitivity, self.wavenumber)
        peak, average = sound_pressure_level(np.array(pressures))
        return float(peak), float(average)

    @cached_property
    def full(self) -> float:
        """Peak level at full scale [dB SPL]."""
        return self.at(1.0)[0]

    def safe_cap(self) -> float:
        """Return a cap at which the peak level is at most ``MAX_HEAD_LEVEL``.

        The cap is 1 if full scale does not exceed this level. Otherwise, the cap is usually about a
        tenth below the largest cap at which the level is not exceeded.

        Raises
        ------
        InvalidInput
            If the boards cannot reduce the level to ``MAX_HEAD_LEVEL``.
        """
        if self.full <= MAX_HEAD_LEVEL:
            return 1.0
        if not self.levels.phase_only:
            # The pressure is proportional to the amplitude, except for rounding to levels.
            largest = min(1.0, float(np.abs(self.drives).max()))
            cap = largest * 10.0 ** ((MAX_HEAD_LEVEL - self.full) / 20.0)
            for _ in range(10):
                cap = float(f"{0.9 * cap:.2g}")
                peak, _ = self.at(cap)
                if np.isfinite(peak) and peak <= MAX_HEAD_LEVEL:
                    return cap
        raise InvalidInput(
            f"these boards cannot be turned down to {MAX_HEAD_LEVEL:g} dB at a head 0.5 m from the "
            f"array, where full scale produces up to {self.full:.0f} dB. Set a cap such as 0.3, or "
            "1 for full scale (--cap, --full-scale).",
            code="out_of_range",
        )
