"""The sound on the skin and in the slice with the hand in its place, solved beside the page as often as it can afford.

The whole hand is solved for the newest drive, on panels that bend with it, in a process of low
priority. That takes the better part of a second, so the page says how old it is.
"""

import os
import time
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection

import numpy as np
from jaxtyping import Complex128, Float64
from scipy.spatial import KDTree

from airtact.acoustics.solvers.bem.solutions import DirectSolution
from airtact.errors import InvalidInput, NotConverged
from airtact.hands.shape import Hulls
from airtact.live.drives.bending import BendingHand
from airtact.live.drives.riding import ride
from airtact.live.page.section import Section
from airtact.live.page.sound import DirectSound
from airtact.live.parts import LiveScene
from airtact.printing import in_short
from airtact.timing import give_way

ACCURACY, RESIDUAL = 0.1, 0.05
"""Accuracy that panels are made for, and relative residual of the iteration."""

SHARE = 0.4
"""Largest share of a processor that solving takes."""

NICE = 8
"""How much lower the priority of its process is: between those of the loop's own solvers."""

NEIGHBOURS = 3
"""Nodes of the panels between which the pressure on the skin is interpolated."""

OFF_SKIN = 1e-3
"""Points nearer to the skin than this get the pressure at this distance: nearer, the panels are too coarse [m]."""

LEAST_DISTANCE = 1e-5
"""Below this a point counts as standing on a node [m]."""


@dataclass(frozen=True, eq=False)
class Asked:
    """What to solve.

    Attributes
    ----------
    time : by ``time.monotonic`` [s].
    joints : (25, 3) of the hand [m].
    foci : (F, 3) [m].
    amplitudes : (E,) of the drive, share of full scale.
    skin : (V, 3) points on its skin [m].
    section : the slice.
    """

    time: float
    joints: Float64[np.ndarray, "25 3"]
    foci: Float64[np.ndarray, "foci 3"]
    amplitudes: Complex128[np.ndarray, "elements"]
    skin: Float64[np.ndarray, "skin 3"]
    section: Section

    __repr__ = in_short


@dataclass(frozen=True, eq=False)
class Sound:
    """The sound of a moment.

    Attributes
    ----------
    time : when it was asked for, by ``time.monotonic`` [s].
    hand : whether the hand is in its place; else it is the direct sound.
    skin : (V,) peak pressure on the skin [Pa].
    section : the slice.
    field : (P,) pressure at its points [Pa], 0 inside a hand in its place.
    """

    time: float
    hand: bool
    skin: Float64[np.ndarray, "skin"]
    section: Section
    field: Complex128[np.ndarray, "points"]

    __repr__ = in_short


class SoundSolver:
    """Solves one hand after the other.

    Parameters
    ----------
    scene : of the live loop.
    """

    def __init__(self, scene: LiveScene) -> None:
        self._scene, self._direct = scene, DirectSound(scene)
        self._hand = BendingHand(scene, ACCURACY, seen=0.0)

    def solved(self, asked: Asked) -> Sound:
        """Solve one.

        Raises
        ------
        InvalidInput
            The joints are no hand's, or a focus lies inside it.
        NotConverged
            The iteration did not settle.
        """
        sources = self._direct.sources(asked.amplitudes, asked.foci.mean(axis=0))
        found = self._hand.received(asked.joints, sources, RESIDUAL)
        hulls = ride(self._scene, asked.joints).hand.shape.hulls
        field = _around(found, hulls, asked.section.points())
        return Sound(
            asked.time, True, np.abs(_between_nodes(found, asked.skin)), asked.section, field
        )


class SolvedSound:
    """Solves in a process of its own, one after the other; ``ask`` and ``newest`` return at once.

    Parameters
    ----------
    scene : of the live loop.
    """

    def __init__(self, scene: LiveScene) -> None:
        spawning = get_context("spawn")
        self._pipe, theirs = spawning.Pipe()
        self._process = spawning.Process(target=_solve_on, args=(scene, theirs), daemon=True)
        self._process.start()
        theirs.close()
        self._ready, self._newest = False, None

    def ask(self, asked: Asked) -> None:
        """Ask for another one, unless one is being solved."""
        with suppress(OSError, EOFError):  # where the process has died, nothing is solved any more
            while self._pipe.poll():
                got = self._pipe.recv()
                self._ready, self._newest = got is None, got or self._newest
            if self._ready:
                self._pipe.send(asked)
                self._ready = False

    @property
    def newest(self) -> Sound | None:
        """The newest one that was solved; None before the first."""
        return self._newest

    def close(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.join()
        self._pipe.close()


def _solve_on(scene: LiveScene, pipe: Connection) -> None:
    """Send None whenever ready, and the sound of what comes then, if it can be solved."""
    with suppress(AttributeError, OSError):
        os.setsid()
    give_way(NICE)
    solver = SoundSolver(scene)
    with suppress(OSError, EOFError):
        while True:
            pipe.send(None)
            asked = pipe.recv()
            begun = time.process_time()
            with suppress(InvalidInput, NotConverged):
                pipe.send(solver.solved(asked))
            time.sleep((1.0 / SHARE - 1.0) * (time.process_time() - begun))


def _between_nodes(
    found: DirectSolution, points: Float64[np.ndarray, "skin 3"]
) -> Complex128[np.ndarray, "skin"]:
    """Interpolate the pressure at the nodes at points on the skin."""
    away, nearest = KDTree(found.surface.nodes.points).query(points, NEIGHBOURS)
    weights = 1.0 / np.maximum(away, LEAST_DISTANCE) ** 2
    return np.einsum(
        "pn,pn->p", weights / weights.sum(axis=1, keepdims=True), found.pressure[nearest, 0]
    )


def _around(
    found: DirectSolution, hulls: Hulls, points: Float64[np.ndarray, "points 3"]
) -> Complex128[np.ndarray, "points"]:
    """Evaluate the pressure at points outside the hand, those on its skin a little off it; it is 0 inside."""
    here = hulls.look(points)
    outside = here.distance > 0.0
    lifted = points + np.maximum(OFF_SKIN - here.distance, 0.0)[:, None] * here.gradient
    field = np.zeros(len(points), dtype=np.complex128)
    field[outside] = found.at(lifted[outside], np.zeros(int(outside.sum()), dtype=bool))[:, 0]
    return field
