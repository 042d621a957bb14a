"""The page in a real browser: what is set there reaches the loop, and what the loop does is to be seen."""

import io
import time

import numpy as np
import pytest
from PIL import Image

from live.live_scenes import Loop
from references.motions import pinch_pose

PATIENCE = 120.0
"""The pictures are drawn by the processor, which others may be using [s]."""


def opened_page(browser, address):
    page = browser.new_page(viewport={"width": 1280, "height": 800})
    page.set_default_timeout(1e3 * PATIENCE)
    page.asked, page.faults = [], []
    page.on("request", lambda request: page.asked.append(request.url))
    page.on(
        "console",
        lambda message: page.faults.append(message.text) if message.type == "error" else None,
    )
    page.on("pageerror", lambda fault: page.faults.append(str(fault)))
    page.goto(address)
    page.get_by_text("drives per second").first.wait_for()
    return page


def until(true, what: str) -> None:
    end = time.monotonic() + PATIENCE
    while not true():
        assert time.monotonic() < end, f"{what} did not happen."
        time.sleep(0.05)


def colours(page) -> int:
    picture = Image.open(io.BytesIO(page.screenshot())).convert("RGB")
    return len(np.unique(np.asarray(picture)[:, 330:950].reshape(-1, 3), axis=0))


def slider(page, label: str):
    return page.locator(
        f"xpath=//label[normalize-space()='{label}']/following::*[@role='slider'][1]"
    )


def test_what_is_set_on_the_page_reaches_the_loop(browser) -> None:
    with Loop() as loop:
        page, at = opened_page(browser, loop.page.address), loop.page
        page.get_by_text("playing", exact=True).wait_for()
        until(lambda: colours(page) > 200, "a picture of the hand")
        slider(page, "offset [mm]").press("ArrowRight")
        until(lambda: at.controls.offset == pytest.approx(1.1e-3), "a larger offset")
        slider(page, "level cap [%]").press("Home")
        until(lambda: at.controls.cap == 0.0, "a lower cap")
        page.get_by_label("ignore the hand").click()
        until(lambda: at.controls.ignore_hand, "to ignore the hand")
        page.get_by_label("modulated").click()
        until(lambda: not at.controls.modulated, "a constant amplitude")
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


def test_escape_is_the_emergency_stop(browser) -> None:
    with Loop() as loop:
        page = opened_page(browser, loop.page.address)
        page.keyboard.press("Escape")
        until(loop.pressed.is_set, "the emergency stop")
        page.close()


DRAWN = """() => {
    const viewer = window.__viserMutable, found = {};
    for (const name of ["/array", "/hand"])
        viewer.nodeRefFromName[name]?.traverse((part) => { if (part.isMesh) found[name] ??= part; });
    const seen = Object.values(found).map((mesh) => [
        mesh.material.type, mesh.material.vertexColors, new Set(mesh.geometry.attributes.color.array).size > 10
    ]);
    return { seen, cheap: viewer.cheap };
}"""
"""What array and hand are drawn with."""


@pytest.mark.slow
def test_the_page_shows_the_sound_with_the_hand_in_its_place(browser) -> None:
    with Loop() as loop:
        page = opened_page(browser, loop.page.address)
        page.get_by_text("pressure for the hand").wait_for()
        page.close()


def test_array_and_hand_have_the_colours_that_were_sent(browser) -> None:
    with Loop() as loop:
        page = opened_page(browser, loop.page.address)
        until(lambda: colours(page) > 200, "a picture of the hand")
        until(lambda: len(page.evaluate(DRAWN)["seen"]) == 2, "the array and the hand")
        assert page.evaluate(DRAWN) == {
            "seen": 2 * [["MeshBasicMaterial", True, True]],
            "cheap": True,
        }
        assert page.faults == []
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
        slider(page, "index [°]").press("End")
        until(lambda: not np.allclose(seen(), before), "an open finger")
        after = seen()
        moved = np.flatnonzero(np.linalg.norm(after - before, axis=1) > 1e-6)
        assert moved.tolist() == [7, 8, 9]
        page.close()
        until(lambda: loop.stream.latest("left").lost, "a lost hand")
