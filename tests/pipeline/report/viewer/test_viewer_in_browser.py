"""The pages of `haustra view FOLDER` in a headless Chromium: looked at and clicked through."""

from __future__ import annotations

import json
import threading
from dataclasses import dataclass, field

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.report.viewer.folder_server import FolderServer
from tests.helpers.showing.chromium import CHROMIUM, FLAGS, PATIENCE_MS, complaints, until
from tests.helpers.showing.shown_runs import make_shown_run

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here: apt-get install chromium")
slow = pytest.mark.slow  # each is quick, but they are many and share a browser; the first is the everyday one


@slow
def test_figures_of_the_largest_of_several_submaps_say_so(opened):
    """They are no figures of the film."""
    page = opened.open("play?run=one")
    count = page.evaluate("maps.length")
    assert count > 1
    said = f"(largest of {count} submaps)"
    assert f"was seen {said}" in page.inner_text("#coverage-words")
    cells = opened.open("compare?a=one&b=three").locator("#figures tbody tr").all_inner_texts()
    for title in ("wall seen", "surface"):
        assert said in next(cell for cell in cells if cell.startswith(title))
    assert "wall seen and surface are the largest one's" in opened.open().inner_text("body")


CAMERA = "document.getElementById('{}').layout.scene.camera.eye"


@dataclass
class Opened:
    """A browser's page, the server's address, and all that the page said and fetched."""

    page: object
    address: str
    said: list[str] = field(default_factory=list)
    fetched: list[str] = field(default_factory=list)

    def open(self, path: str = "") -> object:
        self.page.goto(self.address + path)
        self.page.wait_for_selector("html[data-ready=yes]")
        return self.page


@pytest.fixture(scope="module")
def opened(tmp_path_factory):
    sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed: pip install playwright")
    root = tmp_path_factory.mktemp("viewed")
    for name in ("one", "two"):
        make_shown_run(root / name)
    make_shown_run(root / "three", film="another", frames=50, judged=False)
    (root / "batch.json").write_text(json.dumps([{"folder": "x/unread", "status": "failed", "message": "is: no film"}]))
    server = FolderServer(root)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=list(FLAGS))
        page = browser.new_page(viewport={"width": 1400, "height": 1000})
        page.set_default_timeout(PATIENCE_MS)
        made = Opened(page, server.address)
        page.on("console", lambda message: made.said.append(message.text))
        page.on("pageerror", lambda error: made.said.append(f"error: {error}"))
        page.on("request", lambda request: made.fetched.append(request.url))
        yield made
        browser.close()
    server.shutdown()
    server.server_close()


def test_the_list_is_searched_sorted_and_leads_to_the_player(opened):
    page = opened.open()
    names = page.locator("#runs tbody a[href^='/play']")
    until(page, lambda: names.count() == 3)
    page.click("#runs th button[data-by=name]")
    assert names.all_inner_texts() == ["one", "three", "two"]
    assert page.get_attribute("#runs th:has(button[data-by=name])", "aria-sort") == "ascending"
    page.click("#runs th button[data-by=name]")
    assert names.all_inner_texts() == ["two", "three", "one"]
    page.fill("#find", "thr")
    assert names.all_inner_texts() == ["three"]
    assert page.inner_text("#count") == "1 of 4 runs"
    page.click("#runs tbody a[href^='/play']")
    page.wait_for_selector("html[data-ready=yes]")
    assert page.inner_text("#title") == "three"
    assert not complaints(opened.said)
    assert all(url.startswith((opened.address, "data:", "blob:")) for url in opened.fetched)


@slow
def test_the_player_steps_by_keys_plays_and_pauses(opened):
    page = opened.open("play?run=one")
    first = page.get_attribute("#frame", "src")
    page.keyboard.press("ArrowRight")
    assert page.get_attribute("#frame", "src") != first
    page.keyboard.press("Home")
    assert page.get_attribute("#frame", "src") == first
    page.keyboard.press(" ")
    assert page.get_attribute("#play", "aria-pressed") == "true"
    until(page, lambda: int(page.input_value("#slider")) > 5)
    page.keyboard.press(" ")
    assert page.get_attribute("#play", "aria-pressed") == "false"
    stopped = page.input_value("#slider")
    page.wait_for_timeout(300)
    assert page.input_value("#slider") == stopped
    page.keyboard.press("End")
    assert page.input_value("#slider") == page.get_attribute("#slider", "max")
    assert not complaints(opened.said)


