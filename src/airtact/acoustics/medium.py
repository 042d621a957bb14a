"""Media: speed of sound, density and absorption; ``air`` computes them for humid air.

Sources
-------
- O. Cramer, "The variation of the specific heat ratio and the speed of sound in air with
  temperature, pressure, humidity, and CO2 concentration", J. Acoust. Soc. Am. 93, 2510 (1993),
  equation (15) with Table III.
- A. Picard, R. S. Davis, M. Gläser, K. Fujii, "Revised formula for the density of moist air
  (CIPM-2007)", Metrologia 45, 149 (2008), equation (2) and appendix A.
- ISO 9613-1:1993, "Attenuation of sound during propagation outdoors, part 1", equations (3) to (5),
    (B.2), (B.3).
"""

import math
from dataclasses import dataclass

from airtact.errors import between, positive

_PASCAL = 101325.0  # one standard atmosphere, the reference pressure of ISO 9613-1
_CARBON_DIOXIDE = 0.0004  # mole fraction, as in CIPM-2007


@dataclass(frozen=True)
class Medium:
    """A fluid in which sound travels.

    Attributes
    ----------
    sound_speed : speed of sound [m/s], 100 to 10000.
    density : density [kg/m³], 0.01 to 30000.
    absorption : decay α of the amplitude of a plane wave, e^{−αx} [Np/m], 0 to 1e6. It is the same
        at all frequencies.

    Raises
    ------
    InvalidInput
        If a number is outside its range.

    Examples
    --------
    >>> paper_air = Medium(sound_speed=343.1, density=1.293)
    >>> round(paper_air.wavelength(40e3) * 1e3, 2)
    8.58
    """

    sound_speed: float
    density: float
    absorption: float = 0.0

    def __post_init__(self) -> None:
        numbers = {
            "sound_speed": between(
                self.sound_speed, 1e2, 1e4, "sound speed", "m/s", "is it in km/s?"
            ),
            "density": between(self.density, 1e-2, 3e4, "density", "kg/m³", "is it in g/cm³?"),
            "absorption": between(
                self.absorption, 0.0, 1e6, "absorption", "Np/m", "use 0 for none."
            ),
        }
        for name, number in numbers.items():
            object.__setattr__(self, name, number)

    def wavenumber(self, frequency: float) -> complex:
        """Return the wavenumber k = 2πf/c + i·absorption [1/m] at a frequency [Hz]."""
        angular = 2.0 * math.pi * positive(frequency, "frequency", "Hz")
        return complex(angular / self.sound_speed, self.absorption)

    def wavelength(self, frequency: float) -> float:
        """Return the wavelength c/f [m] at a frequency [Hz]."""
        return self.sound_speed / positive(frequency, "frequency", "Hz")


def air(celsius: float = 20.0, humidity: float = 0.5, frequency: float = 40e3) -> Medium:
    """Return the ``Medium`` of humid air at one atmosphere (101 325 Pa), for use in a ``Scene``.

    The speed of sound follows Cramer (1993, equation 15), the density follows CIPM-2007, and
    the absorption follows ISO 9613-1.

    Parameters
    ----------
    celsius : temperature [°C], -20 to 50 (the range of ISO 9613-1; the formulas of Cramer and
        CIPM-2007 were fitted from 0 to 30 °C).
    humidity : relative humidity, 0 to 1.
    frequency : frequency at which the absorption is computed [Hz], above 0. The absorption does not
        adapt to the frequency of a ``Scene``, so pass the same frequency to the scene.

    Returns
    -------
    The ``Medium`` with the speed of sound [m/s], the density [kg/m³], and the absorption at
    ``frequency`` [Np/m].

    Raises
    ------
    InvalidInput
        If a value is outside its range.

    Examples
    --------
    >>> medium = air(celsius=20.0, humidity=0.5, frequency=40e3)
    >>> round(medium.sound_speed, 1), round(medium.density, 3)
    (344.0, 1.199)
    """
    frequency = positive(frequency, "frequency", "Hz")
    celsius = between(
        celsius, -20.0, 50.0, "the air's temperature", "°C", "the formulas hold only in this range."
    )
    slip = "50 per cent is humidity=0.5."
    humidity = between(humidity, 0.0, 1.0, "relative humidity", "", slip)
    vapour = _vapour_fraction(celsius, humidity)
    return Medium(
        _sound_speed(celsius, vapour),
        _density(celsius, vapour),
        _absorption(celsius, humidity, frequency),
    )


