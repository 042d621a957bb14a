"""Fields computed elsewhere: what interpolation keeps of them, and what is rejected."""

from pathlib import Path

import numpy as np
import pytest

import airtact as at
from faults import raises_code
from references import relative_columns as relative
from worlds import AIR as PAPER_AIR
from worlds import one_each

SCENE = at.Scene(PAPER_AIR, [at.sound_hard(at.sphere(0.004, 0.002))])
SOURCES = one_each(np.array([[0.0, 0.0, 0.006], [0.0, 0.007, 0.0]]))
EXACT = at.SphereSeries().radiate(SCENE, SOURCES)


def nodes_about(edge: float, reach: float = 0.012, away: float = 0.03) -> np.ndarray:
    """Nodes on a jittered grid round a position away from the sphere."""
    axis = np.arange(-reach, reach + 0.1 * edge, edge)
    grid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3) + [
        0.0,
        0.0,
        away,
    ]
    return grid + np.random.default_rng(1).uniform(-0.2, 0.2, size=grid.shape) * edge


NODES = nodes_about(PAPER_AIR.wavelength(40e3) / 6)
INNER = np.random.default_rng(2).uniform(-0.008, 0.008, size=(60, 3)) + [0.0, 0.0, 0.03]


def as_csv(path: Path, nodes: np.ndarray, pressures: np.ndarray) -> Path:
    """Write as COMSOL does, in millimetres."""
    lines = ["% Model: ball.mph", "% X, Y, Z, p1 (Pa), p2 (Pa)"]
    for node, row in zip(nodes * 1e3, pressures, strict=True):
        numbers = [f"{value.real:.12g}{value.imag:+.12g}i" for value in row]
        lines.append(",".join([*(f"{x:.12g}" for x in node), *numbers]))
    path.write_text("\n".join(lines))
    return path


def test_interpolation_without_the_carrier_keeps_the_field():
    """Plain linear interpolation at λ/6 is 9 % off; without the carrier only the slow part is."""
    sampled = at.SampledField(SCENE, SOURCES, NODES, EXACT.at(NODES))
    true = EXACT.at(INNER)
    assert sampled.valid(INNER).all()
    assert relative(sampled.at(INNER), true).max() < 0.01
    plain = at.SampledField(
        SCENE, at.Monopoles(SOURCES.positions, np.zeros((2, 2))), NODES, EXACT.at(NODES)
    )
    assert relative(plain.at(INNER), true).min() > 0.04


def test_nothing_is_known_beyond_the_samples():
    sampled = at.SampledField(SCENE, SOURCES, NODES, EXACT.at(NODES))
    positions = np.array([INNER[0], [0.0, 0.0, 0.05], [0.02, 0.0, 0.03]])
    assert sampled.valid(positions).tolist() == [True, False, False]
    assert np.isnan(sampled.at(positions[1:])).all()
    assert len(sampled.on_surface.points) == 0
    array = at.PhasedArray(positions)
    with raises_code("data_missing"):
        at.transfer_matrix(sampled, array)


def test_a_whole_way_through_with_a_field_from_a_file(tmp_path):
    path = as_csv(tmp_path / "ball.csv", NODES, EXACT.at(NODES).conj())
    sampled = at.acoustics.load_samples(path, SCENE, SOURCES, "e^{+jωt}", scale=1e-3)
    array = at.PhasedArray(INNER[:12])
    found = at.transfer_matrix(sampled, array).matrix
    assert relative(found.T, at.transfer_matrix(EXACT, array).matrix.T).max() < 0.01
    assert sampled.report.warnings == ()


def test_the_other_sign_of_time_is_rejected(tmp_path):
    near = nodes_about(0.003, reach=0.006, away=0.016)
    path = as_csv(tmp_path / "ball.csv", near, EXACT.at(near).conj())
    with raises_code("does_not_match"):
        at.acoustics.load_samples(path, SCENE, SOURCES, "e^{-iωt}", scale=1e-3)


@pytest.mark.parametrize("scale", [1.0, 0.0254])
def test_a_unit_of_length_that_does_not_fit_is_warned_of(tmp_path, scale):
    """The file is in millimetres."""
    nodes = nodes_about(0.003, away=0.016)
    nodes = nodes[SCENE.depth(nodes) < 0]
    path = as_csv(tmp_path / "ball.csv", nodes, EXACT.at(nodes))
    for stated, warnings in ((scale, 1), (1e-3, 0)):
        sampled = at.acoustics.load_samples(path, SCENE, SOURCES, "e^{-iωt}", scale=stated)
        assert len(sampled.report.warnings) == warnings


