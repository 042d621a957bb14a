"""The 3-D scene of a page: data embedded in the page, drawn by ``viewer.js`` with three.js.

three.js is taken from the installed trimesh, so nothing is downloaded.
"""

import base64
import gzip
import importlib.util
import json
import re
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Complex, Float64, Real
from markupsafe import Markup
from matplotlib import colormaps
from matplotlib.colors import to_hex

from airtact.acoustics.solvers.problem import RadiatedField
from airtact.acoustics.target_points import outward
from airtact.drives.drive import Drive
from airtact.errors import counted
from airtact.evaluation.slices import Slices, SurfacePressure, slices_around, surface_pressure
from airtact.evaluation.windows import Window
from airtact.geometry.mesh.triangles import unit
from airtact.reports.array_figures import spacing, unfold
from airtact.reports.field_figure import COLOURS
from airtact.reports.solids import sheet_of, towards_viewer
from airtact.setup.sequences import paths_of
from airtact.setup.setup import Setup

# Centre and radius [m] of a view, and the direction to the viewer
View = tuple[Float64[np.ndarray, "3"], float, Float64[np.ndarray, "3"]]


@dataclass(frozen=True, eq=False)
class SceneView:
    """The 3-D scene on the page of a report, with the pressures of several drives.

    Attributes
    ----------
    setup : setup with the transducers, the foci and the planes.
    drives : amplitudes (E,) of each drive by name; the first drive is shown at the
        start.
    reached : (F, D) peak pressure at each focus for each drive [Pa].
    surfaces : bodies with the pressures on them; None in open air.
    slices : pressure of each drive in parallel planes.
    held_equal : description of the quantity that is equal for all drives.
    """

    setup: Setup
    drives: Mapping[str, Complex[np.ndarray, "elements"]]
    reached: Float64[np.ndarray, "foci drives"]
    surfaces: SurfacePressure | None
    slices: Slices
    held_equal: str

    @cached_property
    def peak(self) -> float:
        """Largest pressure in the scene [Pa], at the end of the colour scale for all drives."""
        air = self.slices.pressures[self.slices.depth < 0.0]
        walls = 0.0 if self.surfaces is None else self.surfaces.pressures.max()
        return float(max(air.max(initial=1e-9), self.reached.max(), walls))

    @property
    def solid(self) -> Float64[np.ndarray, "points 3"]:
        """Positions of the transducers and corners of the bodies [m]."""
        bodies = np.empty((0, 3)) if self.surfaces is None else self.surfaces.vertices
        return np.concatenate([self.setup.array.positions, bodies])

    @property
    def sheets(self) -> list[Float64[np.ndarray, "4 3"]]:
        """Corners of the visible part of each plane [m], anticlockwise as seen from its front."""
        everything = np.concatenate([self.solid, self.setup.target.points])
        return [sheet_of(plane, everything) for plane in self.setup.scene.planes]


def scene_view(
    setup: Setup,
    field: RadiatedField,
    at_foci: Complex[np.ndarray, "foci excitations"],
    drives: Mapping[str, Drive],
    scales: Sequence[float],
    window: Window,
    held_equal: str,
) -> SceneView:
    """Evaluate the pressures of drives in slices around the foci and on the bodies.

    Parameters
    ----------
    field : solved field, whose first excitations correspond to the drives.
    at_foci : pressure of the field at the foci [Pa].
    drives : drives by name, with the amplitudes for which the field was solved.
    scales : (D,) factor by which each drive is multiplied for the picture.
    window : grid of points in a plane through the foci; the slices are nearly parallel to it.
    held_equal : description of the quantity that is equal for all drives after scaling.
    """
    columns = list(range(len(drives)))
    slices = slices_around(field.for_pictures, columns, setup.target.points, window)
    surfaces = surface_pressure(field, columns)
    if surfaces is not None:
        surfaces = replace(surfaces, pressures=surfaces.pressures * scales)
    return SceneView(
        setup=setup,
        drives={
            name: scale * drive.amplitudes
            for (name, drive), scale in zip(drives.items(), scales, strict=True)
        },
        reached=np.abs(at_foci[:, columns]) * scales,
        surfaces=surfaces,
        slices=replace(slices, pressures=slices.pressures * scales),
        held_equal=held_equal,
    )


