"""Mid-air haptics with the hand in the sound: what every transducer of a phased array must emit.

The way through: a ``Scene`` (what is in the air) and a ``Target`` (what a person feels); one solve with beacons, the
virtual sources at the foci; the transfer matrix to a ``PhasedArray`` by reciprocity; a ``Drive``; its evaluation with
another solver. The main path is at the top; the rest is in the public modules ``synthesis``, ``targets``, ``plot``,
``boards``, ``emission``, ``live``, ``tracking``, ``sensing``, ``hands``, ``evaluation``, ``solvers``, ``scene``,
``scene_file`` and ``surfaces``.
"""

import importlib
import os
import warnings
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from airtact.conventions import InvalidInput, NotConverged
    from airtact.evaluation.comparison import compare
    from airtact.evaluation.field import field_map
    from airtact.evaluation.metrics import evaluate
    from airtact.examples import example
    from airtact.files.drives import load_drive
    from airtact.hand.files import load_hand
    from airtact.hand.fitting.fit import fit_hand
    from airtact.hand.hand import Hand, hand_from_joints
    from airtact.hand.pinch import pinch
    from airtact.hardware.autd3_link import AUTD3Link
    from airtact.hardware.emission import Emission
    from airtact.pose import Pose
    from airtact.sampling.ensemble import ensemble
    from airtact.scene.medium import Medium, air
    from airtact.scene.planes import plane
    from airtact.scene.scene import Scene, filled, impedance, sound_hard
    from airtact.scene.sources import Monopoles
    from airtact.scene.target import Target
    from airtact.scene.uncertainty import Uncertainty
    from airtact.scene_file.building import read_scene
    from airtact.sensing.echoes import Echoes
    from airtact.sensing.registration import locate
    from airtact.sensing.scattering import scattering_matrix
    from airtact.sensing.self_calibration import calibrate
    from airtact.sensing.simulation import simulate_echoes
    from airtact.solvers.bem.solver import BoundaryElement
    from airtact.solvers.fem.solver import FiniteElement
    from airtact.solvers.free_field import FreeField
    from airtact.solvers.sampled_field import SampledField
    from airtact.solvers.spherical.multipole_field import multipole_expansion
    from airtact.solvers.spherical.sphere_series import SphereSeries
    from airtact.store.stored import Stored
    from airtact.surfaces.files import load_surface
    from airtact.surfaces.primitives import capsule, sphere
    from airtact.surfaces.surface import Surface
    from airtact.sweeping.sweep import sweep
    from airtact.synthesis.best import best
    from airtact.synthesis.gerchberg_saxton import weighted_gerchberg_saxton
    from airtact.synthesis.max_min import max_min
    from airtact.synthesis.quantise import quantise
    from airtact.synthesis.samples.robust import robust
    from airtact.synthesis.time_reversal import time_reversal
    from airtact.synthesis.upper_bound import upper_bound
    from airtact.transducers.element import monopole, piston
    from airtact.transducers.layout import PhasedArray, autd3_board, flat_boards, surrounding_box
    from airtact.transducers.plates import reflecting_boards
    from airtact.transfer import Drive, TransferMatrix, focus_by_distance, open_air_matrix, transfer_matrix

    from airtact import (  # isort: skip
        boards,
        emission,
        evaluation,
        hands,
        live,
        plot,
        scene,
        scene_file,
        sensing,
        solvers,
        surfaces,
        synthesis,
        targets,
        tracking,
    )

# The compiled loops' threads would spin for milliseconds after each loop and keep NumPy's own off the cores; for some
# microseconds they may, until the next loop, as waking them takes longer. Read when the loops are loaded, after this.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
os.environ.setdefault("GOMP_SPINCOUNT", "3000")

__version__ = "0.1.0"

__all__ = [
    "AUTD3Link",
    "BoundaryElement",
    "Drive",
    "Echoes",
    "Emission",
    "FiniteElement",
    "FreeField",
    "Hand",
    "InvalidInput",
    "Medium",
    "Monopoles",
    "NotConverged",
    "PhasedArray",
    "Pose",
    "SampledField",
    "Scene",
    "SphereSeries",
    "Stored",
    "Surface",
    "Target",
    "TransferMatrix",
    "Uncertainty",
    "air",
    "autd3_board",
    "best",
    "boards",
    "calibrate",
    "capsule",
    "compare",
    "emission",
    "ensemble",
    "evaluate",
    "evaluation",
    "example",
    "field_map",
    "filled",
    "fit_hand",
    "flat_boards",
    "focus_by_distance",
    "hand_from_joints",
    "hands",
    "impedance",
    "live",
    "load_drive",
    "load_hand",
    "load_surface",
    "locate",
    "max_min",
    "monopole",
    "multipole_expansion",
    "open_air_matrix",
    "pinch",
    "piston",
    "plane",
    "plot",
    "quantise",
    "read_scene",
    "reflecting_boards",
    "robust",
    "scattering_matrix",
    "scene",
    "scene_file",
    "sensing",
    "simulate_echoes",
    "solvers",
    "sound_hard",
    "sphere",
    "surfaces",
    "surrounding_box",
    "sweep",
    "synthesis",
    "targets",
    "time_reversal",
    "tracking",
    "transfer_matrix",
    "upper_bound",
    "weighted_gerchberg_saxton",
]

