from .emission import Played as Played
from .file_link import FileLink as FileLink
from .link import Link as Link
from .link import LinkFailed as LinkFailed
from .link import RecordingLink as RecordingLink
from .serial_link import SerialLink as SerialLink
