"""Sentences about a setup and its drive: warnings before the solve and remarks after it."""

from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from jaxtyping import Bool, Float64

import airtact as at
from airtact.acoustics.target_points import outward
from airtact.drives.drive import Drive, quantise
from airtact.drives.max_min import upper_bound
from airtact.drives.methods import METHODS
from airtact.drives.sequence import MIN_FRAMES
from airtact.drives.transfer import MIN_FOCUS_DISTANCE, TransferMatrix, fraction
from airtact.emission.codecs import codec_of
from airtact.emission.emission import frames_of_period
from airtact.errors import InvalidInput, counted, in_mm, millimetres
from airtact.evaluation.metrics import pascals, sensation
from airtact.geometry.distances import nearest, nearest_pair
from airtact.setup.setup import Setup
from airtact.transducers.boards import kind_of_array
from airtact.transducers.levels import AmplitudeModulation
from airtact.transducers.placement import (
    open_air_bound,
    overlapping_boards,
    strongest_open_air,
)

# Largest distance from a body at which a focus can be felt [m], slightly over a wavelength.
MAX_SKIN_DISTANCE = 10e-3


def with_skin(setup: Setup) -> Bool[np.ndarray, "foci"]:
    """Return a mask of the foci that may be on skin: those near a body, or all foci in open air."""
    points = setup.target.points
    skin = np.arange(len(points)) >= setup.lobes
    if setup.scene.obstacles:
        skin &= -setup.scene.depth(points) <= MAX_SKIN_DISTANCE
    return skin


def touches(setup: Setup) -> tuple[str, ...]:
    """Describe the contacts of bodies with virtual objects: place, depth and strength."""
    if setup.contacts is None:
        return ()
    contacts = setup.contacts
    words = [
        f"{place} {1e3 * depth:.1f} mm deep in {name}"
        for place, depth, name in zip(
            contacts.places, contacts.depths, contacts.objects, strict=True
        )
    ]
    sentences = [f"Touching: {', '.join(words)}."]
    if not contacts.runs:
        strongest = contacts.foci(wavelength=setup.scene.wavelength).strengths.max()
        if strongest < 0.995:
            sentences.append(
                f"At this depth, the strongest touch has {strongest:.0%} of full strength: scale "
                "the drive by this factor."
            )
    return tuple(sentences)


def trap_sentences(setup: Setup, verdicts: "Sequence[at.traps.Verdict]") -> Iterator[str]:
    """State the verdict on each trap, and any noticeable distance from the requested point."""
    for index, (trap, verdict) in enumerate(zip(setup.traps, verdicts, strict=True), 1):
        away = float(np.linalg.norm(verdict.point - trap.point))
        moved = (
            f" It is {millimetres(away)} from the requested point."
            if away > setup.scene.wavelength / 20.0
            else ""
        )
        yield f"Trap {index}: {verdict}.{moved}"


