"""Randomly damaged meshes are repaired correctly, or rejected with a position."""

import re
from collections import Counter

import numpy as np
import pytest

import airtact as at
from airtact.errors import in_mm
from geometry.mesh.repaired_meshes import accepted, apart, volume
from references.damaged_meshes import DAMAGES, Mesh, body, damaged


def check_fault(fault: at.InvalidInput) -> None:
    """A position in the sentence of an error is the one that is drawn."""
    if shown := re.search(r"\([-\d., ]+\) mm", str(fault)):
        assert fault.position is not None, str(fault)
        assert shown.group() == in_mm(fault.position)


def outcome(name: str, sound: Mesh, damaged_mesh: Mesh) -> str:
    try:
        result = accepted(*damaged_mesh)
    except at.InvalidInput as fault:
        check_fault(fault)
        return "rejected"
    widths = [float(width) for width in re.findall(r"up to ([\d.]+) mm", " ".join(result.notes))]
    # Slivers and cracks move the surface by 5 micrometres each. A sharp edge through the middle of
    # a hole, cut off, would deviate by half the hole's width.
    bound = 10e-6 + 0.5 * 1e-3 * max(widths, default=0.0)
    mesh = (result.vertices, result.triangles)
    assert apart(mesh, sound) <= bound, (name, result.notes)
    assert volume(*mesh) == pytest.approx(volume(*sound), rel=5e-3), (name, result.notes)
    return "repaired"


def outcomes(seeds: range) -> Counter:
    return Counter(outcome(*damaged(np.random.default_rng(seed))) for seed in seeds)


@pytest.mark.parametrize("count", [20, pytest.param(500, marks=pytest.mark.slow)])
def test_damaged_meshes_are_repaired_or_rejected(count):
    found = outcomes(range(count))
    assert min(found["repaired"], found["rejected"]) >= 0.15 * count


REPAIRED = (
    "flipped triangles",
    "flipped patch",
    "inside out",
    "needles",
    "caps",
    "t junctions",
    "idle vertices",
    "doubled triangles",
    "doubled part",
    "doubled vertices",
    "soup",
)
REJECTED = (
    "not a number",
    "moved copy",
    "inner copy",
    "spiked",
    "wrong index",
    "fin",
    "loose triangle",
    "hung on a vertex",
)


@pytest.mark.parametrize(
    ("kind", "expected"),
    [*((kind, "repaired") for kind in REPAIRED), *((kind, "rejected") for kind in REJECTED)],
)
def test_damage_is_repaired_only_if_it_leaves_the_shape_known(kind, expected):
    rng = np.random.default_rng(0)
    name, sound = body(rng)
    assert outcome(f"{name}: {kind}", sound, DAMAGES[kind](rng, *sound)) == expected, name
