"""The sound follows a moving hand: frames of a tracker become drives at the boards, and what was done is recorded.

``follow`` is the loop. Frames come from a ``HandSource``, drives from a ``DriveMaker`` and go to an
``Output``; a ``SessionWriter`` records all of it, and ``read_session`` reads it back.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
