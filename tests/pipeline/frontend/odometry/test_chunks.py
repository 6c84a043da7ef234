"""A film tracked in overlapping chunks: cut, kept on disk, sewn where both sides posed the same frames."""

import copy
import json
from functools import lru_cache
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from haustra.core.errors import HaustraError
from haustra.core.progress import SilentProgress
from haustra.core.ray_table import RayTable
from haustra.core.sim3 import transform_points
from pipeline.config import Config, OdometrySettings, load_config
from pipeline.frontend.odometry import chunks
from pipeline.frontend.odometry.chunk_stitching import first_from_second
from pipeline.frontend.odometry.chunks import jobs_of, local_run, split, stitch_chunks, temp_dir, track_chunks
from pipeline.frontend.odometry.frame_io import frame_features
from pipeline.frontend.odometry.front_end import track_frames
from pipeline.frontend.registry import check_front_end
from pipeline.frontend.structure_stage import solve_structure
from pipeline.mapping import submap_merging
from pipeline.mapping.map_io import load_maps, save_maps
from pipeline.mapping.submap_merging import Merged
from pipeline.mapping.submap_of_map import to_submap
from reconstruction.evaluation.trajectory_metrics import trajectory_errors
from tests.helpers.processes import alive
from tests.helpers.tubes import textured_tube
from tests.helpers.tubes.textured_tube import CAMERA, camera_at, polished, render, run, stored, wall_texture

SETTINGS = Config().front_end_settings
COUNT = 44
TRUE = np.stack([camera_at(k) for k in range(COUNT)])
IMAGES = [render(world_from_camera) for world_from_camera in TRUE]
RAYS = RayTable(CAMERA)


def tracked(first, last, images=IMAGES):
    """The map of a stretch, with the film's frame numbers."""
    (local_map,), _ = run(images[first:last])
    for keyframe in local_map.keyframes:
        keyframe.frame += first
    local_map.tracked_frames = [
        type(p)(p.frame + first, p.keyframe, p.camera_from_keyframe, p.ids, p.pixels) for p in local_map.tracked_frames
    ]
    return local_map


@pytest.fixture(scope="module")
def stretch():
    """The map of a stretch of the film, tracked once; each call gives one of its own, to be changed."""
    once = lru_cache(tracked)
    return lambda first, last: copy.deepcopy(once(first, last))


@lru_cache
def more_images():
    return [render(camera_at(k)) for k in range(COUNT, 72)]


def elsewhere(local_map, scale):
    """The same map in another world: turned, shifted, in another unit."""
    world_from_old = np.eye(4)
    world_from_old[:3, :3] = scale * textured_tube.camera_at(7)[:3, :3]
    world_from_old[:3, 3] = [5, -3, 40]
    rotation = world_from_old[:3, :3] / scale
    for keyframe in local_map.keyframes:
        camera_from_new = keyframe.camera_from_world.copy()
        camera_from_new[:3, :3] = camera_from_new[:3, :3] @ rotation.T
        camera_from_new[:3, 3] = scale * camera_from_new[:3, 3] - camera_from_new[:3, :3] @ world_from_old[:3, 3]
        keyframe.camera_from_world = camera_from_new
    local_map.tracks.points = transform_points(world_from_old, local_map.tracks.points)
    local_map.tracked_frames = [posed.scaled(scale) for posed in local_map.tracked_frames]
    return local_map


@given(st.integers(3, 20_000), st.integers(1, 40))
def test_chunks_cover_the_film_and_overlap(count, wanted):
    pieces = split(count, wanted)
    assert 1 <= len(pieces) <= wanted
    assert sorted(set().union(*pieces)) == list(range(count))
    for one, other in pairwise(pieces):
        assert one.stop - other.start == chunks.OVERLAP
    if len(pieces) > 1:
        assert min(map(len, pieces)) >= 3 * chunks.OVERLAP - 1
        assert max(map(len, pieces)) - min(map(len, pieces)) <= 1


