"""The report in a browser: a headless Chromium opens it from disk and clicks through it."""

import json

import cv2
import numpy as np
import pytest

from pipeline.report.page.page import write_page
from tests.helpers.showing.chromium import CHROMIUM, FLAGS, PATIENCE_MS, complaints, until
from tests.helpers.tiny_run import make_tiny_run

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here: apt-get install chromium")
slow = pytest.mark.slow  # each is quick, but they are many and share a browser; the first is the everyday one


@pytest.fixture(scope="module")
def browser():
    sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed: pip install playwright")
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=list(FLAGS))
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def opened(browser, tmp_path_factory):
    """The page of a run with two submaps, ready, with all that it said and fetched."""
    run = make_tiny_run(tmp_path_factory.mktemp("browser") / "tiny")
    write_page(*run.parts)
    page, said, fetched = browser.new_page(viewport={"width": 1300, "height": 1000}), [], []
    page.set_default_timeout(PATIENCE_MS)
    page.on("console", lambda message: said.append(message.text))
    page.on("pageerror", lambda error: said.append(f"error: {error}"))
    page.on("request", lambda request: fetched.append(request.url))
    page.goto(run.workspace.report.as_uri())
    page.wait_for_selector("html[data-ready=yes]")
    return page, said, fetched


def frame_shown(page):
    return page.inner_text(".keyframe.current h3")


def picture_shown(page):
    return page.get_attribute(".keyframe.current img", "src")


def visible(page):
    """Visibility of the view's traces by their order in scene.js."""
    return page.evaluate("document.getElementById('view3d').data.map(trace => trace.visible !== false)")


def test_it_is_drawn_and_clicked_through_and_says_and_fetches_nothing(opened):
    """Reddish wall in the middle of the view, not an empty canvas; slider, buttons and keys change the keyframe."""
    page, said, fetched = opened
    assert page.locator(".keyframe:visible").count() == 1
    assert page.inner_text(".cards").count("91 %") == 1
    assert "the light contradicts" in page.inner_text(".caution")
    shot = page.screenshot(clip=page.locator("#view3d").bounding_box())
    shot = cv2.imdecode(np.frombuffer(shot, np.uint8), cv2.IMREAD_COLOR).astype(int)
    blue, _, red = np.moveaxis(shot, -1, 0)
    assert (red - blue > 40).mean() > 0.1
    page.locator("#slider").fill("0")
    first = frame_shown(page), picture_shown(page)
    page.click("#next")
    second = frame_shown(page), picture_shown(page)
    assert first[0] != second[0]
    assert first[1] != second[1]
    page.locator("body").press("ArrowLeft")
    assert frame_shown(page) == first[0]
    page.locator("#slider").press("ArrowRight")
    assert frame_shown(page) == second[0]
    assert page.input_value("#slider") == "1"
    assert complaints(said) == []
    assert [url for url in fetched if not url.startswith(("data:", "blob:"))] == [page.url]


@slow
def test_timeline_and_the_table_of_regions_lead_to_keyframes(opened):
    page, *_ = opened
    mark = page.locator("#timeline .shown").nth(7)
    words = mark.locator("title").text_content()
    mark.click(force=True)
    assert frame_shown(page).split(" ·")[0] == words.split(",")[0]
    page.click("a.goto")
    assert page.locator(".keyframe.current .ring").inner_text() == "1"


@slow
def test_a_ring_in_the_picture_marks_where_a_missed_region_lies(opened):
    page, *_ = opened
    (region,) = json.loads(page.text_content("#run-data"))["submaps"][0]["missed"]["regions"]
    page.click("a.goto")
    image, ring = (page.locator(f".keyframe.current {what}").first.bounding_box() for what in ("img", ".ring"))
    middle = ring["x"] + ring["width"] / 2 - image["x"], ring["y"] + ring["height"] / 2 - image["y"]
    share = np.array(middle) / (image["width"], image["height"])
    assert share == pytest.approx(region["at"], abs=0.01)
    assert page.locator(".ring").evaluate("mark => getComputedStyle(mark).fontWeight") == "600"
    page.evaluate("select(current, '9')")  # as a click on another region does
    assert page.locator(".ring.pale").count() == 1
    page.click("a.goto")
    assert page.locator(".ring.pale").count() == 0
    page.evaluate("select(current, '9')")
    page.locator("#slider").fill("0")
    assert page.locator(".ring.pale").count() == 0
    assert page.locator(".keyframe.current .ring").count() == 0
    page.evaluate("scene.clicked({data: scene.element.data[TRACE.numbers], pointNumber: 0})")
    assert page.locator(".keyframe.current .ring:not(.pale)").count() == 1


