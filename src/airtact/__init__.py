"""Mid-air haptics with the hand in the sound: what every transducer of a phased array must emit.

The way through: a ``Scene`` (what is in the air) and a ``Target`` (what shall be felt); one solve with imagined beacons
in the foci; the transfer matrix to a ``PhasedArray`` by reciprocity; a ``Drive``; its evaluation by another solver.
"""

from airtact.conventions import InvalidInput, NotConverged
from airtact.evaluation.attainable import attainable
from airtact.evaluation.comparison import Comparison, compare
from airtact.evaluation.field import field_map
from airtact.evaluation.metrics import Evaluation, evaluate
from airtact.evaluation.microphone import Microphone
from airtact.evaluation.radiation import Pad, RadiationMap, radiation_map, radiation_pressure
from airtact.evaluation.scan import Overlay, Scan, load_scan, overlay_scan
from airtact.evaluation.thresholds import sound_pressure_level
from airtact.evaluation.verification import SideLobe, Verification, verify
from airtact.hand.anatomy_parts import Touch
from airtact.hand.files import load_hand
from airtact.hand.fitting.fit import FittedHand, fit_hand
from airtact.hand.fitting.size_prior import HandAnatomy
from airtact.hand.hand import Hand, hand_from_joints
from airtact.hand.pinch import Pinch, pinch
from airtact.hardware.autd3_link import AUTD3Link
from airtact.hardware.emission import Emission, Played
from airtact.hardware.file_link import FileLink
from airtact.hardware.link import Link, LinkFailed, RecordingLink
from airtact.hardware.serial_link import SerialLink
from airtact.pose import Pose
from airtact.scene.drawings import picture, svg_path, text
from airtact.scene.medium import Medium, air
from airtact.scene.scene import Obstacle, Scene, filled, impedance, sound_hard
from airtact.scene.sources import Monopoles
from airtact.scene.target import Target
from airtact.scene.target_points import circle, onto_surface, polyline, segment, sphere_shell, surface_points
from airtact.solvers.bem.solver import BoundaryElement
from airtact.solvers.fem.solver import FiniteElement
from airtact.solvers.free_field import FreeField
from airtact.solvers.problem import RadiatedField, Solver, SolveReport, SurfaceField
from airtact.solvers.sampled_field import SampledField, load_samples
from airtact.solvers.spherical.multipole_field import multipole_expansion
from airtact.solvers.spherical.sphere_series import SphereSeries
from airtact.store.stored import Stored
from airtact.surfaces.files import load_surface
from airtact.surfaces.panels import Panels
from airtact.surfaces.primitives import capsule, sphere
from airtact.surfaces.surface import Surface
from airtact.surfaces.union import merged
from airtact.synthesis.constraint import Constraint
from airtact.synthesis.eigenvector import eigenvector
from airtact.synthesis.gerchberg_saxton import (
    gerchberg_saxton,
    gs_pat,
    weighted_gerchberg_saxton,
    weighted_gerchberg_saxton_sets,
)
from airtact.synthesis.gradient import gradient
from airtact.synthesis.inverse_filter import inverse_filter, iterated_time_reversal
from airtact.synthesis.max_min import max_min
from airtact.synthesis.quantise import Frame, Levels, quantise, rounding_error
from airtact.synthesis.reach import achieved_fraction
from airtact.synthesis.sequence import (
    Sequence,
    amplitude_modulation,
    check_playable,
    lateral_modulation,
    spatiotemporal_modulation,
)
from airtact.synthesis.stalling import Stalled
from airtact.synthesis.time_reversal import phase_conjugate, time_reversal
from airtact.synthesis.upper_bound import UpperBound, upper_bound
from airtact.tracking.frame import HandFrame
from airtact.tracking.prediction import Predictor
from airtact.tracking.receivers import OscReceiver, WebSocketReceiver
from airtact.tracking.recordings import Recording, load_recording, replay, save_recording
from airtact.tracking.stream import HandStream, StreamHealth
from airtact.transducers.boards import Board, board_named, poses_of_boards
from airtact.transducers.calibration import load_calibration
from airtact.transducers.element import Element, monopole, piston
from airtact.transducers.layout import PhasedArray, autd3_board, board_array, flat_boards, join, surrounding_box
from airtact.transfer import (
    Drive,
    TransferMatrix,
    focus_by_distance,
    focus_by_distance_phase_only,
    transfer_matrix,
)

__version__ = "0.1.0"

__all__ = [
    "AUTD3Link",
    "Board",
    "BoundaryElement",
    "Comparison",
    "Constraint",
    "Drive",
    "Element",
    "Emission",
    "Evaluation",
    "FileLink",
    "FiniteElement",
    "FittedHand",
    "Frame",
    "FreeField",
    "Hand",
    "HandAnatomy",
    "HandFrame",
    "HandStream",
    "InvalidInput",
    "Levels",
    "Link",
    "LinkFailed",
    "Medium",
    "Microphone",
    "Monopoles",
    "NotConverged",
    "Obstacle",
    "OscReceiver",
    "Overlay",
    "Pad",
    "Panels",
    "PhasedArray",
    "Pinch",
    "Played",
    "Pose",
    "Predictor",
    "RadiatedField",
    "RadiationMap",
    "Recording",
    "RecordingLink",
    "SampledField",
    "Scan",
    "Scene",
    "Sequence",
    "SerialLink",
    "SideLobe",
    "SolveReport",
    "Solver",
    "SphereSeries",
    "Stalled",
    "Stored",
    "StreamHealth",
    "Surface",
    "SurfaceField",
    "Target",
    "Touch",
    "TransferMatrix",
    "UpperBound",
    "Verification",
    "WebSocketReceiver",
    "achieved_fraction",
    "air",
    "amplitude_modulation",
    "attainable",
    "autd3_board",
    "board_array",
    "board_named",
    "capsule",
    "check_playable",
    "circle",
    "compare",
    "eigenvector",
    "evaluate",
    "field_map",
    "filled",
    "fit_hand",
    "flat_boards",
    "focus_by_distance",
    "focus_by_distance_phase_only",
    "gerchberg_saxton",
    "gradient",
    "gs_pat",
    "hand_from_joints",
    "impedance",
    "inverse_filter",
    "iterated_time_reversal",
    "join",
    "lateral_modulation",
    "load_calibration",
    "load_hand",
    "load_recording",
    "load_samples",
    "load_scan",
    "load_surface",
    "max_min",
    "merged",
    "monopole",
    "multipole_expansion",
    "onto_surface",
    "overlay_scan",
    "phase_conjugate",
    "picture",
    "pinch",
    "piston",
    "polyline",
    "poses_of_boards",
    "quantise",
    "radiation_map",
    "radiation_pressure",
    "replay",
    "rounding_error",
    "save_recording",
    "segment",
    "sound_hard",
    "sound_pressure_level",
    "spatiotemporal_modulation",
    "sphere",
    "sphere_shell",
    "surface_points",
    "surrounding_box",
    "svg_path",
    "text",
    "time_reversal",
    "transfer_matrix",
    "upper_bound",
    "verify",
    "weighted_gerchberg_saxton",
    "weighted_gerchberg_saxton_sets",
]
