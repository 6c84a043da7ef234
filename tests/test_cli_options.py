"""What the command line says against the settings file, and the options that reach a run."""

import sys

import pytest

from pipeline import cli, cli_runs, rerun_export, run
from pipeline.config import load_config
from pipeline.errors import HaustraError


@pytest.fixture
def runs(monkeypatch):
    """(output, config) of each run that the command line starts, instead of the run."""
    started = []
    monkeypatch.setattr(run, "reconstruct", lambda _, output, config, **__: started.append((output, config)))
    return started


def command(monkeypatch, *words):
    monkeypatch.setattr(sys, "argv", ["reconstruct", *map(str, words)])
    with pytest.raises(SystemExit) as stop:
        cli.reconstruct_main()
    return stop.value.code or 0


def test_an_option_overrides_its_setting_and_leaves_the_section_alone(tmp_path):
    path = tmp_path / "settings.yaml"
    path.write_text("frames: {end_s: 9, long_side: 256, stride: 5}\n")
    frames = load_config(path, frames={"start_s": 1.5, "end_s": None, "stride": 2}).frames
    assert (frames.start_s, frames.end_s, frames.stride, frames.long_side) == (1.5, 9.0, 2, 256)


def test_a_section_that_is_no_mapping_stays_one_sentence(tmp_path):
    path = tmp_path / "settings.yaml"
    for content in ("frames: 5\n", "frames:\n"):
        path.write_text(content)
        with pytest.raises(HaustraError, match=r"setting 'frames'"):
            load_config(path, frames={"start_s": 1.0})


def test_a_part_of_the_video_is_asked_for_by_options(monkeypatch, tmp_path, runs):
    assert command(monkeypatch, "a.mp4", "-o", tmp_path, "--start", 1, "--end", 2.5, "--stride", 3, "-q") == 0
    frames = runs[0][1].frames
    assert (frames.start_s, frames.end_s, frames.stride) == (1.0, 2.5, 3)


def test_an_end_before_the_start_is_refused(monkeypatch, tmp_path, runs, capsys):
    assert command(monkeypatch, "a.mp4", "-o", tmp_path, "--start", 3, "--end", 2) == 1
    assert capsys.readouterr().err == "error: setting 'frames': Value error, end_s must be after start_s\n"
    assert runs == []


def test_a_batch_hands_the_part_to_every_video():
    assert cli_runs.options_of({"start": 1.0, "end": None, "stride": 2}) == ["--start", "1.0", "--stride", "2"]


def test_a_recording_is_written_into_the_run_folder(monkeypatch, tmp_path, runs, capsys):
    monkeypatch.setattr(rerun_export, "import_rerun", lambda: None)
    monkeypatch.setattr(rerun_export, "export_rerun", lambda made, target: target)
    assert command(monkeypatch, "a.mp4", "-o", tmp_path, "--rerun", "-q") == 0
    assert capsys.readouterr().out.strip() == str(tmp_path / "run.rrd")


def test_a_missing_recorder_is_told_before_the_work(monkeypatch, tmp_path, runs, capsys):
    monkeypatch.setitem(sys.modules, "rerun", None)
    assert command(monkeypatch, "a.mp4", "-o", tmp_path, "--rerun") == 1
    assert "pip install 'haustra[rerun]'" in capsys.readouterr().err
    assert runs == []
