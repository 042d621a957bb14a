"""Fig. 8 to 10 of the paper: its measurement, done by a virtual microphone."""

from pathlib import Path

import numpy as np
from jaxtyping import Complex128, Float64

from airtact.evaluation.comparison import HELD_EQUAL
from airtact.evaluation.microphone import Microphone
from airtact.evaluation.windows import AXES, Window
from airtact.experiments.part import Part, coordinates, draw_planes, write_columns
from airtact.experiments.pressures import HELD, equal_energy_factors
from airtact.experiments.settings import Settings
from airtact.experiments.solved import CONSIDERED, IGNORED, Solved
from airtact.reports.field_figure import COLOURS, cut_bodies
from airtact.reports.page import paragraph, picture, table
from airtact.timing import Clock

NOISE = 0.01
"""Noise of each reading, over the largest of all (rms)."""

SEED = 2014


def measurement(made: Solved, settings: Settings, folder: Path, clock: Clock) -> Part:
    """Move a quarter-inch microphone round one focus under both drives."""
    microphone, focus = Microphone(), made.dummies.foci[1]
    side = 2 * settings.scan_half
    window = Window(focus, AXES["x"], AXES["z"], side, side, settings.scan_step)
    with clock.step("microphone", f"moving a microphone to {len(window.points)} positions"):
        pressure = microphone.read(made.compared.field, window.points)
    read = readings(pressure * equal_energy_factors(made))
    largest = float(np.nanmax(read[:, :2]))
    shown: dict[str, np.ndarray] = dict(
        zip((CONSIDERED, IGNORED), (read[:, :2] / largest).T, strict=True)
    )
    columns = ("considered", "ignored", "considered_phase_only", "ignored_phase_only")
    write_columns(
        folder,
        "microphone",
        {
            **coordinates(window.points),
            **{name: ("Pa", read[:, index]) for index, name in enumerate(columns)},
        },
    )
    blocked = int(np.isnan(read[:, 0]).sum())
    scale = (COLOURS, 0.0, 1.0, f"reading over the largest of both, {HELD}")
    peaks = peak_ratios(read, equal_energy_factors(made))
    pieces = (
        paragraph(
            f"A microphone with a face of {1e3 * microphone.diameter:.2f} mm looks down along z, parallel to the faces "
            f"of the array, and is moved in steps of {1e3 * settings.scan_step:.2f} mm round the focus on the right "
            f"finger. It reads the mean over its face with {100 * NOISE:.0f} % of noise and does not scatter sound "
            f"itself. At {blocked} of {len(read)} positions a finger is in its way; they are blank, and the focus, on "
            "the skin, is one of them. "
            f"The largest reading with the fingers considered is at {_position(window.points, read[:, 0])}, with them "
            f"ignored at {_position(window.points, read[:, 1])}: where the disc has room, not at the focus."
        ),
        picture(
            draw_planes(
                window, shown, cut_bodies(window, made.dummies.surfaces), focus[None], scale
            ),
            "Fig. 9 (left) and Fig. 10 (right) of the paper: what the microphone reads, over the largest of both as "
            f"the paper has it, both drives at {HELD}. Blank: the finger is in the way. data/microphone",
            "two maps of a microphone's readings beside a finger",
        ),
        table(
            ["held equal", "peak, ignored / considered", "squared", "paper"],
            [[held, f"{ratio:.3f}", f"{ratio**2:.3f}", "0.60"] for held, ratio in peaks.items()],
            "The largest reading with the fingers ignored over that with them considered.",
        ),
    )
    return Part(
        "A virtual measurement (Fig. 8 to 10)",
        pieces,
        ((f"{peaks[HELD]:.2f}", f"ratio of readings, {HELD}"),),
    )


def _position(
    points: Float64[np.ndarray, "positions 3"], read: Float64[np.ndarray, "positions"]
) -> str:
    x, _, z = 1e3 * points[int(np.nanargmax(read))]
    return f"x = {x:.1f} mm, z = {z:.1f} mm"


def readings(
    pressure: Complex128[np.ndarray, "positions excitations"],
) -> Float64[np.ndarray, "positions excitations"]:
    """Return the magnitude of the pressure at a microphone [Pa] with noise, NaN where there is none."""
    chance = np.random.default_rng(SEED)
    noise = chance.standard_normal((2, *pressure.shape)) / np.sqrt(2)
    return np.abs(pressure + NOISE * np.nanmax(np.abs(pressure)) * (noise[0] + 1j * noise[1]))


def peak_ratios(
    read: Float64[np.ndarray, "positions 4"], factors: Float64[np.ndarray, "4"]
) -> dict[str, float]:
    """Largest reading ignored over considered, for each normalisation.

    The columns of ``read`` are both drives at equal energy, then both by their phases alone;
    ``factors`` brought them there from equal peak.
    """
    peak = np.nanmax(read, axis=0)
    first, second = factors[:2]
    values = (peak[1] / second / (peak[0] / first), peak[1] / peak[0], peak[3] / peak[2])
    return {held: float(value) for held, value in zip(HELD_EQUAL, values, strict=True)}
