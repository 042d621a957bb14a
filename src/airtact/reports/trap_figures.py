"""Pictures of a trap: Gor'kov's potential in three planes, and the force along three axes."""

import numpy as np
from markupsafe import Markup
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from airtact.evaluation.windows import Window
from airtact.reports.field_figure import COLOURS, Cut, draw_plane, solid_depth
from airtact.reports.page import picture
from airtact.reports.plots import COLOURS_OF_DRIVES
from airtact.setup.rendering import Rendering
from airtact.traps.gorkov import clearances, derivatives, force_of, potential_of


def trap_pictures(run: Rendering, index: int) -> list[Markup]:
    """Draw the potential in three planes through a trap, and the force along three axes."""
    scene = run.setup.scene
    field = run.verification.field
    bead = run.setup.traps[index].bead(scene)
    point = run.traps[index].point
    beads = np.array([verdict.point for verdict in run.traps])
    x, y, z = np.eye(3)
    size = scene.wavelength

    windows = [Window(point, *sides, size, size, size / 28) for sides in ((x, y), (x, z), (y, z))]
    points = np.concatenate([window.points for window in windows])
    # The velocity is undefined inside bodies, so the picture stays grey there.
    velocity = field.velocity(points)[:, :, 0]
    gradient = 2j * np.pi * scene.frequency * scene.medium.density * velocity
    potential = 1e9 * potential_of(field.at(points)[:, 0], gradient, bead, scene)
    known = potential[np.isfinite(potential)]
    # Close to a body, the potential may be far higher than around the trap.
    scale = ScalarMappable(Normalize(known.min(), np.percentile(known, 98)), COLOURS)
    panels = []
    for window, values in zip(windows, np.split(potential, 3), strict=True):
        cut = Cut(window, {}, solid_depth(scene, window.points))
        label = "Gor'kov's potential [nJ]"
        right, up = (name[0] for name in window.labels)
        panels.append(
            picture(
                draw_plane(None, cut, values, scale, beads, None, label),
                f"Plane along {right} and {up}.",
                f"Map of the potential along {right} and {up}, lowest at the trap",
            )
        )

    # Compute the force along each axis where there is room for the bead.
    weight = 9.80665 * bead.mass
    distances = np.linspace(-0.5, 0.5, 61) * size
    lines = point + distances[:, None] * np.eye(3)[:, None]
    free = clearances(field, lines.reshape(-1, 3)) >= bead.room(scene)
    along = np.full((3, 61), np.nan)
    if free.any():
        pull = force_of(derivatives(field, lines.reshape(-1, 3)[free], bead), bead, scene)
        along[free.reshape(3, 61)] = pull[np.arange(len(pull)), np.nonzero(free)[0] // 61]
    figure = Figure(figsize=(4.7, 4.6), layout="constrained")
    axes = figure.subplots()
    # Different line styles keep curves visible if they coincide.
    styles = zip("xyz", COLOURS_OF_DRIVES, ("-", "-", "--"), strict=False)
    for (name, colour, style), curve in zip(styles, along, strict=True):
        axes.plot(1e3 * distances, 1e6 * curve, style, color=colour, label=f"along {name}")
    for level in (-weight, weight):
        words = "weight" if level > 0.0 else None
        axes.axhline(1e6 * level, color="0.4", linestyle=":", label=words)
    axes.axvline(0.0, color="0.8", linewidth=0.8)
    axes.set(xlabel="distance from the bead [mm]", ylabel="force along the axis [µN]")
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=4)
    stiffness = ", ".join(f"{value:.3g}" for value in run.traps[index].stiffness.diagonal())
    panels.append(
        picture(
            figure,
            f"Force along each axis. The slopes at the bead are the stiffnesses {stiffness} N/m; "
            f"the weight of the bead is {1e6 * weight:.2g} µN.",
            "Curves of the force along x, y and z",
        )
    )
    return panels
