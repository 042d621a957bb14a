"""Where the hand is now: frames of trackers, streams of them, recordings, and prediction."""

from airtact.tracking.frame import FaultyFrame, HandFrame
from airtact.tracking.messages import from_json, from_osc, to_json, to_osc
from airtact.tracking.prediction import Predictor
from airtact.tracking.receivers import OscReceiver, WebSocketReceiver
from airtact.tracking.recordings import Recording, load_recording, replay, save_recording
from airtact.tracking.stream import HandStream, StreamHealth

__all__ = [
    "FaultyFrame",
    "HandFrame",
    "HandStream",
    "OscReceiver",
    "Predictor",
    "Recording",
    "StreamHealth",
    "WebSocketReceiver",
    "from_json",
    "from_osc",
    "load_recording",
    "replay",
    "save_recording",
    "to_json",
    "to_osc",
]
