"""Many videos: one that fails stops no other, finished ones are kept, and everything is in the table."""

import csv
import json
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

from conftest import textured_frames, write_video
from pipeline import batch, cli
from pipeline.batch import Children, Job, is_finished, plan_jobs, process_pool, run_batch, run_job
from pipeline.batch_table import Outcome, finished_outcome, print_table
from pipeline.config import load_config
from pipeline.errors import HaustraError
from pipeline.progress import SilentProgress
from pipeline.workspace import create_workspace, write_json

METRICS = {
    "frames": {"posed": 9, "total": 12},
    "warnings": [],
    "submaps": [{"area": 3.5, "unit": "mm", "coverage": {"judged": True, "covered_percent": 80.0}}],
}


def finish(video, folder, config=None):
    """A run folder as a finished reconstruction leaves it, as far as a batch looks."""
    workspace = create_workspace(folder, video, config or load_config(None), overwrite=False)
    workspace.finish("report")
    write_json(workspace.metrics, METRICS)
    workspace.lock.release()


@pytest.fixture
def videos(tmp_path):
    for name in ("one/a.mp4", "two/a.mp4", "b.mp4"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(name.encode())
    return [tmp_path / "one" / "a.mp4", tmp_path / "two" / "a.mp4", tmp_path / "b.mp4"]


def test_each_video_has_a_folder_of_its_own_that_it_keeps(videos, tmp_path):
    out = tmp_path / "out"
    jobs = plan_jobs([*videos, videos[0]], out)
    assert [job.video for job in jobs] == videos
    names = [job.folder.name for job in jobs]
    assert names[0] == "a"
    assert names[1].startswith("a-")
    assert names[2] == "b"
    for job in jobs:
        finish(job.video, job.folder)
    # Alone or in another order, each finds its own again.
    assert [job.folder.name for job in plan_jobs([videos[1]], out)] == [names[1]]
    assert [job.folder.name for job in plan_jobs(videos[::-1], out)] == names[::-1]


def test_only_whole_runs_with_the_same_settings_count_as_finished(videos, tmp_path):
    config = load_config(None)
    finish(videos[0], tmp_path / "run")
    assert is_finished(tmp_path / "run", config)
    assert not is_finished(tmp_path / "run", load_config(None, seed=3))
    assert not is_finished(tmp_path / "nowhere", config)
    (tmp_path / "run" / "metrics.json").unlink()
    assert not is_finished(tmp_path / "run", config)


def fake_pool(statuses):
    """A pool that says what it is told, and finishes the runs that it calls done."""

    def pool(jobs, words):
        for job in jobs:
            status = statuses[job.folder.name[0]]
            if status is KeyboardInterrupt:
                raise KeyboardInterrupt
            if status == "done":
                finish(job.video, job.folder)
                yield finished_outcome(job.video, job.folder, "done", 0.5)
            else:
                yield Outcome(str(job.video), str(job.folder), status, 0.1, message="a [red] reason, with a comma")

    return pool


def test_a_failure_stops_no_other_and_a_second_call_tries_it_again(videos, tmp_path, capsys):
    out, config = tmp_path / "out", load_config(None)
    videos = videos[1:]
    first = run_batch(videos, out, [], config, fake_pool({"a": "failed", "b": "done"}), SilentProgress())
    assert [row.status for row in first] == ["failed", "done"]
    rows = list(csv.DictReader((out / "batch.csv").open()))
    assert [row["status"] for row in rows] == ["failed", "done"]
    assert rows[0]["message"] == "a [red] reason, with a comma"
    record = json.loads((out / "batch.json").read_text())[1]
    assert (record["posed"], record["frames"], record["area"], record["covered_percent"]) == (9, 12, 3.5, 80.0)
    print_table(first)
    table = capsys.readouterr().out
    assert "a [red] reason" in " ".join(table.split())
    assert "9/12" in table
    second = run_batch(videos, out, [], config, fake_pool({"a": "done"}), SilentProgress())
    assert {row.video: row.status for row in second} == {str(videos[0]): "done", str(videos[1]): "kept"}


def test_ctrl_c_keeps_what_is_done(videos, tmp_path):
    out = tmp_path / "out"
    pool = fake_pool({"b": "done", "a": KeyboardInterrupt})
    with pytest.raises(KeyboardInterrupt):
        run_batch(videos[::-1], out, [], load_config(None), pool, SilentProgress())
    assert [row["status"] for row in csv.DictReader((out / "batch.csv").open())].count("done") == 1
    assert "not started" in (out / "batch.csv").read_text()


@pytest.mark.parametrize(
    ("program", "words"),
    [
        ("import sys; print('error: no two frames', file=sys.stderr); sys.exit(1)", "no two frames"),
        ("import os; os.kill(os.getpid(), 9)", "ended by SIGKILL; out of memory?"),
        ("raise RuntimeError('a bug')", "RuntimeError: a bug"),
        ("import sys; sys.exit(3)", "exit code 3"),
    ],
)
def test_however_a_process_ends_there_is_one_sentence(tmp_path, monkeypatch, program, words):
    monkeypatch.setattr(
        Children, "run", lambda self, _, log: subprocess.run([sys.executable, "-c", program], stderr=log).returncode
    )
    outcome = run_job(Job(tmp_path / "a.mp4", tmp_path / "a"), [])
    assert outcome.status == "failed"
    assert words in outcome.message
    assert "\n" not in outcome.message


def test_stopping_ends_every_child_as_ctrl_c_would(tmp_path):
    script = "import time\ntry:\n time.sleep(600)\nexcept KeyboardInterrupt:\n raise SystemExit(130)"
    children, codes = Children(), []

    with (tmp_path / "log").open("w") as log:
        command = [sys.executable, "-c", script]
        threads = [threading.Thread(target=lambda: codes.append(children.run(command, log.fileno()))) for _ in range(2)]
        for thread in threads:
            thread.start()
        while len(children._alive) < 2:
            time.sleep(0.01)
        time.sleep(1.0)  # until both sleep
        children.stop()
        for thread in threads:
            thread.join()
        assert children.run(command, log.fileno()) == -signal.SIGINT  # and none starts any more
    assert len(codes) == 2
    assert set(codes) <= {130, -signal.SIGINT}  # stopped while Python itself was starting: the latter


def test_the_command_isolates_failures_and_ends_with_code_1(tmp_path, monkeypatch, capsys):
    """Two videos that cannot be reconstructed, in real processes, through the command line."""
    write_video(tmp_path / "dark.mp4", [np.zeros((96, 96, 3), np.uint8)] * 5)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["haustra", "batch", "dark.mp4", "gone.mp4", "-o", "out", "--jobs", "2", "-q"])
    with pytest.raises(SystemExit) as stop:
        cli.main()
    assert stop.value.code == 1
    said = capsys.readouterr()
    assert "2 of 2 videos failed" in said.err
    messages = {
        row["video"].split("/")[-1]: row["message"] for row in csv.DictReader((tmp_path / "out/batch.csv").open())
    }
    assert "black" in messages["dark.mp4"]
    assert "there is no file or folder" in messages["gone.mp4"]


