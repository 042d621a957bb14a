"""How good a drive is: fields and figures of merit, by a solver that did not make it."""

from airtact.evaluation.comparison import HELD_EQUAL, Comparison, compare
from airtact.evaluation.field import drive_sources, field_map
from airtact.evaluation.metrics import Evaluation, evaluate
from airtact.evaluation.microphone import Microphone
from airtact.evaluation.radiation import Pad, RadiationMap, radiation_map, radiation_pressure
from airtact.evaluation.scan import Overlay, Scan, load_scan, overlay_scan
from airtact.evaluation.thresholds import sound_pressure_level
from airtact.evaluation.verification import SideLobe, Verification, attainable, verify

__all__ = [
    "HELD_EQUAL",
    "Comparison",
    "Evaluation",
    "Microphone",
    "Overlay",
    "Pad",
    "RadiationMap",
    "Scan",
    "SideLobe",
    "Verification",
    "attainable",
    "compare",
    "drive_sources",
    "evaluate",
    "field_map",
    "load_scan",
    "overlay_scan",
    "radiation_map",
    "radiation_pressure",
    "sound_pressure_level",
    "verify",
]
