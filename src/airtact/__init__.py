"""Drives of ultrasonic phased arrays for mid-air haptics, including the scattering by the hand.

A ``Scene`` describes the bodies in the air, and a ``Target`` describes what a person feels. One
solve with beacons, which are virtual sources at the foci, determines the transfer matrix of a
``PhasedArray`` by reciprocity. A ``Drive`` is computed from this matrix and evaluated by another
solver. These names are here; the rest is in the packages ``acoustics``, ``drives``, ``emission``,
``evaluation``, ``geometry``, ``hands``, ``live``, ``sensing``, ``setup``, ``touch`` and
``transducers``, and in ``plot``.

Names are listed in ``__init__.pyi`` and imported when first used.
"""

import os

from airtact.lazy import attached

# By default OpenMP threads spin for milliseconds after each loop and keep NumPy's threads off the
# cores. A few microseconds of spinning are enough to reach the next loop without waking them. The
# variables are read when the kernels are loaded.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
os.environ.setdefault("GOMP_SPINCOUNT", "3000")

__version__ = "0.2.0"

__getattr__, __dir__, __all__ = attached(__name__, __file__)
