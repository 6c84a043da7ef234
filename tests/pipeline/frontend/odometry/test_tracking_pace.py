"""What keeps tracking at a film's pace: keyframes as far apart as asked, few adjustments, no more threads than pay."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from haustra.core.progress import SilentProgress
from haustra.core.ray_table import RayTable
from pipeline.config import FAST_KEYFRAME_MOTION, Config, OdometrySettings
from pipeline.frontend.odometry import front_end, initialization, tracking
from pipeline.frontend.odometry.chunk_worker import track
from pipeline.frontend.odometry.chunks import jobs_of
from pipeline.frontend.odometry.frame_io import frame_features
from pipeline.frontend.odometry.tracking import Odometry
from pipeline.frontend.structure_stage import solve_structure
from pipeline.mapping.local_map import WINDOW
from pipeline.mapping.map_adjustment import adjust_window
from pipeline.mapping.map_io import load_maps
from tests.helpers.tubes.textured_tube import CAMERA, MASK, camera_at, render, stored


def tracked(frames, step, camera=CAMERA, **settings):
    """The one map of these frames of the tube."""
    odometry = Odometry(RayTable(camera), 0, **settings)
    for k in frames:
        image = render(camera_at(k, step))
        odometry.process(k, image, odometry.view(image, MASK))
    (local_map,) = odometry.finish()
    return local_map


@pytest.fixture
def adjusted(monkeypatch):
    """The keyframes at which a window was adjusted."""
    seen = []
    for module in (initialization, tracking):
        monkeypatch.setattr(
            module, "adjust_window", lambda m, **k: (seen.append(m.keyframes[-1].frame), adjust_window(m, **k))
        )
    return seen


EVERY_OTHER = [*range(16), *range(17, 60, 2)]


@pytest.mark.parametrize(
    ("step", "frames", "least_skipped"), [(1.2, range(34), 1 / 2), (0.12, range(80), None), (0.6, EVERY_OTHER, 1 / 3)]
)
def test_windows_are_adjusted_at_keyframes_at_least_three_frames_apart(adjusted, step, frames, least_skipped):
    """At 1.2 mm a frame most are keyframes, at 0.12 not one of three; the first window is adjusted at each. Frames that
    were left out count."""
    keyframes = [keyframe.frame for keyframe in tracked(frames, step).keyframes]
    first, later = keyframes[:WINDOW], keyframes[WINDOW:]
    assert set(first[-4:]) < set(adjusted)
    last = first[-1]
    for frame in later:
        due = frame - last >= 3
        assert (frame in adjusted) == due
        last = frame if due else last
    skipped = len(set(later) - set(adjusted))
    assert (skipped > len(later) * least_skipped > 3) if least_skipped else (skipped < len(later) / 2)


def test_with_a_guessed_lens_windows_are_adjusted_at_each_keyframe(adjusted):
    """Left bent longer, maps were lost more often and not joined again."""
    local_map = tracked(range(24), 1.2, replace(CAMERA, trusted=False))
    frames = [keyframe.frame for keyframe in local_map.keyframes]
    assert set(frames[WINDOW:]) < set(adjusted)
    assert len(frames) > WINDOW + 6
    assert max(np.diff(frames[WINDOW:])) < 3


@pytest.mark.parametrize(
    "motion", [OdometrySettings().keyframe_motion, pytest.param(FAST_KEYFRAME_MOTION, marks=pytest.mark.slow)]
)
def test_keyframes_are_as_far_apart_as_asked(motion):
    """The corners of two neighbours moved by the share that was asked for, in the median, and by one frame's more at
    most. (The first ones are the start's.)"""
    local_map = tracked(range(100), 0.3, keyframe_motion=motion)
    moved = []
    for one, other in zip(local_map.keyframes[5:], local_map.keyframes[6:], strict=False):
        _, mine, theirs = np.intersect1d(one.ids, other.ids, return_indices=True)
        way = np.median(np.linalg.norm(other.pixels[theirs] - one.pixels[mine], axis=1)) / CAMERA.width
        moved.append((way, way / (other.frame - one.frame)))
    way, a_frame = np.median(moved, axis=0)
    assert len(moved) > 4
    assert 0.9 * motion < way < 1.1 * motion + a_frame


def test_keyframe_motion_reaches_the_tracker_in_one_go_and_in_chunks(tmp_path):
    workspace, frames = stored(tmp_path, [render(camera_at(k, 0.3)) for k in range(50)])
    (tmp_path / "chunks").mkdir()
    count = {}
    for motion in (OdometrySettings().keyframe_motion, FAST_KEYFRAME_MOTION):
        config = Config(odometry=OdometrySettings(keyframe_motion=motion))
        with frame_features(workspace) as features:
            (whole,), *_ = front_end._tracked(frames, features, config.front_end_settings, workspace, SilentProgress())
        (job,) = jobs_of(frames.index, CAMERA, [range(50)], config.front_end_settings, workspace)
        job["output"] = str(tmp_path / "chunks" / "0.npz")
        track(job)
        (chunk,) = load_maps(Path(job["output"]), RayTable(CAMERA))
        assert [k.frame for k in chunk.keyframes] == [k.frame for k in whole.keyframes]
        count[motion] = len(whole.keyframes)
    often, seldom = count.values()
    assert seldom < 0.75 * often  # with the few of the start


def threads():
    """Of OpenCV, and the most of any BLAS."""
    return cv2.getNumThreads(), max(pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas")


def test_libraries_keep_to_one_thread_while_frames_are_tracked_and_get_theirs_back(tmp_path, monkeypatch):
    before, seen, process = cv2.getNumThreads(), [], Odometry.process

    def asked(*arguments):
        seen.append(threads())
        return process(*arguments)

    def stop(*_, **__):
        seen.append(threads())
        raise InterruptedError

    monkeypatch.setattr(Odometry, "process", asked)
    monkeypatch.setattr(front_end, "adjust_maps", stop)
    workspace, frames = stored(tmp_path, [render(camera_at(k)) for k in range(8)])
    try:
        cv2.setNumThreads(3)
        with threadpool_limits(2, "blas"):
            with pytest.raises(InterruptedError):
                solve_structure(
                    frames,
                    frame_features(workspace),
                    "odometry",
                    Config().front_end_settings,
                    workspace,
                    SilentProgress(),
                )
            assert threads() == (3, 2)
    finally:
        cv2.setNumThreads(before)
    assert len(seen) == 9
    assert set(seen) == {(1, 1)}
