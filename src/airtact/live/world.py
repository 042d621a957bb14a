"""What is to be felt: virtual objects and foci, which applications change while the loop runs."""

from collections.abc import Sequence
from dataclasses import dataclass
from threading import Lock

import numpy as np
from jaxtyping import Float64

from airtact.errors import in_short
from airtact.touch.objects import VirtualObject, objects_of


@dataclass(frozen=True, eq=False)
class WantedFocus:
    """A focus that an application asks for.

    Exactly one of ``point`` and ``place`` is given.

    Attributes
    ----------
    name : name of the focus, unique in its application.
    strength : strength of the touch, from 0 to 1.
    point : (3,) position in scene coordinates, or in those of the object ``on`` [m].
    place : place of a hand such as ``"right.index.pad"``; without a side, of the scene's hand.
    on : name of the object that the point moves with, or None.
    offset : distance from the skin, for a place [m].
    """

    name: str
    strength: float = 1.0
    point: Float64[np.ndarray, "3"] | None = None
    place: str | None = None
    on: str | None = None
    offset: float = 0.5e-3

    __repr__ = in_short


class World:
    """The virtual objects and wanted foci of the loop; any thread may read and change them.

    Parameters
    ----------
    objects : objects of the scene file.
    """

    def __init__(self, objects: Sequence[VirtualObject] = ()) -> None:
        self._lock = Lock()
        self._objects = objects_of(objects)
        self._foci: tuple[WantedFocus, ...] = ()

    @property
    def objects(self) -> tuple[VirtualObject, ...]:
        """The objects; the tuple is replaced at every change."""
        return self._objects

    def foci(self, now: float) -> tuple[WantedFocus, ...]:
        """Return the foci wanted at a time of ``time.monotonic`` [s]."""
        with self._lock:
            return self._foci
