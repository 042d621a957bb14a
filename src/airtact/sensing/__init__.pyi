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
from .shapes.fit import LocatedShape as LocatedShape
from .shapes.fit import locate_shape as locate_shape
from .shapes.unknown import UnknownShape as UnknownShape
from .time_reversal import (
    TimeReversal as TimeReversal,
)
from .time_reversal import (
    dort as dort,
)
from .time_reversal import (
    iterate_time_reversal as iterate_time_reversal,
)
from .transmission import simulate_transmissions as simulate_transmissions
