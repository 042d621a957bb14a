"""The page in a real browser: what is set there reaches the loop, and what the loop does is to be seen."""

import io
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import airtact
from airtact.live.page.touches import TouchPage
from airtact.live.world import World
from live.live_scenes import Loop
from references.motions import pinch_pose

HERE = Path(__file__).parent
PATIENCE = 120.0
"""The pictures are drawn by the processor, which others may be using [s]."""


def opened_page(browser, address, file=None, script=None, wait="#numbers tr"):
    page = browser.new_page(viewport={"width": 1280, "height": 800})
    page.set_default_timeout(1e3 * PATIENCE)
    page.asked, page.faults = [], []
    page.on("request", lambda request: page.asked.append(request.url))
    page.on(
        "console",
        lambda message: page.faults.append(message.text) if message.type == "error" else None,
    )
    page.on("pageerror", lambda fault: page.faults.append(str(fault)))
    if file is not None:
        page.add_init_script(path=file)
    if script is not None:
        page.add_init_script(script)
    page.goto(address)
    page.locator(wait).first.wait_for()
    page.locator("canvas[data-frames]").wait_for()
    return page


def until(true, what: str) -> None:
    end = time.monotonic() + PATIENCE
    while not true():
        assert time.monotonic() < end, f"{what} did not happen."
        time.sleep(0.05)


def colours(page) -> int:
    picture = Image.open(io.BytesIO(page.screenshot())).convert("RGB")
    return len(np.unique(np.asarray(picture)[:, 330:950].reshape(-1, 3), axis=0))


def pixel(page, wanted) -> tuple[float, float]:
    """Return a pixel of the uppermost thing of some colours in the picture, apart from the axes."""
    box = page.locator(".stage").bounding_box()
    picture = Image.open(io.BytesIO(page.screenshot(clip=box))).convert("RGB")
    rows, columns = np.nonzero(wanted(np.asarray(picture).astype(int)[90:, 20:-90]))
    upper = rows < rows.min() + 60
    x = box["x"] + 20 + float(np.median(columns[upper]))
    return x, box["y"] + 90 + float(np.median(rows[upper]))


def drag(page, x: float, y: float) -> None:
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 30, y - 20, steps=3)
    page.mouse.up()


def test_what_is_set_on_the_page_reaches_the_loop(browser) -> None:
    box = airtact.VirtualObject(
        airtact.touch.Box((0.03, 0.03, 0.03)), airtact.Pose.shift((0.0, 0.0, -0.05)), "box"
    )
    world = World([box])
    with Loop(world=world) as loop:
        page, at = opened_page(browser, loop.page.address), loop.page
        page.get_by_text("playing", exact=True).wait_for()
        until(lambda: colours(page) > 200, "a picture of the hand")
        page.locator("[name=slice]").uncheck()
        page.locator("[name=surfaces]").uncheck()
        blue = pixel(page, lambda colours: colours[..., 2] - colours[..., 0] > 25)
        drag(page, *blue)
        until(lambda: world.objects[0].pose.translation[2] != -0.05, "a box elsewhere")
        page.get_by_label("offset from the skin").press("ArrowRight")
        until(lambda: at.controls.offset == pytest.approx(1.1e-3), "a larger offset")
        page.get_by_label("level cap").press("Home")
        until(lambda: at.controls.cap == 0.0, "a lower cap")
        page.get_by_label("ignore the hand").click()
        until(lambda: at.controls.ignore_hand, "to ignore the hand")
        page.get_by_label("modulated").click()
        until(lambda: not at.controls.modulated, "a constant amplitude")
        page.get_by_label("index.pad on").click()
        until(lambda: at.controls.levels == {"index.pad": 0.0}, "a focus that is off")
        page.get_by_label("strength of thumb.pad").press("Home")
        levels = {"index.pad": 0.0, "thumb.pad": 0.01}
        until(lambda: at.controls.levels == levels, "a weak focus")
        with page.expect_download() as kept:
            page.get_by_role("button", name="save as CSV").click()
        head, thumb, index = kept.value.path().read_text(encoding="utf-8").splitlines()
        assert head.startswith("focus,x [m]")
        assert thumb.startswith('"thumb.pad",')
        assert index.endswith(",0")
        page.get_by_role("button", name="Stop", exact=True).click()
        until(lambda: not at.controls.playing, "the stop")
        page.get_by_text("waiting for a hand", exact=True).wait_for()
        page.get_by_role("button", name="Start", exact=True).click()
        until(lambda: at.controls.playing, "the start")
        assert not loop.pressed.is_set()
        page.get_by_role("button", name="EMERGENCY STOP").click()
        until(loop.pressed.is_set, "the emergency stop")
        page.get_by_role("button", name="STOPPED FOR GOOD").wait_for()
        assert page.faults == []
        assert [
            url for url in page.asked if not url.startswith((at.address, "data:", "blob:"))
        ] == []
        page.close()


@pytest.mark.slow
def test_the_page_shows_the_sound_with_the_hand_in_its_place(browser) -> None:
    with Loop() as loop:
        page = opened_page(browser, loop.page.address)
        page.get_by_text("peak pressure [Pa]").wait_for()
        page.close()


