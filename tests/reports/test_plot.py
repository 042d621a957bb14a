"""Plots: they return the axes, with units on every axis and bar, and what is drawn has the numbers of the result."""

from collections.abc import Iterator
from dataclasses import replace

import matplotlib
import numpy as np
import pytest
from matplotlib import pyplot

import airtact as at
from airtact.evaluation.windows import plane_across
from faults import raises_code

PINCH = at.pinch(gap=0.012)
SCENE = at.Scene(at.Medium(343.1, 1.293), [at.sound_hard(surface) for surface in PINCH.surfaces])
TARGET = at.Target(PINCH.foci(offset=0.5e-3), pressures=1500.0)
ARRAY = at.surrounding_box()
SOLVER = at.BoundaryElement(accuracy=0.1)


@pytest.fixture(autouse=True)
def _no_window() -> Iterator[None]:
    yield
    pyplot.close("all")


@pytest.fixture(scope="module")
def beacons() -> at.acoustics.RadiatedField:
    return SOLVER.radiate(SCENE, TARGET.beacons())


@pytest.fixture(scope="module")
def drive(beacons) -> at.Drive:
    return at.time_reversal(at.transfer_matrix(beacons, ARRAY), TARGET)


@pytest.fixture(scope="module")
def evaluation(drive) -> at.evaluation.Evaluation:
    return at.evaluate(SCENE, ARRAY, drive, TARGET, solver=SOLVER)


@pytest.fixture(scope="module")
def comparison(drive) -> at.evaluation.Comparison:
    drives = {"one": drive, "two": drive.phase_only()}
    return at.compare(SCENE, ARRAY, drives, TARGET, solver=SOLVER)


def bar_of(axes: matplotlib.axes.Axes) -> matplotlib.axes.Axes:
    (bar,) = (other for other in axes.figure.axes if other is not axes)
    return bar


def test_a_field_is_that_of_the_evaluation(evaluation) -> None:
    axes = at.plot.field(evaluation, plane="xz")
    assert (axes.get_xlabel(), axes.get_ylabel(), axes.get_aspect()) == ("x [mm]", "z [mm]", 1.0)
    assert bar_of(axes).get_ylabel() == "peak pressure [Pa]"
    (image,) = axes.images
    window = plane_across(TARGET.points, "xz", SCENE.wavelength)
    shown = np.ma.filled(np.ma.asarray(image.get_array()), np.nan).ravel()
    pressure = np.abs(evaluation.field.at(window.points)[:, 0])
    outside = np.isfinite(pressure)
    np.testing.assert_allclose(shown[outside], pressure[outside], rtol=1e-12)
    assert image.norm.vmax == pytest.approx(np.nanmax(pressure))
    lowest, highest = axes.get_xlim()
    assert lowest < 1e3 * TARGET.points[:, 0].min() < 1e3 * TARGET.points[:, 0].max() < highest


def test_a_field_goes_into_given_axes_on_a_given_scale(beacons, comparison) -> None:
    figure, (left, right) = pyplot.subplots(1, 2)
    assert at.plot.field(beacons, drive=1, most=100.0, ax=left) is left
    assert left.images[0].norm.vmax == 100.0
    assert at.plot.field(comparison, drive="two", ax=right) is right
    assert right.get_title() == "two"
    assert len(pyplot.get_fignums()) == 1
    figure.canvas.draw()


def test_the_difference_of_two_drives_is_in_decibels(comparison) -> None:
    axes = at.plot.field(comparison, drive="two", over="one")
    assert bar_of(axes).get_ylabel() == "two relative to one [dB]"
    same = at.plot.field(comparison, drive="one", over="one")
    assert np.abs(np.ma.compressed(np.ma.asarray(same.images[0].get_array()))).max() == 0.0


