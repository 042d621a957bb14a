"""Frames per second to boards, and the cost of rounding at a focus. Prints one table.

Run as ``python -m benchmarks.frames``.
"""

import time
from collections.abc import Callable

import numpy as np

import airtact as at
from airtact.emission.codecs import codec_of

SECONDS = 2.0


def transfer_and_drive() -> tuple[at.TransferMatrix, at.Drive, at.PhasedArray]:
    fingers, array = at.pinch(), at.surrounding_box(board="autd3")
    medium = at.Medium(sound_speed=343.1, density=1.293)
    scene = at.Scene(
        medium, [at.sound_hard(surface) for surface in fingers.surfaces], frequency=40e3
    )
    target = at.Target(fingers.foci())
    transfer = at.transfer_matrix(
        at.BoundaryElement(accuracy=0.03).radiate(scene, target.beacons()), array
    )
    return transfer, at.time_reversal(transfer, target), array


def frames_a_second(drive: at.Drive, array: at.PhasedArray) -> dict[str, float]:
    """Send until the time is over: the link alone, and through its process with rounding and the watchdog."""
    link = at.AUTD3Link(
        at.transducers.poses_of_boards(
            at.transducers.board_named("autd3"), array.positions, array.normals
        )
    )
    link.open()
    frame = at.quantise(drive)
    rates = {"frames": _rate(lambda: link.send(frame))}
    link.stop()
    link.close()
    with at.Emission(link, cap=1.0, ramp=0.0) as emission:
        rates["drives"] = _rate(lambda: emission.send(drive))
    return rates


def _rate(send: Callable[[], object]) -> float:
    begun, count = time.perf_counter(), 0
    while time.perf_counter() - begun < SECONDS:
        send()
        count += 1
    return count / (time.perf_counter() - begun)


def main() -> None:
    transfer, drive, array = transfer_and_drive()
    rates = frames_a_second(drive, array)
    print("| what | figure |\n|---|---|")
    print(
        f"| frames a second through AUTD3's Audit link, {len(array)} elements | {rates['frames']:.0f} |"
    )
    print(f"| drives a second, with rounding and watchdog | {rates['drives']:.0f} |")
    for name in ("autd3", "openmpd", "sonicsurface", "nano16"):
        levels = codec_of(name).levels
        worst = np.abs(at.drives.rounding_error(transfer, drive, at.quantise(drive, levels))).max()
        held = ", equal energy" if levels.phase_only else ""
        words = f"{len(levels.amplitudes)} amplitudes, {levels.phases} phases ({name}{held})"
        print(f"| focus of the pinch rounded to {words} | {worst:.3%} |")
    every = drive.phase_only()
    for phases in (32, 16):
        levels = at.transducers.Levels(np.array([0.0, 1.0]), phases=phases)
        worst = np.abs(at.drives.rounding_error(transfer, every, at.quantise(every, levels))).max()
        print(f"| focus of its phases alone, rounded to {phases} | {worst:.3%} |")


if __name__ == "__main__":
    main()