@pytest.mark.slow
def test_a_hand_is_dragged_only_while_the_page_is_open(browser) -> None:
    with Loop(dragged=True) as loop:
        time.sleep(0.5)
        assert loop.stream.latest("left") is None
        page = opened_page(browser, loop.page.address)

        def seen() -> np.ndarray:
            """Joints of the newest frame; those before, while a busy machine loses the hand."""
            newest = loop.stream.latest("left")
            return joints if newest is None or newest.lost else newest.landmarks

        until(lambda: loop.stream.latest("left") is not None, "a frame of the hand")
        joints = pinch_pose()[0]
        before = seen()
        np.testing.assert_allclose(before, joints, atol=1e-6)
        page.get_by_label("open the index finger").press("End")
        until(lambda: not np.allclose(seen(), before), "an open finger")
        after = seen()
        moved = np.flatnonzero(np.linalg.norm(after - before, axis=1) > 1e-6)
        assert moved.tolist() == [7, 8, 9]
        drag(page, *pixel(page, lambda colours: colours.max(axis=-1) < 200))
        until(lambda: not np.allclose(seen(), after), "a hand elsewhere")
        shift = seen() - after
        np.testing.assert_allclose(shift, np.tile(shift[0], (25, 1)), atol=1e-9)
        assert 0.005 < np.linalg.norm(shift[0]) < 0.1
        page.close()
        until(lambda: loop.stream.latest("left").lost, "a lost hand")


def in_the_headset(points: np.ndarray) -> list:
    """Return scene coordinates in a headset's, which has y up: the origin is 0.5 m before the viewer."""
    return (points[:, [0, 2, 1]] * [1, 1, -1] + [0, 1.2, -0.5]).tolist()


def test_a_headset_gives_its_hands_in_the_coordinates_of_the_scene_and_escape_stops(
    browser,
) -> None:
    with Loop(dragged=True) as loop:
        page = opened_page(browser, loop.page.address, HERE / "headset_stand_in.js")
        right = pinch_pose()[0] * [-1, 1, 1]
        page.evaluate("joints => (hands.right = joints)", in_the_headset(right))
        page.get_by_role("button", name="Enter AR/VR").click()
        newest = loop.stream.latest
        until(lambda: newest("right") and not newest("right").lost, "a tracked hand")
        np.testing.assert_allclose(newest("right").landmarks, right, atol=1e-5)
        until(lambda: newest("left").lost, "the end of the dragged hand")
        drawn = page.locator("canvas").get_attribute("data-frames")
        # Both hands pinch for two seconds: the origin moves to the middle between them.
        hands = [right + [0.2, 0.0, 0.1], right * [-1, 1, 1] + [-0.2, 0.0, 0.1]]
        for side, joints in zip(("right", "left"), hands, strict=True):
            joints[9] = joints[4] + [0.0, 0.0, 0.01]
            page.evaluate(f"joints => (hands.{side} = joints)", in_the_headset(joints))
        thumbs = 0.5 * (hands[0][4] + hands[1][4]) + [0.0, 0.0, 0.005]
        moved = hands[0] - thumbs
        until(
            lambda: (
                not newest("right").lost
                and np.allclose(newest("right").landmarks, moved, atol=1e-5)
            ),
            "another origin",
        )
        page.get_by_role("button", name="Leave AR/VR").click()
        until(
            lambda: newest("right").lost and newest("left") and not newest("left").lost,
            "the dragged hand",
        )
        until(
            lambda: page.locator("canvas").get_attribute("data-frames") != drawn, "the page itself"
        )
        page.keyboard.press("Escape")
        until(loop.pressed.is_set, "the emergency stop")
        assert page.faults == []
        page.close()


def test_the_page_of_a_registration_shows_what_to_touch_and_what_to_repeat(browser, example_setup):
    elements = airtact.live.elements_to_touch(example_setup.array)
    point = example_setup.array.positions[elements[1]]
    step = airtact.live.TouchStep(2, 6, elements[1], point, "transducer 17", 0.4)
    with TouchPage(example_setup, elements, 0, "127.0.0.1") as served:
        served.show(step)
        page = opened_page(browser, served.address, wait="#rows tr")
        heading, words = page.locator("h1"), page.locator("#words")
        rows = page.locator("#rows tr")
        assert heading.text_content() == "Touch 2 of 6"
        assert words.text_content() == "transducer 17: hold for 0.6 s"
        assert rows.all_text_contents() == ["1recorded", "2touch now", "3", "4", "5", "6"]
        # The labels are drawn with the next image of the 3-D scene.
        page.locator("svg").get_by_text("touch 2", exact=True).wait_for()
        # The touch that contradicts the others is the one to repeat.
        served.show(replace(step, share=0.0, residuals=(1e-3, 2e-2, 0.0, 0.0, 0.0, 1e-3)))
        page.locator("tr.wrong").wait_for()
        assert page.locator("tr.wrong").text_content() == "2repeat now20.0 mm"
    until(lambda: heading.text_content() == "The registration has ended", "the end")
    assert not page.faults
    page.close()
