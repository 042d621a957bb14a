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


@pytest.mark.parametrize(
    ("line", "code", "words"),
    [
        ("rotation = 0.035", "out_of_range", "uncertainty 0.035 radians"),
        ("position = -1e-3", "out_of_range", "uncertainty -0.001"),
        ("samples = 0", "out_of_range", "uncertainty 0"),
        ("position = nan", "not_finite", "uncertainty nan"),
        ("along_skin = 1e-3", "empty", "uncertainty along_skin"),
        ("positon = 1e-3", "unknown_key", "uncertainty.positon"),
    ],
)
def test_wrong_numbers_name_the_table(read, line, code, words) -> None:
    with raises_code(code, words):
        read(f"[uncertainty]\n{line}\n")


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
    assert "Effect of uncertainty" in (tmp_path / "report.html").read_text(encoding="utf-8")
    contenders = at.compare(setup).contenders
    nine_of_ten = {one.name: one.kept for one in contenders if one.kept is not None}
    assert len(nine_of_ten) == len(contenders)
    # Contenders are rounded to levels.
    assert nine_of_ten["robust"] == pytest.approx(kept.lowest_tenth[0], rel=0.02)
    assert nine_of_ten["robust phase only"] == max(nine_of_ten.values())
