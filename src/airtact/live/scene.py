"""From a scene file to the scene of the live loop."""

import numpy as np

from airtact.conventions import InvalidInput
from airtact.hand.hand import PLACES
from airtact.live.parts import LiveScene
from airtact.scene.scene import check_no_planes
from airtact.scene_file.building import Setup
from airtact.transducers.modulation import AmplitudeModulation
from airtact.validation import counted, fixed


def live_scene(setup: Setup) -> LiveScene:
    """Return what of a scene file stays the same while its hand moves.

    Parameters
    ----------
    setup : a scene of one sound-hard hand, whose foci are before its places, as ``read_scene`` gives it.

    Raises
    ------
    InvalidInput
        The scene holds another body, a focus does not ride on the hand, or it asks for what the live loop does not do:
        pressures, phases, suppression, or moving foci.
    """
    check_no_planes(setup.scene, "live")
    on_hand = [ride for ride in setup.riding if ride is not None and ride[0] in PLACES]
    if len(on_hand) < len(setup.foci) or not setup.hands:
        raise InvalidInput(
            f"{setup.path.name}: live needs foci that ride on a hand: {', '.join(PLACES)} of a body with joints, "
            f'and {len(on_hand) if setup.hands else 0} of {len(setup.foci)} do; give [[foci]] at = "thumb.pad".',
            code="foci_not_on_hand",
        )
    if len(setup.bodies) != 1 or setup.scene.obstacles[0].boundary != "sound_hard":
        raise InvalidInput(
            f"{setup.path.name}: live follows 1 sound-hard hand, and the scene has "
            f"{counted(len(setup.bodies), 'body', 'bodies')}: leave the others out.",
            code="bodies_not_live",
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
            code="setting_not_taken",
        )
    if setup.modulation is not None and not isinstance(setup.modulation, AmplitudeModulation):
        raise InvalidInput(
            f'{setup.path.name}: live modulates the amplitude of its {len(setup.foci)} foci: give kind = "am".',
            code="setting_not_taken",
        )
    return LiveScene(
        medium=setup.medium,
        frequency=setup.frequency,
        array=setup.array,
        side=setup.hands[0].side,
        radii=setup.hands[0].radii,
        places=tuple(name for name, _ in on_hand),
        offsets=fixed(np.array([offset for _, offset in on_hand])),
        method=setup.method,
        modulation=setup.modulation,
    )
