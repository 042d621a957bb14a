"""The vector of unknowns of the fit: coordinates of the joints, then the logarithms of the sizes of the hand.

The sizes are 37 lengths, as ``SPANS`` orders them, and the radii at 25 joints. The body depends on
joints and radii only; ``BODY`` picks these from all unknowns.
"""

import numpy as np
from jaxtyping import Float64

from airtact.hands.anatomy_parts import WEB_BALL
from airtact.hands.joints import BONES, NAMES

TIES = (
    *((5, 10), (10, 15), (15, 20), (6, 11), (11, 16), (16, 21), (1, 5)),
    *((5, 11), (10, 6), (10, 16), (15, 11), (15, 21), (20, 16)),
)
"""Joints of the palm between which no bone runs, but that keep their distance."""

SPANS = (*BONES, *TIES)
"""Joints at both ends of every length that a hand keeps."""

JOINTS = slice(0, 3 * len(NAMES))
"""Coordinates of the 25 joints [m] among the unknowns: 75."""

SIZES = slice(JOINTS.stop, JOINTS.stop + len(SPANS) + len(NAMES))
"""Logarithms of the sizes among the unknowns: 62."""

RADII = slice(SIZES.stop - len(NAMES), SIZES.stop)
"""Logarithms of the radii among the unknowns: 25."""

COUNT = SIZES.stop
"""How many unknowns there are: 137."""

SIZE_COUNT = SIZES.stop - SIZES.start

SIZE_LENGTHS, SIZE_RADII = slice(0, len(SPANS)), slice(len(SPANS), SIZE_COUNT)
"""Lengths and radii among the sizes."""

BODY = np.r_[JOINTS, RADII]
"""The unknowns that the body depends on: 100."""

BODY_BLOCK = np.ix_(BODY, BODY)
"""Their block in a matrix of all unknowns."""

BODY_RADII = slice(JOINTS.stop, len(BODY))
"""Radii among the unknowns of the body."""

BALLS = len(NAMES) + 1
"""Balls of the body, one at each joint and one in the thumb's metacarpal; a ball has four numbers."""


def _balls_by_body() -> Float64[np.ndarray, "numbers body"]:
    """Return the derivatives of centres and radii of the balls by joints and radii."""
    rows = np.zeros((BALLS, 4, len(BODY)))
    for ball in range(len(NAMES)):
        rows[ball, range(3), range(3 * ball, 3 * ball + 3)] = 1.0
        rows[ball, 3, BODY_RADII.start + ball] = 1.0
    rows[WEB_BALL] = 0.5 * (rows[1] + rows[2])
    rows[WEB_BALL, 3] = 0.4 * (rows[1, 3] + rows[2, 3])
    return rows.reshape(4 * BALLS, len(BODY))


BALLS_BY_BODY = _balls_by_body()


def joined(
    joints: Float64[np.ndarray, "25 3"], sizes: Float64[np.ndarray, "sizes"]
) -> Float64[np.ndarray, "unknowns"]:
    """Write joints [m] and logarithms of sizes as one vector of unknowns."""
    return np.concatenate([joints.ravel(), sizes])


def joints_in(unknowns: Float64[np.ndarray, "unknowns"]) -> Float64[np.ndarray, "25 3"]:
    """Return the joints [m] in a vector of unknowns."""
    return unknowns[JOINTS].reshape(-1, 3)


def balls_at(unknowns: Float64[np.ndarray, "unknowns"]) -> Float64[np.ndarray, "balls 4"]:
    """Return centres and radii of the balls of a hand [m]."""
    return (BALLS_BY_BODY @ np.concatenate([unknowns[JOINTS], np.exp(unknowns[RADII])])).reshape(
        BALLS, 4
    )


def by_body(
    by_balls: Float64[np.ndarray, "rows numbers"], sizes: Float64[np.ndarray, "sizes"]
) -> Float64[np.ndarray, "rows body"]:
    """Turn derivatives by centres and radii of the balls into those by joints and the logarithms of radii."""
    found = by_balls @ BALLS_BY_BODY
    found[:, BODY_RADII] *= np.exp(sizes[SIZE_RADII])
    return found
