"""What a run survives: being killed, a second process in its folder, a depth map of nothing, a pose gone wild."""

import errno
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from haustra.core.errors import HaustraError
from haustra.core.progress import SilentProgress
from pipeline.config import load_config
from pipeline.demo import CAMERA, VIDEO
from pipeline.run_folder.creating import create_workspace
from pipeline.run_folder.lock import RunLock
from pipeline.run_folder.resuming import resume_workspace
from pipeline.run_folder.subprocesses import run_isolated
from pipeline.run_folder.workspace import open_workspace
from tests.helpers.processes import alive, wait_for
from tests.helpers.sphere_views import RADIUS, fuse, sphere_depth, views

HOLDER = """
import sys, time
from pathlib import Path
from pipeline.run_folder.lock import RunLock
lock = RunLock(Path(sys.argv[1]))
print("held", flush=True)
time.sleep(600)
"""


def start_holder(folder):
    holder = subprocess.Popen([sys.executable, "-c", HOLDER, str(folder)], stdout=subprocess.PIPE, text=True)
    assert holder.stdout.readline() == "held\n"
    return holder


def test_a_second_process_is_refused_until_the_first_is_killed(tmp_path):
    video = tmp_path / "a.mp4"
    video.write_bytes(b"any bytes")
    config, folder = load_config(None), tmp_path / "run"
    create_workspace(folder, video, config, overwrite=False).lock.release()
    holder = start_holder(folder)
    try:
        before = (folder / "run.yaml").read_bytes()
        for attempt in (
            lambda: resume_workspace(folder, video, config),
            lambda: create_workspace(folder, video, config, overwrite=True),
        ):
            with pytest.raises(HaustraError, match="another process is working in"):
                attempt()
        assert (folder / "run.yaml").read_bytes() == before
        open_workspace(folder)  # who only reads is let in
    finally:
        holder.kill()
        holder.wait()
    with resume_workspace(folder, video, config):
        pass


def test_a_refused_run_leaves_the_folder_unlocked(tmp_path):
    video = tmp_path / "a.mp4"
    video.write_bytes(b"any bytes")
    folder = tmp_path / "run"
    with create_workspace(folder, video, load_config(None), overwrite=False) as workspace:
        workspace.finish("frames")
    with pytest.raises(HaustraError, match="already holds a run; add --resume"):
        create_workspace(folder, video, load_config(None), overwrite=False)
    with pytest.raises(HaustraError, match=r"holds a run; its settings were others \(seed: 0, now 7\), so --overwrite"):
        create_workspace(folder, video, load_config(None, seed=7), overwrite=False)
    with pytest.raises(HaustraError, match="other settings"):
        resume_workspace(folder, video, load_config(None, seed=7))
    (tmp_path / "b.mp4").write_bytes(b"another film")
    with pytest.raises(HaustraError, match=r"it is of another source, .*a\.mp4: give another folder"):
        create_workspace(folder, tmp_path / "b.mp4", load_config(None), overwrite=False)
    RunLock(folder).release()


@pytest.mark.parametrize("code", [errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS])
def test_a_file_system_without_locks_is_told_of_once(tmp_path, monkeypatch, caplog, code):
    fcntl = pytest.importorskip("fcntl")

    def refuse(*_):
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(fcntl, "flock", refuse)
    for _ in range(2):
        RunLock(tmp_path).release()
    assert [record.getMessage().split(";")[0] for record in caplog.records] == [
        f"the file system of {tmp_path} has no locks"
    ]


@pytest.mark.parametrize("code", [errno.EIO, errno.EBADF, errno.EINVAL])
def test_a_lock_that_fails_otherwise_is_an_error(tmp_path, monkeypatch, code):
    fcntl = pytest.importorskip("fcntl")

    def refuse(*_):
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(fcntl, "flock", refuse)
    with pytest.raises(HaustraError, match=rf"cannot lock .*{os.strerror(code)}"):
        RunLock(tmp_path)


CHILD_OF_ISOLATION = """
import time
print("1 2", flush=True)
time.sleep(600)
"""
PARENT = """
import os, sys
from pathlib import Path
from pipeline.run_folder.subprocesses import run_isolated
from haustra.core.progress import SilentProgress
sys.path.insert(0, sys.argv[1])
os.environ["PYTHONPATH"] = sys.argv[1]
run_isolated("sleeper", "sleep", {}, Path(sys.argv[1]) / "x.log", "sleeping", SilentProgress())
"""


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux ends a child with its parent")
def test_a_worker_dies_with_the_run_that_is_killed(tmp_path):
    """Else it would go on writing into the features that a resumed run reads."""
    (tmp_path / "sleeper.py").write_text(CHILD_OF_ISOLATION)
    parent = subprocess.Popen([sys.executable, "-c", PARENT, str(tmp_path)])
    wait_for(lambda: len(alive(tmp_path)) == 2)
    parent.kill()
    parent.wait()
    wait_for(lambda: alive(tmp_path) == [])