def reach_cautions(setup: Setup) -> tuple[str, ...]:
    """Warn before the solve about foci that are hard to reach, to separate or to feel."""
    scene = setup.scene
    points = setup.target.points
    cautions = [
        f"the plane {millimetres(plane.height(setup.array.positions).min(), 3)} behind the boards "
        "is ignored: the boards only radiate forwards, so no sound reaches it."
        for plane in setup.left_out
    ]
    if setup.objects and setup.contacts is None:
        cautions.append(
            "the scene defines its foci, so its virtual objects "
            f"({', '.join(item.name for item in setup.objects)}) are only displayed. "
            "Bodies that reflect sound belong in [[obstacles]]."
        )
    overlap = overlapping_boards(setup.array)
    if overlap is not None:
        first, second, point = overlap
        cautions.append(
            f"boards {first} and {second} overlap around {in_mm(point)}: move one of them."
        )
    if len(setup.target.suppression_points) and not METHODS[setup.method].heeds_suppression_points:
        cautions.append(
            f"the method {setup.method} ignores the suppression points: use best, gradient or "
            "inverse_filter."
        )
    if setup.contacts is not None and not setup.contacts.runs:
        note = setup.contacts.foci(wavelength=scene.wavelength).note
        cautions += [f"{note}."] if note else []
    cautions += _too_fast(setup)
    # A focus in mid-air may be intended, so it is not an error.
    bare = int(np.count_nonzero(~with_skin(setup))) - setup.lobes
    if bare:
        away = -scene.depth(points)
        away[: setup.lobes] = 0.0
        more = (
            f", and {counted(bare - 1, 'other focus', 'other foci')} over "
            f"{1e3 * MAX_SKIN_DISTANCE:g} mm"
            if bare > 1
            else ""
        )
        cautions.append(
            f"{setup.foci[int(away.argmax())]} is {millimetres(away.max())} from the nearest "
            f"body{more}: there is no skin at that point, so comparing it with the tactile "
            "threshold is meaningless."
        )
    if len(points) > 1:
        first, second, apart = nearest_pair(points)
        if apart < MIN_FOCUS_DISTANCE * scene.wavelength:
            cautions.append(
                f"{setup.foci[first]} and {setup.foci[second]} are {millimetres(apart)} apart, "
                "less than a tenth of the wavelength. Most methods cannot separate such foci and "
                "return no drive: remove one focus."
            )
    # The few points on a face give its near field only roughly: on the axis of a disc of 4.5 mm,
    # the pressure is 4 % off at 1 mm and 7 % at 0.1 mm.
    apart = nearest(points, setup.array.positions)[0]
    for name, distance in zip(setup.foci, apart, strict=True):
        if distance < setup.array.element.radius:
            cautions.append(
                f"{name} is {millimetres(distance)} from a transducer: closer than a radius to a "
                "face, the pressure is up to 7 % off. Move the focus away."
            )
    bounds = open_air_bound(setup.array, points, scene.wavenumber)
    strongest = strongest_open_air(setup.array, scene.wavenumber)
    # A hard surface doubles the pressure of a plane wave, and so does a plane. For reflecting
    # boards, there is no such bound.
    gain = (2.0 if scene.obstacles else 1.0) * (2.0 if scene.planes else 1.0)
    gain = np.inf if scene.boards else gain
    pressures = setup.target.pressures
    requested = np.zeros(len(bounds)) if pressures is None else np.abs(pressures)
    for name, bound, pressure in zip(setup.foci, bounds, requested, strict=True):
        if bound < 0.1 * strongest:  # a tenth of the pressure is a hundredth of the force
            cautions.append(
                f"{name} is out of the array's reach: in open air, all elements together produce "
                f"only {bound / strongest:.1%} (less than 10%) of the {strongest:,.0f} Pa that "
                "they produce at their strongest point. Move the focus or the array."
            )
        if 0.0 < pressure < 50.0:
            cautions.append(
                f"the requested pressure of {name} is {pressure:.3g} Pa, too little to be felt: is "
                "it in kilopascals? Use pascals."
            )
        if pressure > gain * bound:
            words = {1.0: "", 2.0: ", and at most about twice that on a hard surface"}.get(
                gain, ", and at most about four times that on a hard surface beside a plane"
            )
            cautions.append(
                f"the requested pressure of {name} is {pressure:,.0f} Pa, but all elements at full "
                f"scale produce {bound:,.0f} Pa in open air{words}. Request less, or use more "
                "boards."
            )
    return tuple(cautions)


