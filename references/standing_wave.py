"""Force of a plane standing wave on a sphere of any size, in closed form."""

import numpy as np
from scipy.special import spherical_jn, spherical_yn

import airtact as at

AIR = at.Medium(sound_speed=343.1, density=1.2)
FOAM = at.Medium(900.0, 29.36)
K = 2 * np.pi * 40e3 / 343.1

# Two elements 8 m apart, in phase, with an antinode of 2 kPa in the middle
PAIR = at.PhasedArray(np.array([[0.0, -4.0, 0.0], [0.0, 4.0, 0.0]]), element=at.monopole(4e3))
BOTH = at.Drive(np.ones(2, dtype=np.complex128))
ENERGY = 2000**2 / (8 * 1.2 * 343.1**2)


def standing_wave_function(size: float, filling: at.Medium | None) -> float:
    """Return Y of the force πa²EY sin 2kz on a sphere of size ka, hard or filled.

    E is the energy density of the wave (T. Hasegawa, J. Acoust. Soc. Am. 65, 32, 1979).
    """
    order = np.arange(24)
    admittance = np.zeros(24)
    if filling is not None:
        ratio = AIR.sound_speed / filling.sound_speed
        inner = spherical_jn(order, size * ratio, True) / spherical_jn(order, size * ratio)
        admittance = -AIR.density / filling.density * ratio * inner
    regular = spherical_jn(order, size, True) + admittance * spherical_jn(order, size)
    outgoing = spherical_jn(order, size) + 1j * spherical_yn(order, size)
    slope = spherical_jn(order, size, True) + 1j * spherical_yn(order, size, True)
    waves = -regular / (slope + admittance * outgoing)
    a = waves.real
    b = waves.imag
    terms = b[1:] * (1 + 2 * a[:-1]) - b[:-1] * (1 + 2 * a[1:])
    return float(8 / size**2 * np.sum((order[:-1] + 1) * (-1.0) ** order[:-1] * terms))
