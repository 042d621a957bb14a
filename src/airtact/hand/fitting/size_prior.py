"""The sizes of one person's hand, learned from its first frames: lengths of bones, radii of the skin.

Sources
-------
- Meta Platforms, iwer 2.5.0 (MIT): proportions of a generic hand, from ``examples/hands/relaxed.json``.
- A. Buryanov, V. Kotiuk, "Proportions of hand segments", Int. J. Morphol. 28, 755 (2010): hands differ from the mean
  proportions by about a tenth.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from airtact.hand.joints import BONES, CHAINS, NAMES, RADII
from airtact.printing import in_short
from airtact.validation import fixed

TIES = (
    *((5, 10), (10, 15), (15, 20), (6, 11), (11, 16), (16, 21), (1, 5)),
    *((5, 11), (10, 6), (10, 16), (15, 11), (15, 21), (20, 16)),
)
"""Joints of the palm between which no bone runs, but that keep their distance."""

SPANS = (*BONES, *TIES)
"""Joints at both ends of every length that a hand keeps."""

GENERIC = fixed(
    1e-3
    * np.array(
        [49.4, 43.2, 35.9, 39.0, 42.8, 33.0, 34.3, 25.0, 60.6, 38.5, 24.7, 22.7, 62.6, 43.6]
        + [28.0, 25.4, 54.8, 39.6, 27.0, 24.8, 46.4, 31.2, 20.6, 22.3]
        + [16.7, 19.0, 8.9, 22.7, 21.1, 22.2, 12.7, 63.5, 65.9, 59.3, 64.2, 48.9, 55.8]
    )
)
"""Those lengths of a hand of ``LENGTH`` [m]."""

COUNT = len(SPANS) + 25
"""How many sizes a hand has."""

COMMON, THICK, FINGER, RADIUS, BASE = 0.15, 0.05, 0.03, 0.05, 0.02
"""Standard deviations of the logarithm of sizes between people: of all sizes at once, of all radii, of those of one
finger, of each radius by itself, and of those at the wrist and the bases of the metacarpals: a palm is no row of balls,
and they must not follow its flat side."""

THICKNESS = 0.6
"""Power of the length of hands with which their thickness grows: long hands are slender."""

OWN, WRIST, TIP, TIE = 0.08, 0.15, 0.3, 0.2
"""Those of the length of a bone by itself, of those at the wrist, of the last ones, which trackers end where they like,
and of ties."""

LEARNED = 8
"""Frames from which the sizes of a person are learned; later ones keep them."""


@dataclass(frozen=True, eq=False)
class HandAnatomy:
    """Sizes of one person's hand, as a normal distribution of their logarithms.

    Attributes
    ----------
    mean : (62,) logarithms of 37 lengths [m], as ``SPANS`` orders them, and of the radii at 25 joints [m].
    covariance : (62, 62) of these.
    frames : how many frames they were learned from.
    """

    mean: Float64[np.ndarray, "62"]
    covariance: Float64[np.ndarray, "62 62"]
    frames: int

    __repr__ = in_short

    @property
    def lengths(self) -> dict[str, float]:
        """Length of each bone [m], by the joints at its ends."""
        lengths = np.exp(self.mean[: len(BONES)])
        return {f"{NAMES[a]} to {NAMES[b]}": float(x) for (a, b), x in zip(BONES, lengths, strict=True)}

    @property
    def radii(self) -> Float64[np.ndarray, "25"]:
        """Radius of the skin round each joint (25,) [m]."""
        return np.exp(self.mean[len(SPANS) :])

    @property
    def settled(self) -> bool:
        """Whether enough frames were seen: later ones keep the sizes."""
        return self.frames >= LEARNED

    def learned(self, sizes: Float64[np.ndarray, "62"], covariance: Float64[np.ndarray, "62 62"]) -> "HandAnatomy":
        """Take what a frame has taught: the mean over frames, as firm as one of them.

        What the shape of the body cannot show is off in every frame alike, so that more of them make nothing surer.

        Parameters
        ----------
        sizes : (62,) logarithms that were found in one frame, by itself.
        covariance : (62, 62) of these.
        """
        share = 1.0 / (self.frames + 1)
        mean = (1.0 - share) * self.mean + share * sizes
        return HandAnatomy(fixed(mean), fixed((1.0 - share) * self.covariance + share * covariance), self.frames + 1)


def anybody(joints: Float64[np.ndarray, "25 3"]) -> HandAnatomy:
    """Sizes of a hand of which only rough joints are known, by those of people.

    Parameters
    ----------
    joints : (25, 3) [m]; the distances from wrist to knuckles set the size.
    """
    knuckles = [chain[1] for chain in CHAINS[1:]]
    usual = GENERIC[1:5] + GENERIC[[SPANS.index((chain[0], chain[1])) for chain in CHAINS[1:]]]
    scale = float(np.linalg.norm(joints[knuckles] - joints[0], axis=1).sum() / usual.sum())
    own = np.full(COUNT, OWN)
    own[:5], own[len(BONES) :], own[len(SPANS) :] = WRIST, TIE, RADIUS
    own[[SPANS.index((chain[-2], chain[-1])) for chain in CHAINS]] = TIP
    own[len(SPANS) + np.array([0, *(chain[0] for chain in CHAINS)])] = BASE
    follows = np.r_[np.ones(len(SPANS)), np.full(25, THICKNESS)]
    covariance = np.diag(own**2) + COMMON**2 * np.outer(follows, follows)
    radii = np.arange(len(SPANS), COUNT)
    covariance[np.ix_(radii, radii)] += THICK**2
    for chain in CHAINS:
        rows = len(SPANS) + np.array(chain[1:])
        covariance[np.ix_(rows, rows)] += FINGER**2
    return HandAnatomy(fixed(np.log(np.r_[GENERIC, RADII]) + np.log(scale) * follows), fixed(covariance), 0)
