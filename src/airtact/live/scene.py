"""From a scene file to the scene of the live loop."""

from dataclasses import replace

import numpy as np

from airtact.acoustics.scene import check_no_boards
from airtact.checks import counted, fixed
from airtact.drives.motion import FRAMES, Motion
from airtact.drives.sequence import FEWEST
from airtact.errors import InvalidInput
from airtact.hands.hand import PLACES
from airtact.live.drives.riding import ride
from airtact.live.parts import LiveScene, MovingFoci
from airtact.setup.setup import Setup
from airtact.transducers.modulation import AmplitudeModulation

MOST_FRAMES = 64
"""Frames of a path at most: each is a drive, and all of them are made anew for each pose."""


def live_scene(setup: Setup) -> LiveScene:
    """Return what of a scene file stays the same while its hand moves.

    Parameters
    ----------
    setup : a scene of one sound-hard hand, whose foci are before its places, as ``read_scene``
        gives it.

    Raises
    ------
    InvalidInput
        The scene holds another body, a focus does not ride on the hand, it asks for pressures, phases or suppression,
        which the live loop does not do, or as ``moving_foci_of``.
    """
    check_no_boards(setup.scene, "live")
    on_hand = [ride for ride in setup.riding if ride is not None and ride[0] in PLACES]
    if len(on_hand) < len(setup.foci) or not setup.hands:
        raise InvalidInput(
            f"{setup.path.name}: live needs foci that ride on a hand: {', '.join(PLACES)} of a body with joints, "
            f'and {len(on_hand) if setup.hands else 0} of {len(setup.foci)} do; give [[foci]] at = "thumb.pad".',
            code="misplaced",
        )
    if len(setup.bodies) != 1 or setup.scene.obstacles[0].boundary != "sound_hard":
        raise InvalidInput(
            f"{setup.path.name}: live follows 1 sound-hard hand, and the scene has "
            f"{counted(len(setup.bodies), 'body', 'bodies')}: leave the others out.",
            code="not_supported",
        )
    target = setup.target
    if (
        target.pressures is not None
        or target.phases is not None
        or np.ptp(target.weights)
        or target.suppression_points.size
    ):
        raise InvalidInput(
            f"{setup.path.name}: live makes the weakest of {len(setup.foci)} foci as strong as it can: leave pressure, "
            "share, phase_degrees and suppression out.",
            code="options_clash",
        )
    scene = LiveScene(
        medium=setup.medium,
        frequency=setup.frequency,
        array=setup.array,
        side=setup.hands[0].side,
        radii=setup.hands[0].radii,
        places=tuple(name for name, _ in on_hand),
        offsets=fixed(np.array([offset for _, offset in on_hand])),
        method=setup.method,
        modulation=setup.modulation if isinstance(setup.modulation, AmplitudeModulation) else None,
        planes=tuple(setup.scene.planes),
    )
    return (
        replace(scene, moving=moving_foci_of(setup, scene))
        if isinstance(setup.modulation, Motion)
        else scene
    )


def moving_foci_of(setup: Setup, scene: LiveScene) -> MovingFoci:
    """Fix the paths of the foci of a scene file to the bones of its hand, so that they ride along.

    Parameters
    ----------
    setup : a scene whose modulation is a motion.
    scene : made of it.

    Raises
    ------
    InvalidInput
        A path does not lie along the skin, has more than 64 frames, or is run too fast for frames of whole periods of
        the sound.
    """
    motion, foci, target = setup.modulation, len(scene.places), setup.target
    assert isinstance(motion, Motion)
    if motion.through_points(foci):
        paths, places, shifts = (
            target.points[None],
            np.arange(foci)[:, None],
            np.zeros((foci, 1, 3)),
        )
        words = f"a focus runs through the {foci} places"
    else:
        paths = motion.paths(setup.scene, target, setup.array.positions.mean(axis=0))
        frames = ride(scene, setup.hands[0].joints).frames
        shifts = np.einsum("fnj,fij->nfi", paths - target.points[:, None], frames)
        places = np.tile(np.arange(foci), (len(shifts), 1))
        words = "each focus runs along a path"
    repeat = -(-FEWEST // len(places))
    places, shifts = np.repeat(places, repeat, axis=0), np.repeat(shifts, repeat, axis=0)
    if len(places) > MOST_FRAMES:
        raise InvalidInput(
            f"{setup.path.name}: live makes at most {MOST_FRAMES} frames of a path anew for each drive, not "
            f"{len(places)}: give frames = {FRAMES}.",
            code="sizes_differ",
        )
    turns = motion.turns(paths)
    if turns * len(places) > setup.frequency:
        raise InvalidInput(
            f"{setup.path.name}: {turns:g} rounds of {len(places)} frames are more than the {setup.frequency:g} periods"
            f" of the sound in a second: give {setup.frequency / len(places):.4g} Hz or less.",
            code="out_of_range",
        )
    rate = setup.frequency / round(setup.frequency / (turns * len(places)))
    words = f"{words} {rate / len(places):.3g} times a second"
    return MovingFoci(places, fixed(shifts), rate, words)
