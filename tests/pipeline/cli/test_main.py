"""What the command line says against the settings file, and the options that reach a run."""

import errno
import subprocess
import sys
from contextlib import nullcontext
from inspect import signature
from typing import get_type_hints

import pytest

from completion.training.config import TrainConfig
from haustra.core.errors import CompletionError, HaustraError
from pipeline import run
from pipeline.cli import batch, completion_commands
from pipeline.cli import main as cli
from pipeline.config import FAST_KEYFRAME_MOTION, OdometrySettings, load_config
from pipeline.demo import CAMERA, VIDEO
from pipeline.report import rerun_export
from pipeline.run_folder.workspace import Workspace


@pytest.fixture
def runs(monkeypatch):
    """(output, config) of each run that the command line starts, instead of the run; of a video that is there."""
    started = []
    monkeypatch.setattr(run, "reconstruct", lambda _, output, config, **__: started.append((output, config)))
    return started


def command(monkeypatch, *arguments):
    monkeypatch.setattr(sys, "argv", ["reconstruct", *map(str, arguments)])
    with pytest.raises(SystemExit) as stop:
        cli.reconstruct_main()
    return stop.value.code or 0


def test_a_tensor_that_only_a_cycle_holds_does_not_fail_the_command():
    """Open3D's exit code 1: a run that had ended well was a failed one, where a cycle was left from compiling loops."""
    script = """
import gc, sys
from pipeline.cli.main import run_cleanly
from reconstruction.mesh.open3d_import import import_open3d

def command():
    held = [import_open3d().core.Tensor([1.0])]
    held.append(held)

gc.disable()
sys.exit(run_cleanly(command))
"""
    ended = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=120, check=False)
    assert (ended.returncode, ended.stdout) == (0, ""), ended.stderr


@pytest.mark.parametrize("fault", [KeyboardInterrupt(), OSError(errno.ENOSPC, "full")])
def test_a_command_that_is_cut_short_says_how_to_go_on(tmp_path, monkeypatch, capsys, fault):
    """By the run that it had begun, if any; another command has nothing to go on with."""

    def cut(run):
        with run:
            raise fault

    (tmp_path / "run").mkdir()
    workspace = Workspace(tmp_path / "run")
    monkeypatch.setattr(sys, "argv", ["haustra", "compare"])
    assert cli.run_cleanly(lambda: cut(workspace)) in (1, cli.INTERRUPTED)
    assert capsys.readouterr().err.strip().endswith("give the command again")
    workspace.save()
    cli.run_cleanly(lambda: cut(workspace))
    kept = f"what was finished is kept in {workspace.root}: the same command with --resume goes on"
    assert capsys.readouterr().err.strip().endswith(kept)
    fault.__notes__.clear()
    monkeypatch.setattr(sys, "argv", ["haustra", "batch"])
    cli.run_cleanly(lambda: cut(nullcontext()))
    assert capsys.readouterr().err.strip().endswith("what was finished is kept: the same command goes on")


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
    assert command(monkeypatch, VIDEO, "-o", tmp_path, "--start", 1, "--end", 2.5, "--stride", 3, "-q") == 0
    frames = runs[0][1].frames
    assert (frames.start_s, frames.end_s, frames.stride) == (1.0, 2.5, 3)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ([VIDEO, "--stereo-layout", "side-by-side"], "needs the calibration of both (--stereo)"),
        ([VIDEO, "--stereo", VIDEO, "--stereo-right", VIDEO, "--stereo-layout", "over-under"], "leave one of them out"),
        ([VIDEO, "--stereo", VIDEO, "--stereo-right", VIDEO, "--stereo-layout", "side-by-side"], "leave one of them"),
        ([""], "a path is empty on the command line"),
        ([VIDEO, "-o", ""], "what follows -o is empty on the command line"),
        ([VIDEO, "--output="], "--output= is empty on the command line"),
    ],
)
def test_a_command_that_says_too_little_begins_nothing(monkeypatch, capsys, runs, words, told):
    assert command(monkeypatch, *words) == 1
    error = capsys.readouterr().err
    assert told in error
    assert len(error.splitlines()) == 1
    assert not runs


def test_an_empty_path_is_not_the_current_folder():
    with pytest.raises(HaustraError, match="a path is empty"):
        run.reconstruct("", "out")


def test_a_setting_that_is_not_there_is_named(tmp_path):
    path = tmp_path / "settings.yaml"
    for text, name in (("odometry: {keyframe_motoin: 1}", "odometry.keyframe_motoin"), ("fast: true", "fast")):
        path.write_text(text)
        with pytest.raises(HaustraError, match=f"there is no setting '{name}'"):
            load_config(path)


@pytest.mark.parametrize("value", [".nan", ".inf"])
def test_a_setting_is_a_finite_number(tmp_path, value):
    path = tmp_path / "settings.yaml"
    path.write_text(f"fusion: {{max_error_voxels: {value}}}\n")
    with pytest.raises(HaustraError, match=r"setting 'fusion.max_error_voxels': .* finite number"):
        load_config(path)


