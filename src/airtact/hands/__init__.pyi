from .body import Touch as Touch
from .files import load_cloud as load_cloud
from .files import load_landmarks as load_landmarks
from .files import load_rigged_hand as load_rigged_hand
from .fitting.fit import FittedHand as FittedHand
from .fitting.priors import HandAnatomy as HandAnatomy
from .hand import places_on as places_on
from .pinch_dummy import Pinch as Pinch
from .tracking.frame import FaultyFrame as FaultyFrame
from .tracking.frame import HandFrame as HandFrame
from .tracking.messages import (
    from_json as from_json,
)
from .tracking.messages import (
    from_osc as from_osc,
)
from .tracking.messages import (
    to_json as to_json,
)
from .tracking.messages import (
    to_osc as to_osc,
)
from .tracking.prediction import Predictor as Predictor
from .tracking.receivers import OscReceiver as OscReceiver
from .tracking.receivers import WebSocketReceiver as WebSocketReceiver
from .tracking.recordings import (
    Recording as Recording,
)
from .tracking.recordings import (
    load_recording as load_recording,
)
from .tracking.recordings import (
    replay as replay,
)
from .tracking.recordings import (
    save_recording as save_recording,
)
from .tracking.stream import HandStream as HandStream
from .tracking.stream import StreamHealth as StreamHealth
