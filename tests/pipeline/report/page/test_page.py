"""The report as a file: whole, bounded, escaped, and readable without a script."""

import base64
import hashlib
import html.parser
import json
import re
from dataclasses import replace
from typing import get_args

import cv2
import numpy as np
import pytest

from pipeline.demo import FOLDER
from pipeline.input.frame_quality import Verdict
from pipeline.report.page import keyframe_gallery as browser
from pipeline.report.page import scene
from pipeline.report.page.keyframe_gallery import Shown, choose_shown
from pipeline.report.page.page import write_page
from pipeline.report.page.summary import cautions, details
from pipeline.report.page.timeline import MOST_COLUMNS, FrameStates, timeline_section
from pipeline.surface.coverage_stage import CoverageResult
from reconstruction.mesh.decimation import decimated
from reconstruction.mesh.mesh_io import read_mesh
from reconstruction.mesh.surface_mesh import SurfaceMesh
from tests.helpers.tiny_run import make_tiny_run


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


def scene_of(page):
    return json.loads(re.search(r'id="run-data">(.*?)</script>', page, re.DOTALL)[1])


def test_nothing_is_fetched_and_the_policy_says_so(page):
    found: list[str] = []

    class Addresses(html.parser.HTMLParser):
        def handle_starttag(self, tag, attrs):
            found.extend(value for name, value in attrs if name in ("src", "href", "srcset", "action", "data"))

    Addresses().feed(without_scripts(page))
    assert len(found) > 100
    assert [a for a in found if not a.startswith(("data:image/", "#"))] == []
    policy = re.search(r'http-equiv="Content-Security-Policy" content="([^"]+)"', page)[1]
    allowed = {words[0]: words[1:] for words in map(str.split, policy.split(";"))}
    scripts = re.findall(r"<script>(.*?)</script>", page, flags=re.DOTALL)
    digests = [base64.b64encode(hashlib.sha256(script.encode()).digest()).decode() for script in scripts]
    assert allowed.pop("script-src") == [f"'sha256-{digest}'" for digest in digests], "these scripts and no others"
    assert allowed == {
        "default-src": ["'none'"],
        "style-src": ["'unsafe-inline'"],
        "img-src": ["data:", "blob:"],
        "base-uri": ["'none'"],
        "form-action": ["'none'"],
    }
    assert page.index("Content-Security-Policy") < page.index("<style")


def test_names_are_escaped(page):
    text = without_scripts(page)
    assert "tiny &lt;run&gt;" in text
    assert text.count("tiny &lt;b&gt;&amp;&lt;b&gt; video.mp4") == 2, "in the head and among the figures"
    assert "<i>note</i>" not in text
    assert "<run>" not in text
    assert "<!--" not in text, "a mark of the template was not filled in"


def test_the_films_folder_is_not_told(page):
    """A report is passed on."""
    assert "of somebody" not in page
    assert "/films" not in page


def test_units_and_numbers_are_in_words(run):
    metrics = json.loads(json.dumps(run.metrics))
    metrics["mapper"] = "odometry"
    metrics["submaps"][1]["doubt"] = {"probability": 0.2, "heaviest": "its points lie 2 px beside"}
    assert "left open" not in details(metrics)
    metrics["submaps"][0]["opened_area_share"] = 0.0123
    text = details(metrics)
    assert text.count("<th>left open</th><td>1.23 % of the surface, small dark spots") == 1
    assert "scene units² of surface" in text
    assert " scene²" not in text
    assert "visual odometry" in text
    assert "<th>probability that this map is wrong</th><td>20 %; what speaks most against it: its points lie" in text
    record = run.coverage[0].record
    assert "; 1 missed region of 5 mm and more" in CoverageResult(record, None).sentence
    assert "; 0 missed regions of" in CoverageResult(record | {"missed_regions": []}, None).sentence


@pytest.mark.parametrize(("count", "open_ones"), [(0, 0), (4, 4), (5, 5), (9, 4)])
def test_many_cautions_are_all_there_the_rest_counted_and_folded(count, open_ones):
    text = cautions({"warnings": [f"no {k}" for k in range(count)], "frames": {"notes": ["good to know"]}})
    head, _, folded = text.partition("<details")
    assert all(f">no {k}<" in text for k in range(count))
    assert head.count('class="caution"') == open_ones
    assert (f"{count - open_ones} more cautions" in folded) == (count > open_ones)
    assert text.endswith(">good to know</p>")


