"""What makes a drive perceptible, as a scene file has it."""

import pytest

import airtact as at
from faults import raises_code
from paths import EXAMPLES

SCENE = """[medium]
sound_speed = 343.1
density = 1.293
[array]
layout = "surrounding_box"
[[foci]]
point = [0.0, 0.0, 0.0]
"""


@pytest.mark.parametrize(
    ("text", "modulation"),
    [
        ("", None),
        ('[drive.modulation]\nkind = "am"', at.transducers.AmplitudeModulation(200.0, 1.0)),
        (
            '[drive.modulation]\nkind = "am"\nfrequency = 80\ndepth = 0.5',
            at.transducers.AmplitudeModulation(80.0, 0.5),
        ),
        ('[drive.modulation]\nkind = "lm"', at.drives.Motion("lm")),
        (
            '[drive.modulation]\nkind = "lm"\npath = "line"\nlength = 6e-3',
            at.drives.Motion("lm", "line", 6e-3),
        ),
        (
            '[drive.modulation]\nkind = "stm"\nradius = 0.02\nfrequency = 60.0\nframes = 40\nalong = "array"',
            at.drives.Motion("stm", None, 0.02, 60.0, 40, "array"),
        ),
    ],
)
def test_a_scene_says_how_its_drive_is_modulated(tmp_path, text: str, modulation) -> None:
    path = tmp_path / "scene.toml"
    path.write_text(SCENE + text)
    assert at.read_scene(path).modulation == modulation


@pytest.mark.parametrize("name", sorted(path.name for path in EXAMPLES.glob("*.toml")))
def test_the_examples_are_felt(name: str) -> None:
    assert at.read_scene(EXAMPLES / name).modulation == at.transducers.AmplitudeModulation(
        200.0, 1.0
    )


@pytest.mark.parametrize(
    ("text", "code", "shown"),
    [
        ("frequency = 200.0", "key_missing", "drive.modulation.kind is missing"),
        ('kind = "fm"', "unknown_name", 'drive.modulation.kind = "fm"'),
        ('kind = "am"\nradius = 3e-3', "key_misplaced", "drive.modulation.radius"),
        (
            'kind = "am"\ndepth = 1.5',
            "out_of_range",
            "drive: modulation: the depth of the modulation is 1.5",
        ),
        ('kind = "lm"\npath = "square"', "unknown_name", 'path = "square"'),
        ('kind = "lm"\nlength = 3e-3', "key_misplaced", "length goes only with"),
        ('kind = "lm"\npath = "line"\nradius = 3e-3', "key_misplaced", "radius goes only with"),
        ('kind = "stm"\npath = "points"', "too_few", "there is 1"),
        ('kind = "lm"\nspeed = 3', "unknown_key", "drive.modulation.speed"),
    ],
)
def test_a_modulation_that_cannot_be_is_rejected(
    tmp_path, text: str, code: str, shown: str
) -> None:
    path = tmp_path / "scene.toml"
    path.write_text(f"{SCENE}[drive.modulation]\n{text}\n")
    with raises_code(code, shown):
        at.read_scene(path)
