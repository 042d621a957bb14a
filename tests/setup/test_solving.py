"""The solver that verifies a drive is the next more accurate one that fits."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

import airtact as at
from airtact.acoustics.solvers.bem.field import BoundaryField
from airtact.acoustics.solvers.bem.solver import OF_THE_DIRECT, BoundaryElement, SharedPanels
from airtact.drives.transfer import transfer_to
from airtact.evaluation.metrics import radiate_drives
from airtact.setup.sentences import reach_cautions, sensations
from airtact.setup.solving import (
    MOST_UNKNOWNS,
    solve_beacons,
    solve_foci,
    unknowns_of,
    verification_solver,
)
from airtact.timing import Clock
from airtact.transducers.placement import open_air_bound
from paths import EXAMPLES, SCENES

PINCH = at.read_scene(EXAMPLES / "pinch.toml")


def test_a_method_that_ignores_suppression_points_is_named() -> None:
    points = PINCH.target.points
    target = at.Target(points, suppression_points=points[:1] + [0.0, 0.0, 0.05])
    assert reach_cautions(replace(PINCH, target=target)) == ()
    (words,) = reach_cautions(replace(PINCH, target=target, method="time_reversal"))
    assert "time_reversal ignores" in words


def test_foci_that_no_method_separates_are_named() -> None:
    (point, *_) = PINCH.target.points
    near = replace(PINCH, target=at.Target(np.stack([point, point + [0.0, 0.5e-3, 0.0]])))
    (words,) = reach_cautions(near)
    assert words.startswith("thumb.pad and finger.pad are 0.5 mm apart")
    assert reach_cautions(PINCH) == ()


def test_modulations_too_fast_for_the_boards_are_named() -> None:
    board = at.transducers.board_array("sonicsurface")
    setup = at.Setup(at.Scene(at.air()), board, at.Target((0.0, 0.0, 0.15)))
    for modulation, highest in (
        (at.transducers.AmplitudeModulation(200.0), "44 Hz or less"),
        (at.drives.Motion("stm", frequency=44.0), "at most 5.5 times"),
        (at.drives.Motion("lm", frequency=44.0, frames=4), "at most 22 times"),
    ):
        (words,) = reach_cautions(replace(setup, modulation=modulation))
        assert highest in words
    assert not reach_cautions(replace(setup, modulation=at.drives.Motion("stm", frequency=5.5)))


def test_foci_close_to_a_transducer_are_named() -> None:
    board = at.flat_boards(1, 1)
    close = at.Target(board.positions[:1] + [[0.0, 0.0, 1e-3]])
    setup = at.Setup(at.Scene(at.air(celsius=20.0)), board, close)
    assert "1 mm from a transducer" in reach_cautions(setup)[0]


def test_requests_above_what_absorbing_air_lets_through_are_named() -> None:
    absorbing = at.Scene(at.Medium(sound_speed=343.0, density=1.2, absorption=10.0))
    board = at.flat_boards(1, 1)
    target = at.Target(np.array([[0.0, 0.0, 0.2]]), pressures=np.array([1e5]))
    words = " ".join(reach_cautions(at.Setup(absorbing, board, target)))
    most = open_air_bound(board, target.points, absorbing.wavenumber)[0]
    focused = at.focus(board, target.points[0], medium=absorbing.medium)
    assert most == pytest.approx(focused.pressures[0], rel=1e-3)
    assert f"{most:,.0f} Pa" in words


def test_foci_away_from_skin_are_named() -> None:
    points = PINCH.target.points + np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.043]])
    away = -PINCH.scene.depth(points)[1]
    assert away > 0.02
    (words,) = reach_cautions(replace(PINCH, target=at.Target(points)))
    assert words.startswith(f"finger.pad is {1e3 * away:.2g} mm")
    far = replace(PINCH, target=at.Target(PINCH.target.points + [0.0, 0.0, 0.043]))
    assert "1 other focus" in reach_cautions(far)[0]
    open_air = replace(
        PINCH, target=at.Target(points), scene=replace(PINCH.scene, obstacles=()), bodies=()
    )
    assert reach_cautions(open_air) == ()
    felt = replace(PINCH, modulation=at.transducers.AmplitudeModulation())
    pressures = np.array([5570.0, 557.0])
    assert "20 dB above" in sensations(replace(felt, target=at.Target(points)), pressures)[0]
    (words,) = sensations(replace(felt, target=far.target), pressures)
    assert "10 mm" in words
    assert "0 dB above" in sensations(felt, pressures)[0]


@dataclass(frozen=True)
class Warned(at.acoustics.Solver):
    """A closed form that warns as boundary elements do where their direct solution is 5 % off."""

    def radiate(self, scene, sources):
        field = at.SphereSeries().radiate(scene, sources)
        return replace(
            field,
            report=replace(
                field.report, warnings=(f"{OF_THE_DIRECT} is 5 % off", "coarse triangles")
            ),
        )


def test_what_a_matrix_is_made_from_carries_no_warning_of_the_direct_solution() -> None:
    setup = replace(at.read_scene(SCENES / "ball.toml"), solver=Warned())
    assert len(setup.solver.radiate(setup.scene, setup.target.beacons()).report.warnings) == 2
    assert solve_foci(setup, Clock())[1].warnings == ("coarse triangles",)


@pytest.mark.parametrize(
    "setup", [PINCH, replace(PINCH, accuracy=0.2), at.read_scene(SCENES / "ball.toml")]
)
def test_verification_has_nearly_twice_the_unknowns_or_more(setup) -> None:
    emitting = at.Monopoles(setup.array.positions, np.ones(len(setup.array)))
    solver = verification_solver(setup)
    assert isinstance(solver, BoundaryElement)
    assert solver.enough == setup.accuracy
    unknowns, refined = (
        BoundaryElement(accuracy=accuracy).unknowns(setup.scene, emitting)
        for accuracy in (setup.accuracy, solver.accuracy)
    )
    assert 1.8 * unknowns <= refined <= MOST_UNKNOWNS


def test_verification_of_the_best_accuracy_stays_there() -> None:
    ball = replace(at.read_scene(SCENES / "ball.toml"), accuracy=1e-4)
    assert verification_solver(ball) == BoundaryElement(accuracy=1e-4, enough=1e-4)


def test_bodies_too_large_for_a_finer_mesh_are_verified_on_the_panels_of_the_drive(
    monkeypatch,
) -> None:
    monkeypatch.setattr("airtact.setup.solving.MOST_UNKNOWNS", 3000)
    verifier = verification_solver(PINCH)
    assert isinstance(verifier, SharedPanels)
    clock = Clock()
    beacons = solve_beacons(PINCH, clock, estimate=False, verifier=verifier)
    drive = at.Drive(np.ones(len(PINCH.array), dtype=complex))
    field = radiate_drives(PINCH.scene, PINCH.array, [drive], verifier)
    assert isinstance(field, BoundaryField)
    assert isinstance(beacons, BoundaryField)
    assert field.surface is beacons.surface
    assert "panels" not in field.report.seconds
    # Its pressures are those of the direct equation, and agree with the transfer matrix.
    expected = transfer_to(beacons, PINCH.array).matrix @ drive.amplitudes
    assert field.at(PINCH.target.points)[:, 0] == pytest.approx(expected, rel=0.02)
    assert 1e-4 < field.report.estimated_error < 1.5 * PINCH.accuracy
    # Another scene gets panels of its own.
    moved = replace(PINCH.scene, obstacles=PINCH.scene.obstacles[:1])
    alone = verifier.radiate(moved, PINCH.target.beacons())
    assert len(alone.surface.nodes.points) < len(field.surface.nodes.points)


def test_open_air_and_filled_bodies_have_solvers_of_their_own() -> None:
    scene = replace(PINCH.scene, obstacles=())
    assert verification_solver(replace(PINCH, scene=scene, bodies=())) == at.FreeField()
    filled = replace(
        PINCH.scene,
        obstacles=tuple(
            replace(one, boundary="filled", medium=at.Medium(1481.0, 998.0))
            for one in PINCH.scene.obstacles
        ),
    )
    setup = replace(PINCH, scene=filled, solver=at.FiniteElement(order=4))
    assert verification_solver(setup) == at.FiniteElement(order=5)
    lined = replace(
        PINCH.scene,
        obstacles=tuple(at.impedance(one.surface, 2.0) for one in PINCH.scene.obstacles),
    )
    assert isinstance(verification_solver(replace(setup, scene=lined)), BoundaryElement)


def test_the_verification_warns_against_what_the_scene_asks() -> None:
    setup = at.read_scene(SCENES / "ball.toml")
    solver = verification_solver(setup)
    assert isinstance(solver, BoundaryElement)
    assert solver.accuracy < setup.accuracy == solver.max_error
    field = solver.radiate(setup.scene, setup.target.beacons())
    assert field.max_error == setup.accuracy
    point = setup.target.points[0] + [0.0, 0.0, -1e-3]
    assert field.report_at(point[None]).warnings == field.report.warnings
    assert "3.3e-10" in replace(field, max_error=1e-9).report_at(point[None]).warnings[-1]


@pytest.mark.parametrize("radius", [0.01, 0.5])
def test_unknowns_of_small_bodies_are_counted_and_of_large_ones_estimated(radius) -> None:
    solver = BoundaryElement(accuracy=0.1)
    away = np.array([[0.0, 0.0, 1.5]])
    scene = at.Scene(at.air(celsius=20.0), [at.sound_hard(at.sphere(radius, radius / 8))])
    unknowns = unknowns_of(solver, scene, away)
    if radius < 0.1:
        assert unknowns == solver.unknowns(scene, at.Monopoles(away, np.ones(1)))
    else:
        area = 4 * np.pi * radius**2
        estimate = solver.nodes_per_square_wavelength * area / scene.wavelength**2
        assert estimate > 50_000
        assert unknowns == pytest.approx(estimate, rel=1e-3)


def test_a_filled_sphere_solved_by_the_series_is_verified_by_it() -> None:
    ball = at.filled(at.sphere(radius=3e-3, edge=1.5e-3), at.Medium(1500.0, 1000.0))
    setup = at.Setup(
        at.Scene(at.air(), [ball]),
        at.autd3_board(at.Pose.shift((0.0, 0.0, -0.15))),
        at.Target(np.array([[0.0, 0.0, -4e-3]])),
        solver=at.SphereSeries(),
    )
    rendering = at.render(setup)
    computed = rendering.transfer.matrix @ rendering.drive.amplitudes
    assert rendering.pressures == pytest.approx(np.abs(computed), rel=1e-6)