def viewer_values(view: SceneView, chosen: tuple[int, int] = (0, 1)) -> dict[str, Any]:
    """Return the values for the page's template; the page first shows the two ``chosen`` drives."""
    setup = view.setup
    facts, numbers = stage_facts(setup, view.peak, _arrays(view), view.sheets, _views(view))
    asked = [""] * len(setup.foci)
    if setup.target.pressures is not None:
        asked = [f"{pressure:,.0f} Pa" for pressure in setup.target.pressures]
    for focus, words, got in zip(facts["foci"], asked, view.reached, strict=True):
        focus.update(asked=words, got=_rounded(got))
    facts |= {
        "drives": list(view.drives),
        "paths": [[_rounded(1e3 * point) for point in path] for path in paths_of(setup)],
        "objects": [thing.name for thing in setup.objects],
        "slices": _planes(view),
        "backs": not _surrounds(view),
    }
    return {
        "drives": list(view.drives),
        "chosen": list(chosen),
        **embedded(facts, numbers),
        "labels": facts["slices"]["labels"],
        "alternative": viewer_alternative(view),
        "caption": _caption(view),
        "axes": [2, 1, 0] if view.slices.any_axis else [2],
        # More than two foci might not lie in one plane. If foci are far from the slice, it would
        # hide parts of the bodies.
        "sliced": len(setup.foci) <= 2 or not setup.scene.obstacles,
    }


def embedded(facts: dict[str, Any], numbers: bytes) -> dict[str, Any]:
    """Return the template values that embed ``facts``, ``numbers`` and three.js in a page."""
    three = three_js()
    return {
        # A "<" could end the script that contains the facts.
        "facts": Markup(json.dumps(facts).replace("<", "\\u003c")),
        "numbers": _packed(numbers),
        "three": _packed(three.encode()),
        "notice": " ".join(re.findall("(?:Copyright|SPDX)[^\\n]*", three)),
    }


def joined(arrays: Mapping[str, np.ndarray]) -> tuple[dict[str, tuple[str, int, int]], bytes]:
    """Join arrays for JavaScript; return the type, offset and size of each, and the bytes."""
    places = {}
    data = bytearray()
    for name, values in arrays.items():
        # JavaScript's typed arrays must start at multiples of their item size.
        data += bytes(-len(data) % 4)
        places[name] = (values.dtype.name, len(data), values.size)
        data += values.tobytes()
    return places, bytes(data)


def colour_scales() -> dict[str, list[str]]:
    """Return 128 colours of each scale as hexadecimal text, such as ``"#ffffff"``."""
    return {
        name: [to_hex(colour) for colour in colormaps[scale](np.linspace(0.0, 1.0, 128))]
        for name, scale in (
            ("pressure", COLOURS),
            ("difference", "RdBu_r"),
            ("phase", "twilight"),
            ("amplitude", "viridis"),
        )
    }


def pressure_bytes(pressure: Float64[np.ndarray, "*points"], peak: float) -> np.ndarray:
    """Convert pressures to bytes on a square-root scale, with 255 at ``peak`` [Pa]."""
    # The square root keeps weak fields visible: 1 % of the peak becomes 25 of 255.
    return np.round(255.0 * np.sqrt(np.clip(pressure / peak, 0.0, 1.0))).astype(np.uint8)


def viewer_alternative(view: SceneView) -> str:
    """Describe the scene and the pressures at the foci as text."""
    got = view.reached[:, 0]
    words = f"{got.min():,.0f} to {got.max():,.0f} Pa"
    # A screen reader would take too long for more than 8 foci.
    if len(got) <= 8:
        words = ", ".join(
            f"{pressure:,.0f} Pa at {name}"
            for name, pressure in zip(view.setup.foci, got, strict=True)
        )
    bodies = "" if view.surfaces is None else ", the bodies"
    bodies += "".join(f", the virtual object {thing.name}" for thing in view.setup.objects)
    bodies += ", a rigid plane" if view.setup.scene.planes else ""
    elements = counted(len(view.setup.array), "transducer", "transducers")
    first = next(iter(view.drives))
    return f"{elements}{bodies} and a slice through the field in 3-D; {first} produces {words}."


def _caption(view: SceneView) -> str:
    sentences = [
        f"The slice and the surfaces use the same colour scale for all drives, up to "
        f"{view.peak:,.0f} Pa."
    ]
    if len(view.drives) > 1:
        sentences.append(f"Drives are shown at {view.held_equal}.")
    if view.setup.scene.planes:
        sentences.append(
            "The rigid plane is drawn as a translucent sheet, or as an outline from behind."
        )
    if view.setup.objects:
        names = ", ".join(thing.name for thing in view.setup.objects)
        sentences.append(f"Virtual objects ({names}) are transparent: sound passes through them.")
    if len(paths_of(view.setup)):
        sentences.append("Foci move along the dashed lines; the field is shown for foci at rest.")
    if view.surfaces:
        sentences.append(
            "Values within a sixth of a wavelength of a surface are interpolated, with an error "
            "of a few per cent."
        )
    return " ".join(sentences)


