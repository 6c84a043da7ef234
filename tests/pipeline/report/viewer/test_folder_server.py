"""The runs of a folder over HTTP: what is listed, what is given, and that nothing else is."""

from __future__ import annotations

import http.client
import json
import re
import threading
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from haustra.core.errors import HaustraError
from pipeline.depth.depth_io import read_depth
from pipeline.report.viewer import run_files
from pipeline.report.viewer.depth_colours import depth_scales
from pipeline.report.viewer.folder_server import FolderServer
from pipeline.report.viewer.run_list import find_runs, row_of
from pipeline.report.viewer.view_folder import view_folder
from tests.helpers.showing.shown_runs import make_shown_run, tum_line


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two finished runs, one a folder deeper, one stopped, one refused, one damaged, a film of a batch without one, and
    things that are no run."""
    root = tmp_path_factory.mktemp("runs")
    make_shown_run(root / "first run")
    make_shown_run(root / "seeds" / "é 2")
    for name, record in {
        "stopped": {"stages": {"frames": {}}},
        "refused": {"stages": {}, "refused": "is black"},
    }.items():
        (root / name).mkdir()
        (root / name / "run.yaml").write_text(yaml.safe_dump(record | {"config": {"seed": 1}}))
    (root / "damaged").mkdir()
    (root / "damaged" / "run.yaml").write_text("[")
    (root / "notes").mkdir()
    failed = [{"folder": "/elsewhere/seeds/unread", "status": "failed", "message": "is not a video"}]
    waits = [{"folder": "/elsewhere/seeds/waits", "status": "not started", "message": ""}]
    has_run = [{"folder": "/elsewhere/seeds/é 2", "status": "failed", "message": "of another call"}]
    (root / "seeds" / "batch.json").write_text(json.dumps(failed + waits + has_run))
    (root / "batch.json").write_text("[{")
    (root / "secret.txt").write_text("secret")
    return root


@pytest.fixture(scope="module")
def ask(folder: Path):
    server = FolderServer(folder)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()

    def call(path: str, **headers: str) -> tuple[int, bytes, str]:
        connection = http.client.HTTPConnection("127.0.0.1", server.server_address[1], timeout=30)
        connection.request("GET", path, headers=headers)
        answer = connection.getresponse()
        return answer.status, answer.read(), answer.headers.get("Content-Security-Policy", "")

    yield call
    server.shutdown()
    server.server_close()
    thread.join()


def test_every_run_is_a_line_and_nothing_else(ask) -> None:
    rows = {row["name"]: row for row in json.loads(ask("/runs")[1])["runs"]}
    assert sorted(rows) == ["damaged", "first run", "refused", "seeds/unread", "seeds/é 2", "stopped"]
    assert (rows["seeds/unread"]["status"], rows["seeds/unread"]["words"]) == ("failed", ["is not a video"])
    assert rows["seeds/é 2"]["status"] == "finished"
    assert [rows[name]["status"] for name in ("stopped", "refused", "damaged")] == ["stopped", "refused", "damaged"]
    assert rows["stopped"]["words"] == ["after frames"]
    assert rows["refused"]["words"] == ["is black"]
    first = rows["first run"]
    assert (first["status"], first["unit"], first["submaps"]) == ("finished", "mm", 2)
    assert first["picture"] is not None


@pytest.mark.parametrize("name", ["first%20run", "seeds/%C3%A9%202"])
def test_a_run_gives_its_frames_depth_and_report(ask, folder: Path, name: str) -> None:
    status, body, _ = ask(f"/player/{name}")
    assert status == 200
    player = json.loads(body)
    index, key = player["frames"][3][0], player["keyframes"][0]
    frame = cv2.imdecode(np.frombuffer(ask(f"/frame/{name}/{index}")[1], np.uint8), cv2.IMREAD_COLOR)
    for kind in ("depth", "confidence"):
        shown = cv2.imdecode(np.frombuffer(ask(f"/{kind}/{name}/{key}")[1], np.uint8), cv2.IMREAD_COLOR)
        assert shown.shape == frame.shape
        assert len(np.unique(shown)) > 3
    assert len(json.loads(ask(f"/scene/{name}")[1])["submaps"]) == 2
    status, report, policy = ask(f"/report/{name}")
    assert status == 200
    assert b'id="run-data"' in report
    assert not policy


def test_depth_has_the_reports_colours_and_ends(ask, folder: Path) -> None:
    """As the report's legend says them, in each submap's unit; also where loop closing moved keyframes."""
    player, report = json.loads(ask("/player/first%20run")[1]), ask("/report/first%20run")[1].decode()
    bars = re.findall(r"<span>([^<]+)</span><span>depth \[([^]]+)\]</span><span>([^<]+)</span>", report)
    assert [(f"{d['low']:.3g}", d["unit"], f"{d['high']:.3g}") for d in player["depths"]] == bars
    assert player["ramps"]["depth"] in report
    first, second = player["depths"]
    key, run = first["keyframes"][0], folder / "first run"
    depth = 25 * read_depth(run / "depth" / f"{key:06d}.png")
    levels = np.clip((depth - first["low"]) / (first["high"] - first["low"]) * 255, 0, 255).astype(np.uint8)
    wanted = cv2.applyColorMap(levels, cv2.COLORMAP_TURBO)
    shown = cv2.imdecode(np.frombuffer(ask(f"/depth/first%20run/{key}")[1], np.uint8), cv2.IMREAD_COLOR)
    assert (shown[depth > 0] == wanted[depth > 0]).all()
    assert second["unit"] == "scene units"


def test_a_moved_keyframes_depth_is_painted_as_moved(tmp_path: Path) -> None:
    make_shown_run(tmp_path / "run")
    record = yaml.safe_load((tmp_path / "run" / "run.yaml").read_text())
    still = depth_scales(tmp_path / "run")[1]
    record["submaps"][1]["depth_scale"] = [2.0] * len(still.keyframes)
    (tmp_path / "run" / "run.yaml").write_text(yaml.safe_dump(record))
    moved = depth_scales(tmp_path / "run")[1]
    assert (moved.low, moved.high) == pytest.approx((2 * still.low, 2 * still.high))


@pytest.mark.parametrize(
    "page", ["/", "/play?run=first%20run", "/compare?a=x&b=y", "/assets/plotly.js", "/assets/style.css"]
)
def test_pages_forbid_what_comes_from_elsewhere(ask, page: str) -> None:
    status, _, policy = ask(page)
    assert status == 200
    assert "default-src 'none'" in policy
    assert "script-src 'self'" in policy


@pytest.mark.parametrize(
    "path",
    [
        "/secret.txt", "/../secret.txt", "/report/..", "/report/notes", "/report/first%20run/../../secret.txt",
        "/frame/first%20run/..%2F..%2Fsecret", "/frame/first%20run/999999", "/frame/first%20run/-1",
        "/depth/first%20run/0x1", "/assets/../secret.txt", "/assets/run_files.py", "/player/none", "/player/refused",
        "/scene/stopped", "/%2e%2e/secret.txt", "//etc/passwd", "/coverage/damaged", "/turn/first%20run::none",
    ],
)  # fmt: skip
def test_what_is_not_there_is_not_given(ask, path: str) -> None:
    status, body, _ = ask(path)
    assert status == 404
    assert b"secret" not in body


def test_a_page_of_another_name_cannot_read_it(ask) -> None:
    assert ask("/runs", Host="evil.example:80")[0] == 403


@pytest.mark.parametrize("seed", range(10))
def test_the_turn_between_two_runs_is_that_of_their_paths(tmp_path: Path, seed: int) -> None:
    """Also where the centres lie on one line, which leaves a roll open."""
    rng = np.random.default_rng(seed)
    spun = Rotation.random(random_state=seed)
    times = np.arange(12) / 30
    centres = np.outer(times, [0, 0, 1.0]) if seed % 2 else np.cumsum(rng.normal(size=(12, 3)), axis=0)
    poses = Rotation.from_rotvec(0.1 * rng.normal(size=(12, 3)))
    for name, turn, scale in (("a", Rotation.identity(), 1.0), ("b", spun, 7.0)):
        (tmp_path / name).mkdir()
        record = {"stages": {}, "config": {}, "source": {"sha256": {"source": "same"}}}
        (tmp_path / name / "run.yaml").write_text(yaml.safe_dump(record))
        lines = [
            tum_line(time, turn.apply(scale * centre), turn * rotation)
            for time, centre, rotation in zip(times, centres, poses, strict=True)
        ]
        (tmp_path / name / "trajectory.tum").write_text("".join(lines))
    found = run_files.turn_between(tmp_path / "a", tmp_path / "b")
    np.testing.assert_allclose(found, spun.inv().as_matrix(), atol=1e-6)


def test_other_films_have_no_turn(tmp_path: Path) -> None:
    for name in "ab":
        (tmp_path / name).mkdir()
        record = {"stages": {}, "config": {}, "source": {"sha256": {"source": name}}}
        (tmp_path / name / "run.yaml").write_text(yaml.safe_dump(record))
    assert run_files.turn_between(tmp_path / "a", tmp_path / "b") is None


def test_a_folder_without_runs_is_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(HaustraError, match="no run lies in it"):
        view_folder(tmp_path, 0, False, print)


def test_a_run_folder_is_a_list_of_itself(folder: Path) -> None:
    assert find_runs(folder / "first run") == {"first run": folder / "first run"}
    assert row_of("x", folder / "damaged").status == "damaged"
