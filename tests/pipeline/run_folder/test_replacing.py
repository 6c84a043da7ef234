"""A run that is replaced: kept until the new one has a camera path, whenever either is stopped or refused."""

import errno
import os
import shutil
from pathlib import Path

import pytest

from haustra.core.errors import HaustraError
from pipeline.config import load_config
from pipeline.live.finish import begin_record, take_folder
from pipeline.run_folder.creating import create_workspace
from pipeline.run_folder.resuming import resume_workspace
from pipeline.run_folder.workspace import open_workspace


class Stopped(BaseException):
    """As a kill, but in this process."""


@pytest.fixture
def old_run(tmp_path):
    """A run with artefacts, and a second video and settings to replace it by."""
    (tmp_path / "a.mp4").write_bytes(b"old")
    (tmp_path / "b.mp4").write_bytes(b"new")
    folder = tmp_path / "run"
    with create_workspace(folder, tmp_path / "a.mp4", load_config(None), overwrite=False) as workspace:
        workspace.finish("structure")
        workspace.finish("depth")
        workspace.depth.mkdir()
        workspace.depth_path(3).write_bytes(b"old depth")
        workspace.mesh.write_bytes(b"old mesh")
        workspace.models.mkdir()
        (workspace.models / "0.npz").write_bytes(b"old poses")
    (folder / "thesis.tex").write_text("precious")
    return folder


def stop_at(monkeypatch, function, name):
    """Let `os.replace`, `shutil.rmtree` or `Path.unlink` end the process, as it were, at a file of this name."""
    owner = {"replace": os, "rmtree": shutil, "unlink": Path}[function]
    real = getattr(owner, function)

    def stop(path, *others, **named):
        if Path(path).name == name:
            raise Stopped
        return real(path, *others, **named)

    monkeypatch.setattr(owner, function, stop)


@pytest.mark.parametrize("when", ["log", "depth", "mesh.ply", "run.yaml", "run.yaml.partial"])
@pytest.mark.parametrize("way", ["resume", "overwrite"])
def test_a_stop_while_an_old_run_is_set_aside_leaves_that_run(old_run, tmp_path, monkeypatch, when, way):
    old, new, config = tmp_path / "a.mp4", tmp_path / "b.mp4", load_config(None, seed=4)
    stop_at(monkeypatch, "replace", when)
    with pytest.raises(Stopped):
        create_workspace(old_run, new, config, overwrite=True)
    monkeypatch.undo()
    if way == "resume":
        workspace = resume_workspace(old_run, old, load_config(None))
    else:
        with pytest.raises(HaustraError, match="already holds a run"):
            create_workspace(old_run, new, config, overwrite=False)
        workspace = resume_workspace(old_run, old, load_config(None))
    with workspace:
        assert workspace.is_done("depth")
        assert workspace.depth_path(3).read_bytes() == b"old depth"
        assert workspace.mesh.read_bytes() == b"old mesh"
    names = {path.name for path in old_run.iterdir()} - {"run.yaml.partial"}
    assert names == {"run.yaml", "depth", "mesh.ply", "thesis.tex", "log", ".lock"}


def test_a_run_that_cannot_be_set_aside_stays(old_run, tmp_path, monkeypatch):
    real = os.replace

    def fail(path, *others):
        if Path(path).name == "mesh.ply":
            monkeypatch.undo()
            raise PermissionError
        real(path, *others)

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(PermissionError):
        create_workspace(old_run, tmp_path / "b.mp4", load_config(None), overwrite=True)
    assert {path.name for path in old_run.iterdir()} == {"run.yaml", "depth", "mesh.ply", "thesis.tex", "log", ".lock"}


