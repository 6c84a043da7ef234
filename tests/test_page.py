"""The report as a file: whole, bounded, escaped, and readable without a script."""

import base64
import html.parser
import json
import re

import numpy as np
import pytest

from pipeline.demo import FOLDER
from pipeline.page import browser, write_page
from pipeline.page.browser import choose_shown
from pipeline.page.timeline import MOST_COLUMNS, FrameStates, timeline_section
from reconstruction.decimate import decimated
from reconstruction.export import read_mesh
from tiny_run import make_tiny_run


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    made = make_tiny_run(tmp_path_factory.mktemp("page") / "tiny <run>")
    write_page(*made.parts)
    return made


@pytest.fixture(scope="module")
def page(run):
    return run.workspace.report.read_text()


def without_scripts(page):
    return re.sub(r"<script(?! type).*?</script>", "", page, flags=re.DOTALL)


def test_nothing_is_fetched_and_the_policy_says_so(page):
    found: list[str] = []

    class Addresses(html.parser.HTMLParser):
        def handle_starttag(self, tag, attrs):
            found.extend(value for name, value in attrs if name in ("src", "href", "srcset", "action", "data"))

    Addresses().feed(without_scripts(page))
    assert len(found) > 100
    assert [a for a in found if not a.startswith(("data:image/", "#"))] == []
    policy = re.search(r'http-equiv="Content-Security-Policy" content="([^"]+)"', page)[1]
    assert policy.startswith("default-src 'none'; script-src 'sha256-")
    assert "connect" not in policy
    assert "unsafe-inline' ; script" not in policy
    assert page.index("Content-Security-Policy") < page.index("<style")


def test_names_are_escaped(page):
    text = without_scripts(page)
    assert "tiny &lt;run&gt;" in text
    assert "tiny &lt;b&gt;&amp;&lt;/b&gt; video.mp4" in text
    assert "<i>note</i>" not in text
    assert "<run>" not in text
    assert "<!--" not in text, "a mark of the template was not filled in"


def test_the_keyframes_are_counted_and_bounded(run, page):
    assert sum(map(len, run.dense)) == 120
    assert page.count('<article class="keyframe"') == browser.MOST_KEYFRAMES == 60
    assert "60 of 120 keyframes, evenly spread" in page
    shown = choose_shown(run.frames, run.dense)
    assert {k.submap for k in shown} == {0, 1}
    assert (shown[0].frame, shown[-1].frame) == (run.dense[0].submap.frames[0], run.dense[1].submap.frames[-1])
    assert run.workspace.report.stat().st_size < 15e6


def test_noisy_pictures_are_coded_more_coarsely(run, monkeypatch):
    shown = choose_shown(run.frames, run.dense, 6)
    limits = [(0.0, 4.0)] * 2

    def size():
        panels = browser._within_budget(shown, run.dense, run.surfaces, limits)
        return sum(len(picture) for panel in panels for picture in panel.pictures)

    fine = size()
    monkeypatch.setattr(browser, "BUDGET", int(0.8 * fine))
    assert size() <= 0.8 * fine


def test_the_scene_holds_what_the_run_holds(run, page):
    data = json.loads(re.search(r'id="run-data">(.*?)</script>', page, re.DOTALL)[1])
    first, second = data["submaps"]
    assert (first["unit"], second["unit"]) == ("mm", "scene units")
    centres = np.frombuffer(base64.b64decode(first["path"]["places"]), "<f4").reshape(-1, 3)
    np.testing.assert_allclose(centres, 25 * run.dense[0].submap.centres, atol=1e-4)
    mesh, packed = run.surfaces[0].mesh, first["mesh"]
    steps = np.frombuffer(base64.b64decode(packed["vertices"]), "<u2").reshape(-1, 3) / 65535
    np.testing.assert_allclose(packed["low"] + steps * packed["span"], mesh.vertices, atol=0.01)
    assert np.frombuffer(base64.b64decode(packed["faces"]), "<u4").reshape(-1, 3).tolist() == mesh.faces.tolist()
    (region,) = first["missed"]["regions"]
    assert region["frame"] == run.coverage[0].record["missed_regions"][0]["frame"]
    assert second["missed"]["regions"] == []
    assert sum(len(s["shown"]) for s in data["submaps"]) == len(data["shown"]) == 60


def test_the_timeline_counts_every_frame(page):
    film = page[page.index('class="timeline"') : page.index('class="key"') + 1500]
    for words in ("used (125)", "blurred (2)", "black (2)", "burnt out (1)", "repeated (1)", "posed, submap 1 (30)"):
        assert words in film, words
    assert "used, but not posed (5)" in film
    assert film.count('class="shown"') == 60


def test_a_long_video_keeps_its_timeline_small():
    count = 100_000
    verdicts = np.random.default_rng(0).choice(["used", "blurred", "black"], count).tolist()
    states = FrameStates(np.arange(count), np.arange(count) / 30, verdicts, np.zeros(count, int))
    section = timeline_section(states, [], [])
    assert len(section) < 400_000
    assert section.count("<rect") <= 4 * MOST_COLUMNS + 1


def test_a_decimated_mesh_is_the_same_surface():
    mesh = read_mesh(FOLDER / "mesh.ply")
    target = len(mesh.faces) // 4
    few = decimated(mesh, target)
    assert 0.9 * target <= len(few.faces) <= target
    assert few.face_areas.sum() == pytest.approx(mesh.face_areas.sum(), rel=0.02)
    np.testing.assert_allclose(few.vertices.min(axis=0), mesh.vertices.min(axis=0), atol=1)
    # Still wound towards the lumen: the signed volume keeps its sign and size.
    volume = [np.einsum("fi,fi->", m.vertices[m.faces[:, 0]], _face_vectors(m)) / 6 for m in (mesh, few)]
    assert volume[1] == pytest.approx(volume[0], rel=0.05)
    assert decimated(few, target) is few
    assert len(decimated(mesh, len(mesh.faces) // 15).faces) <= len(mesh.faces) // 15


def _face_vectors(mesh):
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return np.cross(b - a, c - a)
