"""Drives of ultrasonic phased arrays for mid-air haptics, including scattering by the hand.

A ``Scene`` describes the bodies in the air, and a ``Target`` describes what is to be felt. By
reciprocity, a single solve with beacons, which are virtual sources at the foci, determines the
transfer matrix of a ``PhasedArray``. A ``Drive`` is computed from this matrix and verified by a
second solver. These names are in ``airtact`` itself. All others are in the packages ``acoustics``,
``drives``, ``emission``, ``evaluation``, ``geometry``, ``hands``, ``live``, ``sensing``, ``setup``,
``touch``, ``transducers`` and ``traps``, and in ``plot``.

The names are listed in ``__init__.pyi`` and imported on first use.
"""

import os

from airtact.lazy import attached

# By default, OpenMP threads spin for milliseconds after each loop and keep NumPy's threads off the
# cores. To reach the next loop without waking them, a few microseconds of spinning are enough. The
# variables are read when the kernels are loaded.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
os.environ.setdefault("GOMP_SPINCOUNT", "3000")

__version__ = "0.2.0"

__getattr__, __dir__, __all__ = attached(__name__, __file__)
