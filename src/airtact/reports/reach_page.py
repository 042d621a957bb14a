"""The page of a reach map: the skin in 3-D, and the extremes of each part."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from airtact.errors import counted
from airtact.evaluation.metrics import not_modelled
from airtact.reports import plot
from airtact.reports.page import picture, write_page
from airtact.reports.solids import broad_view, sheet_of, space_axes, towards_viewer
from airtact.reports.viewer import embedded, framed, stage_facts
from airtact.setup.reaching import ReachMap


def write_reach_page(path: Path, result: ReachMap) -> None:
    """Write a page that maps the largest attainable pressure on the skin.

    An existing file is replaced.
    """
    setup = result.setup
    kilopascals = 1e-3 * result.bounds
    rows = []
    for name, *ends in result.extremes:
        row = [name]
        for point in ends:
            row.append(f"{kilopascals[point]:.2f}")
            row += [f"{round(1e3 * number)}".replace("-", "−") for number in result.points[point]]
        rows.append(row)
    figure = Figure(figsize=(11.0, 5.0), layout="constrained")
    azimuth, elevation = plot.view_of_reach(result)
    for side, view in enumerate(((azimuth, elevation), (azimuth + 180.0, -elevation))):
        plot.reach(result, ax=space_axes(figure, view, (1, 2, 1 + side)))
    facts, numbers = _facts(result)
    write_page(
        path,
        "reach.html.j2",
        title=f"airtact: reach on {setup.title}",
        setup=setup,
        transducers=counted(len(setup.array), "transducer", "transducers"),
        points=counted(len(kilopascals), "point", "points"),
        facts=[
            (f"{kilopascals.max():.3g} kPa", "at the strongest point of the skin"),
            (f"{np.median(kilopascals):.3g} kPa", "median over the points"),
            (f"{kilopascals.min():.3g} kPa", "at the weakest point of the skin"),
        ],
        rows=rows,
        still=picture(
            figure,
            "Largest pressure at each point of the skin, seen from the side of the array and from "
            "behind.",
            "Two views of the skin, coloured by the largest pressure",
            wide=True,
        ),
        report=result.report,
        not_modelled=not_modelled(result.report),
        space=embedded(facts, numbers),
    )


def _facts(result: ReachMap) -> tuple[dict[str, Any], bytes]:
    setup = result.setup
    everything = np.concatenate([setup.array.positions, result.vertices])
    sheets = [sheet_of(plane, everything) for plane in setup.scene.planes]
    seen = towards_viewer(*plot.view_of_reach(result))
    aside = towards_viewer(*broad_view(everything))
    skin = framed(result.vertices, seen)
    facts, data = stage_facts(
        setup,
        float(result.bounds.max()),
        {
            "vertices": (1e3 * result.vertices).astype(np.float32),
            "triangles": result.triangles.astype(np.uint32),
            "bounds": result.on_skin.astype(np.float32),
        },
        sheets,
        {
            "first": skin,
            "foci": skin,
            "back": framed(result.vertices, -seen),
            "array": framed(np.concatenate([everything, *sheets]), aside),
        },
    )
    facts |= {
        "least": plot.lowest_colour(result),
        "paths": [],
        "points": [
            {"position": (1e3 * point).round(2).tolist(), "place": place}
            for point, place in zip(result.points, result.places, strict=True)
        ],
        # Transducers that face away would hide the skin.
        "backs": False,
    }
    return facts, data
