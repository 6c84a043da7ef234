"""Many videos: one that fails stops no other, finished ones are kept, and everything is in the table."""

import csv
import json
import os
import sys
from pathlib import Path

import numpy as np
import pytest

from haustra.core.progress import SilentProgress, TerminalProgress
from pipeline.cli import batch
from pipeline.cli import main as cli
from pipeline.cli import run_commands as cli_runs
from pipeline.cli.batch import ChildProcesses, Job, kept_outcome, plan_jobs, process_pool, resume_hint, run_batch
from pipeline.cli.batch_table import Outcome, finished_outcome, print_table, write_table
from pipeline.config import load_config
from pipeline.run_folder import inputs as run_inputs
from pipeline.run_folder.creating import create_workspace
from pipeline.run_folder.workspace import write_json
from tests.helpers.videos import write_video

METRICS = {
    "frames": {"posed": 9, "total": 12},
    "warnings": [],
    "submaps": [{"area": 3.5, "unit": "mm", "coverage": {"judged": True, "covered_percent": 80.0}}],
}


def finish(video, folder, config=None):
    """A run folder as a finished reconstruction leaves it, as far as a batch looks."""
    workspace = create_workspace(folder, video, config or load_config(None), overwrite=False)
    workspace.finish("report")
    workspace.mesh.touch()
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


@pytest.mark.parametrize("lost", ["metrics.json", "mesh.ply"])
def test_only_whole_runs_with_the_same_settings_count_as_finished(videos, tmp_path, lost):
    config, job = load_config(None), Job(videos[0], tmp_path / "run")
    finish(job.video, job.folder)
    assert kept_outcome(job, config).area == 3.5
    assert kept_outcome(job, load_config(None, seed=3)) is None
    assert kept_outcome(Job(videos[0], tmp_path / "nowhere"), config) is None
    (tmp_path / "run" / lost).unlink()
    assert kept_outcome(job, config) is None


@pytest.mark.parametrize("metrics", ["[]", "{", '{"frames": {"posed": "many"}}', '{"submaps": [{"area": []}]}'])
def test_damaged_figures_are_a_failed_row_and_the_run_is_gone_on_with(videos, tmp_path, metrics):
    job = Job(videos[0], tmp_path / "run")
    finish(job.video, job.folder)
    (job.folder / "metrics.json").write_text(metrics)
    outcome = finished_outcome(job.video, job.folder, "done")
    assert outcome.status == "failed"
    assert "metrics.json cannot be read" in outcome.message
    assert kept_outcome(job, load_config(None)) is None


def test_a_run_is_kept_only_while_its_files_are_the_same(videos, tmp_path, monkeypatch):
    camera = tmp_path / "camera.json"
    camera.write_text("one")
    config, job = load_config(None, camera=str(camera)), Job(videos[0], tmp_path / "run")
    finish(job.video, job.folder, config)
    read = []
    monkeypatch.setattr(run_inputs, "digest", lambda path, digest=run_inputs.digest: read.append(path) or digest(path))
    assert kept_outcome(job, config) is not None
    assert read == [], "what looks untouched is not read again"
    os.utime(videos[0], ns=(0, 0))
    assert kept_outcome(job, config) is not None, "touched, but the same bytes"
    assert read == [videos[0]]
    for path in (videos[0], camera):
        before = path.read_bytes()
        path.write_bytes(before[::-1])  # as long as before
        os.utime(path, ns=(1, 1))
        assert kept_outcome(job, config) is None, f"another {path.name}"
        path.write_bytes(before)
        assert kept_outcome(job, config) is not None
    camera.unlink()
    assert kept_outcome(job, config) is None


def fake_pool(statuses):
    """A pool that says what it is told, and finishes the runs that it calls done."""

    def pool(jobs, arguments):
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


BLOCKED = {
    "the log is a folder": lambda out: (out / "b.log").mkdir(),
    "the record is a folder": lambda out: (out / "b" / "run.yaml").mkdir(parents=True),
    "the record is no record": lambda out: (
        (out / "b").mkdir(),
        (out / "b" / "run.yaml").write_bytes(b"a: 2001-99-99"),
    ),
    "the run folder is a file": lambda out: (out / "b").write_text(""),
}