def test_the_keyframes_are_counted_and_bounded(run, page):
    assert sum(map(len, run.completed)) == 120
    assert page.count('<article class="keyframe"') == browser.MOST_KEYFRAMES == 60
    assert "60 of 120 keyframes, evenly spread" in page
    shown = choose_shown(run.frames, run.completed)
    assert {k.submap for k in shown} == {0, 1}
    assert (shown[0].frame, shown[-1].frame) == (run.completed[0].submap.frames[0], run.completed[1].submap.frames[-1])
    assert run.workspace.report.stat().st_size < 15e6


def test_noisy_pictures_are_coded_more_coarsely(run, monkeypatch):
    shown = choose_shown(run.frames, run.completed, 6)
    limits = [(0.0, 4.0)] * 2

    def size():
        panels = browser._within_budget(shown, run.completed, run.surfaces, limits)
        return sum(len(picture) for panel in panels for picture in panel.pictures)

    fine = size()
    monkeypatch.setattr(browser, "BUDGET", int(0.8 * fine))
    assert size() <= 0.8 * fine


def test_the_scene_holds_what_the_run_holds(run, page):
    data = scene_of(page)
    first, second = data["submaps"]
    assert (first["unit"], second["unit"]) == ("mm", "scene units")
    centres = np.frombuffer(base64.b64decode(first["path"]["places"]), "<f4").reshape(-1, 3)
    np.testing.assert_allclose(centres, 25 * run.completed[0].submap.centres, atol=1e-4)
    mesh, packed = run.surfaces[0].mesh, first["mesh"]
    steps = np.frombuffer(base64.b64decode(packed["vertices"]), "<u2").reshape(-1, 3) / 65535
    np.testing.assert_allclose(packed["low"] + steps * packed["span"], mesh.vertices, atol=0.01)
    assert np.frombuffer(base64.b64decode(packed["faces"]), "<u4").reshape(-1, 3).tolist() == mesh.faces.tolist()
    (region,) = first["missed"]["regions"]
    assert f"nearest frame {run.coverage[0].record['missed_regions'][0]['frame']} (" in region["words"]
    pose = next(np.reshape(view["pose"], (3, 4)) for view in first["shown"] if view["keyframe"] == region["keyframe"])
    patch, camera = run.coverage[0].missed[0].vertices, run.completed[0].camera
    place = patch[np.linalg.norm(patch - region["centre"], axis=1).argmin()]
    (fx, fy), (cx, cy) = camera.focal, camera.centre
    pixel = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]) @ np.linalg.inv([*pose, [0, 0, 0, 1]])[:3] @ [*place, 1]
    size = np.array([camera.width, camera.height])
    assert region["at"] == pytest.approx(pixel[:2] / pixel[2] / size, abs=1e-5)
    assert np.multiply(first["view"], np.repeat([fx, fy], 2)) + np.repeat([cx, cy], 2) == pytest.approx(
        [0, size[0], 0, size[1]], abs=1e-9
    )
    assert second["missed"]["regions"] == []
    assert sum(len(s["shown"]) for s in data["submaps"]) == len(data["shown"]) == 60


def test_every_verdict_has_a_colour_of_its_own(page):
    rules = [page[at : page.index("}", at)].split("{")[1] for v in get_args(Verdict) if (at := page.find(css(v))) >= 0]
    assert len(rules) == len(set(rules)) == len(get_args(Verdict))


def css(verdict):
    return f".v-{verdict.replace(' ', '-')} "


def test_submaps_that_cannot_be_judged_share_one_section(run, page):
    assert not run.coverage[1].picture
    listed = page[page.index("<h2>Coverage of the other submaps</h2>") :]
    assert "submap 1: " in listed[: listed.index("</ul>")]
    assert "further maps are" not in page


def test_the_timeline_counts_every_frame(page):
    film = page[page.index('class="timeline"') : page.index('class="key"') + 1500]
    for words in ("used (125)", "blurred (2)", "black (2)", "overexposed (1)", "duplicate (1)", "posed, submap 1 (30)"):
        assert words in film, words
    assert "used, but not posed (5)" in film
    drawn = re.findall(r'<rect class="s-none"[^>]*width="([0-9.]+)"', film)
    assert 0 < sum(map(float, drawn)) < 0.2 * 1000
    assert film.count('class="shown"') == 60


def test_a_long_video_keeps_its_timeline_small():
    count = 100_000
    verdicts = np.random.default_rng(0).choice(["used", "blurred", "black"], count).tolist()
    states = FrameStates(np.arange(count), np.arange(count) / 30, verdicts, np.zeros(count, int))
    section = timeline_section(states, [], [])
    assert len(section) < 400_000
    assert section.count("<rect") <= 4 * MOST_COLUMNS + 1


