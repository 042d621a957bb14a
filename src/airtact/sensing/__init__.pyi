from .codes import (
    hadamard_codes as hadamard_codes,
)
from .codes import (
    random_codes as random_codes,
)
from .codes import (
    single_codes as single_codes,
)
from .echoes import load_echoes as load_echoes
from .family import ScatteringFamily as ScatteringFamily
from .family import scattering_family as scattering_family
from .registration import Located as Located
from .residual import unexplained as unexplained
from .scattering import ScatteringMatrix as ScatteringMatrix
from .self_calibration import Calibrated as Calibrated
from .transmission import simulate_transmissions as simulate_transmissions