@pytest.mark.parametrize("blocked", BLOCKED)
def test_whatever_is_wrong_with_one_video_is_a_row_and_the_others_go_on(videos, tmp_path, monkeypatch, blocked):
    out = tmp_path / "out"
    out.mkdir()
    BLOCKED[blocked](out)

    def refuse_b(self, command, log):
        video, folder = Path(command[5]), Path(command[7])
        if folder.name == "b":
            return 1
        finish(video, folder)
        return 0

    monkeypatch.setattr(ChildProcesses, "run", refuse_b)
    outcomes = run_batch([videos[2], videos[0]], out, [], load_config(None), process_pool(1), SilentProgress())
    assert [outcome.status for outcome in outcomes] == ["failed", "done"]
    assert [row["status"] for row in csv.DictReader((out / "batch.csv").open())] == ["failed", "done"]


def test_names_on_disk_clash_with_no_log_and_no_table(tmp_path):
    names = ["b.mp4", "b.log.mp4", "B.mp4", "batch.csv.mp4", "\N{SNOWMAN}" * 84 + ".mp4", "x" * 251, "caf\udce9.mp4"]
    videos, out = [tmp_path / name for name in names], tmp_path / "out"
    out.mkdir()
    for order in (videos, videos[::-1]):
        jobs = plan_jobs(order, out)
        paths = [path.name.casefold() for job in jobs for path in (job.folder, job.log)] + ["batch.csv", "batch.json"]
        assert len(set(paths)) == len(paths), "two things of one name"
        for job in jobs:
            with job.log.open("w") as log:
                log.write(job.folder.name)  # not too long, and letters that can be written
    table = [Outcome(str(job.video), str(job.folder), "failed") for job in jobs]
    write_table(table, out)
    assert len(list(csv.DictReader((out / "batch.csv").open()))) == len(names)
    print_table(table)


def test_brackets_in_names_are_no_markup(tmp_path, capsys):
    outcome = Outcome(str(tmp_path / "scan[left].mp4"), str(tmp_path), "failed", message="lost [/tmp/x] and [b]")
    print_table([outcome])
    told = " ".join(capsys.readouterr().out.split())
    assert "scan[left].mp4" in told
    assert "lost [/tmp/x] and [b]" in told
    progress = TerminalProgress()
    progress.log(outcome.sentence)
    with progress.bar("of [/tmp/x]", 2) as advance:
        advance(1, note="[/tmp/y]")
    told = capsys.readouterr().err
    assert "scan[left].mp4 failed: lost [/tmp/x] and [b]" in told
    assert "of [/tmp/x]" in told
    assert "[/tmp/y]" in told


def test_overwrite_replaces_what_is_of_other_settings_or_another_video_alone(videos, tmp_path, monkeypatch):
    """Finished and the same: kept. Stopped and the same: gone on with. All else: replaced, if that is asked for."""
    for name in ("done", "stopped", "other", "replaced", "damaged", "new"):
        (tmp_path / f"{name}.mp4").write_text(name)
    given, out, config = sorted(tmp_path.glob("*.mp4")), tmp_path / "out", load_config(None)
    for name, made_with in {"done": config, "replaced": config, "other": load_config(None, seed=7)}.items():
        finish(tmp_path / f"{name}.mp4", out / name, made_with)
    create_workspace(out / "stopped", tmp_path / "stopped.mp4", config, overwrite=False).lock.release()
    (tmp_path / "replaced.mp4").write_text("a longer film")
    (out / "damaged").mkdir()
    (out / "damaged" / "run.yaml").write_text("stages: [")

    def how(overwrite):
        asked = {}

        def run(self, command, log):
            asked[Path(command[7]).name] = next((word for word in command if word in ("--resume", "--overwrite")), "")
            return 1

        monkeypatch.setattr(ChildProcesses, "run", run)
        run_batch(given, out, ["--seed", "0"], config, process_pool(1), SilentProgress(), overwrite)
        return asked

    every = {"b": "", "new": "", "stopped": "--resume"}
    assert how(False) == every | dict.fromkeys(("other", "replaced", "damaged"), "--resume")
    told = "3 because of a run of another video or with other settings in the folder, which --overwrite replaces"
    assert resume_hint(given, out, config, 3) == told  # there are no others to try again
    assert resume_hint(given, out, config, 4) == told + "; the same command tries the others again"
    assert resume_hint([tmp_path / "stopped.mp4", videos[2]], out, config, 2) == "the same command tries them again"
    assert how(True) == every | dict.fromkeys(("other", "replaced", "damaged"), "--overwrite")


