"""Where the files that tests read stand."""

from pathlib import Path

ROOT = Path(__file__).parents[1]
EXAMPLES = ROOT / "src/airtact/setup/examples"
HANDS = EXAMPLES / "hands"
GENERIC_HAND = HANDS / "generic-hand-right.glb"
SCENES = ROOT / "tests/scenes"
