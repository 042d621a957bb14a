"""Meshes damaged at random: repaired and right, or rejected with number and position; never wrong, never a crash."""

import re
from collections import Counter

import numpy as np
import pytest

from airtact.checks import in_mm
from airtact.errors import InvalidInput
from geometry.mesh.repaired_meshes import accepted, apart, volume
from references.damaged_meshes import DAMAGES, Mesh, body, damaged

HAIR = 10e-6
"""Twice what a sliver or a crack may move the surface [m]."""
SHARE_OF_HOLE = 0.5
"""A sharp edge through the middle of a hole, cut off, would lie off by half the hole's width."""


def check_fault(fault: InvalidInput) -> None:
    """An error has a code and a number, and the position in its sentence is the one that is drawn."""
    said = str(fault)
    assert fault.code != "invalid_input", said
    assert re.search(r"\d", said), said
    assert " mm" in said or re.search(r"triangle \d+ names|0 triangles", said), said
    if shown := re.search(r"\([-\d., ]+\) mm", said):
        assert fault.position is not None, said
        assert shown.group() == in_mm(fault.position)


def outcome(name: str, whole: Mesh, torn: Mesh) -> str:
    """Repair a mesh and hold it against the undamaged one: "repairs" or "rejected"."""
    try:
        result = accepted(*torn)
    except InvalidInput as fault:
        check_fault(fault)
        return "rejected"
    filled = [
        float(found) for note in result.notes for found in re.findall(r"up to ([\d.]+) mm", note)
    ]
    bound = HAIR + SHARE_OF_HOLE * 1e-3 * max(filled, default=0.0)
    assert apart((result.vertices, result.triangles), whole) <= bound, (name, result.notes)
    assert volume(result.vertices, result.triangles) == pytest.approx(volume(*whole), rel=5e-3), (
        name,
        result.notes,
    )
    return "repairs"


def outcomes(seeds: range) -> Counter:
    return Counter(outcome(*damaged(np.random.default_rng(seed))) for seed in seeds)


@pytest.mark.parametrize("first", range(0, 80, 20))
def test_80_damaged_meshes_are_repaired_or_rejected(first):
    found = outcomes(range(first, first + 20))
    assert min(found["repairs"], found["rejected"]) >= 3


@pytest.mark.slow
def test_500_damaged_meshes_are_repaired_or_rejected():
    found = outcomes(range(1000, 1500))
    assert found["repairs"] >= 150
    assert found["rejected"] >= 150


ALWAYS = [
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
]


@pytest.mark.parametrize("kind", ALWAYS)
def test_what_leaves_the_shape_known_is_always_repaired(kind):
    for seed in range(5):
        rng = np.random.default_rng(seed)
        name, whole = body(rng)
        assert outcome(f"{name}: {kind}", whole, DAMAGES[kind](rng, *whole)) == "repairs", name


NEVER = [
    "not a number",
    "moved copy",
    "inner copy",
    "spiked",
    "wrong index",
    "fin",
    "loose triangle",
    "hung on a vertex",
]


@pytest.mark.parametrize("kind", NEVER)
def test_what_has_no_known_shape_is_always_rejected(kind):
    for seed in range(5):
        rng = np.random.default_rng(seed)
        name, whole = body(rng)
        assert outcome(f"{name}: {kind}", whole, DAMAGES[kind](rng, *whole)) == "rejected", name
