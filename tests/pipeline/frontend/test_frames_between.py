"""Frames between those that were mapped: posed by the points of a map of known places on a rendered tube."""

import time
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from haustra.core.progress import SilentProgress
from haustra.core.se3 import angle_between, inverse
from pipeline.config import Config
from pipeline.frontend.automatic import FrontEndJob
from pipeline.frontend.base import FoundSubmap, FrontEndResult
from pipeline.frontend.frames_between import every_nth, with_frames_between
from pipeline.frontend.odometry.klt import detect, tracker_image
from pipeline.frontend.registry import FRONT_ENDS
from pipeline.mapping.submap import Submap, read_submap
from pipeline.matching.sift_cache import SiftCache
from tests.helpers.candidates import many_frames
from tests.helpers.tubes.textured_tube import CAMERA, MASK, RADIUS, camera_at, render, stored

COUNT, EVERY = 9, 4
POSES = np.array([camera_at(k) for k in range(COUNT)])
IMAGES = [render(pose) for pose in POSES]


def on_the_wall(pose, pixels):
    """(N,3) where the rays of pixels meet the tube."""
    plane, _ = CAMERA.unproject(pixels)
    rays = np.column_stack([plane, np.ones(len(plane))]) @ pose[:3, :3].T
    centre = pose[:3, 3]
    a, b = (rays[:, :2] ** 2).sum(1), (rays[:, :2] * centre[:2]).sum(1)
    length = (-b + np.sqrt(b * b - a * ((centre[:2] ** 2).sum() - RADIUS**2))) / a
    return centre + length[:, None] * rays


def true_map(frames):
    """A map with the true poses of these frames and, of each, its corners' true places on the wall."""
    points, observations, pixels = [], [], []
    for row, frame in enumerate(frames):
        corners = detect(tracker_image(IMAGES[frame], MASK), np.zeros((0, 2), np.float32), 12)
        places = on_the_wall(POSES[frame], corners.astype(float))
        near = places[:, 2] - POSES[frame][2, 3] < 60.0
        first = sum(len(some) for some in points)
        points.append(places[near])
        pixels.append(corners[near])
        observations.append(np.column_stack([np.full(near.sum(), row), first + np.arange(near.sum())]))
    count = sum(len(some) for some in points)
    return Submap(
        np.array(frames),
        POSES[frames],
        np.concatenate(points),
        np.full(count, 0.5),
        np.concatenate(observations),
        np.concatenate(pixels).astype(float),
        CAMERA.params,
    )


def read(frame):
    return IMAGES[frame], MASK


@pytest.fixture(scope="module")
def whole():
    return with_frames_between(true_map([0, 4, 8]), many_frames(COUNT), EVERY, read)


def test_the_frames_between_have_their_true_poses(whole):
    assert whole.frames.tolist() == list(range(COUNT))
    for found, true in zip(whole.world_from_camera, POSES, strict=True):
        assert np.linalg.norm(found[:3, 3] - true[:3, 3]) < 0.1, "mm, of steps of 0.8 in a tube of 20 mm radius"
        assert np.degrees(angle_between(inverse(found), inverse(true))) < 0.2


def test_what_was_mapped_stays_and_the_others_see_nothing(whole):
    seed = true_map([0, 4, 8])
    assert np.array_equal(whole.world_from_camera[[0, 4, 8]], seed.world_from_camera)
    assert np.array_equal(whole.points, seed.points)
    assert np.array_equal(whole.observations, seed.observations * [4, 1])
    assert np.array_equal(whole.pixels, seed.pixels)


def test_frames_that_show_something_else_or_are_too_far_or_late_get_no_pose():
    other = [render(POSES[0]) if k != 2 else np.full_like(IMAGES[0], 90) for k in range(COUNT)]
    grey = with_frames_between(
        true_map([0, 4]), many_frames(5), EVERY, lambda k: ((other if k == 2 else IMAGES)[k], MASK)
    )
    assert grey.frames.tolist() == [0, 1, 3, 4]
    far = with_frames_between(true_map([0, 1]), many_frames(COUNT), 2, read)
    assert far.frames.tolist() == [0, 1, 2, 3]
    late = with_frames_between(true_map([0, 4]), many_frames(5), EVERY, read, deadline=time.monotonic())
    assert late.frames.tolist() == [0, 4]
    apart = replace(many_frames(5), seconds=np.array([0.0, 0.1, 2.0, 3.9, 4.0]))
    assert with_frames_between(true_map([0, 4]), apart, EVERY, read).frames.tolist() == [0, 1, 3, 4]
    blind = replace(true_map([0, 4]), observations=np.zeros((0, 2), int), pixels=np.zeros((0, 2)))
    assert with_frames_between(blind, many_frames(5), EVERY, read).frames.tolist() == [0, 4]


def test_a_front_end_that_is_given_every_fourth_frame_comes_back_with_all(tmp_path, monkeypatch):
    workspace, frames = stored(tmp_path, IMAGES)
    seen = []

    def run(some, *_):
        seen.append(some.index.tolist())
        return FrontEndResult({"global": [FoundSubmap(true_map([0, 4, 8]), tmp_path)]})

    monkeypatch.setitem(FRONT_ENDS, "sfm", SimpleNamespace(run=run))
    job = FrontEndJob(SiftCache(None), Config().front_end_settings, workspace, SilentProgress())
    (found,) = job.run("sfm", frames, EVERY).candidates["global"]
    assert seen == [[0, 4, 8]]
    assert found.submap.frames.tolist() == list(range(COUNT))
    assert found.check.frames == COUNT
    assert read_submap(found.folder).frames.tolist() == list(range(COUNT)), "COLMAP's own model has not all frames"
    assert job.run("sfm", frames).candidates["global"][0].folder == tmp_path


@pytest.mark.parametrize(
    ("count", "every", "kept"), [(9, 4, [0, 4, 8]), (8, 3, [0, 3, 6, 7]), (1, 2, [0]), (5, 1, [0, 1, 2, 3, 4])]
)
def test_every_nth_frame_and_the_last(count, every, kept):
    assert every_nth(many_frames(count), every).index.tolist() == kept


def test_the_last_frame_before_a_gap_is_kept():
    frames = many_frames(10)
    apart = replace(frames, seconds=frames.seconds + np.where(frames.index >= 6, 5.0, 0.0))
    assert every_nth(apart, 4).index.tolist() == [0, 4, 5, 8, 9]
