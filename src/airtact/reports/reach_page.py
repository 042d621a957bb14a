"""The page of a reach map: the skin in 3-D, the extremes of each part, and the table as CSV."""

import base64
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from airtact.errors import counted
from airtact.evaluation.metrics import not_modelled
from airtact.reports import plot
from airtact.reports.array_figures import spacing, unfold
from airtact.reports.page import picture, write_page
from airtact.reports.solids import broad_view, sheet_of, space_axes, towards_viewer
from airtact.reports.viewer import colour_scales, embedded, framed, joined
from airtact.setup.reaching import ReachMap


def write_reach_page(path: Path, result: ReachMap) -> None:
    """Write reach.html, replacing an existing file."""
    setup = result.setup
    kilopascals = 1e-3 * result.bounds
    rows = []
    for name, *ends in result.extremes:
        row = [name]
        for point in ends:
            place = ", ".join(f"{round(1e3 * number)}" for number in result.points[point])
            row += [f"{kilopascals[point]:.2f}", place.replace("-", "−")]
        rows.append(row)
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
        table=base64.b64encode(result.csv.encode()).decode("ascii"),
        still=_still(result),
        report=result.report,
        not_modelled=not_modelled(result.report),
        space=embedded(facts, numbers),
    )


def _still(result: ReachMap) -> Any:
    figure = Figure(figsize=(11.0, 5.0), layout="constrained")
    azimuth, elevation = plot.view_of_reach(result)
    for side, view in enumerate(((azimuth, elevation), (azimuth + 180.0, -elevation))):
        plot.reach(result, ax=space_axes(figure, view, (1, 2, 1 + side)))
    return picture(
        figure,
        "Largest pressure at each point of the skin, seen from the side of the array and from "
        "behind.",
        "Two views of the skin, coloured by the largest pressure",
        wide=True,
    )


def _facts(result: ReachMap) -> tuple[dict[str, Any], bytes]:
    setup = result.setup
    array = setup.array
    everything = np.concatenate([array.positions, result.vertices])
    sheets = [sheet_of(plane, everything) for plane in setup.scene.planes]
    seen = towards_viewer(*plot.view_of_reach(result))
    aside = towards_viewer(*broad_view(everything))
    places, data = joined(
        {
            "positions": (1e3 * array.positions).astype(np.float32),
            "normals": np.asarray(array.normals, dtype=np.float32),
            "vertices": (1e3 * result.vertices).astype(np.float32),
            "triangles": result.triangles.astype(np.uint32),
            "bounds": result.on_skin.astype(np.float32),
        }
    )
    views = {
        "first": framed(result.vertices, seen),
        "back": framed(result.vertices, -seen),
        "array": framed(np.concatenate([everything, *sheets]), aside),
    }
    views["foci"] = views["first"]
    facts = {
        "title": f"{setup.title} reach",
        "most": float(result.bounds.max()),
        "arrays": places,
        "colours": colour_scales(),
        "radius": 0.45e3
        * min(
            spacing(array.positions[face.elements])
            for face in unfold(array.positions, array.normals)
        ),
        "foci": [
            {"name": name, "position": (1e3 * point).tolist()}
            for name, point in zip(setup.foci, setup.target.points, strict=True)
        ],
        "paths": [],
        "sheets": [(1e3 * sheet).tolist() for sheet in sheets],
        "parts": list(dict.fromkeys(result.places)),
        "points": [
            {
                "position": (1e3 * point).round(2).tolist(),
                "place": place,
            }
            for point, place in zip(result.points, result.places, strict=True)
        ],
        "views": {
            name: {
                "middle": (1e3 * middle).tolist(),
                "reach": 1e3 * reach,
                "seen": [float(np.arctan2(way[1], way[0])), float(np.arcsin(way[2]))],
            }
            for name, (middle, reach, way) in views.items()
        },
        # Transducers that face away would hide the skin.
        "backs": False,
    }
    return facts, data
