"""What a scene file holds in doubt."""

import numpy as np
import pytest

import airtact as at
from faults import raises_code

OPEN_AIR = """
medium = { celsius = 20.0 }
array = { layout = "flat_boards", rows = 1, columns = 1, pose = { translation = [-0.08, -0.07, -0.15] } }
foci = [{ point = [0.0, 0.0, 0.0] }, { point = [0.02, 0.0, 0.0] }]
"""


@pytest.fixture
def read(read):
    return lambda text: read(OPEN_AIR, text)


def test_the_table_is_an_uncertainty_with_its_samples(read) -> None:
    setup = read(
        '[drive]\nmethod = "robust"\n[uncertainty]\nposition = 1e-3\nrotation = 2.0\nsamples = 16\nseed = 3\n'
    )
    assert setup.uncertainty == at.Uncertainty(position=1e-3, rotation=2.0)
    assert (setup.samples, setup.seed, setup.method) == (16, 3, "robust")
    assert read("").uncertainty is None


def test_wrong_numbers_name_the_table(read) -> None:
    with raises_code("out_of_range", "uncertainty", "0.035", "radians"):
        read("[uncertainty]\nrotation = 0.035\n")
    with raises_code("out_of_range", "uncertainty", "-0.001"):
        read("[uncertainty]\nposition = -1e-3\n")
    with raises_code("out_of_range", "uncertainty", "0"):
        read("[uncertainty]\nsamples = 0\n")
    with raises_code("not_finite", "uncertainty", "nan"):
        read("[uncertainty]\nposition = nan\n")
    with raises_code("empty", "uncertainty", "along_skin"):
        read("[uncertainty]\nalong_skin = 1e-3\n")
    with raises_code("unknown_key", "uncertainty.positon"):
        read("[uncertainty]\npositon = 1e-3\n")


@pytest.mark.slow
def test_a_rendering_reports_what_is_kept_nine_of_ten_times(read, tmp_path) -> None:
    setup = read('[drive]\nmethod = "robust"\n[uncertainty]\nposition = 2e-3\nrotation = 3.0\n')
    result = at.render(setup)
    kept = result.robustness
    assert kept is not None
    assert kept.names == ("robust", "time reversal")
    assert kept.pressures.shape == (2, 256)
    assert kept.lowest_tenth[0] > kept.lowest_tenth[1]
    assert np.quantile(kept.pressures[0], 0.1) == pytest.approx(kept.lowest_tenth[0])
    assert kept.sentence() in result.remarks
    at.write_report(result, tmp_path)
    assert "not as expected" in (tmp_path / "report.html").read_text(encoding="utf-8")
    contenders = at.compare(setup).contenders
    nine_of_ten = {one.name: one.kept for one in contenders if one.kept is not None}
    assert len(nine_of_ten) == len(contenders)
    # Contenders are rounded to levels.
    assert nine_of_ten["robust"] == pytest.approx(kept.lowest_tenth[0], rel=0.02)
    assert nine_of_ten["robust phase only"] == max(nine_of_ten.values())
