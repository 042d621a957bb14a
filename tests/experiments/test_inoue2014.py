"""The paper's experiment from end to end: small, and as ``--quick`` does it."""

import dataclasses
import re

import pytest

from airtact.experiments.inoue2014 import reproduce
from airtact.experiments.settings import QUICK

TINY = dataclasses.replace(
    QUICK,
    name="tiny",
    order=2,
    elements_per_wavelength=1.2,
    judging=0.1,
    truth=0.1,
    sweep_drive=0.1,
    sweep_judge=0.1,
    plane_step=4e-3,
    gaps=(6e-3, 12e-3),
    radii=(8e-3, 10e-3),
    tilts=(20.0,),
    ways=("from below",),
    tilt_gaps=(12e-3,),
    scan_step=2e-3,
    study_orders=(1, 2),
    study_sizes=(1.0, 10.0),
    study_seconds=0.5,
    study_budget=1.0,
    poses=2,
    node_spacings=(2.0,),
    water_order=2,
)


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    told = []
    folder = tmp_path_factory.mktemp("inoue2014")
    return folder, reproduce(folder, tell=told.append, settings=TINY), told


def test_page_is_self_contained_and_says_what_was_left_out(small) -> None:
    folder, done, _ = small
    page = done.page.read_text(encoding="utf-8")
    assert page.count("data:image/png;base64,") >= 9
    assert re.findall(r'(?:src|href)="(?!data:)', page) == []
    assert "This is the tiny run" in page
