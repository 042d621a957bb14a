"""Scenes of the live loop and solutions of their hands, solved once per session."""

import pytest

import airtact as at
from airtact.live.drives.factors import PartSolver
from airtact.live.scene import pose_hand
from live.live_scenes import VirtualClock, one_board, open_pinch


@pytest.fixture
def clock(monkeypatch):
    """A virtual clock for the loop: it measures and waits without taking time."""
    clock = VirtualClock()
    monkeypatch.setattr("airtact.live.loop.time", clock)
    return clock


@pytest.fixture(scope="session")
def example_setup():
    return at.read_scene(at.example("live_pinch"))


@pytest.fixture(scope="session")
def example_scene(example_setup):
    return at.live.live_scene(example_setup)


@pytest.fixture(scope="session")
def board():
    return one_board()


@pytest.fixture(scope="session")
def joints():
    return open_pinch(0.02)


@pytest.fixture(scope="session")
def phalanges(board, joints):
    return PartSolver(board).meshed(joints, "phalanges", 0.0)


@pytest.fixture(scope="session")
def exact(board, joints):
    """The transfer matrix of the whole hand before the board."""
    posed = pose_hand(board, joints)
    air = at.Scene(board.medium, [at.sound_hard(posed.hand.surface)], frequency=board.frequency)
    solver = at.BoundaryElement(accuracy=0.03, estimate=False)
    return at.transfer_matrix(solver.radiate(air, at.Target(posed.foci).beacons()), board.array)
