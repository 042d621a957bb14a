"""From a drive to a board: links, and emissions that end in silence."""

from airtact.hardware.autd3_link import AUTD3Link
from airtact.hardware.emission import Emission, Played
from airtact.hardware.file_link import FileLink
from airtact.hardware.link import Link, LinkFailed, RecordingLink
from airtact.hardware.serial_link import SerialLink

__all__ = [
    "AUTD3Link",
    "Emission",
    "FileLink",
    "Link",
    "LinkFailed",
    "Played",
    "RecordingLink",
    "SerialLink",
]
