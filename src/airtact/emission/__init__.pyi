from .emission import Played as Played
from .frame_file import write_frames as write_frames
from .link import Link as Link
from .link import LinkFailed as LinkFailed
from .link import RecordingLink as RecordingLink
from .serial_link import SerialLink as SerialLink
from .udp_link import UDPLink as UDPLink
