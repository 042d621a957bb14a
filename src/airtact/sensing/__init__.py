"""What the echoes of a hand in the array's own sound show: coded transmissions, and their files."""

from airtact.sensing.codes import hadamard_codes, random_codes, single_codes
from airtact.sensing.echoes import Echoes, load_echoes

__all__ = ["Echoes", "hadamard_codes", "load_echoes", "random_codes", "single_codes"]