@slow
def test_depth_follows_the_film_and_a_missed_region_is_found_by_a_click(opened):
    page = opened.open("play?run=one")
    depth = page.get_attribute("#depth", "src")
    page.keyboard.press("End")
    assert page.get_attribute("#depth", "src") != depth
    assert "scene units" in page.inner_text("#depth-scale"), "the second submap's own"
    page.keyboard.press("Home")
    assert [text in page.inner_text("#depth-scale") for text in ("mm", "scene units")] == [True, False]
    seconds = page.evaluate("run.regions[0].seconds")
    assert f"({seconds:.2f} s)" in page.inner_text("#regions li")
    page.click("#regions button")
    assert "region 1" in page.inner_text("#missed")
    assert page.locator("#regions li.here").count() >= 1
    region = page.evaluate("run.regions[0].frame")
    assert f"frame {region}" in page.inner_text("#frame-words")


@slow
def test_the_camera_rides_along(opened):
    page = opened.open("play?run=one")
    before = page.evaluate(CAMERA.format("view3d"))
    page.click("#inside")
    until(page, lambda: page.evaluate(CAMERA.format("view3d")) != before)
    riding = page.evaluate(CAMERA.format("view3d"))
    page.evaluate("document.activeElement.blur()")
    page.evaluate("goTo(run.frames[40][0])")
    until(page, lambda: page.evaluate(CAMERA.format("view3d")) != riding)
    page.click("#outside")
    assert page.get_attribute("#inside", "aria-pressed") == "false"


@slow
def test_two_are_ticked_compared_and_turned_by_one_camera(opened):
    page = opened.open()
    page.check("input[aria-label='compare one']")
    assert page.is_disabled("#compare")
    page.check("input[aria-label='compare two']")
    page.click("#compare")
    page.wait_for_selector("html[data-ready=yes]")
    assert "one film" in page.inner_text("#linked")
    assert page.inner_text("#figures").count("of 132") == 2 or page.locator("#figures tbody tr").count() == 6
    page.evaluate("scenes.a.look({eye: {x: 0.3, y: -1.7, z: 0.4}, center: {x: 0, y: 0, z: 0}, up: {x: 0, y: 0, z: 1}})")
    until(page, lambda: np.allclose(list(page.evaluate(CAMERA.format("view-b")).values()), [0.3, -1.7, 0.4], atol=1e-4))
    page.uncheck("#link")
    page.evaluate("scenes.a.look({eye: {x: 1, y: 1, z: 1}, center: {x: 0, y: 0, z: 0}, up: {x: 0, y: 0, z: 1}})")
    page.wait_for_timeout(300)
    assert np.allclose(list(page.evaluate(CAMERA.format("view-b")).values()), [0.3, -1.7, 0.4], atol=1e-4)
    assert not complaints(opened.said)


