"""Keyframes as they settle: the right pictures, the map around them, once each, and none that shows nothing new."""

from __future__ import annotations

import numpy as np

from haustra.core.se3 import inverse
from pipeline.config import Config
from pipeline.input.calibration import Calibration
from pipeline.input.content_area import ContentArea
from pipeline.live.live_tracking import AROUND, SETTLED_BY, SETTLED_S, LiveTracker, _Waiting
from pipeline.live.warm_up import KEYFRAMES, SIDE, small_camera, small_map
from pipeline.live.working_view import WorkingFrame, WorkingView
from pipeline.mapping.submap_of_map import to_submap


def make_tracker():
    everywhere = np.full((SIDE, SIDE), 255, np.uint8)
    whole = ContentArea(everywhere, (0, 0, SIDE, SIDE), everywhere)
    config = Config()
    view = WorkingView(whole, Calibration(small_camera(), "drawn"), config.frames)
    tracker = LiveTracker(view, config.odometry, config.depth, config.seed)
    tracker._map, tracker.map_number = small_map(), 0
    return tracker


def waiting(tracker, came, motion=0.0):
    """Every keyframe of the map waits, and each shows something new; its picture is grey of its number."""
    tracker.motion = motion
    for number, keyframe in enumerate(tracker._map.keyframes):
        rgb = np.full((SIDE, SIDE, 3), 10 * number, np.uint8)
        frame = WorkingFrame(keyframe.frame, number / 30, rgb, np.full((SIDE, SIDE), 255, np.uint8), "used")
        tracker._waiting.append(_Waiting(keyframe, frame, came))


def test_keyframes_settle_by_later_ones_or_by_time_and_come_once():
    tracker = make_tracker()
    waiting(tracker, came=100.0)
    early = tracker.settled(100.1)
    assert [one.frame for one in early] == list(range(KEYFRAMES - SETTLED_BY))
    late = tracker.settled(100.0 + SETTLED_S + 0.1)
    assert [one.frame for one in late] == list(range(KEYFRAMES - SETTLED_BY, KEYFRAMES))
    assert tracker.settled(1e9) == tracker.finish() == []


def test_a_keyframe_comes_with_its_own_picture_and_pose():
    tracker = make_tracker()
    waiting(tracker, came=0.0)
    released = tracker.finish()
    assert len(released) == KEYFRAMES
    for one in released:
        assert one.around.frames[one.row] == one.frame
        assert int(one.rgb[0, 0, 0]) == 10 * one.frame
        camera_from_world = tracker._map.keyframes[one.frame].camera_from_world
        np.testing.assert_allclose(one.around.world_from_camera[one.row], inverse(camera_from_world), atol=1e-12)


def test_a_view_that_shows_nothing_new_is_not_completed():
    tracker = make_tracker()
    waiting(tracker, came=0.0, motion=10.0)  # widths: none moves so far
    assert [one.frame for one in tracker.finish()] == [0]


def test_the_map_of_the_latest_keyframes_is_that_part_of_the_whole():
    local_map = small_map()
    for frame, keyframe in ((100, 1), (200, 3), (300, 5)):
        seen = local_map.keyframes[keyframe]
        local_map.add_tracked_frame(frame, seen.camera_from_world, seen.ids, seen.pixels)
        local_map.tracked_frames[-1] = type(local_map.tracked_frames[-1])(
            frame, keyframe, np.eye(4), seen.ids.astype(np.int32), seen.pixels.astype(np.float32)
        )
    part = local_map.latest(3)
    assert part.frames == {3, 4, 5, 200, 300}
    for tracked in part.tracked_frames:
        np.testing.assert_array_equal(
            part.camera_from_world_of(tracked), local_map.keyframes[3 if tracked.frame == 200 else 5].camera_from_world
        )
    whole, all_of_it = (to_submap(m, small_camera().params, refit=False) for m in (local_map, local_map.latest(AROUND)))
    np.testing.assert_array_equal(whole.frames, all_of_it.frames)
    np.testing.assert_array_equal(whole.points, all_of_it.points)


def test_a_map_that_the_light_contradicts_is_forgotten_and_named():
    tracker = make_tracker()
    waiting(tracker, came=0.0)
    tracker.odometry.refused_map = tracker._map
    assert tracker._follow_map() == []
    assert tracker.refused == {0}
    assert tracker.settled(1e9) == []
    assert tracker.submap(10) is None


def test_a_map_that_was_lost_for_good_is_still_shown():
    tracker = make_tracker()
    waiting(tracker, came=0.0)
    for kept in ([tracker._map], [], []):  # one of few keyframes would not even be kept
        tracker.odometry.maps += kept
        assert tracker._follow_map() == []
    assert tracker.refused == set()
    assert len(tracker.settled(1e9)) == KEYFRAMES