TWICE = np.array(NODES)
TWICE[7] = TWICE[3]


@pytest.mark.parametrize(
    ("nodes", "pressures", "code"),
    [
        (NODES, np.ones(len(NODES), complex), "wrong_shape"),
        (
            NODES,
            np.where(np.arange(len(NODES))[:, None] == 3, np.nan, np.ones(2) + 0j),
            "not_finite",
        ),
        (TWICE, np.ones((len(NODES), 2), complex), "given_twice"),
        (NODES[:3], np.ones((3, 2), complex), "too_few"),
    ],
)
def test_samples_that_do_not_fit_are_rejected(nodes, pressures, code):
    with raises_code(code):
        at.SampledField(SCENE, SOURCES, nodes, pressures)


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("x,y,p\n0,0,1", "data_missing"),
        ("x,y,z\n0,0,1", "data_missing"),
        ("x,y,z,p_real\n0,0,1,2", "data_missing"),
        ("x,y,z,p_imag\n0,0,1,2", "data_missing"),
        ("x,y,z,p\n0,0,1", "wrong_shape"),
        ("x,y,z,p\n0,0,1,loud", "file_unreadable"),
        ("% x,y,z,p\n0,0,1,NaN", "all_zero"),
        ("% x,y,z,acpr.Lp_t (dB)\n0,0,1,120", "does_not_match"),
        ("% x,y,z,p (Pa) @ freq=25000,q (Pa) @ freq=30000\n0,0,1,1,2", "does_not_match"),
        ("x,y,z,p\n0,0,1+2i,3", "file_unreadable"),
        ("x,y,z,p\n0,0,1,0\n0,1,1,0i\n1,0,1,0\n0,0,2,0", "all_zero"),
        ("x,y,z,p,q\n0,0,1,1,1\n0,1,1,1,1\n1,0,1,1,1\n1,1,1,1,1", "misplaced"),
        ("1,2,3,4", "file_unreadable"),
    ],
)
def test_files_that_cannot_be_read_are_rejected(tmp_path, text, code):
    (tmp_path / "field.csv").write_text(text)
    with raises_code(code):
        at.acoustics.load_samples(tmp_path / "field.csv", SCENE, SOURCES, "e^{-iωt}")


@pytest.mark.parametrize("spaced", [False, True])
def test_exports_of_comsol_are_read_as_they_come(tmp_path, spaced):
    """The unit of length in the comments, NaN in solids, other frequencies, commas in names."""
    names = [f"p_t (Pa) @ freq={f}, gap={gap}" for f in (40000, 40400) for gap in (1, 2)]
    lines = ["% Model,ball.mph", "% Length unit,mm"]
    lines.append("% " + ("   " if spaced else ",").join(["X", "Y", "Z", *names]))
    pressures = EXACT.at(NODES).conj()
    for node, row in zip(NODES * 1e3, pressures, strict=True):
        numbers = [
            f"{value.real:.12g}{value.imag:+.12g}i" for value in (*row, 2 * row[0], 9.0 + 0j)
        ]
        lines.append(("  " if spaced else ",").join([*(f"{x:.12g}" for x in node), *numbers]))
    lines.append(("  " if spaced else ",").join(["0", "0", "0", *["NaN"] * 4]))
    path = tmp_path / "export.txt"
    path.write_text("\n".join(lines))
    sampled = at.acoustics.load_samples(path, SCENE, SOURCES, "e^{+jωt}")
    np.testing.assert_allclose(sampled.at(INNER), EXACT.at(INNER), rtol=0.05)
    assert f"1 of {len(NODES) + 1} rows" in sampled.report.warnings[-1]
    with raises_code("does_not_match"):
        at.acoustics.load_samples(path, SCENE, SOURCES, "e^{+jωt}", scale=1.0)
    with raises_code("sizes_differ"):
        single = at.Monopoles(SOURCES.positions[:1], np.ones((1, 1)))
        at.acoustics.load_samples(path, SCENE, single, "e^{+jωt}")
