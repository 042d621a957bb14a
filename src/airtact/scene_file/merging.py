"""Sound-hard bodies of a scene file that overlap or nearly touch, made one."""

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from airtact.scene.scene import Obstacle, sound_hard
from airtact.surfaces.checks import NEAREST, approach
from airtact.surfaces.union import merged


def with_merged_bodies(names: Sequence[str], obstacles: Sequence[Obstacle]) -> tuple[list[str], list[Obstacle]]:
    """Make one of sound-hard bodies that overlap, touch or stand nearer than ``NEAREST``.

    Parameters
    ----------
    names : of each body.
    obstacles : the bodies.

    Returns
    -------
    names : those of merged bodies joined with " + ", in the place of their first.
    obstacles : the bodies.

    Raises
    ------
    InvalidInput
        See ``merged``.
    """
    hard = [index for index, obstacle in enumerate(obstacles) if obstacle.boundary == "sound_hard"]
    near = [pair for pair in combinations(hard, 2) if _hang_together(*(obstacles[index] for index in pair))]
    one, two = np.array(near, dtype=np.int64).reshape(-1, 2).T
    count = len(obstacles)
    groups = connected_components(coo_array((np.ones(len(one)), (one, two)), shape=(count, count)), directed=False)[1]
    words, bodies = [], []
    for group in dict.fromkeys(groups.tolist()):
        members = np.flatnonzero(groups == group).tolist()
        words.append(" + ".join(names[index] for index in members))
        surfaces = [obstacles[index].surface for index in members]
        bodies.append(obstacles[members[0]] if len(members) == 1 else sound_hard(merged(surfaces, NEAREST)))
    return words, bodies


def _hang_together(one: Obstacle, two: Obstacle) -> bool:
    return approach(one.surface, two.surface, NEAREST * (1.0 - 1e-9)) is not None
