"""The sound follows a moving hand: frames of a tracker become drives at the boards, and what was done is recorded.

``follow`` is the loop. Frames come from a ``HandSource``, drives from a ``DriveMaker`` and go to an ``Output``; a
``SessionWriter`` records all of it, and ``read_session`` reads it back.
"""

from airtact.live.distances import Distances
from airtact.live.drives.maker import HandAware
from airtact.live.images import WithImages
from airtact.live.loop import Followed, Status, follow
from airtact.live.output import Boards, Nowhere, Output
from airtact.live.parts import Controls, DriveMaker, LiveScene, Moment, MovingFoci
from airtact.live.scene import live_scene
from airtact.live.session import Session, SessionWriter, read_session, recording_of
from airtact.live.sources import HandSource, PageHands, ReceivedHands, RecordedHands
from airtact.live.verification import VerifiedSession, verify_session

__all__ = [
    "Boards",
    "Controls",
    "Distances",
    "DriveMaker",
    "Followed",
    "HandAware",
    "HandSource",
    "LiveScene",
    "Moment",
    "MovingFoci",
    "Nowhere",
    "Output",
    "PageHands",
    "ReceivedHands",
    "RecordedHands",
    "Session",
    "SessionWriter",
    "Status",
    "VerifiedSession",
    "WithImages",
    "follow",
    "live_scene",
    "read_session",
    "recording_of",
    "verify_session",
]