def test_phases_of_one_board_stand_where_its_transducers_do() -> None:
    board = at.autd3_board()
    amplitudes = np.exp(1j * np.linspace(-3.0, 3.0, 249))
    axes = at.plot.phases(board, at.Drive(amplitudes))
    (discs,) = axes.collections
    np.testing.assert_allclose(
        np.ptp(discs.get_offsets(), axis=0), 1e3 * np.ptp(board.positions, axis=0)[:2]
    )
    assert bar_of(axes).get_xlabel() == "phase [rad]"
    colour = matplotlib.colormaps["twilight"]((np.angle(amplitudes) + np.pi) / (2 * np.pi))
    assert {tuple(row) for row in np.round(discs.get_facecolor(), 6)} == {
        tuple(row) for row in np.round(colour, 6)
    }


def test_a_scene_holds_bodies_transducers_and_foci(drive) -> None:
    axes = at.plot.scene(SCENE, ARRAY, drive, TARGET)
    assert axes.name == "3d"
    assert bar_of(axes).get_ylabel() == "phase of the transducers [rad]"
    assert axes.get_xlabel() == "x [mm]"
    assert len(at.plot.scene(SCENE).collections) == 1 + len(SCENE.obstacles)
    given = pyplot.figure().add_subplot(projection="3d")
    assert at.plot.scene(at.Scene(SCENE.medium, []), at.autd3_board(), ax=given) is given
    given.figure.canvas.draw()


def test_pads_stand_beside_what_was_asked(evaluation, comparison) -> None:
    axes = at.plot.pads(evaluation)
    assert [bar.get_height() for bar in axes.patches] == pytest.approx(
        evaluation.magnitudes.tolist()
    )
    asked = [segment[0, 1] for segment in axes.collections[0].get_segments()]
    assert asked == [1500.0, 1500.0]
    assert axes.get_ylabel() == "peak pressure [Pa]"
    groups = at.plot.pads(comparison, held_equal="equal energy")
    assert [bar.get_height() for bar in groups.patches] == pytest.approx(
        comparison.under("equal energy").ravel().tolist()
    )
    assert [text.get_text() for text in groups.get_legend().get_texts()] == ["one", "two"]


@pytest.mark.parametrize(
    ("draw", "code"),
    [
        (lambda given, _: at.plot.field(given, over="two"), "options_clash"),
        (lambda _, comparison: at.plot.field(comparison, drive="three"), "unknown_name"),
        (lambda given, _: at.plot.field(given, drive=5), "unknown_name"),
        (lambda given, _: at.plot.field(given, plane="zx"), "unknown_name"),
        (lambda given, _: at.plot.field(replace(given, field=None)), "empty"),
        (lambda given, _: at.plot.field(given.field), "empty"),
        (lambda *_: at.plot.phases(at.autd3_board(), at.Drive(np.ones(996))), "sizes_differ"),
        (lambda *_: at.plot.phases(ARRAY, at.Drive(np.ones(996)), show="gain"), "unknown_name"),
        (lambda *_: at.plot.scene(SCENE, ax=pyplot.subplots()[1]), "wrong_kind"),
        (lambda *_: at.plot.scene(at.Scene(SCENE.medium, [])), "empty"),
        (
            lambda _, comparison: at.plot.pads(comparison, held_equal="equal power"),
            "unknown_name",
        ),
    ],
)
@pytest.mark.usefixtures("as_outside_the_tests")
def test_plots_that_cannot_be_made_are_rejected(evaluation, comparison, draw, code) -> None:
    with raises_code(code):
        draw(evaluation, comparison)


def test_reach_colours_the_skin_by_the_bound() -> None:
    ball = at.Scene(at.air(), [at.sound_hard(at.sphere(9e-3, 2e-3))])
    board = at.autd3_board().facing((0.0, 0.0, 0.0), (0.0, 0.0, -1.0), 0.1)
    result = at.reach(at.Setup(ball, board, at.Target((0.0, 0.0, 0.012))), 20, 0.06)
    axes = at.plot.reach(result)
    assert axes.get_xlabel() == "x [mm]"
    (bar,) = [other for other in axes.figure.axes if other is not axes]
    assert "kPa" in bar.get_ylabel()
    assert bar.get_ylim()[1] == pytest.approx(1e-3 * result.bounds.max())
    # Seen from the side of the array, which is below
    assert axes.elev < 0.0
