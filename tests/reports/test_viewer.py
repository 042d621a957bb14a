"""The scene of a page turns, shows values and fetches nothing, in a real browser."""

import csv
import json
import re
from dataclasses import replace

import numpy as np
import pytest

import airtact as at
from airtact.reports.run_page import fields_of
from airtact.reports.solids import towards_viewer
from airtact.reports.viewer import three_js, viewer_values
from airtact.timing import Clock
from paths import SCENES

BALL = SCENES / "ball.toml"


@pytest.fixture(scope="module")
def rendered(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    result = at.render(at.read_scene(BALL))
    at.write_report(result, folder)
    return folder / "report.html", result


def opened_page(browser, path, width=1200, **settings):
    """Open a page; what it asks for, and what it says in the console, is in its lists."""
    page = browser.new_page(
        viewport={"width": width, "height": 900}, accept_downloads=True, **settings
    )
    page.asked = []
    page.said = []
    page.on("request", lambda request: page.asked.append(request.url))
    page.on("console", lambda message: page.said.append(message.text))
    page.on("pageerror", lambda fault: page.said.append(str(fault)))
    page.goto(path.as_uri())
    page.wait_for_selector("#viewer[data-first-picture]")
    return page


@pytest.fixture(scope="module")
def view(rendered):
    return fields_of(rendered[1], Clock())[1]


@pytest.fixture
def report(browser, rendered):
    page = opened_page(browser, rendered[0])
    yield page
    assert page.said == []
    assert [url for url in page.asked if not url.startswith(("file:", "data:", "blob:"))] == []
    page.close()


def stage(page):
    box = page.locator(".stage").bounding_box()
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def still(page):
    page.wait_for_timeout(300)
    return page.locator(".stage").screenshot()


def test_a_drag_turns_the_scene_and_a_wheel_comes_nearer(report):
    pictures = [still(report)]
    report.mouse.move(*stage(report))
    report.mouse.down()
    x, y = stage(report)
    report.mouse.move(x + 180, y + 60, steps=6)
    report.mouse.up()
    pictures.append(still(report))
    report.mouse.wheel(0, -400)
    pictures.append(still(report))
    assert len(set(pictures)) == 3


def test_keys_and_controls_change_the_scene(report):
    pictures = [still(report)]
    report.focus("canvas")
    for key in ("ArrowLeft", "+", "PageUp"):
        report.keyboard.press(key)
        pictures.append(still(report))
    for name, value in (
        ("shown", "level"),
        ("shown", "difference"),
        ("array", "amplitude"),
        ("axis", "0"),
    ):
        report.select_option(f"[name={name}]", value)
        pictures.append(still(report))
    for name in ("surfaces", "cut", "slice"):
        report.click(f"[name={name}]")
        pictures.append(still(report))
    report.click("[data-look=array]")
    pictures.append(still(report))
    assert len(set(pictures)) == len(pictures)


def test_the_values_under_the_pointer_are_those_of_the_field(report, rendered, view):
    run = rendered[1]
    report.locator(".stage").scroll_into_view_if_needed()
    ring = report.locator("svg circle").nth(1).bounding_box()
    report.mouse.move(ring["x"] + ring["width"] / 2, ring["y"] + ring["height"] / 2)
    words = report.inner_text("output")
    assert run.setup.foci[0] in words
    assert "requested: 900 Pa" in words
    assert f"object considered: {run.pressures[0]:,.0f} Pa" in words
    report.uncheck("[name=surfaces]")
    report.click("[data-look=foci]")
    box = report.locator(".stage").bounding_box()
    shown = []
    for share in np.linspace(0.3, 0.7, 30):
        report.mouse.move(box["x"] + share * box["width"], box["y"] + 0.35 * box["height"])
        words = report.inner_text("output") if report.is_visible("output") else ""
        if words.startswith("air"):
            shown.append(
                [
                    float(number.replace("−", "-").replace(",", ""))
                    for number in re.findall(r"[−\d,.]+\d", words)
                ]
            )
    assert len(shown) > 5
    points = 1e-3 * np.array(shown)[:, :3]
    pressures = np.array(shown)[:, 3]
    away = np.linalg.norm(points, axis=1) > 7.5e-3
    scale = np.abs(run.drive.amplitudes).max()
    np.testing.assert_allclose(
        pressures[away],
        scale * np.abs(run.verification.at(points[away])["object considered"]),
        atol=0.02 * view.peak,
    )


def test_pictures_can_be_kept(report):
    with report.expect_download() as kept:
        report.click("[name=svg]")
    drawing = kept.value.path().read_text(encoding="utf-8")
    assert kept.value.suggested_filename == "ball.svg"
    assert "south pole</text>" in drawing
    assert "data:image/png;base64," in drawing
    with report.expect_download() as kept:
        report.click("[name=png]")
    assert kept.value.path().read_bytes().startswith(b"\x89PNG")


def test_tables_can_be_saved(report, tmp_path):
    for button in report.locator("button.save").all():
        with report.expect_download() as download:
            button.click()
        download.value.save_as(tmp_path / download.value.suggested_filename)
    assert len(list(tmp_path.iterdir())) == report.locator("table").count() >= 2
    with (tmp_path / "pressure-at-each-focus.csv").open(encoding="utf-8-sig", newline="") as file:
        saved = list(csv.reader(file))
    shown = report.locator("h2:has-text('Pressure at each focus') ~ .scroll tr").first
    assert saved[0] == shown.locator("th").all_text_contents()
    assert len({len(row) for row in saved}) == 1


def test_nothing_is_wider_than_a_narrow_screen(browser, rendered):
    page = opened_page(browser, rendered[0], width=400, color_scheme="dark")
    assert page.evaluate("document.documentElement.scrollWidth") <= 400
    assert page.said == []
    page.close()


def test_still_pictures_stand_in_on_paper_and_where_the_scene_fails(browser, rendered):
    page = opened_page(browser, rendered[0])
    assert not page.is_visible(".still img")
    page.emulate_media(media="print")
    assert page.is_visible(".still img")
    assert not page.is_visible("#viewer")
    page.close()
    page = browser.new_page()
    page.add_init_script("HTMLCanvasElement.prototype.getContext = () => null")
    page.goto(rendered[0].as_uri())
    page.wait_for_selector("#viewer-fault:visible")
    assert "still pictures follow" in page.inner_text("#viewer-fault")
    assert page.is_visible(".still img")
    page.close()


def test_a_comparison_shows_the_field_of_each_method(browser, tmp_path):
    contest = at.compare(at.read_scene(BALL))
    at.write_report(contest, tmp_path)
    page = opened_page(browser, tmp_path / "methods.html")
    names = page.locator("[name=drive] option").all_inner_texts()
    assert names == [one.name for one in contest.contenders]
    pictures = set()
    for index in range(len(names)):
        page.select_option("[name=drive]", str(index))
        pictures.add(still(page))
    assert len(pictures) > 2
    assert page.said == []
    page.close()


def test_three_js_is_found_whole_with_its_licence(view):
    script = three_js()
    assert "SPDX-License-Identifier: MIT" in script
    assert script.rstrip().endswith("}));")
    values = viewer_values(view)
    assert "Three.js Authors" in values["notice"]
    assert "249 transducers" in values["alternative"]


def test_the_first_slice_hides_no_focus(view):
    """It goes through the focus farthest from the viewer, to half a step."""
    foci = view.setup.target.points + np.outer([0.0, 4e-3], view.slices.axes[2])
    seen = replace(view, setup=replace(view.setup, target=at.Target(foci)))
    facts = json.loads(viewer_values(seen)["facts"])
    towards = towards_viewer(*np.degrees(facts["views"]["first"]["seen"]))
    normal = np.array(facts["slices"]["axes"][2])
    corner = facts["slices"]["corner"][2]
    height = corner + facts["slices"]["start"][2] * facts["slices"]["steps"][2]
    before = (1e3 * seen.setup.target.points @ normal - height) * np.sign(normal @ towards)
    assert np.ptp(before) == pytest.approx(4.0)
    assert before.min() == pytest.approx(0.0, abs=0.5 * facts["slices"]["steps"][2])


def test_a_plane_is_a_sheet_seen_from_its_front(browser, tmp_path):
    """The first look at the whole array is from its front, where pointing beside the transducers names it."""
    scene = tmp_path / "over.toml"
    text = BALL.read_text(encoding="utf-8")
    plane = "[[planes]]\npoint = [0.0, 0.0, -0.07]\nnormal = [0.0, 0.0, 1.0]\n"
    scene.write_text(f"{text}\n{plane}", encoding="utf-8")
    at.write_report(at.render(at.read_scene(scene)), tmp_path / "out")
    page = opened_page(browser, tmp_path / "out" / "report.html")
    (sheet,) = page.evaluate(
        "JSON.parse(document.getElementById('viewer-facts').textContent).sheets"
    )
    np.testing.assert_allclose(np.array(sheet)[:, 2], -70.0)
    page.click("[data-look=array]")
    assert "a rigid plane" in page.get_attribute("canvas", "aria-label")
    still(page)
    box = page.locator(".stage").bounding_box()
    words = set()
    for share in np.linspace(0.1, 0.9, 25):
        page.mouse.move(box["x"] + share * box["width"], box["y"] + 0.6 * box["height"])
        words.add(page.inner_text("output").split(" at ")[0] if page.is_visible("output") else "")
    assert "rigid plane" in words
    assert any(word.startswith("transducer") for word in words)
    assert page.said == []
    page.close()


def test_a_virtual_object_is_drawn_and_named(browser, rendered, tmp_path):
    result = rendered[1]
    box = at.VirtualObject(at.touch.Box((0.01, 0.02, 0.01)), at.Pose.shift((0, 0, -9e-3)), "brick")
    drawn = replace(result, setup=replace(result.setup, objects=(box,)))
    at.write_report(drawn, tmp_path)
    page = opened_page(browser, tmp_path / "report.html")
    (facts,) = page.evaluate("[JSON.parse(document.getElementById('viewer-facts').textContent)]")
    assert facts["objects"] == ["brick"]
    assert facts["arrays"]["object brick triangles"][2] == 36
    assert "the virtual object brick" in page.get_attribute("canvas", "aria-label")
    plain = opened_page(browser, rendered[0])
    assert still(page) != still(plain)
    assert page.said == plain.said == []
    page.close()
    plain.close()


def test_pages_stay_small(rendered):
    assert rendered[0].stat().st_size < 3e6