def test_fast_means_fewer_keyframes_and_leaves_the_files_word_otherwise(monkeypatch, tmp_path, runs):
    path = tmp_path / "settings.yaml"
    path.write_text("odometry: {keyframe_motion: 0.03}\n")
    for arguments in ((), ("--fast",), ("--config", path), ("--config", path, "--fast")):
        assert command(monkeypatch, VIDEO, "-o", tmp_path, "-q", *arguments) == 0
    motions = [config.odometry.keyframe_motion for _, config in runs]
    assert motions == [OdometrySettings().keyframe_motion, FAST_KEYFRAME_MOTION, 0.03, FAST_KEYFRAME_MOTION]


def test_an_end_before_the_start_is_refused(monkeypatch, tmp_path, runs, capsys):
    assert command(monkeypatch, VIDEO, "-o", tmp_path, "--start", 3, "--end", 2) == 1
    assert (
        capsys.readouterr().err
        == "error: setting 'frames': the end (--end), 2 s, is not after the start (--start), 3 s\n"
    )
    assert runs == []


def test_a_batch_hands_the_part_to_every_video(monkeypatch, tmp_path, runs):
    """The words with which each video's own process is started give the settings that the batch compares runs with."""
    given = []
    arguments = ["haustra", "batch", "a.mp4", "-o", str(tmp_path), "--start", "1", "--stride", "2", "--fast"]
    arguments += ["--jobs", "1", "-q"]
    monkeypatch.setattr(
        batch, "run_batch", lambda _, __, arguments, settings, *___: given.append((arguments, settings)) or []
    )
    monkeypatch.setattr(sys, "argv", arguments)
    with pytest.raises(SystemExit) as stop:
        cli.main()
    assert not stop.value.code
    arguments, settings = given[0]
    assert (settings.frames.start_s, settings.frames.end_s, settings.frames.stride) == (1.0, None, 2)
    assert settings.odometry.keyframe_motion == FAST_KEYFRAME_MOTION
    assert command(monkeypatch, VIDEO, "-o", tmp_path, "-q", *arguments) == 0
    assert runs[0][1] == settings


@pytest.mark.parametrize("option", ["--start", "--end"])
@pytest.mark.parametrize("value", ["nan", "inf"])
def test_a_time_must_be_a_number(monkeypatch, tmp_path, runs, option, value):
    assert command(monkeypatch, VIDEO, "-o", tmp_path, option, value) != 0
    assert runs == []


def test_a_part_beyond_the_end_is_one_sentence(tmp_path):
    for end, told in ((None, "the end"), (600.0, "600 s")):
        config = load_config(None, camera=str(CAMERA), frames={"start_s": 500.0, "end_s": end})
        with pytest.raises(HaustraError, match=f"between 500 s and {told}; the film's last frame is at [0-9.]+ s$"):
            run.reconstruct(VIDEO, tmp_path / "run", config, overwrite=True)


def test_a_recording_is_written_into_the_run_folder(monkeypatch, tmp_path, runs, capsys):
    monkeypatch.setattr(rerun_export, "check_rerun", lambda: None)
    monkeypatch.setattr(rerun_export, "export_rerun", lambda made, target: target)
    assert command(monkeypatch, VIDEO, "-o", tmp_path, "--rerun") == 0
    assert capsys.readouterr().out.strip() == str(tmp_path / "run.rrd")
    assert command(monkeypatch, VIDEO, "-o", tmp_path, "--rerun", "-q") == 0
    assert capsys.readouterr().out == ""


def test_a_missing_recorder_is_told_before_the_work(monkeypatch, tmp_path, runs, capsys):
    monkeypatch.setitem(sys.modules, "rerun", None)
    assert command(monkeypatch, VIDEO, "-o", tmp_path, "--rerun") == 1
    assert "pip install 'haustra[rerun]'" in capsys.readouterr().err
    assert runs == []


@pytest.mark.parametrize("tau", ["nan", "-1", "0", "inf"])
def test_compare_wants_a_positive_distance(monkeypatch, capsys, tmp_path, tau):
    (tmp_path / "run.yaml").write_text("{}")
    monkeypatch.setattr(sys, "argv", ["haustra", "compare", str(tmp_path), str(tmp_path), "--tau-mm", tau])
    with pytest.raises(SystemExit) as stop:
        cli.main()
    assert stop.value.code == 1
    assert "positive distance" in capsys.readouterr().err


def test_a_missing_gpu_is_refused_before_anything_is_written(monkeypatch, tmp_path):
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    with pytest.raises(CompletionError, match="no CUDA device"):
        run.reconstruct(VIDEO, tmp_path / "out", load_config(None).model_copy(update={"device": "cuda"}))
    assert not (tmp_path / "out").exists()


def test_the_help_of_train_names_the_defaults_of_its_settings():
    named = set()
    for name, annotated in get_type_hints(completion_commands.train, include_extras=True).items():
        told = next(
            (o.show_default for o in getattr(annotated, "__metadata__", ()) if hasattr(o, "show_default")), None
        )
        if isinstance(told, str):
            assert told == str(TrainConfig.model_fields[name].default), name
            named.add(name)
    optional = {name for name, of in signature(completion_commands.train).parameters.items() if of.default is None}
    assert named == optional - {"preset", "init"}
