"""Sentences about a setup and its drive: cautions before the solve, remarks after it."""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Bool, Float64

from airtact.drives.drive import Drive, quantise
from airtact.drives.max_min import upper_bound
from airtact.drives.reach import MIN_FOCUS_DISTANCE, nearest_foci
from airtact.drives.transfer import TransferMatrix
from airtact.errors import counted, in_mm
from airtact.evaluation.metrics import pascals
from airtact.evaluation.tactile_thresholds import sensation
from airtact.setup.setup import Setup
from airtact.transducers.modulation import AmplitudeModulation
from airtact.transducers.placement import (
    open_air_bound,
    overlapping_boards,
    strongest_open_air,
)

# Largest distance of a focus from a body at which skin can feel it [m], a wavelength and more
MAX_SKIN_DISTANCE = 10e-3


def with_skin(setup: Setup) -> Bool[np.ndarray, "foci"]:
    """Return for each focus whether a body is near enough to feel it.

    In open air any may be felt.
    """
    if not setup.scene.obstacles:
        return np.ones(len(setup.target.points), dtype=bool)
    return np.asarray(-setup.scene.depth(setup.target.points) <= MAX_SKIN_DISTANCE)


def reach_cautions(setup: Setup) -> tuple[str, ...]:
    """Warn of foci that are hard to reach, to separate or to feel, before anything is solved."""
    return (
        *(
            f"the plane {1e3 * plane.height(setup.array.positions).min():.3g} mm behind the boards "
            "is left out: they radiate forwards only, so it gets none of their sound."
            for plane in setup.left_out
        ),
        *_board_cautions(setup),
        *_path_cautions(setup),
        *_skin_cautions(setup),
        *_separation_cautions(setup),
        *_pressure_cautions(setup),
    )


def _board_cautions(setup: Setup) -> Iterator[str]:
    overlap = overlapping_boards(setup.array)
    if overlap is not None:
        first, second, point = overlap
        yield (
            f"boards {first} and {second} overlap around {in_mm(point)}: two boards cannot be at "
            "one place; move one of them."
        )


def _path_cautions(setup: Setup) -> Iterator[str]:
    motion = setup.motion
    if motion is None or motion.through_points(len(setup.foci)):
        return
    distances = motion.strayed(setup.scene, setup.target, setup.array.positions.mean(axis=0))
    for name, off in zip(setup.foci, distances, strict=True):
        count = int((off > setup.scene.wavelength / 2.0).sum())
        if count:
            yield (
                f"the path around {name} leaves the body: {count} of {len(off)} positions lie up "
                f"to {1e3 * off.max():.2g} mm farther from it than the focus, over half a "
                "wavelength; give a smaller radius or length."
            )


def _skin_cautions(setup: Setup) -> Iterator[str]:
    # A focus in mid-air may be meant, so this only warns.
    bare = ~with_skin(setup)
    if not bare.any():
        return
    away = -setup.scene.depth(setup.target.points)
    more = int(np.count_nonzero(bare)) - 1
    beside = ""
    if more:
        foci = counted(more, "other focus", "other foci")
        beside = f", and {foci} over {1e3 * MAX_SKIN_DISTANCE:g} mm"
    yield (
        f"{setup.foci[int(away.argmax())]} is {1e3 * away.max():.2g} mm from the nearest "
        f"body{beside}: no skin is modelled there, so its level above the tactile threshold is "
        "meaningless."
    )


def _separation_cautions(setup: Setup) -> Iterator[str]:
    if len(setup.target.points) < 2:
        return
    first, second, apart = nearest_foci(setup.target.points)
    if apart < MIN_FOCUS_DISTANCE * setup.scene.wavelength:
        yield (
            f"{setup.foci[first]} and {setup.foci[second]} are {1e3 * apart:.2g} mm apart, under a "
            "tenth of the wavelength: most methods cannot separate them and make no drive; leave "
            "one out."
        )


