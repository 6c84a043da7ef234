"""A live session from the film to the run: looked at in a browser, killed in the middle, gone on with."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import urllib.request
from contextlib import contextmanager

import pytest

from haustra.core.errors import HaustraError
from haustra.core.progress import SilentProgress
from pipeline.config import load_config
from pipeline.demo import CAMERA, VIDEO
from pipeline.live.finish import begin_record, read_record, take_folder
from pipeline.live.live_run import live
from pipeline.live.session import LiveSession
from pipeline.run import reconstruct
from pipeline.run_folder.creating import create_workspace
from tests.helpers.processes import wait_for
from tests.helpers.showing.chromium import CHROMIUM, FLAGS, PATIENCE_MS, complaints, until

SETTINGS = f"""
camera: {CAMERA}
front_end: sfm
lumen_mm: 40.0
frames: {{end_s: 0.86, stride: 2}}
"""


@contextmanager
def session(folder, *options):
    """`haustra live` of the embedded clip, played again and again, as a process; and the page's address."""
    command = [sys.executable, "-P", "-c", "from pipeline.cli.main import main; main()", "live", str(VIDEO)]
    command += ["-o", str(folder), "--no-browser", "--loops", "200", *options]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    try:
        line = process.stdout.readline()
        while line and "http://" not in line:
            line = process.stdout.readline()
        yield process, line.split()[0]
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


def told(address):
    with urllib.request.urlopen(address + "state", timeout=30) as answer:
        return json.load(answer)


def test_a_session_ends_with_its_film_and_is_recorded(tmp_path):
    config = load_config(None, camera=str(CAMERA))
    folder = tmp_path / "run"
    assert live(str(VIDEO), folder, config, SilentProgress(), open_browser=False, finish=False) is None
    record = read_record(folder)
    counts = record.figures["counts"]
    assert record.recording.samefile(VIDEO)
    assert record.config == config
    assert counts["came"] == 165 >= counts["tracked"] + counts["skipped"]
    assert counts["shown"] >= 2
    assert record.figures["surface_after_s"]["median"] > 0
    with pytest.raises(HaustraError, match="--resume finishes it, --overwrite replaces it"):
        live(str(VIDEO), folder, config, SilentProgress(), open_browser=False)


def refused(session):
    raise HaustraError("the source cannot be opened")


def test_a_source_that_shows_nothing_leaves_the_folder_to_the_next_command(tmp_path, monkeypatch):
    monkeypatch.setattr(LiveSession, "run", refused)
    with pytest.raises(HaustraError, match="cannot be opened"):
        live("tcp://127.0.0.1:1", tmp_path / "run", load_config(None), SilentProgress(), open_browser=False)
    assert [path.name for path in (tmp_path / "run").iterdir()] == [".lock"]


@pytest.mark.parametrize(
    ("left", "stub"),
    [
        pytest.param(("run.yaml", "live.json"), True, id="run"),
        pytest.param(("run.yaml", "live.json"), False, id="run, found out by a session", marks=pytest.mark.slow),
        pytest.param(("live.json", "film.mkv"), False, id="session", marks=pytest.mark.slow),
    ],
)
def test_a_source_that_shows_nothing_leaves_what_it_was_to_replace(tmp_path, monkeypatch, left, stub):
    """A mistyped address had removed a finished run, or the record without which no --resume finds its recording."""
    folder = tmp_path / "run"
    lock = take_folder(folder, overwrite=False)
    begin_record(folder, "camera", folder / "film.mkv", load_config(None))
    lock.release()
    if "run.yaml" in left:
        with create_workspace(folder, VIDEO, load_config(None), False) as workspace:
            workspace.finish("structure")
        (folder / "mesh.ply").write_text("old")
    else:
        (folder / "film.mkv").write_bytes(b"old")
    before = {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}
    assert set(left) <= set(before)
    if stub:  # a session finds it out once its network is loaded, which takes long
        monkeypatch.setattr(LiveSession, "run", refused)
    with pytest.raises(HaustraError, match="cannot be opened"):
        live("tcp://127.0.0.1:1", folder, load_config(None), SilentProgress(), open_browser=False, overwrite=True)
    assert {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()} == before


def test_another_session_replaces_a_run_and_leaves_the_users_files(tmp_path):
    folder = tmp_path / "run"
    with create_workspace(folder, VIDEO, load_config(None), False) as workspace:
        workspace.finish("frames")
    (folder / "mesh.ply").write_text("old")
    (folder / "notes.txt").write_text("mine")
    with pytest.raises(HaustraError, match="--overwrite replaces it"):
        take_folder(folder, overwrite=False)
    lock = take_folder(folder, overwrite=True)
    begin_record(folder, "film", VIDEO, load_config(None))
    lock.release()
    assert sorted(path.name for path in folder.iterdir() if path.is_file()) == [".lock", "live.json", "notes.txt"]


@pytest.mark.slow
def test_a_session_that_was_killed_is_finished_by_resume_as_reconstruct_would(tmp_path):
    settings = tmp_path / "settings.yaml"
    settings.write_text(SETTINGS)
    folder = tmp_path / "run"
    with session(folder, "--config", str(settings)) as (process, address):
        wait_for(lambda: told(address)["counts"]["shown"] >= 1)
        process.send_signal(signal.SIGKILL)
        process.wait()
    command = [sys.executable, "-P", "-c", "from pipeline.cli.main import main; main()"]
    subprocess.run([*command, "live", "--resume", "-o", str(folder), "-q"], check=True)
    reconstruct(VIDEO, tmp_path / "straight", load_config(settings))
    for name in ("mesh.ply", "trajectory.tum"):
        assert (folder / name).read_bytes() == (tmp_path / "straight" / name).read_bytes()
    assert not (folder / "live").exists()


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here: apt-get install chromium")
def test_the_page_shows_a_surface_that_grows_until_q(tmp_path):
    sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed: pip install playwright")
    said = []
    with (
        session(tmp_path / "run", "--camera", str(CAMERA), "--no-finish") as (process, address),
        sync_api.sync_playwright() as playwright,
    ):
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=list(FLAGS))
        page = browser.new_page(viewport={"width": 1300, "height": 900})
        page.set_default_timeout(PATIENCE_MS)
        page.on("console", lambda message: said.append(message.text))
        page.on("pageerror", lambda error: said.append(f"error: {error}"))
        page.goto(address)

        first = {}  # triangles of each map when it was first drawn

        def has_grown():
            state = told(address)
            if state["faces"]:
                first.setdefault(state["map"], state["faces"])
            return state["faces"] > first.get(state["map"], state["faces"])

        def drawn():
            return int(page.get_attribute("#view3d", "data-drawn") or 0)

        until(page, lambda: drawn() > 0)
        before, empty = drawn(), page.locator("#view3d").screenshot()
        until(page, has_grown)
        until(page, lambda: drawn() > before)
        assert page.locator("#view3d").screenshot() != empty
        assert page.inner_text("#headline") in ("Tracking", "Lost", "Starting", "No view")
        assert page.locator("#frame").evaluate("image => image.naturalWidth") > 0
        page.click("#outside")
        until(page, lambda: page.get_attribute("#outside", "aria-pressed") == "true")
        page.keyboard.press("q")
        assert process.wait(60) == 0
        browser.close()
    assert complaints(said) == [] or all("net::ERR_" in text for text in complaints(said))
