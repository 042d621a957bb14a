"""A drive made with the fingers in place, its bytes read back from the firmware, and what the fingers get of them."""

import numpy as np

import airtact as at
from airtact.acoustics.scene import Scene, sound_hard
from airtact.drives.transfer import focus_by_distance, transfer_matrix
from airtact.evaluation.field import drive_sources
from airtact.transducers.boards import board_named, poses_of_boards
from airtact.transducers.layout import surrounding_box


def test_the_bytes_in_the_firmware_make_the_planned_foci_between_fingers() -> None:
    fingers = at.pinch()
    medium = at.Medium(343.1, 1.293)
    scene = Scene(medium, [sound_hard(surface) for surface in fingers.surfaces])
    target = at.Target(fingers.foci())
    array = surrounding_box(board="autd3")
    beacons = at.BoundaryElement(accuracy=0.03).radiate(scene, target.beacons())
    drive = at.time_reversal(transfer_matrix(beacons, array), target)

    link = at.AUTD3Link(poses_of_boards(board_named("autd3"), array.positions, array.normals))
    with at.Emission(link, cap=1.0, ramp=0.0) as emission:
        sent = emission.send(drive)
        played = link.played()
    assert played.same_as(sent)

    # One forward solution with the fingers in place, all transducers speaking: the plan, the bytes,
    # and no hand.
    ignorant = focus_by_distance(array, target, medium, 40e3)
    sources = drive_sources(array, [drive, played.drive(), ignorant])
    plan, heard, control = np.abs(
        at.BoundaryElement(accuracy=0.03).radiate(scene, sources).at(target.points)
    ).T
    assert np.abs(heard / plan - 1.0).max() < 1e-3
    planned = np.abs(transfer_matrix(beacons, array).pressure(drive))
    np.testing.assert_allclose(heard, planned, rtol=0.03)
    energy = np.linalg.norm(drive.amplitudes) / np.linalg.norm(ignorant.amplitudes)
    assert np.all(heard > control * energy)
