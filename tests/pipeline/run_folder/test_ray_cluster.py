"""What a Ray cluster is given to do comes out as it does without one."""

import sys

import numpy as np
import pytest

from haustra.core.errors import HaustraError
from haustra.core.progress import SilentProgress
from haustra.core.ray_table import RayTable
from pipeline.cli.batch import run_batch
from pipeline.config import Config, load_config
from pipeline.frontend.odometry.chunks import jobs_of, local_run, ray_run, temp_dir, track_chunks
from pipeline.mapping.submap_of_map import to_submap
from tests.helpers.tubes.textured_tube import CAMERA, camera_at, render, stored
from tests.helpers.videos import textured_frames, write_video

IMAGES = [render(camera_at(k)) for k in range(30)]
RAYS = RayTable(CAMERA)


@pytest.mark.parametrize("asked", ["batch", "chunks"])
def test_ray_is_asked_for_by_name(monkeypatch, asked):
    from pipeline.cli.batch_ray import ray_pool

    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(HaustraError, match=r"pip install 'haustra\[cluster\]'"):
        ray_pool("local", 1) if asked == "batch" else ray_run("local")


@pytest.mark.slow
def test_a_local_ray_cluster_does_the_same(tmp_path):
    pytest.importorskip("ray", reason="Ray is not installed: pip install 'haustra[cluster]'")
    from pipeline.cli.batch_ray import ray_pool

    write_video(tmp_path / "dark.mp4", [np.zeros((96, 96, 3), np.uint8)] * 5)
    write_video(tmp_path / "short.mp4", textured_frames(1, size=96))
    videos = [tmp_path / "dark.mp4", tmp_path / "short.mp4"]
    rows = run_batch(videos, tmp_path / "out", [], load_config(None), ray_pool("local", 1), SilentProgress())
    assert [row.status for row in rows] == ["failed", "failed"]
    assert "black" in rows[0].message
    assert "only 1 of 1 frames" in rows[1].message


@pytest.mark.slow
def test_chunks_on_a_local_cluster_are_those_of_processes(tmp_path):
    pytest.importorskip("ray", reason="Ray is not installed: pip install 'haustra[cluster]'")
    found = []
    for name, run in (("ray", ray_run("local")), ("here", local_run(2))):
        (tmp_path / name).mkdir()
        workspace, frames = stored(tmp_path / name, IMAGES[:30])
        jobs = jobs_of(frames.index, CAMERA, [range(18), range(8, 30)], Config().front_end_settings, workspace)
        maps, stitching = track_chunks(jobs, RAYS, run, SilentProgress())
        assert stitching.chunks == 2
        assert len(list(temp_dir(workspace).glob("*.npz"))) == 2
        found.append([to_submap(m, CAMERA.params) for m in maps])
    for one, other in zip(*found, strict=True):
        np.testing.assert_array_equal(one.world_from_camera, other.world_from_camera)


@pytest.mark.slow
def test_a_chunk_that_fails_on_the_cluster_is_one_sentence(tmp_path):
    pytest.importorskip("ray", reason="Ray is not installed: pip install 'haustra[cluster]'")
    workspace, frames = stored(tmp_path, IMAGES[:5])
    (job,) = jobs_of(frames.index + 100, CAMERA, [range(5)], Config().front_end_settings, workspace)
    with pytest.raises(HaustraError, match=r"chunk 0 failed: .*missing or damaged"):
        track_chunks([job], RAYS, ray_run("local"), SilentProgress())
