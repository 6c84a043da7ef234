"""What keeps tracking at a film's pace: few adjustments where keyframes come fast, and no more threads than pay."""

import cv2
import pytest
from test_odometry import camera_at, render, run, stored

from pipeline.config import Config
from pipeline.odometry import front_end
from pipeline.odometry.local_map import WINDOW, LocalMap
from pipeline.progress import SilentProgress
from pipeline.structure import solve_structure


@pytest.mark.parametrize(("step", "frames"), [(1.2, 34), (0.12, 80)])
def test_windows_are_adjusted_at_keyframes_at_least_three_frames_apart(monkeypatch, step, frames):
    """At 1.2 mm a frame most are keyframes, at 0.12 not one of three; the first window is adjusted at each."""
    adjusted, real = [], LocalMap.adjust
    monkeypatch.setattr(
        LocalMap, "adjust", lambda m, *a, **k: (adjusted.append(m.keyframes[-1].frame), real(m, *a, **k))
    )
    ((local_map,), _) = run([render(camera_at(k, step)) for k in range(frames)])
    keyframes = [keyframe.frame for keyframe in local_map.keyframes]
    first, later = keyframes[:WINDOW], keyframes[WINDOW:]
    assert set(first[-4:]) < set(adjusted)
    last = first[-1]
    for frame in later:
        due = frame - last >= 3
        assert (frame in adjusted) == due
        last = frame if due else last
    skipped = len(set(later) - set(adjusted))
    assert (skipped > len(later) / 2 > 3) if step > 1 else (skipped < len(later) / 2)


def test_libraries_keep_to_one_thread_while_frames_are_tracked_and_get_theirs_back(tmp_path, monkeypatch):
    before, seen = cv2.getNumThreads(), []

    def stop(*_, **__):
        seen.append(cv2.getNumThreads())
        raise InterruptedError

    monkeypatch.setattr(front_end, "adjust_maps", stop)
    workspace, frames = stored(tmp_path, [render(camera_at(k)) for k in range(8)])
    try:
        cv2.setNumThreads(3)
        with pytest.raises(InterruptedError):
            solve_structure(frames, Config(front_end="odometry"), workspace, SilentProgress())
        assert seen == [1]
        assert cv2.getNumThreads() == 3
    finally:
        cv2.setNumThreads(before)
