"""Make the sound follow a moving hand: the loop turns a tracker's frames into drives.

``run`` starts the loop from a scene file. ``follow`` is the loop itself: it receives
frames from a ``HandSource`` and drives from a ``DriveMaker``, and sends the drives to
an ``Output``. A ``SessionWriter`` records the run, and ``read_session`` reads the
recording.
"""

from airtact.lazy import attached

__getattr__, __dir__, __all__ = attached(__name__, __file__)