def test_what_is_kept_is_what_comes_back(tmp_path, stretch):
    local_map = stretch(0, 28)
    save_maps([local_map, elsewhere(stretch(14, COUNT), 2.0)], tmp_path / "maps.npz")
    back, _ = load_maps(tmp_path / "maps.npz", RAYS)
    expected, found = (to_submap(m, CAMERA.params) for m in (local_map, back))
    for name in ("frames", "world_from_camera", "points", "observations", "pixels", "error_px"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))
    assert not list(tmp_path.glob("*.part*"))


@pytest.mark.parametrize("scale", [0.5, 1.0, 3.0])
def test_maps_of_overlapping_stretches_become_one(scale, stretch):
    first, second = stretch(0, 28), elsewhere(stretch(14, COUNT), scale)
    (whole,), stitching = stitch_chunks([[first], [second]])
    assert (stitching.chunks, stitching.closed) == (2, 1)
    submap = to_submap(polished([whole])[0], CAMERA.params)
    assert submap.frames.tolist() == list(range(COUNT))
    assert trajectory_errors(submap.world_from_camera, TRUE).ate_rmse < 0.15
    across = submap.observations[submap.observations[:, 0] >= 28, 1]
    assert np.isin(across, submap.observations[submap.observations[:, 0] < 14, 1]).sum() == 0
    middle = [k for k in whole.keyframes if 14 <= k.frame < 28]
    assert middle
    for keyframe in middle:  # what either chunk saw, so that the seam is held by both
        own = keyframe.ids < first.tracks_in_use()
        assert min(own.sum(), (~own).sum()) > 20


def test_stretches_that_share_too_little_stay_apart():
    first, second = tracked(0, 24), tracked(19, COUNT)
    assert first_from_second(first, second) is None
    kept, stitching = stitch_chunks([[first], [second]])
    assert kept == [first, second]
    assert stitching.closed == 0
    assert stitch_chunks([[], [first], []]) == ([first], chunks.Stitching(3, 0))


def test_maps_that_do_not_agree_stay_apart(monkeypatch, stretch):
    """The same frame numbers, but another wall and another way through it; then a scale that changes on the way."""
    first = stretch(0, 28)
    monkeypatch.setattr(textured_tube, "TEXTURE", wall_texture(seed=9))
    others = [render(camera_at(1.7 * k + 30)) for k in range(COUNT)]
    assert first_from_second(first, tracked(14, COUNT, others)) is None
    monkeypatch.undo()
    bent = stretch(14, COUNT)
    for posed in bent.keyframes:
        posed.camera_from_world[:3, 3] *= 1 + 0.05 * (posed.frame - 14)
    assert first_from_second(first, bent) is None


def test_a_film_in_chunks_is_one_map_and_a_stopped_run_goes_on(tmp_path, monkeypatch):
    monkeypatch.setattr(chunks, "OVERLAP", 12)
    true = np.stack([camera_at(k) for k in range(72)])
    images = IMAGES + more_images()
    workspace, frames = stored(tmp_path, images)
    settings = Config(odometry=OdometrySettings(chunks=3)).front_end_settings
    result = track_frames(frames, frame_features(workspace), settings, workspace, SilentProgress())
    assert result.stitching == chunks.Stitching(2, 1), "three would be too short"
    (submap,) = result.submaps
    assert submap.frames.tolist() == list(range(72))
    assert trajectory_errors(submap.world_from_camera, true).ate_rmse < 0.1
    jobs = jobs_of(frames.index, CAMERA, split(72, 3), SETTINGS, workspace)

    def refuse(waiting):
        raise AssertionError("all chunks are there")

    again, _ = track_chunks(jobs, RAYS, refuse, SilentProgress())
    assert [m.keyframes[0].frame for m in again] == [0]
    (temp_dir(workspace) / "0.npz").write_bytes(b"PK\3\4 damaged")
    asked = []

    def remember(waiting):
        asked.extend(job["number"] for job in waiting)
        yield 0

    with pytest.raises(HaustraError, match="chunks 0 left no maps"):
        track_chunks(jobs, RAYS, remember, SilentProgress())
    assert asked == [0]
    assert json.loads((temp_dir(workspace) / "1.json").read_text())["number"] == 1


