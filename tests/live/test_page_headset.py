"""A headset's hand touches a virtual ball: the page shows the contact's focus, where the ball is."""

import os
import re
import shutil
import subprocess
import sys
import tarfile

import numpy as np
import pytest

import airtact as at
from live.test_page_browser import HERE, in_the_headset, opened_page, until


@pytest.fixture
def headset(request, tmp_path) -> str:
    """Return the script of a headset: our own stand-in, or the emulator iwer (MIT) from npm."""
    if request.param == "stand_in":
        return (HERE / "headset_stand_in.js").read_text(encoding="utf-8")
    npm = shutil.which("npm")
    if npm is None:
        pytest.skip("npm is not installed, so the emulator iwer cannot be fetched")
    command = [npm, "pack", "--silent", "iwer@2.5.0"]
    packed = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=120)
    if packed.returncode:
        pytest.skip(f"npm cannot fetch the emulator iwer: {packed.stderr[-300:]}")
    with tarfile.open(tmp_path / packed.stdout.split()[-1]) as archive:
        emulator = archive.extractfile("package/build/iwer.min.js").read().decode()
    return emulator + (HERE / "headset_iwer.js").read_text(encoding="utf-8")


@pytest.mark.slow
@pytest.mark.parametrize("headset", ["stand_in", "iwer"], indirect=True)
def test_a_hand_in_a_headset_touches_a_ball_and_leaves_it(browser, tmp_path, headset) -> None:
    rest = at.read_scene("touch_button", moving=True).hands[0]
    pad, normal = rest.position("index.pad")
    ball = pad + 0.01 * normal  # the pad is 2 mm deep
    scene = tmp_path / "scene.toml"
    scene.write_text(
        "[array]\nlayout = 'flat_boards'\npose = { translation = [-0.09, -0.07, -0.2] }\n"
        f"[[obstacles]]\nhand = '{at.example('relaxed.json')}'\n"
        f"[[objects]]\nname = 'ball'\nsphere = {{ centre = {ball.tolist()}, radius = 0.012 }}\n"
        "[drive.modulation]\nkind = 'am'\n",
        encoding="utf-8",
    )
    command = ["live", str(scene), "--from", "page", "--page-port", "0", "--out", str(tmp_path)]
    loop = subprocess.Popen(
        [sys.executable, "-m", "airtact", *command],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
    )
    try:
        touch(browser, loop, headset, rest, ball, normal)
    finally:
        loop.kill()
        loop.communicate()


def touch(browser, loop, headset, rest, ball, normal) -> None:
    """Touch the ball on the page of a loop, for a second in two."""
    address = next(filter(None, (re.search(r"http://\S+", line) for line in loop.stderr)))[0]
    page = opened_page(browser, address, script=headset)
    # A second each: the pad in the ball, then 13 mm away from it.
    poses = [in_the_headset(rest.joints - away * normal) for away in (0.0, 0.015)]
    page.evaluate(
        "poses => setInterval(() => (hands.left = poses[Math.floor(performance.now() / 1000) % 2]), 10)",
        poses,
    )
    page.get_by_role("button", name="Enter AR/VR").click()
    foci = page.locator("#foci tr")
    for _ in range(2):
        until(lambda: foci.count() > 0, "a focus at the contact")
        until(lambda: foci.count() == 0, "the end of the contact")
    until(lambda: foci.count() > 0, "a focus at the contact")
    with page.expect_download() as kept:
        page.evaluate("document.querySelector('[name=csv]').click()")
    lines = kept.value.path().read_text(encoding="utf-8").splitlines()[1:]
    for line in lines:
        point = np.array(re.findall(r",(-?[\d.]+(?:e-?\d+)?)", line)[:3], dtype=float)
        assert np.linalg.norm(point - ball) < 0.014
    assert page.faults == []
    page.close()