@cache
def three_js() -> str:
    """Return three.js from trimesh's viewer as a script that defines ``THREE``."""
    # Importing trimesh would take 0.4 s.
    (folder,) = importlib.util.find_spec("trimesh").submodule_search_locations  # pyright: ignore
    archive = zipfile.ZipFile(Path(folder) / "resources" / "templates" / "viewer.zip")
    text = archive.read(archive.namelist()[0]).decode()
    # The archive contains a page; three.js extends from its licence to the end of the module.
    start = text.index("/**\n * @license", text.index("<script>"))
    return text[start : text.index("})", text.index('"__esModule"', start)) + len("})}));")]


def _packed(data: bytes) -> str:
    return base64.b64encode(gzip.compress(data, 4, mtime=0)).decode("ascii")


def stage_facts(
    setup: Setup,
    most: float,
    arrays: Mapping[str, np.ndarray],
    sheets: Sequence[Float64[np.ndarray, "4 3"]],
    views: Mapping[str, View],
) -> tuple[dict[str, Any], bytes]:
    """Return the data of any 3-D scene on a page: values as a dictionary, and arrays as bytes.

    Parameters
    ----------
    setup : setup with the transducers and foci.
    most : pressure at the upper end of the colour scale [Pa].
    arrays : NumPy arrays for the page, by name; those of the transducers are added.
    sheets : corners of each visible plane [m].
    views : views by name, as returned by ``framed``.
    """
    array = setup.array
    places, data = joined(
        {
            "positions": (1e3 * array.positions).astype(np.float32),
            "normals": np.asarray(array.normals, dtype=np.float32),
            **arrays,
        }
    )
    faces = unfold(array.positions, array.normals)
    facts = {
        "title": setup.title,
        "most": most,
        "arrays": places,
        "colours": colour_scales(),
        "radius": 0.45e3 * min(spacing(array.positions[face.elements]) for face in faces),
        "foci": [
            {"name": name, "label": label, "position": _rounded(1e3 * point)}
            for name, label, point in zip(
                setup.foci, setup.labels, setup.target.points, strict=True
            )
        ],
        "sheets": [[_rounded(1e3 * corner) for corner in sheet] for sheet in sheets],
        "views": {
            name: {
                "middle": _rounded(1e3 * centre),
                "reach": 1e3 * float(radius),
                "seen": [float(np.arctan2(seen[1], seen[0])), float(np.arcsin(seen[2]))],
            }
            for name, (centre, radius, seen) in views.items()
        },
    }
    return facts, data


def _rounded(numbers: Real[np.ndarray, "numbers"]) -> list[float]:
    return [float(f"{number:.6g}") for number in numbers]


def _arrays(view: SceneView) -> dict[str, np.ndarray]:
    slices = view.slices
    # A byte represents depths of up to half the distance of the planes, on both sides of a surface.
    depth = np.clip(slices.depth / (0.5 * slices.steps.max()), -1.0, 1.0)
    arrays = {
        "depth": np.round(127.5 * (1.0 + depth)).astype(np.uint8),
    }
    for index, amplitudes in enumerate(view.drives.values()):
        arrays[f"amplitude {index}"] = np.abs(amplitudes).astype(np.float32)
        arrays[f"phase {index}"] = np.angle(amplitudes).astype(np.float32)
        arrays[f"field {index}"] = pressure_bytes(slices.pressures[..., index], view.peak)
    if view.surfaces is not None:
        arrays["vertices"] = (1e3 * view.surfaces.vertices).astype(np.float32)
        arrays["triangles"] = view.surfaces.triangles.astype(np.uint32)
        for index in range(len(view.drives)):
            arrays[f"surface {index}"] = pressure_bytes(
                view.surfaces.pressures[:, index], view.peak
            )
    for thing in view.setup.objects:
        vertices, triangles = thing.mesh
        arrays[f"object {thing.name} vertices"] = (1e3 * vertices).astype(np.float32)
        arrays[f"object {thing.name} triangles"] = triangles.astype(np.uint32)
    return arrays


