"""Which frames become keyframes, on submaps that are made up."""

import numpy as np
import pytest

from haustra.core.frame_spacing import LEAST_FRAMES
from pipeline.depth.keyframe_selection import choose_keyframes
from pipeline.mapping.submap import Submap

PARAMS = (160.0, 160.0, 160.0, 160.0)


def test_a_frame_that_sees_far_less_than_those_around_it_is_no_keyframe():
    """As odometry leaves it: every fourth frame has features of its own, those between only what was followed."""
    rng, frames = np.random.default_rng(1), 24
    start = rng.uniform(0, 320, (100, 2))
    rows = [(f, p) for f in range(frames) for p in range(100 if f % 4 == 1 else 30)]
    pixels = np.array([start[p] + [4.0 * f, 0.0] for f, p in rows])
    poses = np.repeat(np.eye(4)[None], frames, axis=0)
    submap = Submap(np.arange(frames), poses, np.ones((100, 3)), np.ones(100), np.array(rows), pixels, PARAMS)
    assert choose_keyframes(submap, 320, 0.02).tolist() == list(range(1, frames, 4))


def test_frames_that_see_nothing_are_no_keyframes_even_where_they_are_a_gap():
    """As the points stage leaves a slow film: every thirtieth frame has points, and no other."""
    rng, seeing = np.random.default_rng(3), [0, 30, 60]
    start = rng.uniform(0, 320, (100, 2))
    rows = [(f, p) for f in seeing for p in range(100)]
    pixels = np.array([start[p] + [4.0 * f, 0.0] for f, p in rows])
    poses = np.repeat(np.eye(4)[None], 61, axis=0)
    submap = Submap(np.arange(61), poses, np.ones((100, 3)), np.ones(100), np.array(rows), pixels, PARAMS)
    assert choose_keyframes(submap, 320, 0.02).tolist() == seeing


def test_the_wall_that_passes_the_camera_makes_a_keyframe_though_the_middle_stands_still():
    frames, share = 10, 30  # of 100 points, near the camera
    start = np.random.default_rng(2).uniform(0, 320, (100, 2))
    rows = [(f, p) for f in range(frames) for p in range(100)]
    pixels = np.array([start[p] + [(8.0 if p < share else 0.1) * f, 0.0] for f, p in rows])
    poses = np.repeat(np.eye(4)[None], frames, axis=0)
    submap = Submap(np.arange(frames), poses, np.ones((100, 3)), np.ones(100), np.array(rows), pixels, PARAMS)
    assert choose_keyframes(submap, 320, 0.02).tolist() == list(range(frames))


@pytest.mark.parametrize("breathing", [False, True])
def test_a_camera_that_hovers_has_so_many_keyframes_and_no_more(breathing):
    """Its points move by 9 px of 320 in all, or to and fro by 3."""
    frames, start = 200, np.random.default_rng(4).uniform(0, 320, (100, 2))
    way = 3 * np.sin(np.arange(frames) / 3) if breathing else np.linspace(0, 9, frames)
    rows = [(f, p) for f in range(frames) for p in range(100)]
    pixels = np.array([start[p] + [way[f], 0.0] for f, p in rows])
    poses = np.repeat(np.eye(4)[None], frames, axis=0)
    submap = Submap(np.arange(frames), poses, np.ones((100, 3)), np.ones(100), np.array(rows), pixels, PARAMS)
    chosen = choose_keyframes(submap, 320, 0.02)
    assert len(chosen) == (LEAST_FRAMES if breathing else pytest.approx(9 / (6.4 / 8), abs=2))
    assert (np.diff(chosen) > 0).all()
