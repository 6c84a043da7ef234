"""Depth and surface of keyframes: the wall where it is, parts that are closed, and the picture of depth."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from pipeline.config import ConsistencySettings, FusionSettings
from pipeline.live import dense_worker
from pipeline.live.dense_worker import DenseWork, LiveCamera, painted_png
from pipeline.live.warm_up import SIDE, small_camera, small_keyframes

WALL = 1.2  # of a plane square to the view, in the map's unit


def plane(rgb, depth, error):
    """Stands for the network: a plane that every pixel is sure of."""
    return np.full(depth.shape, WALL, np.float32), np.ones(depth.shape, np.float32)


def near_plane(rgb, depth, error):
    wall, sure = plane(rgb, depth, error)
    return np.float32(0.5) * wall, sure


@pytest.fixture
def work(tmp_path):
    seen = LiveCamera(small_camera(), np.full((SIDE, SIDE), 255, np.uint8))
    return DenseWork(seen, tmp_path, FusionSettings(), ConsistencySettings(), plane)


def test_the_surface_is_where_the_depth_says(work):
    first, second = (work(keyframe) for keyframe in small_keyframes())
    part = second.parts[-1]
    np.testing.assert_allclose(part.vertices[:, 2], WALL, atol=1e-5)
    assert part.faces.max() < len(part.vertices)
    assert (part.number, part.version, part.frames) == (0, 2, (1, 3))
    assert len(part.vertices) > len(first.parts[-1].vertices)


def test_another_map_closes_the_part_and_begins_a_new_one(work):
    keyframes = small_keyframes()
    work(keyframes[0])
    closed, grown = work(replace(keyframes[1], map_number=1)).parts
    assert (closed.number, closed.map_number, grown.number, grown.map_number) == (0, 0, 1, 1)
    assert closed.version == 2
    assert grown.frames == (3, 3)


def test_a_part_is_closed_after_so_many_keyframes(work, monkeypatch):
    monkeypatch.setattr(dense_worker, "PART_KEYFRAMES", 1)
    monkeypatch.setattr(dense_worker, "CLOSED_FACES", 500)
    keyframes = small_keyframes()
    work(keyframes[0])
    closed, grown = work(keyframes[1]).parts
    assert len(closed.faces) <= 500 < len(grown.faces)
    assert grown.map_number == closed.map_number == 0


def test_a_keyframe_with_too_few_points_leaves_all_as_it_was(work):
    keyframe = small_keyframes()[0]
    few = keyframe.around.without_points(np.arange(len(keyframe.around.points)) >= 5)
    result = work(replace(keyframe, around=few))
    assert (result.depth_png, result.fate, result.parts) == (b"", "unsure", ())


def test_a_keyframe_of_which_nothing_is_sure_is_not_called_contradicted(work):
    work.completer = lambda rgb, depth, error: (plane(rgb, depth, error)[0], np.zeros(depth.shape, np.float32))
    result = work(small_keyframes()[0])
    assert (result.fate, result.parts) == ("unsure", ())
    assert result.depth_png


def test_depth_that_the_one_before_looks_through_is_not_fused(work, tmp_path):
    """A keyframe whose plane lies at half the distance: most voters must agree before it is left out."""
    keyframes = small_keyframes()
    surface = work(keyframes[0]).parts[-1]
    work(replace(keyframes[0], frame=2))
    work.completer = lambda rgb, depth, error: tuple(
        np.float32(k) * v for k, v in zip((0.5, 1), plane(rgb, depth, error))
    )
    result = work(keyframes[1])
    assert (result.fate, result.parts) == ("contradicted", ())
    assert len(surface.faces)


def test_the_picture_of_depth_is_bright_where_it_is_near():
    depth = np.tile(np.linspace(1, 3, 32, dtype=np.float32), (8, 1))
    depth[0] = 0
    shown = cv2.imdecode(np.frombuffer(painted_png(depth), np.uint8), cv2.IMREAD_COLOR)
    grey = shown.mean(axis=2)
    assert (grey[0] == 0).all()
    assert (np.diff(grey[4]) <= 1).all()
    assert grey[4, 0] > grey[4, -1] + 50
    assert painted_png(np.zeros((4, 4), np.float32)) == b""