def _planes(view: SceneView) -> dict[str, Any]:
    slices = view.slices
    counts = slices.depth.shape[::-1]
    focus = (view.setup.target.points.mean(axis=0) - slices.corner) @ slices.axes.T / slices.steps
    # The slice passes through the focus farthest from the viewer, so that it hides no focus.
    seen = _first_direction(view)
    heights = ((view.setup.target.points - slices.corner) @ slices.axes[2]) / slices.steps[2]
    # The axis may point toward the viewer or away from it.
    focus[2] = heights.min() if slices.axes[2] @ seen > 0.0 else heights.max()
    start = [int(np.clip(round(at), 0, count - 1)) for at, count in zip(focus, counts, strict=True)]
    return {
        "corner": _rounded(1e3 * slices.axes @ slices.corner),
        "axes": slices.axes.tolist(),
        "steps": _rounded(1e3 * slices.steps),
        "counts": list(counts),
        "labels": ["xyz"[int(np.argmax(axis))] for axis in slices.axes],
        "start": start,
    }


def _views(view: SceneView) -> dict[str, View]:
    slices = view.slices
    spans = slices.steps * (np.array(slices.depth.shape[::-1]) - 1)
    middle = slices.corner + (spans / 2.0) @ slices.axes
    path_reaches = [
        1.2 * np.linalg.norm(path - middle, axis=1).max() for path in paths_of(view.setup)
    ]
    close = max([0.54 * float(np.linalg.norm(spans[:2])), *path_reaches])
    towards = towards_viewer(*_side(slices.axes[2], view.setup.array.normals))
    first = _first_direction(view)
    # If a view would show a rigid plane from behind, mirror it at the plane.
    front = first
    for plane in view.setup.scene.planes:
        front = front - 2.0 * min(0.0, float(front @ plane.normal)) * plane.normal
    array = framed(np.concatenate([view.solid, *view.sheets]), front)
    views = {"first": array, "array": array, "foci": (middle, close, towards)}
    if _surrounds(view) and view.surfaces is not None:
        views["first"] = framed(
            np.concatenate([view.surfaces.vertices, view.setup.target.points]), first
        )
    return views


def framed(points: Float64[np.ndarray, "points 3"], seen: Float64[np.ndarray, "3"]) -> View:
    """Return the centre, radius [m] and direction of a view that shows all points."""
    across = unit(np.cross([0.0, 0.0, 1.0], seen))
    axes = np.stack([across, np.cross(seen, across), seen])
    projected = points @ axes.T
    middle = (projected.min(axis=0) + projected.max(axis=0)) / 2.0
    right, up, near = (projected - middle).T
    # The camera sees 15 degrees to either side of the centre; near points require more distance.
    half = np.radians(15.0)
    distance = np.max(near + np.maximum(np.abs(right), np.abs(up)) / np.tan(half))
    return middle @ axes, 1.06 * float(distance * np.sin(half)), seen


def _surrounds(view: SceneView) -> bool:
    # Return whether the array surrounds the foci, so that its near side would hide them.
    return bool(np.linalg.norm(view.setup.array.normals.mean(axis=0)) < 0.3)


def _first_direction(view: SceneView) -> Float64[np.ndarray, "3"]:
    # Return the direction to a viewer who can see the array, the slice and the skin at the foci.
    scene = view.setup.scene
    radiated = view.setup.array.normals.mean(axis=0)
    if _surrounds(view):
        return towards_viewer(*_side(view.slices.axes[2], view.setup.array.normals))
    facing = (
        outward(scene.depth, view.setup.target.points).mean(axis=0) if scene.obstacles else radiated
    )
    if np.linalg.norm(facing) < 0.3:
        facing = -radiated
    facing = unit(facing)
    # View the scene from the side: in front of the skin, the viewer would have the array behind.
    normal = view.slices.axes[2] * np.sign(view.slices.axes[2] @ [0.3, -1.0, 0.2])
    candidates = (normal, np.cross([0.0, 0.0, 1.0], facing), np.array([0.0, -1.0, 0.0]))
    across = (axis - axis @ facing * facing for axis in candidates)
    aside = unit(next(axis for axis in across if np.linalg.norm(axis) > 0.5))
    return unit(0.6 * facing + 0.75 * aside + [0.0, 0.0, 0.2])


def _side(
    normal: Float64[np.ndarray, "3"], radiated: Real[np.ndarray, "elements 3"]
) -> tuple[float, float]:
    # Return the first azimuth and elevation for a view of the slice [degrees], on the array's side.
    towards = -radiated.mean(axis=0)
    # If the sound comes from above, view the field from below, so that the array does not hide it.
    below = towards[2] < -0.3
    if abs(normal[2]) > 0.9:
        return -63.0, -29.0 if below else 46.0
    side = normal @ towards if abs(normal @ towards) > 0.3 else normal @ [0.3, -1.0, 0.0]
    seen = normal * np.sign(side)
    return float(np.degrees(np.arctan2(seen[1], seen[0]))) + 29.0, -34.0 if below else 20.0