def test_a_stub_in_the_overlap_hides_no_seam(stretch):
    """The chunk lost track near its end and began again: its last map has a few frames, the one before the rest."""
    first, second = stretch(0, 28), stretch(14, COUNT)
    stub = copy.deepcopy(first)
    stub.keyframes = [k for k in stub.keyframes if 20 <= k.frame < 26]
    stub.tracked_frames = []
    assert len(stub.keyframes) >= 2
    for here in ([first, stub], [stub, first]):
        (whole,), stitching = stitch_chunks([here, [second]])
        assert stitching.closed == 1
        assert whole.frames == set(range(COUNT))
    (whole,), _ = stitch_chunks([[first], [stub, second]])
    assert whole.frames == set(range(COUNT))


@pytest.mark.slow
def test_submaps_of_an_open_seam_share_no_frame(tmp_path, monkeypatch):
    """Each frame has one depth map, and no submap is left without frames."""
    monkeypatch.setattr(chunks, "OVERLAP", 12)
    monkeypatch.setattr(chunks, "first_from_second", lambda *_: None)
    monkeypatch.setattr(submap_merging, "merge_maps", lambda maps, *_: [Merged(m, (k,)) for k, m in enumerate(maps)])
    workspace, frames = stored(tmp_path, IMAGES + more_images())
    config = Config(front_end="odometry", odometry=OdometrySettings(chunks=2))
    submaps = solve_structure(
        frames, frame_features(workspace), config.front_end, config.front_end_settings, workspace, SilentProgress()
    )
    assert len(submaps) == 2
    assert min(len(submap.frames) for submap in submaps) >= 3
    assert sorted(np.concatenate([submap.frames for submap in submaps])) == list(range(72))
    assert not temp_dir(workspace).exists()


def test_settings_that_contradict_one_another_are_refused():
    with pytest.raises(HaustraError, match="ray tracks chunks"):
        load_config(None, odometry={"ray": "local"})
    for setting in ({"chunks": 2}, {"keyframe_motion": 0.05}):
        with pytest.raises(HaustraError, match="take odometry or auto"):
            check_front_end("sfm", load_config(None, odometry=setting).front_end_settings)
    asked = [load_config(None, odometry={"chunks": 2, "ray": ray}) for ray in (None, "local")]
    assert asked[0].is_same_work(asked[1]), "a run may go on elsewhere"
    assert not asked[0].is_same_work(load_config(None, odometry={"chunks": 3}))
    fast = load_config(None, odometry={"chunks": 2, "keyframe_motion": 0.05})
    assert asked[1].differences(fast) == ["odometry.keyframe_motion: 0.012, now 0.05"]


def test_the_others_end_where_one_chunk_fails(tmp_path):
    workspace, frames = stored(tmp_path, IMAGES[:20])
    jobs = jobs_of(np.append(frames.index, 100), CAMERA, [range(20, 21), range(20)], SETTINGS, workspace)
    with pytest.raises(HaustraError, match="chunk 0 failed"):
        track_chunks(jobs, RAYS, local_run(2), SilentProgress())
    assert (temp_dir(workspace) / "1.json").exists()


def test_an_interrupt_ends_every_process_and_what_is_done_stays(tmp_path):
    workspace, frames = stored(tmp_path, IMAGES[:20])
    jobs = jobs_of(frames.index, CAMERA, [range(20), range(20)], SETTINGS, workspace)
    running = local_run(1)(jobs)
    while not (temp_dir(workspace) / "0.json").exists():
        temp_dir(workspace).mkdir(exist_ok=True)
        next(running)
    with pytest.raises(KeyboardInterrupt):
        running.throw(KeyboardInterrupt)
    assert alive(tmp_path) == []
    assert not (temp_dir(workspace) / "1.json").exists()


def test_a_chunk_that_fails_names_its_log(tmp_path):
    workspace, frames = stored(tmp_path, IMAGES[:5])
    (job,) = jobs_of(frames.index + 100, CAMERA, [range(5)], SETTINGS, workspace)  # frames that are not there
    with pytest.raises(HaustraError, match=r"chunk 0 failed .*0\.log"):
        track_chunks([job], RAYS, local_run(1), SilentProgress())
    assert "missing" in (temp_dir(workspace) / "0.log").read_text()
