from .comparison import HELD_EQUAL as HELD_EQUAL
from .comparison import Comparison as Comparison
from .comparison import compare as compare
from .field import drive_sources as drive_sources
from .head_level import sound_pressure_level as sound_pressure_level
from .metrics import Evaluation as Evaluation
from .microphone import Microphone as Microphone
from .radiation import (
    Pad as Pad,
)
from .radiation import (
    RadiationMap as RadiationMap,
)
from .radiation import (
    radiation_map as radiation_map,
)
from .radiation import (
    radiation_pressure as radiation_pressure,
)
from .scan import (
    Overlay as Overlay,
)
from .scan import (
    Scan as Scan,
)
from .scan import (
    load_scan as load_scan,
)
from .scan import (
    overlay_scan as overlay_scan,
)
from .verification import (
    SideLobe as SideLobe,
)
from .verification import (
    Verification as Verification,
)
from .verification import (
    attainable as attainable,
)
from .verification import (
    verify as verify,
)
