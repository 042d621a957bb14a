from .echoes import load_echoes as load_echoes
from .registration import Located as Located
from .registration import unexplained as unexplained
from .scattering import ScatteringFamily as ScatteringFamily
from .scattering import ScatteringMatrix as ScatteringMatrix
from .scattering import scattering_family as scattering_family
from .self_calibration import Calibrated as Calibrated
from .simulation import (
    hadamard_codes as hadamard_codes,
)
from .simulation import (
    random_codes as random_codes,
)
from .simulation import (
    single_codes as single_codes,
)
from .transmission import simulate_transmissions as simulate_transmissions
