"""Laws of acoustics for finite elements, on a capsule and fingers of a hand; boundary elements are the other solver."""

import numpy as np
import pytest

import airtact as at
from airtact.acoustics.target_points import outward
from airtact.hands.body import Hulls, hand_hulls, part_name
from airtact.hands.shape import HandShape
from airtact.hands.skin_mesh import even_skin, midpoints
from references import relative_columns as relative
from references.hand_poses import example
from worlds import AIR as PAPER_AIR
from worlds import directions, far_points, hard, one_each, sphere_rule

WATER = at.Medium(1481.0, 999.7)

pytestmark = pytest.mark.slow


def finger(*names: str) -> at.Surface:
    """Skin of some phalanges of the pinching hand, with their middle at the origin."""
    whole = hand_hulls(*example("pinch"))[0]
    chosen = [part for part in range(14) if part_name(part) in names]
    assert len(chosen) == len(names)
    both = np.ix_(chosen, chosen)
    used, parts = np.unique(whole.parts[chosen][:, :2], return_inverse=True)
    balls = whole.balls[used] - np.append(whole.balls[used, :3].mean(axis=0), 0.0)
    parts = np.column_stack([parts.reshape(-1, 2), np.full(len(chosen), -1)])
    body = Hulls(balls, parts, whole.blend[both], whole.apart[both])
    skin = even_skin(body, 3e-3)
    return at.Surface(
        skin.vertices, skin.triangles, midpoints(body, skin), HandShape(body, at.Pose.identity())
    )


def capsule() -> at.Surface:
    return at.capsule((0.0, 0.001, -0.006), (0.002, -0.001, 0.006), 0.004, 0.002)


def fingertip() -> at.Surface:
    return finger("last phalanx of the pinky finger")


def index_finger() -> at.Surface:
    return finger(*(f"{bone} phalanx of the index finger" for bone in ("first", "middle", "last")))


class Case:
    """A hard body, meshed and factorised, with sources beside it and away from it."""

    def __init__(self, surface: at.Surface) -> None:
        self.scene = at.Scene(PAPER_AIR, [at.sound_hard(surface)])
        self.ready = at.FiniteElement().factorised(self.scene)
        nodes, chance = surface.vertices, np.random.default_rng(5)
        self.reach = float(np.linalg.norm(nodes, axis=1).max())
        chosen = nodes[chance.choice(len(nodes), 3, replace=False)]
        self.beside = chosen + 5e-4 * outward(self.scene.depth, chosen)
        self.sources = np.concatenate([self.beside, directions(3, 1) * (self.reach + 0.012)])


@pytest.fixture(
    scope="module",
    params=[fingertip, capsule, index_finger],
    ids=["fingertip", "capsule", "index finger"],
)
def case(request) -> Case:
    return Case(request.param())


def test_far_away_boundary_elements_find_the_same(case):
    """Sources half a millimetre off the surface and 12 mm off; boundary elements are asked for 0.3 %."""
    sources, points = one_each(case.sources), far_points(30)
    found = case.ready.radiate(case.scene, sources).at(points)
    other = at.BoundaryElement(accuracy=0.003).radiate(case.scene, sources).at(points)
    assert relative(found, other).max() < 0.01


def test_contact_where_panels_stand_off_each_other_agrees_with_finite_elements():
    """Two vertices beside panels that lie 1 and 11 micrometres off the one that is touched."""
    tip = fingertip()
    scene, points = hard(at.Surface(tip.vertices, tip.triangles)), far_points(30)
    ready = at.FiniteElement().factorised(scene)
    for vertex in tip.vertices[[70, 110]]:
        sources = one_each(vertex[None])
        found = at.BoundaryElement().radiate(scene, sources).at(points)
        assert relative(found, ready.radiate(scene, sources).at(points)).max() < 0.03


def power_through(field: at.acoustics.RadiatedField, radius: float) -> tuple[float, float]:
    """Power that leaves a sphere, and the power that crosses it either way."""
    step = 1e-5
    way, area = sphere_rule(32)
    low, high = (field.at(way * (radius + side * step))[:, 0] for side in (-1, 1))
    crossing = np.imag(np.conj(0.5 * (low + high)) * (high - low) / (2 * step))
    return float(area @ crossing), float(area @ np.abs(crossing))


@pytest.mark.parametrize("kind", ["water", "impedance"])
def test_water_keeps_power_and_an_impedance_absorbs_it(kind):
    obstacle = (
        at.filled(capsule(), WATER) if kind == "water" else at.impedance(capsule(), 1.5 + 0.5j)
    )
    scene = at.Scene(PAPER_AIR, [obstacle])
    ready = at.FiniteElement(order=4).factorised(scene)
    source = np.array([[0.0, 0.004, 0.03]])
    left, crossed = power_through(ready.radiate(scene, one_each(source)), 0.016)
    assert abs(left) < 5e-3 * crossed if kind == "water" else left < -0.1 * crossed
    here, there = directions(2, 4) * 0.02, directions(3, 2) * 0.06
    forth = ready.radiate(scene, one_each(here)).at(there)
    back = ready.radiate(scene, one_each(there)).at(here).T
    assert np.abs(forth - back).max() < 3e-3 * np.abs(forth).mean()
