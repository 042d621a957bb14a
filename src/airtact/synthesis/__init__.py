"""What to emit: a transfer matrix and a target in, a drive or a sequence out."""

from airtact.frames.frame import Frame
from airtact.sampling.ensemble import TransferEnsemble
from airtact.synthesis.best import best
from airtact.synthesis.constraint import Constraint
from airtact.synthesis.gerchberg_saxton import (
    gerchberg_saxton,
    gs_pat,
    weighted_gerchberg_saxton,
    weighted_gerchberg_saxton_sets,
)
from airtact.synthesis.gradient import gradient
from airtact.synthesis.least_peak import least_peak
from airtact.synthesis.least_squares import eigenvector, inverse_filter, iterated_time_reversal
from airtact.synthesis.max_min import Stalled, max_min
from airtact.synthesis.methods import METHODS
from airtact.synthesis.motion import Motion, moving_foci, moving_target
from airtact.synthesis.quantise import quantise, rounding_error
from airtact.synthesis.reach import achieved_fraction
from airtact.synthesis.samples.bound import RobustBound, robust_upper_bound
from airtact.synthesis.samples.robust import goal_value, robust, robust_phase_only
from airtact.synthesis.sequence import (
    Sequence,
    amplitude_modulation,
    check_playable,
    lateral_modulation,
    spatiotemporal_modulation,
)
from airtact.synthesis.time_reversal import phase_conjugate, time_reversal
from airtact.synthesis.upper_bound import UpperBound, upper_bound
from airtact.transducers.levels import Levels
from airtact.transducers.modulation import AmplitudeModulation
from airtact.transfer import focus_by_distance, focus_by_distance_phase_only

__all__ = [
    "METHODS",
    "AmplitudeModulation",
    "Constraint",
    "Frame",
    "Levels",
    "Motion",
    "RobustBound",
    "Sequence",
    "Stalled",
    "TransferEnsemble",
    "UpperBound",
    "achieved_fraction",
    "amplitude_modulation",
    "best",
    "check_playable",
    "eigenvector",
    "focus_by_distance",
    "focus_by_distance_phase_only",
    "gerchberg_saxton",
    "goal_value",
    "gradient",
    "gs_pat",
    "inverse_filter",
    "iterated_time_reversal",
    "lateral_modulation",
    "least_peak",
    "max_min",
    "moving_foci",
    "moving_target",
    "phase_conjugate",
    "quantise",
    "robust",
    "robust_phase_only",
    "robust_upper_bound",
    "rounding_error",
    "spatiotemporal_modulation",
    "time_reversal",
    "upper_bound",
    "weighted_gerchberg_saxton",
    "weighted_gerchberg_saxton_sets",
]
