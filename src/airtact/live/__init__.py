"""Make the sound follow a moving hand: the loop turns a tracker's frames into drives.

``run`` starts the loop from a scene file. ``follow`` is the loop itself: frames come from a
``HandSource``, drives from a ``DriveMaker``, and they go to an ``Output``. A ``SessionWriter``
records the run, and ``read_session`` reads it.
"""

from airtact.lazy import attached

__getattr__, __dir__, __all__ = attached(__name__, __file__)