def test_a_run_is_kept_until_the_new_one_has_a_camera_path(old_run, tmp_path):
    """Refused before, the folder is as it was; with a path, nothing of the old run is left."""
    before = {path: path.read_bytes() for path in old_run.rglob("*") if path.is_file() and path.name != ".lock"}
    new, config = tmp_path / "b.mp4", load_config(None, seed=4)
    refused = pytest.raises(HaustraError, match=r"too dark; the earlier run in .*run stays as it was")
    with refused, create_workspace(old_run, new, config, overwrite=True) as workspace:
        assert not workspace.mesh.exists()
        workspace.images.mkdir()
        workspace.finish("frames")
        workspace.mesh.write_bytes(b"new mesh")
        raise HaustraError("too dark")
    after = {path: path.read_bytes() for path in old_run.rglob("*") if path.is_file() and path.name != ".lock"}
    assert after == before
    with create_workspace(old_run, new, config, overwrite=True) as workspace:
        workspace.finish("structure")
    assert {path.name for path in old_run.rglob("*")} == {"run.yaml", "log", "thesis.tex", ".lock"}


def test_a_log_that_a_refusal_names_is_kept(old_run, tmp_path):
    refused = pytest.raises(HaustraError, match=r"its log is .*run/log_refused/colmap\.log; the earlier run")
    with refused, create_workspace(old_run, tmp_path / "b.mp4", load_config(None), overwrite=True) as workspace:
        log = workspace.log / "colmap.log"
        log.write_text("why")
        raise HaustraError(f"COLMAP failed; its log is {log}")
    assert (old_run / "log_refused" / "colmap.log").read_text() == "why"
    assert (old_run / "log" / "models" / "0.npz").read_bytes() == b"old poses"


