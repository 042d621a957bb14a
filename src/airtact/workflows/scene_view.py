"""The scene of a page in space, evaluated: slices round the foci and the pressure on the bodies."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from airtact.acoustics.solvers.problem import RadiatedField
from airtact.drives.transfer import Drive
from airtact.evaluation.slices import slices_around, surface_pressure
from airtact.evaluation.windows import Window
from airtact.reports.viewer import SceneView
from airtact.setup.building import Setup
from airtact.workflows.modulated import paths_of


def scene_view(
    setup: Setup,
    field: RadiatedField,
    drives: Mapping[str, Drive],
    scales: Float64[np.ndarray, "drives"],
    window: Window,
    held_equal: str,
) -> SceneView:
    """Evaluate drives around the foci and on the bodies.

    Parameters
    ----------
    setup : the scene.
    field : its first excitations are those of the drives.
    drives : by name, as they were solved.
    scales : (D,) by which each drive is shown stronger than it was solved.
    window : the plane of the foci.
    held_equal : what the scales hold equal between the drives, in words.
    """
    columns, target = list(range(len(drives))), setup.target
    slices = slices_around(field, columns, target.points, window)
    surfaces = surface_pressure(field, columns)
    asked = target.pressures
    return SceneView(
        drives={
            name: scale * one.amplitudes
            for (name, one), scale in zip(drives.items(), scales, strict=True)
        },
        positions=setup.array.positions,
        normals=setup.array.normals,
        foci=setup.foci,
        points=target.points,
        asked=["as strong as possible"] * len(setup.foci)
        if asked is None
        else [f"{one:,.0f} Pa" for one in asked],
        reached=np.abs(field.at(target.points)[:, columns]) * scales,
        surfaces=surfaces and replace(surfaces, pressures=surfaces.pressures * scales),
        slices=replace(slices, pressures=slices.pressures * scales),
        held_equal=held_equal,
        paths=paths_of(setup),
        planes=setup.scene.planes,
    )