def test_files_are_named_in_full_in_options_and_settings(videos, tmp_path, monkeypatch):
    """A Ray task starts in a folder of its own."""
    monkeypatch.chdir(tmp_path)
    for name in ("lens.json", "net.safetensors", "scale.json", "simcol3d"):
        Path(name).write_text("{}")
    Path("c.yaml").write_text("scale_file: scale.json\nmodel: net.safetensors\n")
    told = {}

    def look(videos, output, arguments, config, *_):
        told.update(arguments=arguments, config=config)
        return []

    monkeypatch.setattr(batch, "run_batch", look)
    arguments = ["haustra", "batch", "b.mp4", "-o", "out", "--camera", "lens.json", "--config", "c.yaml", "-q"]
    monkeypatch.setattr(sys, "argv", arguments)
    with pytest.raises(SystemExit) as stop:
        cli.main()
    assert stop.value.code == 0
    config, arguments = told["config"], told["arguments"]
    full = [str(tmp_path / name) for name in ("lens.json", "net.safetensors", "scale.json")]
    assert [config.camera, config.model, config.scale_file] == full
    assert [arguments[arguments.index(option) + 1] for option in ("--camera", "--model", "--scale")] == full
    assert arguments[arguments.index("--config") + 1] == str(tmp_path / "c.yaml")
    assert cli_runs.files_in_full(load_config(None, camera="simcol3d")) == {}, "a preset, whatever lies here"


def test_ctrl_c_keeps_what_is_done(videos, tmp_path):
    out = tmp_path / "out"
    pool = fake_pool({"b": "done", "a": KeyboardInterrupt})
    with pytest.raises(KeyboardInterrupt):
        run_batch(videos[::-1], out, [], load_config(None), pool, SilentProgress())
    assert [row["status"] for row in csv.DictReader((out / "batch.csv").open())].count("done") == 1
    assert "not started" in (out / "batch.csv").read_text()


def test_the_command_isolates_failures_and_ends_with_code_1(tmp_path, monkeypatch, capsys):
    """Two videos that cannot be reconstructed, one in a real process, through the command line."""
    write_video(tmp_path / "dark.mp4", [np.zeros((96, 96, 3), np.uint8)] * 5)
    (tmp_path / "out" / "logless.log").mkdir(parents=True)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["haustra", "batch", "logless.mp4", "dark.mp4", "-o", "out", "--jobs", "1", "-q"])
    with pytest.raises(SystemExit) as stop:
        cli.main()
    assert stop.value.code == 1
    said = capsys.readouterr()
    assert "2 of 2 videos failed" in said.err
    messages = {
        row["video"].split("/")[-1]: row["message"] for row in csv.DictReader((tmp_path / "out/batch.csv").open())
    }
    assert "black" in messages["dark.mp4"]
    assert "IsADirectoryError" in messages["logless.mp4"]


def test_videos_of_one_name_are_told_apart_by_their_run_folders(capsys):
    films = [Outcome(f"/{day}/v.mp4", f"/out/{run}", "failed", message="why") for day, run in ((1, "v"), (2, "v-ab12"))]
    print_table([*films, Outcome("/1/w.mp4", "/out/w", "failed", message="why")])
    said = capsys.readouterr().out
    for name in ("v.mp4 (in v)", "v.mp4 (in v-ab12)", "w.mp4"):
        assert f"{name}: why" in said
    print_table(films[:1])
    assert capsys.readouterr().out.startswith("1 video: 1 failed")