def test_ray_is_asked_for_by_name(monkeypatch):
    from pipeline.batch_ray import ray_pool

    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(HaustraError, match=r"pip install 'haustra\[cluster\]'"):
        ray_pool("local", 1)


@pytest.mark.slow
def test_a_local_ray_cluster_does_the_same(tmp_path):
    pytest.importorskip("ray", reason="Ray is not installed: pip install 'haustra[cluster]'")
    from pipeline.batch_ray import ray_pool

    write_video(tmp_path / "dark.mp4", [np.zeros((96, 96, 3), np.uint8)] * 5)
    write_video(tmp_path / "short.mp4", textured_frames(1, size=96))
    videos = [tmp_path / "dark.mp4", tmp_path / "short.mp4"]
    rows = run_batch(videos, tmp_path / "out", [], load_config(None), ray_pool("local", 1), SilentProgress())
    assert [row.status for row in rows] == ["failed", "failed"]
    assert "black" in rows[0].message
    assert "only 1 of 1 frames" in rows[1].message


def test_the_pool_gives_outcomes_as_they_come(tmp_path, monkeypatch):
    def slow_first(job, words, children):
        time.sleep(0.3 if job.video.name == "a" else 0)
        return Outcome(str(job.video), str(job.folder), "done")

    monkeypatch.setattr(batch, "run_job", slow_first)
    jobs = [Job(tmp_path / name, tmp_path / name) for name in "ab"]
    assert [outcome.video[-1] for outcome in process_pool(2)(jobs, [])] == ["b", "a"]