def test_a_worker_that_is_late_is_stopped(tmp_path, monkeypatch):
    (tmp_path / "sleeper.py").write_text(CHILD_OF_ISOLATION)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    begun = time.monotonic()
    with pytest.raises(HaustraError, match="sleeping was stopped: the time that it was given is over"):
        run_isolated("sleeper", "sleep", {}, tmp_path / "x.log", "sleeping", SilentProgress(), begun + 2.0)
    assert time.monotonic() - begun < 60  # of the 600 s that it would sleep
    assert alive(tmp_path) == []


@pytest.mark.parametrize("distance", [3.0, 60.0, 1e4])
def test_a_keyframe_with_a_wild_pose_spoils_no_surface(distance):
    """A sphere seen by ten, and an eleventh whose pose is anywhere: three must agree on every piece of surface."""
    poses = views()
    depths = [sphere_depth(world_from_camera) for world_from_camera in poses]
    wild = poses[0].copy()
    wild[:3, 3] += distance * np.array([1.0, 0.5, -0.3]) / np.linalg.norm([1.0, 0.5, -0.3])
    clean = fuse(poses, depths, min_observations=3)
    mesh = fuse([*poses, wild], [*depths, depths[0]], min_observations=3)
    off = np.abs(np.linalg.norm(mesh.vertices, axis=1) - RADIUS)
    assert np.median(off) < 0.3
    assert (off > 3).mean() < 0.02
    assert cKDTree(mesh.vertices).query(clean.vertices)[0].max() < 4  # and none of it is gone


def test_a_depth_map_of_nothing_changes_nothing():
    poses = views(6)
    depths = [sphere_depth(world_from_camera) for world_from_camera in poses]
    nothing = np.full_like(depths[0], np.nan)
    with_it, without = fuse([*poses, poses[0]], [*depths, nothing]), fuse(poses, depths)
    np.testing.assert_array_equal(with_it.vertices, without.vertices)


def tiny_command(folder, *more):
    """The first 26 frames of the embedded clip, every second one used."""
    settings = folder.with_suffix(".yaml")
    settings.write_text("frames: {end_s: 0.86, stride: 2}\nlumen_mm: 40.0\ndepth: {multiview: true}\n")
    words = [sys.executable, "-m", "pipeline", str(VIDEO), "-o", str(folder), "--camera", str(CAMERA), "-q"]
    return [*words, "--config", str(settings), *more]


KILLED_WHEN = {
    "frames are being read": lambda folder: any((folder / "images").glob("*.jpg")),
    "the camera's path is being found": lambda folder: "frames" in open_workspace(folder).record["stages"],
    "depth is being completed": lambda folder: len(list((folder / "first_depth").glob("0*.png"))) >= 4,
    "depth is being refined": lambda folder: len(list((folder / "depth").glob("0*.png"))) >= 2,
    "the surface is being fused": lambda folder: "multiview" in open_workspace(folder).record["stages"],
    "the report is being written": lambda folder: "surface" in open_workspace(folder).record["stages"],
}


@pytest.mark.slow
@pytest.mark.parametrize("front_end", ["odometry", "sfm"])
def test_killed_at_every_stage_it_ends_the_same(tmp_path, front_end):
    """kill -9 six times in the life of one run: at each the next stage is just under way."""
    undisturbed, folder = tmp_path / "undisturbed", tmp_path / "run"
    asked = ("--front-end", front_end)
    subprocess.run(tiny_command(undisturbed, *asked), check=True)
    resume: tuple[str, ...] = ()
    for stage, reached in KILLED_WHEN.items():
        process = subprocess.Popen(tiny_command(folder, *asked, *resume), start_new_session=True)
        wait_for(lambda: process.poll() is not None or ((folder / "run.yaml").exists() and reached(folder)), 300)  # noqa: B023
        assert process.poll() is None, f"it ended before {stage}"
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
        resume = ("--resume",)
    subprocess.run(tiny_command(folder, *asked, "--resume"), check=True)
    for name in ("trajectory.tum", "mesh.ply", "sparse/0/points3D.bin"):
        assert (folder / name).read_bytes() == (undisturbed / name).read_bytes(), f"{name} depends on the kills"
    assert not Path(folder / "metrics.json.partial").exists()