def _pressure_cautions(setup: Setup) -> Iterator[str]:
    target = setup.target
    wavenumber = setup.scene.wavenumber.real
    bounds = open_air_bound(setup.array, target.points, wavenumber)
    strongest = strongest_open_air(setup.array, wavenumber)
    # A hard surface doubles the pressure of a plane wave, and so does a plane. Between reflecting
    # boards there is no such bound.
    gain = (2.0 if setup.scene.obstacles else 1.0) * (2.0 if setup.scene.planes else 1.0)
    gain = np.inf if setup.scene.boards else gain
    asked = np.zeros(len(bounds)) if target.pressures is None else np.abs(target.pressures)
    for name, bound, pressure in zip(setup.foci, bounds, asked, strict=True):
        if bound < 0.1 * strongest:  # a tenth of the pressure is a hundredth of the force
            yield (
                f"{name} is out of the array's reach: it gets {bound / strongest:.1%} of the "
                f"{strongest:,.0f} Pa that the elements bring to their strongest point in open "
                "air, under 10%; move the focus or the array."
            )
        if 0.0 < pressure < 50.0:
            yield (
                f"{name} asks for {pressure:.3g} Pa, too little to be felt: is it in kilopascal? "
                "Give pascals."
            )
        if pressure > gain * bound:
            words = {1.0: "", 2.0: ", and at most about twice that on a hard surface"}.get(
                gain, ", and at most about four times that on a hard surface beside a plane"
            )
            yield (
                f"{name} asks for {pressure:,.0f} Pa, and all elements at full scale bring "
                f"{bound:,.0f} Pa to it in open air{words}: ask for less, or take more boards."
            )


def sensations(
    setup: Setup,
    pressures: Float64[np.ndarray, "foci"],
    moving: Float64[np.ndarray, "frames"] | None = None,
) -> tuple[str, ...]:
    """Compare the foci, or the weakest focus of a sequence, with the tactile threshold.

    Foci away from every body are ignored. If all are, the sentence says so.
    """
    skin = with_skin(setup)
    if not skin.any():
        return (
            f"No body is within {1e3 * MAX_SKIN_DISTANCE:g} mm of a focus: nobody is modelled "
            "there who could feel it.",
        )
    if moving is not None:
        return (
            f"The foci move: {len(moving)} frames, the weakest focus of which gets "
            f"{moving.min():,.0f} Pa.",
            sensation(float(moving.min()), "spatiotemporal"),
        )
    weakest = float(pressures[skin].min())
    if isinstance(setup.modulation, AmplitudeModulation):
        return (sensation(weakest, "amplitude", setup.modulation.depth),)
    return (sensation(weakest, None),)


def share_of_bound(setup: Setup, transfer: TransferMatrix, drive: Drive) -> str:
    """Compare the drive with the certified upper bound, before and after rounding."""
    # A certificate within 1 % is enough for a sentence in whole per cent.
    frame = quantise(drive, setup.levels)
    levels = (
        f"{len(frame.levels.amplitudes)} levels of amplitude and {frame.levels.phases} of phase"
    )
    if not np.any(frame.drive().amplitudes):
        return f"Rounded to {levels} this drive is silent: ask the foci for more."
    bound = upper_bound(transfer, setup.target, tolerance=1e-2)
    exact = bound.reached(transfer, setup.target, drive)
    rounded = bound.reached(transfer, setup.target, frame.drive())
    if not drive.is_full_scale:
        words = (
            f"At full scale no drive exceeds {1.0 / exact:.1f} times that; rounded to {levels} it "
            f"is {rounded / exact:.1%} of it."
        )
    else:
        words = (
            f"That is {exact:.0%} of the upper bound for any drive, {rounded:.0%} rounded to "
            f"{levels}."
        )
    return words.replace("%", " %")


def shadows(setup: Setup, transfer: TransferMatrix) -> Iterator[str]:
    """Warn of foci that the bodies shade from the array."""
    if not setup.scene.obstacles or setup.scene.boards:
        return
    points = setup.target.points
    attainable = np.abs(transfer.matrix).sum(axis=1)[: len(points)]
    open_air = open_air_bound(setup.array, points, setup.scene.wavenumber.real)
    for name, pressure, bound in zip(setup.foci, attainable, open_air, strict=True):
        if pressure < 0.2 * bound:
            yield (
                f"{name} is in the shadow of {' and '.join(setup.bodies)}: it can get "
                f"{pascals(pressure)}, {pressure / bound:.0%} of what the array brings there in "
                "open air; turn the body, or move the array to the other side."
            )


def disagreement(
    setup: Setup, transfer: TransferMatrix, drive: Drive, pressures: Float64[np.ndarray, "foci"]
) -> Iterator[str]:
    """Warn where the two solutions differ by over 1.5 times the accuracy asked for."""
    # The drive comes from the transposed solution and is verified by a forward one of finer panels;
    # where both agree within the accuracy asked, neither panels nor solver are at fault.
    predicted = np.abs(transfer.pressure(drive))[: len(pressures)]
    apart = np.abs(predicted / pressures - 1.0)
    worst = int(np.argmax(apart))
    if apart[worst] > 1.5 * setup.accuracy:
        yield (
            "the solution that the drive is made from and the one that verifies it differ by "
            f"{apart[worst]:.1%} at {setup.foci[worst]}, and {setup.accuracy:.1%} was asked: give "
            "a smaller accuracy under [solver]."
        )
