from .distances import Distances as Distances
from .drives.maker import HandAware as HandAware
from .images import WithImages as WithImages
from .loop import Followed as Followed
from .loop import Status as Status
from .loop import follow as follow
from .output import Boards as Boards
from .output import Nowhere as Nowhere
from .output import Output as Output
from .parts import (
    Controls as Controls,
)
from .parts import (
    DriveMaker as DriveMaker,
)
from .parts import (
    LiveScene as LiveScene,
)
from .parts import (
    Moment as Moment,
)
from .parts import (
    MovingFoci as MovingFoci,
)
from .running import drive_at_rest as drive_at_rest
from .running import hands_from as hands_from
from .running import output_to as output_to
from .running import record as record
from .running import run as run
from .scene import live_scene as live_scene
from .session import (
    Session as Session,
)
from .session import (
    SessionWriter as SessionWriter,
)
from .session import (
    read_session as read_session,
)
from .session import (
    recording_of as recording_of,
)
from .sources import (
    HandSource as HandSource,
)
from .sources import (
    PageHands as PageHands,
)
from .sources import (
    ReceivedHands as ReceivedHands,
)
from .sources import (
    RecordedHands as RecordedHands,
)
from .verification import VerifiedSession as VerifiedSession
from .verification import verify_session as verify_session