@slow
def test_a_click_on_a_keyframe_of_the_path_shows_it(opened):
    page, *_ = opened
    page.locator("#slider").fill("0")
    page.check("input[value=none]")  # the path alone
    page.uncheck("input[value=missed]")
    page.locator(".viewer").scroll_into_view_if_needed()
    # Where plotly draws the markers: clip coordinates from its own matrices.
    spots = page.evaluate(
        """() => {
        const graph = document.getElementById('view3d'), plot = graph._fullLayout.scene._scene, d = plot.dataScale;
        const {model, view, projection} = plot.glplot.cameraParams, {x, y, z} = graph.data[2];
        const box = plot.container.getBoundingClientRect(), rows = [0, 1, 2, 3];
        const times = (m, v) => rows.map(r => m[r] * v[0] + m[4 + r] * v[1] + m[8 + r] * v[2] + m[12 + r] * v[3]);
        return Array.from(x, (_, k) => {
            const place = [x[k] * d[0], y[k] * d[1], z[k] * d[2], 1];
            const c = times(projection, times(view, times(model, place)));
            return [box.left + box.width * (1 + c[0] / c[3]) / 2, box.top + box.height * (1 - c[1] / c[3]) / 2];
        });}"""
    )
    before = frame_shown(page)
    x, y = spots[len(spots) // 2]

    def press():
        """Plotly looks at the mouse once a frame, so a hand slower than that."""
        for place in ((x - 3, y - 3), (x, y)):
            page.mouse.move(*place)
            page.wait_for_timeout(150)
        page.mouse.down()
        page.wait_for_timeout(150)
        page.mouse.up()
        return frame_shown(page) != before

    until(page, press)
    page.check("input[value=open]")
    page.check("input[value=missed]")
    assert 40 <= int(frame_shown(page).split()[1]) <= 60


@slow
def test_layers_and_walls_are_switched(opened):
    page, *_ = opened
    assert visible(page) == [True] * 6
    page.uncheck("input[value=path]")
    page.uncheck("input[value=missed]")
    page.check("input[value=none]")
    assert visible(page) == [False, False, True, False, False, True]
    page.check("input[value=path]")
    page.check("input[value=missed]")
    page.check("input[value=whole]")
    assert visible(page) == [True] * 6
    whole = page.evaluate("document.getElementById('view3d').data[0].i.length")
    page.check("input[value=open]")
    opened_up = page.evaluate("document.getElementById('view3d').data[0].i.length")
    assert 0.3 * whole < opened_up < 0.8 * whole


@slow
def test_another_submap_is_shown_with_its_own_keyframes_and_unit(opened):
    page, *_ = opened
    page.select_option("#submap", "1")
    until(page, lambda: "scene units" in page.text_content("#scale-bar"))
    assert "submap 1" in frame_shown(page)
    assert "scene units" in page.inner_text(".legend.current")
    page.locator("#slider").fill("0")
    until(page, lambda: "mm" in page.text_content("#scale-bar"))
    assert page.input_value("#submap") == "0"


@slow
def test_turning_the_view_opens_the_wall_anew(opened):
    page, said, _ = opened
    faces = "Array.from(document.getElementById('view3d').data[0].i).slice(0, 500).join()"
    before, box = page.evaluate(faces), page.locator("#view3d").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 150, y + 90, steps=4)
    page.mouse.up()
    until(page, lambda: page.evaluate(faces) != before)
    page.click("#view-keyframe")
    page.click("#view-outside")
    assert complaints(said) == []


@slow
def test_it_can_be_read_without_scripts(browser, opened):
    page = browser.new_context(java_script_enabled=False).new_page()
    page.goto(opened[0].url)
    assert page.locator(".keyframe:visible").count() == 60
    assert page.locator(".stage:visible").count() == 0
    assert page.locator("#static img:visible").count() >= 3
    assert "Without JavaScript" in page.inner_text("noscript")


@slow
def test_light_or_dark_is_kept_where_it_can_be(browser, opened):
    """Also where the browser gives a page from disk no store: it is switched all the same."""
    colours = "getComputedStyle(document.documentElement).colorScheme"
    context = browser.new_context(color_scheme="light")
    page = context.new_page()
    page.goto(opened[0].url)
    page.click("#theme")
    assert page.evaluate(colours) == "dark"
    page.reload()
    assert page.evaluate(colours) == "dark"
    refusing = context.new_page()
    refusing.add_init_script(
        "Object.defineProperty(window, 'localStorage', {get() { throw new DOMException('none', 'SecurityError'); }})"
    )
    said = []
    refusing.on("pageerror", lambda error: said.append(str(error)))
    refusing.goto(opened[0].url)
    refusing.wait_for_selector("html[data-ready=yes]")
    assert refusing.evaluate(colours) == "light"
    refusing.click("#theme")
    assert refusing.evaluate(colours) == "dark"
    assert said == []
    context.close()


OVERLAPS = """names => names.flatMap((name, k) => names.slice(k + 1).map(other => [name, other])).filter(pair => {
    const [a, b] = pair.map(name => document.querySelector(name).getBoundingClientRect());
    return a.left < b.right && b.left < a.right && a.top < b.bottom && b.top < a.bottom;
})"""


@slow
def test_on_a_phone_no_sentence_is_cut_off_and_nothing_lies_over_another(browser, opened):
    page = browser.new_page(viewport={"width": 380, "height": 800})
    page.set_default_timeout(PATIENCE_MS)
    page.goto(opened[0].url)
    page.wait_for_selector("html[data-ready=yes]")
    page.evaluate("document.querySelectorAll('details').forEach(part => part.open = true)")
    ends = page.evaluate("[...document.querySelectorAll('.facts td')].map(cell => cell.getBoundingClientRect().right)")
    assert 0 < max(ends) <= 380
    drawn = ["#wall", "#paint", "#layers", ".views", "#scale-bar", "#mesh-note", "#view3d .infolayer g.colorbar"]
    assert page.evaluate(OVERLAPS, drawn) == []
    page.close()
