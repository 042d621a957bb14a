from .bounds import UpperBound as UpperBound
from .conjugation import phase_conjugate as phase_conjugate
from .constraint import Constraint as Constraint
from .frame import Frame as Frame
from .gerchberg_saxton import (
    gs_pat as gs_pat,
)
from .gerchberg_saxton import (
    weighted_gerchberg_saxton_sets as weighted_gerchberg_saxton_sets,
)
from .gradient_descent import gradient as gradient
from .least_squares import (
    eigenvector as eigenvector,
)
from .least_squares import (
    inverse_filter as inverse_filter,
)
from .least_squares import (
    iterated_time_reversal as iterated_time_reversal,
)
from .methods import METHODS as METHODS
from .motion import Motion as Motion
from .motion import moving_foci as moving_foci
from .motion import moving_target as moving_target
from .peak_limited import least_peak as least_peak
from .reach import achieved_fraction as achieved_fraction
from .rounding import rounding_error as rounding_error
from .samples.bound import RobustBound as RobustBound
from .samples.bound import robust_upper_bound as robust_upper_bound
from .samples.robust import goal_value as goal_value
from .samples.robust import robust_phase_only as robust_phase_only
from .sampling.ensemble import TransferEnsemble as TransferEnsemble
from .sequence import (
    Sequence as Sequence,
)
from .sequence import (
    amplitude_modulation as amplitude_modulation,
)
from .sequence import (
    check_playable as check_playable,
)
from .sequence import (
    lateral_modulation as lateral_modulation,
)
from .sequence import (
    spatiotemporal_modulation as spatiotemporal_modulation,
)
from .transfer import focus_by_distance_phase_only as focus_by_distance_phase_only
from .weakest_focus import Stalled as Stalled
