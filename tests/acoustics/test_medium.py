"""Air against the tables of the standards it is taken from."""

import math
from decimal import Decimal

import pytest

from airtact.acoustics.medium import Medium, air
from faults import raises_code

DECIBEL = 20 * math.log10(math.e)

# ISO 9613-1:1993, Table 1 (sub-tables by temperature): °C, relative humidity in per cent, band
# number k with f = 1000 x 10^(k/10) Hz (the exact midband, note 5), attenuation in dB/km as
# printed.
ISO_9613_1_TABLE_1 = [
    (-20, 10, -13, "0.589"),
    (-20, 50, 0, "9.14"),
    (-20, 70, 9, "27.8"),
    (0, 20, 3, "34.6"),
    (0, 100, 8, "88.0"),
    (10, 50, 6, "46.7"),
    (15, 100, 10, "105"),
    (20, 15, 8, "175"),
    (20, 50, 0, "4.66"),
    (20, 50, 3, "9.86"),
    (20, 80, 0, "5.15"),
    (25, 100, 3, "11.4"),
    (30, 50, 6, "24.5"),
    (40, 50, 0, "9.52"),
    (50, 50, 3, "24.8"),
]

# ISO 9613-2:1996, Table 2: octave bands 63 Hz to 8 kHz, dB/km as printed.
ISO_9613_2_TABLE_2 = [
    (10, 70, "0.1 0.4 1.0 1.9 3.7 9.7 32.8 117"),
    (20, 70, "0.1 0.3 1.1 2.8 5.0 9.0 22.9 76.6"),
    (30, 70, "0.1 0.3 1.0 3.1 7.4 12.7 23.1 59.3"),
    (15, 20, "0.3 0.6 1.2 2.7 8.2 28.2 88.8 202"),
    (15, 50, "0.1 0.5 1.2 2.2 4.2 10.8 36.2 129"),
    (15, 80, "0.1 0.3 1.1 2.4 4.1 8.3 23.7 82.8"),
]


def last_digit(printed: str) -> float:
    return 10.0 ** int(Decimal(printed).as_tuple().exponent)


def decibel_per_kilometre(celsius: float, percent: float, frequency: float) -> float:
    return 1e3 * DECIBEL * air(float(celsius), percent / 100, frequency).absorption


@pytest.mark.parametrize(("celsius", "percent", "band", "printed"), ISO_9613_1_TABLE_1)
def test_absorption_is_that_of_iso_9613_1_to_the_last_printed_digit(
    celsius, percent, band, printed
):
    ours = decibel_per_kilometre(celsius, percent, 1000 * 10 ** (band / 10))
    assert ours == pytest.approx(float(printed), abs=0.51 * last_digit(printed))


@pytest.mark.parametrize(("celsius", "percent", "row"), ISO_9613_2_TABLE_2)
def test_absorption_is_that_of_iso_9613_2_in_every_octave(celsius, percent, row):
    for octave, printed in enumerate(row.split()):
        ours = decibel_per_kilometre(celsius, percent, 1000 * 10 ** (0.3 * (octave - 4)))
        # Rounded by the standard from the three digits of ISO 9613-1, so a last digit may have been
        # rounded twice.
        assert ours == pytest.approx(float(printed), abs=0.55 * last_digit(printed))


def test_speed_and_density_are_those_of_iec_61094_2():
    # IEC 61094-2:2009, Annex F, Table F.1: 23 °C, 101 325 Pa, 50 % relative humidity.
    medium = air(23.0, 0.5)
    assert medium.sound_speed == pytest.approx(345.86652, abs=6e-6)
    assert medium.density == pytest.approx(1.1860848, abs=6e-8)


@pytest.mark.parametrize(
    "numbers",
    [
        (0.0, 1.2, 0.0),
        (-343.0, 1.2, 0.0),
        (343.0, 0.0, 0.0),
        (343.0, -1.2, 0.0),
        (math.nan, 1.2, 0.0),
        (343.0, math.inf, 0.0),
        (343.0, 1.2, -0.1),
        (343.0, 1.2, math.nan),
        # in other units
        (0.343, 1.2, 0.0),
        (34300, 1.2, 0.0),
        (343, 0.0012, 0.0),
    ],
)
def test_impossible_media_are_rejected(numbers):
    with raises_code("out_of_range"):
        Medium(*numbers)


@pytest.mark.parametrize("frequency", [0.0, -40e3, math.nan, math.inf])
def test_a_frequency_must_be_above_zero(frequency):
    medium = Medium(343.0, 1.2)
    for ask in (medium.wavenumber, medium.wavelength, lambda f: air(frequency=f)):
        with raises_code("out_of_range"):
            ask(frequency)


@pytest.mark.parametrize(
    ("celsius", "humidity"),
    [(293.15, 0.5), (-40.0, 0.5), (math.nan, 0.5), (20.0, 50.0), (20.0, -0.1), (20.0, math.nan)],
)
def test_air_outside_its_formulas_is_rejected(celsius, humidity):
    with raises_code("out_of_range"):
        air(celsius, humidity)
