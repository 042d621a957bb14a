"""What the echoes of a hand in the array's own sound show: coded transmissions, and where the hand is."""

from airtact.sensing.codes import hadamard_codes, random_codes, single_codes
from airtact.sensing.echoes import Echoes, load_echoes
from airtact.sensing.registration import Located, locate
from airtact.sensing.scattering import ScatteringMatrix, scattering_matrix
from airtact.sensing.simulation import simulate_echoes

__all__ = [
    "Echoes",
    "Located",
    "ScatteringMatrix",
    "hadamard_codes",
    "load_echoes",
    "locate",
    "random_codes",
    "scattering_matrix",
    "simulate_echoes",
    "single_codes",
]