def test_on_a_full_disk_the_kept_run_comes_back(old_run, tmp_path, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    workspace = create_workspace(old_run, tmp_path / "b.mp4", load_config(None), overwrite=True)
    workspace.images.mkdir()
    monkeypatch.setattr(Path, "write_text", full)
    with pytest.raises(HaustraError, match="stays as it was"), workspace:
        raise HaustraError("is the disk full?")
    assert not workspace.images.exists()
    assert workspace.mesh.read_bytes() == b"old mesh"


def test_what_a_stopped_replacement_leaves_is_in_the_way_and_can_be_had_back(old_run, tmp_path):
    create_workspace(old_run, tmp_path / "b.mp4", load_config(None), overwrite=True).lock.release()  # no stage is done
    with pytest.raises(HaustraError, match="already holds a run"):
        create_workspace(old_run, tmp_path / "b.mp4", load_config(None, seed=3), overwrite=False)
    with pytest.raises(HaustraError, match=r"the run that it was to replace is kept: without .*run\.yaml"):
        resume_workspace(old_run, tmp_path / "a.mp4", load_config(None))
    (old_run / "run.yaml").unlink()
    with resume_workspace(old_run, tmp_path / "a.mp4", load_config(None)) as workspace:
        assert workspace.mesh.read_bytes() == b"old mesh"
        assert (workspace.models / "0.npz").exists()


def test_a_kept_run_goes_when_the_new_one_could_not_remove_it(old_run, tmp_path, monkeypatch):
    workspace = create_workspace(old_run, tmp_path / "b.mp4", load_config(None), overwrite=True)
    stop_at(monkeypatch, "replace", ".earlier_run")
    with pytest.raises(Stopped):
        workspace.finish("structure")
    monkeypatch.undo()
    workspace.lock.release()
    with resume_workspace(old_run, tmp_path / "b.mp4", load_config(None)):
        assert not (old_run / ".earlier_run").exists()


def test_a_live_session_takes_the_place_of_both(old_run, tmp_path):
    create_workspace(old_run, tmp_path / "b.mp4", load_config(None), overwrite=True).lock.release()
    told = "camera", tmp_path / "film.mkv", load_config(None)
    with pytest.raises(HaustraError, match=r"already holds a session or run; give another folder \(-o\), --overwrite"):
        take_folder(old_run, overwrite=False)
    lock = take_folder(old_run, overwrite=True)
    begin_record(old_run, *told)
    lock.release()
    assert {path.name for path in old_run.iterdir()} == {"live.json", "thesis.tex", ".lock"}


def stop_after_frames(run, film):
    """A run in place of the old one that is killed before it has a camera path."""
    stopped = create_workspace(run, film, load_config(None), overwrite=True)
    stopped.finish("frames")
    stopped.lock.release()


def test_a_new_run_that_was_stopped_early_does_not_take_the_place_of_the_kept_one(old_run, tmp_path):
    for _ in range(2):
        stop_after_frames(old_run, tmp_path / "b.mp4")
    refused = pytest.raises(HaustraError, match="too dark")
    with refused, resume_workspace(old_run, tmp_path / "b.mp4", load_config(None)):
        raise HaustraError("too dark")
    with resume_workspace(old_run, tmp_path / "a.mp4", load_config(None)) as workspace:
        assert workspace.mesh.read_bytes() == b"old mesh"


@pytest.mark.parametrize("when", ["depth", "mesh.ply"])
def test_a_stop_while_the_kept_run_comes_back_loses_nothing(old_run, tmp_path, monkeypatch, when):
    workspace = create_workspace(old_run, tmp_path / "b.mp4", load_config(None), True)
    stop_at(monkeypatch, "replace", when)
    with pytest.raises(Stopped), workspace:
        raise HaustraError("too dark")
    monkeypatch.undo()
    workspace.lock.release()
    with resume_workspace(old_run, tmp_path / "a.mp4", load_config(None)) as workspace:
        assert workspace.depth_path(3).read_bytes() == b"old depth"
        assert workspace.mesh.read_bytes() == b"old mesh"


@pytest.mark.parametrize("way", ["resume", "overwrite"])
@pytest.mark.parametrize(
    ("function", "when"), [("rmtree", "images"), ("unlink", "mesh.ply"), ("unlink", "report.html")]
)
def test_a_stop_while_an_old_run_is_removed_leaves_a_run(old_run, tmp_path, monkeypatch, function, when, way):
    """Of a run without a camera path, which is not kept: both ways go on from there, and nothing of the old run is
    taken for the new one's."""
    workspace = open_workspace(old_run)
    del workspace.record["stages"]["structure"]
    workspace.save()
    workspace.images.mkdir()
    new, config = tmp_path / "b.mp4", load_config(None, seed=4)
    stop_at(monkeypatch, function, when)
    with pytest.raises(Stopped):
        create_workspace(old_run, new, config, overwrite=True)
    monkeypatch.undo()
    assert open_workspace(old_run).record["stages"] == {}
    if way == "resume":
        workspace = resume_workspace(old_run, new, config)
    else:
        workspace = create_workspace(old_run, new, config, overwrite=True)
    with workspace:
        assert not workspace.depth.exists()
        assert not workspace.mesh.exists()
        assert workspace.log.is_dir()
    with resume_workspace(old_run, new, config) as workspace:
        assert workspace.log.is_dir()
    assert (old_run / "thesis.tex").read_text() == "precious"


def test_a_source_that_cannot_be_read_destroys_no_run(old_run, tmp_path):
    with pytest.raises(FileNotFoundError):
        create_workspace(old_run, tmp_path / "gone.mp4", load_config(None), overwrite=True)
    with resume_workspace(old_run, tmp_path / "a.mp4", load_config(None)) as workspace:
        assert workspace.is_done("depth")
        assert workspace.mesh.read_bytes() == b"old mesh"


def test_a_stop_before_the_first_record_leaves_a_folder_that_is_taken(tmp_path, monkeypatch):
    (tmp_path / "a.mp4").write_bytes(b"any bytes")

    def stop(*_):
        raise Stopped

    monkeypatch.setattr(os, "replace", stop)  # the record is written, but not yet in its place
    with pytest.raises(Stopped):
        create_workspace(tmp_path / "run", tmp_path / "a.mp4", load_config(None), overwrite=False)
    monkeypatch.undo()
    create_workspace(tmp_path / "run", tmp_path / "a.mp4", load_config(None), overwrite=False).lock.release()