@slow
def test_runs_of_two_films_are_found_played_and_compared_from_their_own_first_views(opened):
    """From the list through both players to the comparison, whose figures are each film's own."""
    opened.open().evaluate("sessionStorage.clear()")
    page = opened.open()
    for name, posed in (("one", 120), ("three", 80)):
        page.click(f"#runs tbody a[href='/play?run={name}']")
        page.wait_for_selector("html[data-ready=yes]")
        assert page.inner_text("#title") == name
        assert page.evaluate("run.frames.length") >= posed
        page.click("#back a")
        page.wait_for_selector("html[data-ready=yes]")
        page.check(f"input[aria-label='compare {name}']")
    page.click("#compare")
    page.wait_for_selector("html[data-ready=yes]")
    assert "different films" in page.inner_text("#linked")
    cells = page.locator("#figures tbody tr").first.locator("td").all_inner_texts()
    assert [cell.split(" of ")[0] for cell in cells] == ["120", "80"]
    assert "the light contradicts" in page.inner_text("#figures"), "the doubts of a run"
    until(page, lambda: page.locator("p:text('coverage of three was not judged')").count() == 1)
    rng = np.random.default_rng(0)
    first, second = (Rotation.random(random_state=rng).as_matrix() for _ in range(2))
    found = page.evaluate("([a, b]) => between(a, b)", [first.tolist(), second.tolist()])
    np.testing.assert_allclose(found, first.T @ second, atol=1e-12)  # axes are rows: B's own view becomes A's
    page.evaluate("scenes.b.look({eye: {x: 0.6, y: -1.2, z: 0.9}, center: {x: 0, y: 0, z: 0}, up: {x: 0, y: 0, z: 1}})")
    turn = np.array(page.evaluate("turn"))
    until(page, lambda: np.allclose(list(page.evaluate(CAMERA.format("view-a")).values()), turn @ [0.6, -1.2, 0.9]))
    assert not complaints(opened.said)


@slow
def test_a_run_that_is_not_there_is_said(opened):
    page = opened.open("play?run=nothing")
    assert "not there" in page.inner_text("#fault")
    opened.said.clear()  # the browser says, too, that it was not found


@slow
def test_a_film_without_a_surface_is_listed_and_says_why(opened):
    page = opened.open("play?run=unread")
    assert page.inner_text("#fault") == "the run unread has no surface to show (failed): is: no film"
    assert page.locator("section:visible").count() == 0
    page.click("#back a")
    page.wait_for_selector("#runs tbody tr")
    line = page.locator("#runs tbody tr", has_text="unread")
    assert line.locator("summary").inner_text() == "is"
    assert "is: no film" not in line.inner_text()
    line.locator("summary").click()
    assert "is: no film" in line.inner_text()
    opened.said.clear()


@slow
def test_all_columns_are_in_sight_and_warnings_take_one_line(opened):
    page = opened.page
    long = ["a warning that goes on and on, longer than its column is wide: and its reason", "another"]
    for width in (1300, 650):  # of 1300 px, at once and twice the size
        page.set_viewport_size({"width": width, "height": 900})
        opened.open()
        page.evaluate("long => { rows.forEach(run => { run.words = long; }); draw(); }", long)
        for cell in page.locator("#runs tbody tr").first.locator("td").all():
            box = cell.bounding_box()
            assert box["x"] >= 0
            assert box["x"] + box["width"] <= width
        assert page.locator("details.words").first.bounding_box()["height"] < 30
        assert page.locator("details.words").first.inner_text().endswith("and 1 more")
    opened.open("compare?a=one&b=two")
    page.evaluate(
        "long => table([1, 2].map(() => ({ ...{ posed: 1, total: 2, seen_percent: 3, area: 4 }, words: long })))", long
    )
    last = page.locator("#figures tbody tr").last.locator("td").last.bounding_box()
    assert last["x"] + last["width"] <= width, "both columns of a comparison, too"
    page.set_viewport_size({"width": 1400, "height": 1000})


@slow
@pytest.mark.parametrize("path", ["", "play?run=one", "compare?a=one&b=two", "compare?a=one&b=three"])
def test_at_twice_the_size_nothing_is_cut_off(opened, path):
    """200 % zoom of a 1400 px window is a page 700 px wide."""
    page = opened.page
    page.set_viewport_size({"width": 700, "height": 500})
    opened.open(path)
    wider = page.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth")
    page.set_viewport_size({"width": 1400, "height": 1000})
    assert wider <= 0


@slow
def test_light_and_dark(opened):
    page = opened.open("play?run=one")

    def brightness():
        shot = cv2.imdecode(np.frombuffer(page.screenshot(), np.uint8), cv2.IMREAD_GRAYSCALE)
        return shot[:30].mean()

    before = brightness()
    page.click("#theme")
    assert abs(brightness() - before) > 100
    for path in ("", "play?run=two", "report/one"):
        opened.open(path)
        assert abs(brightness() - before) > 100, "it is kept on the next page"
    page.click("#theme")
    opened.open()
    assert abs(brightness() - before) < 30
