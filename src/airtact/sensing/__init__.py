"""What the echoes of a hand in the array's own sound show: coded transmissions, and where the hand is."""

from airtact.sensing.codes import hadamard_codes, random_codes, single_codes
from airtact.sensing.echoes import Echoes, load_echoes
from airtact.sensing.family import ScatteringFamily, scattering_family
from airtact.sensing.registration import Located, locate
from airtact.sensing.residual import unexplained
from airtact.sensing.scattering import ScatteringMatrix, scattering_matrix
from airtact.sensing.self_calibration import Calibrated, calibrate
from airtact.sensing.shapes.fit import LocatedShape, locate_shape
from airtact.sensing.shapes.unknown import UnknownShape
from airtact.sensing.simulation import simulate_echoes
from airtact.sensing.time_reversal import TimeReversal, dort, iterate_time_reversal
from airtact.sensing.transmission import simulate_transmissions

__all__ = [
    "Calibrated",
    "Echoes",
    "Located",
    "LocatedShape",
    "ScatteringFamily",
    "ScatteringMatrix",
    "TimeReversal",
    "UnknownShape",
    "calibrate",
    "dort",
    "hadamard_codes",
    "iterate_time_reversal",
    "load_echoes",
    "locate",
    "locate_shape",
    "random_codes",
    "scattering_family",
    "scattering_matrix",
    "simulate_echoes",
    "simulate_transmissions",
    "single_codes",
    "unexplained",
]