def _too_fast(setup: Setup) -> Iterator[str]:
    """Warn before the solve if the boards' serial line is too slow for the modulation."""
    made = kind_of_array(setup.array.positions, setup.array.normals)
    if made is None:
        return
    codec = codec_of(made[0])
    try:
        if isinstance(setup.modulation, AmplitudeModulation):
            frames_of_period(setup.modulation.frequency, codec.fastest_frames(len(made[1])))
        elif setup.motion is not None and codec.baud is not None:
            from airtact.setup.sequences import paths_of

            paths = paths_of(setup)
            # Short paths repeat every position.
            frames = -(-MIN_FRAMES // paths.shape[1]) * paths.shape[1]
            codec.check_rate(frames, frames * setup.motion.turns(paths), len(made[1]))
    except InvalidInput as error:
        yield str(error)


def all_at_once(setup: Setup) -> tuple[str, ...]:
    """Warn if all foci are treated as simultaneous although one focus runs through the points."""
    if not setup.in_turn:
        return ()
    return (
        "the pressures are those of all foci at once, but in this scene one focus runs through the "
        "points in turn, which produces higher pressures: see airtact render.",
    )


def facing_away(setup: Setup) -> Iterator[str]:
    """Warn before the solve about foci on skin that faces away from all transducers."""
    scene = setup.scene
    if not scene.obstacles or scene.boards:
        return
    points = setup.target.points
    normals = outward(scene.depth, points)
    depths = np.stack([obstacle.surface.depth(points) for obstacle in scene.obstacles])
    skin = with_skin(setup)
    for index, (name, point) in enumerate(zip(setup.foci, points, strict=True)):
        # On an open hand, the bound on such skin is a fifth of that on skin facing the array.
        if skin[index] and ((setup.array.positions - point) @ normals[index] < 0.0).all():
            body = setup.bodies[int(depths[:, index].argmax())]
            yield (
                f"{name} faces away from all transducers, so it is in the shadow of {body}: turn "
                f"{body}, or move boards to the side that {name} faces (see airtact place). "
                "airtact reach shows which skin the array reaches."
            )


def sensations(
    setup: Setup,
    pressures: Float64[np.ndarray, "foci"],
    moving: "at.setup.MovingDrive | None" = None,
    default_level: Iterable[str] = (),
) -> tuple[str, ...]:
    """Compare the foci, or the weakest focus of a sequence, with the tactile threshold.

    The comparison is followed by the sentences ``default_level``, as returned by the function of
    this name in ``safe_emission``.

    Foci away from all bodies are ignored. If all foci are away from bodies, the sentence says so.
    """
    if setup.traps:
        foci = len(setup.target.points) > setup.lobes
        return ("Skin hardly feels the foci: with traps, their force is constant.",) * foci
    # A silent focus, with a request of 0, is not meant to be felt.
    skin = with_skin(setup) & (setup.target.weights > 0.0)
    if not skin.any():
        return (
            f"No focus is within {1e3 * MAX_SKIN_DISTANCE:g} mm of a body, so there is no skin "
            "that could feel it.",
        )
    if moving is not None:
        return (*moving.sentences(setup.foci), *default_level)
    weakest = float(pressures[skin].min())
    if isinstance(setup.modulation, AmplitudeModulation):
        return (sensation(weakest, "amplitude", setup.modulation.depth), *default_level)
    fastest = np.inf
    made = kind_of_array(setup.array.positions, setup.array.normals)
    if made is not None:
        fastest = codec_of(made[0]).fastest_frames(len(made[1])) / 2.0
    return (sensation(weakest, None, fastest=fastest),)


def share_of_bound(setup: Setup, transfer: TransferMatrix, drive: Drive) -> str:
    """State the fraction of the upper bound that the drive reaches, before and after rounding."""
    # The sentence states whole per cent, so it is enough to certify the bound within 1 %.
    frame = quantise(drive, setup.levels)
    levels = (
        f"{len(frame.levels.amplitudes)} levels of amplitude and {frame.levels.phases} of phase"
    )
    if not np.any(frame.drive().amplitudes):
        return f"Rounded to {levels}, this drive is silent: request higher pressures."
    bound = upper_bound(transfer, setup.target, tolerance=1e-2)
    exact = bound.reached(transfer, setup.target, drive)
    rounded = bound.reached(transfer, setup.target, frame.drive())
    if not drive.is_full_scale:
        words = (
            f"No drive exceeds {1.0 / exact:.1f} times this pressure at full scale. Rounding to "
            f"{levels} "
        )
        if rounded < 1.1 * exact:
            words += f"keeps {rounded / exact:.1%} of the pressure."
        else:
            words += f"multiplies the pressure by {rounded / exact:.2g}."
    else:
        words = (
            f"The drive reaches {exact:.0%} of the upper bound at the weakest focus, and "
            f"{rounded:.0%} when rounded to {levels}."
        )
    return words.replace("%", " %")


def too_strong(setup: Setup, emitted: Float64[np.ndarray, "foci"]) -> tuple[str, ...]:
    """Warn if rounding raises the pressure at a focus to more than 10 % above the request."""
    excess = np.nan_to_num(fraction(emitted, setup.target))
    strongest = int(excess.argmax())
    times = float(excess[strongest])
    if times <= 1.1:
        return ()
    remedy = "request a pressure that these levels produce, or use boards with finer levels"
    if setup.levels.phase_only:
        remedy = (
            f"emit it with --cap {1.0 / times:.2g}, which switches on fewer elements, or use "
            "boards with amplitude levels"
        )
    return (
        f"the boards emit {times:.2g} times the requested pressure at {setup.foci[strongest]}, "
        f"because they round amplitudes to {len(setup.levels.amplitudes)} levels: {remedy}.",
    )


def shadows(setup: Setup, transfer: TransferMatrix) -> Iterator[str]:
    """Warn about foci in the shadow of the bodies."""
    if not setup.scene.obstacles or setup.scene.boards:
        return
    points = setup.target.points
    attainable = np.abs(transfer.matrix).sum(axis=1)[: len(points)]
    open_air = open_air_bound(setup.array, points, setup.scene.wavenumber)
    for name, pressure, bound in zip(setup.foci, attainable, open_air, strict=True):
        if pressure < 0.2 * bound:
            yield (
                f"{name} is in the shadow of {' and '.join(setup.bodies)}: the pressure there can "
                f"reach at most {pascals(pressure)}, {pressure / bound:.0%} of the pressure in "
                "open air. Turn the body, or move the array to the other side."
            )


def disagreement(
    setup: Setup, transfer: TransferMatrix, drive: Drive, pressures: Float64[np.ndarray, "foci"]
) -> Iterator[str]:
    """Warn if a solution and its verification differ by over 1.5 times the requested accuracy."""
    # The drive comes from the transposed solution, and a forward solution verifies it. If both
    # agree within the accuracy, panels and solver are not at fault.
    predicted = np.abs(transfer.pressure(drive))[: len(pressures)]
    # Relative differences mean nothing at foci of request 0.
    apart = np.zeros(len(pressures))
    asked = setup.target.weights > 0.0
    apart[asked] = np.abs(predicted[asked] / pressures[asked] - 1.0)
    worst = int(np.argmax(apart))
    if apart[worst] > 1.5 * setup.accuracy:
        yield (
            f"the solution for the drive and its verification differ by {apart[worst]:.1%} in the "
            f"pressure at {setup.foci[worst]}, more than the accuracy of {setup.accuracy:.1%}: set "
            f"accuracy = {setup.accuracy / 2.0:.2g} or less under [solver]."
        )