def _vapour_fraction(celsius: float, humidity: float) -> float:
    """Return the mole fraction of water vapour by CIPM-2007, appendix A1."""
    kelvin = celsius + 273.15
    saturation = math.exp(
        1.2378847e-5 * kelvin**2 - 1.9121316e-2 * kelvin + 33.93711047 - 6.3431645e3 / kelvin
    )
    enhancement = 1.00062 + 3.14e-8 * _PASCAL + 5.6e-7 * celsius**2
    return humidity * enhancement * saturation / _PASCAL


def _sound_speed(t: float, w: float) -> float:
    """Return the speed of sound [m/s] by Cramer (1993), equation (15).

    t is the temperature in °C, and w the mole fraction of water vapour.
    """
    p = _PASCAL
    c = _CARBON_DIOXIDE
    return (
        331.5024
        + 0.603055 * t
        - 0.000528 * t**2
        + (51.471935 + 0.1495874 * t - 0.000782 * t**2) * w
        + (-1.82e-7 + 3.73e-8 * t - 2.93e-10 * t**2) * p
        + (-85.20931 - 0.228525 * t + 5.91e-5 * t**2) * c
        - 2.835149 * w**2
        - 2.15e-13 * p**2
        + 29.179762 * c**2
        + 0.000486 * w * p * c
    )


def _density(t: float, w: float) -> float:
    """Return the density [kg/m³] by CIPM-2007, equation (2) with the compressibility of A2."""
    kelvin = t + 273.15
    ratio = _PASCAL / kelvin
    dry_part = 1.58123e-6 - 2.9331e-8 * t + 1.1043e-10 * t**2
    first = dry_part + (5.707e-6 - 2.051e-8 * t) * w + (1.9898e-4 - 2.376e-6 * t) * w**2
    compressibility = 1.0 - ratio * first + ratio**2 * (1.83e-11 - 0.765e-8 * w**2)
    dry = 3.483740e-3 + 1.4446e-3 * (_CARBON_DIOXIDE - 0.0004)
    return dry * ratio / compressibility * (1.0 - 0.3780 * w)


def _absorption(celsius: float, humidity: float, frequency: float) -> float:
    """Return the absorption [Np/m] at one atmosphere by ISO 9613-1, equations (3) to (5)."""
    kelvin = celsius + 273.15
    relative = kelvin / 293.15
    # Saturation pressure divided by one atmosphere, (B.2) and (B.3).
    saturation = 10.0 ** (4.6151 - 6.8346 * (273.16 / kelvin) ** 1.261)
    percent = 100.0 * humidity * saturation  # molar concentration of water vapour, (B.1)
    oxygen = 24.0 + 4.04e4 * percent * (0.02 + percent) / (0.391 + percent)
    nitrogen = relative**-0.5 * (
        9.0 + 280.0 * percent * math.exp(-4.170 * (relative ** (-1.0 / 3.0) - 1.0))
    )
    relaxation = 0.01275 * math.exp(-2239.1 / kelvin) / (oxygen + frequency**2 / oxygen)
    relaxation += 0.1068 * math.exp(-3352.0 / kelvin) / (nitrogen + frequency**2 / nitrogen)
    decibel = 8.686 * frequency**2 * (1.84e-11 * relative**0.5 + relative**-2.5 * relaxation)
    return decibel / (20.0 * math.log10(math.e))