_HOMES = {
    "conventions": "InvalidInput NotConverged",
    "evaluation.comparison": "compare",
    "evaluation.field": "field_map",
    "evaluation.metrics": "evaluate",
    "examples": "example",
    "files.drives": "load_drive",
    "hand.files": "load_hand",
    "hand.fitting.fit": "fit_hand",
    "hand.hand": "Hand hand_from_joints",
    "hand.pinch": "pinch",
    "hardware.autd3_link": "AUTD3Link",
    "hardware.emission": "Emission",
    "pose": "Pose",
    "sampling.ensemble": "ensemble",
    "scene.medium": "Medium air",
    "scene.planes": "plane",
    "scene.scene": "Scene filled impedance sound_hard",
    "scene.sources": "Monopoles",
    "scene.target": "Target",
    "scene.uncertainty": "Uncertainty",
    "scene_file.building": "read_scene",
    "sensing.echoes": "Echoes",
    "sensing.registration": "locate",
    "sensing.scattering": "scattering_matrix",
    "sensing.self_calibration": "calibrate",
    "sensing.simulation": "simulate_echoes",
    "solvers.bem.solver": "BoundaryElement",
    "solvers.fem.solver": "FiniteElement",
    "solvers.free_field": "FreeField",
    "solvers.sampled_field": "SampledField",
    "solvers.spherical.multipole_field": "multipole_expansion",
    "solvers.spherical.sphere_series": "SphereSeries",
    "store.stored": "Stored",
    "surfaces.files": "load_surface",
    "surfaces.primitives": "capsule sphere",
    "surfaces.surface": "Surface",
    "sweeping.sweep": "sweep",
    "synthesis.best": "best",
    "synthesis.gerchberg_saxton": "weighted_gerchberg_saxton",
    "synthesis.max_min": "max_min",
    "synthesis.quantise": "quantise",
    "synthesis.samples.robust": "robust",
    "synthesis.time_reversal": "time_reversal",
    "synthesis.upper_bound": "upper_bound",
    "transducers.element": "monopole piston",
    "transducers.layout": "PhasedArray autd3_board flat_boards surrounding_box",
    "transducers.plates": "reflecting_boards",
    "transfer": "Drive TransferMatrix focus_by_distance open_air_matrix transfer_matrix",
}
_MODULE_OF = {name: module for module, names in _HOMES.items() for name in names.split()}
"""Where each name stands: a module is imported when one of its names is first asked for."""

_MOVED = {
    "boards": "Board board_array board_named Element join load_calibration poses_of_boards",
    "emission": "FileLink Link LinkFailed Played RecordingLink SerialLink",
    "evaluation": "Comparison Evaluation Microphone Overlay Pad Scan attainable load_scan overlay_scan "
    "radiation_pressure sound_pressure_level",
    "hands": "FittedHand HandAnatomy Pinch Touch",
    "scene": "Obstacle",
    "solvers": "RadiatedField SolveReport Solver load_samples",
    "surfaces": "Panels merged",
    "synthesis": "Constraint Frame Levels Sequence Stalled UpperBound amplitude_modulation check_playable eigenvector "
    "gerchberg_saxton gradient gs_pat inverse_filter iterated_time_reversal lateral_modulation phase_conjugate "
    "rounding_error spatiotemporal_modulation weighted_gerchberg_saxton_sets focus_by_distance_phase_only",
    "targets": "circle picture polyline segment sphere_shell svg_path text",
    "tracking": "HandFrame HandStream OscReceiver Predictor Recording StreamHealth WebSocketReceiver load_recording "
    "replay save_recording",
}
_RENAMED = {
    "Judgement": "evaluation.Verification",
    "Skin": "solvers.SurfaceField",
    "SkinMap": "evaluation.RadiationMap",
    "Stray": "evaluation.SideLobe",
    "judge": "evaluation.verify",
    "onto_skin": "targets.onto_surface",
    "outgoing_waves": "multipole_expansion",
    "share_reached": "synthesis.achieved_fraction",
    "skin_map": "evaluation.radiation_map",
    "skin_points": "targets.surface_points",
}
_OLD_NAMES = {name: f"{module}.{name}" for module, names in _MOVED.items() for name in names.split()} | _RENAMED
"""Names that were at the top in 0.1.0 and where they are now; they go after one release."""


def __getattr__(name: str) -> Any:
    if name in _MODULE_OF:
        found = getattr(importlib.import_module(f"airtact.{_MODULE_OF[name]}"), name)
    elif name in __all__:
        found = importlib.import_module(f"airtact.{name}")
    elif name in _OLD_NAMES:
        now = _OLD_NAMES[name]
        warnings.warn(
            f"airtact.{name} is now airtact.{now}; the old name goes in 0.3.", DeprecationWarning, stacklevel=2
        )
        module, _, attribute = now.rpartition(".")
        return getattr(importlib.import_module(f"airtact.{module}" if module else "airtact"), attribute)
    else:
        raise AttributeError(f"module 'airtact' has no attribute {name!r}")
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])
