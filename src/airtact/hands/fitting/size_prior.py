"""The sizes of one person's hand, learned from the first frames: lengths of bones and radii of the skin.

Sources
-------
- Meta Platforms, iwer 2.5.0 (MIT): proportions of a generic hand, from
    ``examples/hands/relaxed.json``.
- A. Buryanov, V. Kotiuk, "Proportions of hand segments", Int. J. Morphol. 28, 755 (2010): hands
  differ from the mean proportions by about a tenth.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from airtact.checks import fixed
from airtact.hands.fitting.unknowns import SIZE_COUNT, SIZE_RADII, SPANS
from airtact.hands.joints import BONES, CHAINS, NAMES, RADII
from airtact.printing import in_short

LEARNED = 8
"""Frames from which the sizes of a person are learned; later ones keep them."""


@dataclass(frozen=True, eq=False)
class HandAnatomy:
    """Sizes of one person's hand, as a normal distribution of their logarithms.

    Attributes
    ----------
    mean : (62,) logarithms of 37 lengths [m], as ``SPANS`` orders them, and of the radii at 25
        joints [m].
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
        return {
            f"{NAMES[a]} to {NAMES[b]}": float(x) for (a, b), x in zip(BONES, lengths, strict=True)
        }

    @property
    def radii(self) -> Float64[np.ndarray, "25"]:
        """Radius of the skin round each joint (25,) [m]."""
        return np.exp(self.mean[SIZE_RADII])

    @property
    def settled(self) -> bool:
        """Whether the sizes were learned from enough frames; later frames keep them."""
        return self.frames >= LEARNED

    def learned(
        self, sizes: Float64[np.ndarray, "62"], covariance: Float64[np.ndarray, "62 62"]
    ) -> "HandAnatomy":
        """Add a frame to the mean over frames; its covariance stays that of one frame.

        What the shape of the body cannot show is off in every frame alike, so that more frames make
        nothing surer. ``sizes`` (62,) are logarithms that were found in that frame by itself, with
        their ``covariance`` (62, 62).
        """
        share = 1.0 / (self.frames + 1)
        mean = (1.0 - share) * self.mean + share * sizes
        return HandAnatomy(
            fixed(mean),
            fixed((1.0 - share) * self.covariance + share * covariance),
            self.frames + 1,
        )


GENERIC = fixed(
    1e-3
    * np.array(
        [49.4, 43.2, 35.9, 39.0, 42.8, 33.0, 34.3, 25.0, 60.6, 38.5, 24.7, 22.7, 62.6, 43.6]
        + [28.0, 25.4, 54.8, 39.6, 27.0, 24.8, 46.4, 31.2, 20.6, 22.3]
        + [16.7, 19.0, 8.9, 22.7, 21.1, 22.2, 12.7, 63.5, 65.9, 59.3, 64.2, 48.9, 55.8]
    )
)
"""Lengths of ``SPANS`` of the generic hand, whose radii are ``RADII`` [m]."""

COMMON, THICK, FINGER, RADIUS, BASE = 0.15, 0.05, 0.03, 0.05, 0.02
"""Standard deviations of the logarithm of sizes between people: of all sizes at once, of all radii, of the radii of one
finger, of each radius by itself, and of the radii at the wrist and the bases of the metacarpals.
The last are held firmly because a palm is no row of balls: free radii would follow its flat
side."""

OWN, WRIST, TIP, TIE = 0.08, 0.15, 0.3, 0.2
"""The same of the length of a bone by itself, of bones at the wrist, of last bones, which every tracker ends elsewhere,
and of ties."""

THICKNESS = 0.6
"""Power of the length of hands with which their thickness grows: long hands are slender."""


def population_prior(joints: Float64[np.ndarray, "25 3"]) -> HandAnatomy:
    """Return the sizes of people's hands, scaled to the palm of rough joints (25, 3) [m], from wrist to knuckles."""
    knuckles = [chain[1] for chain in CHAINS[1:]]
    usual = GENERIC[1:5] + GENERIC[[SPANS.index((chain[0], chain[1])) for chain in CHAINS[1:]]]
    scale = float(np.linalg.norm(joints[knuckles] - joints[0], axis=1).sum() / usual.sum())
    own = np.full(SIZE_COUNT, OWN)
    own[:5], own[len(BONES) :], own[SIZE_RADII] = WRIST, TIE, RADIUS
    own[[SPANS.index((chain[-2], chain[-1])) for chain in CHAINS]] = TIP
    own[SIZE_RADII.start + np.array([0, *(chain[0] for chain in CHAINS)])] = BASE
    follows = np.ones(SIZE_COUNT)
    follows[SIZE_RADII] = THICKNESS
    covariance = np.diag(own**2) + COMMON**2 * np.outer(follows, follows)
    covariance[SIZE_RADII, SIZE_RADII] += THICK**2
    for chain in CHAINS:
        rows = SIZE_RADII.start + np.array(chain[1:])
        covariance[np.ix_(rows, rows)] += FINGER**2
    return HandAnatomy(
        fixed(np.log(np.r_[GENERIC, RADII]) + np.log(scale) * follows), fixed(covariance), 0
    )
