"""A focus that runs along the outlines of contacts, where the skin meets a virtual object."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from airtact.errors import in_short
from airtact.hands.hand import Side
from airtact.hands.joints import Point, Points
from airtact.touch.finding import ContactArrays
from airtact.touch.objects import VirtualObject
from airtact.touch.outlines import outline_of
from airtact.touch.skin import Skin

# Frames in a round. Along the 35 mm around a fingertip they are 3 mm apart, which is less than half
# a wavelength.
FRAMES = 12


@dataclass(frozen=True, eq=False)
class Outline:
    """Outline of a contact, along which a focus runs.

    Attributes
    ----------
    name : name of the contact's focus.
    curve : (P, 3) path of the focus [m].
    strength : strength of the focus, from 0 to 1.
    side : "left" or "right", the hand that touches the object.
    """

    name: str
    curve: Points
    strength: float
    side: Side

    __repr__ = in_short


@dataclass(frozen=True, eq=False)
class Round:
    """One round of a focus along all outlines.

    Attributes
    ----------
    points : (N, 3) position of the focus in each of the N frames [m].
    outlines : for each frame, the outline along which the focus runs.
    rate : frames per second.
    """

    points: Points
    outlines: tuple[Outline, ...]
    rate: float

    __repr__ = in_short


def curves_at(
    skin: Skin, thing: VirtualObject, contacts: ContactArrays, index: int, offset: float
) -> tuple[Points, ...]:
    """Return the curves along which a focus runs at a contact, at an offset [m] from the skin.

    Closed curves begin at the same place and have the same sense of rotation in all poses.
    Otherwise, the focus would jump at each new pose, which can be felt.
    """
    normal = contacts.normals[index]
    axis = np.eye(3)[np.abs(normal).argmin()]
    curves = []
    for curve in outline_of(skin, thing, contacts.members[index]):
        shifted = curve
        if skin.look is not None:
            distances, normals = skin.look(curve)
            shifted = curve + (offset - distances)[:, None] * normals
        if (curve[0] == curve[-1]).all():
            ring = shifted[:-1]
            around = np.cross(ring, np.roll(ring, -1, axis=0)).sum(axis=0)
            ring = ring if around @ normal > 0.0 else ring[::-1]
            ring = np.roll(ring, -int((ring @ axis).argmax()), axis=0)
            shifted = np.concatenate([ring, ring[:1]])
        curves.append(shifted)
    return tuple(curves)


def round_along(outlines: Sequence[Outline], frequency: float) -> Round:
    """Return one round of a focus along all outlines, with evenly spaced positions.

    Parameters
    ----------
    outlines : outlines of contacts, at least one.
    frequency : frequency of the sound [Hz]. Each frame lasts a whole number of periods, as
        boards require.
    """
    lengths = [_stations(outline.curve) for outline in outlines]
    ends = np.cumsum([stations[-1] for stations in lengths])
    total = max(float(ends[-1]), 1e-4)
    # The focus moves at 7 m/s. Along outlines shorter than 35 mm it is slower, because skin is most
    # sensitive at about 200 Hz.
    rounds = min(7.0 / total, 200.0)
    rate = frequency / round(frequency / (rounds * FRAMES))
    points: list[Point] = []
    owners = []
    for along in total * (np.arange(FRAMES) + 0.5) / FRAMES:
        index = min(int(np.searchsorted(ends, along)), len(outlines) - 1)
        begun = ends[index] - lengths[index][-1]
        axes = outlines[index].curve.T
        points.append(np.array([np.interp(along - begun, lengths[index], axis) for axis in axes]))
        owners.append(outlines[index])
    return Round(np.array(points), tuple(owners), rate)


def _stations(curve: Points) -> Float64[np.ndarray, "points"]:
    """Return the length [m] along a curve from its start to each of its points."""
    steps = np.linalg.norm(np.diff(curve, axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])