@pytest.mark.parametrize("seconds", [[7.0] * 4, [7.0], [0.0, 0.0, 0.0, 9.0]])
def test_times_that_tell_nothing_still_give_a_timeline(seconds):
    count = len(seconds)
    states = FrameStates(np.arange(count), np.array(seconds), ["used"] * count, np.zeros(count, int))
    section = timeline_section(states, [Shown(0, 0, 0, seconds[0])], [])
    assert states.range[1] > states.range[0]
    assert "nan" not in section
    assert f"used ({count})" in section


def test_a_vertex_nowhere_and_a_submap_without_keyframes_are_shown_without_them(tmp_path):
    made = make_tiny_run(tmp_path / "tiny", 12, 4)
    mesh = made.surfaces[0].mesh
    vertices = mesh.vertices.copy()
    vertices[5] = np.nan
    surfaces = [replace(made.surfaces[0], mesh=replace(mesh, vertices=vertices)), made.surfaces[1]]
    completed = [made.completed[0], replace(made.completed[1], rows=made.completed[1].rows[:0])]
    write_page(made.frames, completed, surfaces, *made.parts[3:])
    first, second = scene_of(made.workspace.report.read_text())["submaps"]
    touching = int((mesh.faces == 5).any(axis=1).sum())
    assert first["triangles"] == len(mesh.faces) - touching > 0
    assert second["triangles"] == len(made.surfaces[1].mesh.faces)
    assert second["shown"] == []


def test_a_run_of_many_submaps_stays_under_its_size(tmp_path, monkeypatch):
    """60 submaps with pictures of noise, the worst for any coding: the largest get maps and keyframes, and the page
    says so."""
    made, count = make_tiny_run(tmp_path / "tiny", 12, 4), 60
    picture, rng = tmp_path / "coverage.png", np.random.default_rng(0)
    cv2.imwrite(str(picture), rng.integers(0, 256, (200, 300, 3)))  # 180 kB
    result = replace(made.coverage[0], picture=picture)
    monkeypatch.setattr("pipeline.report.page.pictures.MOST_STATIC", 1)  # a few small pictures, slowly drawn
    submaps = [made.metrics["submaps"][0]] * count
    write_page(
        made.frames,
        [made.completed[0]] * count,
        [made.surfaces[0]] * count,
        [result] * count,
        made.metrics | {"submaps": submaps},
        made.workspace,
    )
    page = made.workspace.report.read_text()
    data = scene_of(page)
    assert len(page) < 15e6
    assert len(data["submaps"]) == count
    assert sum(submap["triangles"] for submap in data["submaps"]) < 1.3 * scene.TRIANGLES
    assert all(submap["triangles"] > 50 for submap in data["submaps"])
    assert {shown["submap"] for shown in data["shown"]} == set(range(browser.MOST_SUBMAPS))
    assert f"60 of {12 * count} keyframes, evenly spread over the 12 largest of 60 submaps" in page
    assert page.count('class="map"') == 6
    assert "54 further maps are in the run folder" in page
    assert page.count("<li>submap ") == count - 6


@pytest.mark.parametrize(
    ("across", "side"),
    [(0, -1), *(pytest.param(*other, marks=pytest.mark.slow) for other in [(1, 1), (0, 1), (1, -1)])],
)
def test_open_wall_is_first_seen_from_the_side_that_is_open(tmp_path, across, side):
    """Else all of it faces away, and "cut open" shows nothing: left, right, above and below the path."""
    made = make_tiny_run(tmp_path)
    whole = made.surfaces[0].mesh
    middles = whole.vertices[whole.faces].mean(axis=1)
    half = SurfaceMesh.from_triangles(whole.vertices, whole.faces[side * middles[:, across] > 0], colours=whole.colours)
    made.surfaces[0] = replace(made.surfaces[0], mesh=half)
    write_page(*made.parts)
    towards = np.array(scene_of(made.workspace.report.read_text())["submaps"][0]["axes"][2])
    used = np.unique(half.faces)
    assert np.mean(half.normals[used] @ towards) > 0.25


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


@pytest.mark.parametrize("factor", [1e-3, 1.0, 1e4])
def test_decimation_knows_no_unit(factor):
    mesh = read_mesh(FOLDER / "mesh.ply")
    target = len(mesh.faces) // 3
    few = decimated(mesh, target)
    scaled = decimated(mesh.transformed(np.diag([factor] * 3 + [1.0])), target)
    assert abs(len(scaled.faces) - len(few.faces)) < 0.01 * target
    np.testing.assert_allclose(scaled.face_areas.sum() / factor**2, few.face_areas.sum(), rtol=1e-3)


def _face_vectors(mesh):
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return np.cross(b - a, c - a)
