"""A map that a sensor's depth makes metric: its unit, and a bent scale that its adjustment straightens."""

import numpy as np
import pytest

from haustra.core.camera import Camera
from haustra.core.ray_table import RayTable
from haustra.core.se3 import in_camera, inverse
from pipeline.mapping.local_map import LocalMap
from pipeline.mapping.map_adjustment import adjust_all
from pipeline.mapping.metric_map import make_metric, metric_scale

CAMERA = Camera("PINHOLE", 320, 320, (160.0, 160.0, 160.0, 160.0))
COUNT, STEP_MM, RADIUS_MM, UNIT = 24, 3.0, 20.0, 7.0


def pose(k: int) -> np.ndarray:
    found = np.eye(4)
    found[:3, 3] = 2 * np.sin(0.5 * k), 2 * np.cos(0.4 * k), STEP_MM * k
    return found


def tube(seed: int = 0, bend: float = 0.0, unit: float = UNIT) -> tuple[LocalMap, np.ndarray]:
    """A tube's map along its axis whose scale grows by `bend` to its end, and the true points in mm."""
    rng = np.random.default_rng(seed)
    angle, along = rng.uniform(0, 2 * np.pi, 1500), rng.uniform(0, STEP_MM * COUNT + 60, 1500)
    points = np.column_stack([RADIUS_MM * np.cos(angle), RADIUS_MM * np.sin(angle), along])
    stretch = lambda z: 1 + bend * z / (STEP_MM * COUNT)  # noqa: E731
    local_map = LocalMap(RayTable(CAMERA))
    local_map.tracks.reserve(len(points))
    local_map.tracks.points[: len(points)] = points * stretch(points[:, 2:]) / unit
    local_map.tracks.has_point[: len(points)] = True
    for k in range(COUNT):
        local = in_camera(inverse(pose(k)), points)
        seen = np.flatnonzero((local[:, 2] > 12) & (local[:, 2] < 60))
        pixels = CAMERA.project(local[seen])
        inside = ((pixels > 2) & (pixels < 318)).all(axis=1)
        moved = pose(k)
        moved[:3, 3] *= stretch(moved[2, 3]) / unit
        noisy = pixels[inside] + rng.normal(0, 0.2, (int(inside.sum()), 2))
        local_map.add_keyframe(k, inverse(moved), seen[inside], noisy)
    return local_map, points


def sensed(points: np.ndarray, noise: float, scale: float = 1.0):
    """A sensor that finds the depth of the true point nearest to a pixel, with noise; none in a tenth of the places."""

    def depth_at(frame: int, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        rng = np.random.default_rng([frame, len(pixels)])
        local = in_camera(inverse(pose(frame)), points)
        local = local[(local[:, 2] > 12) & (local[:, 2] < 60)]
        off = np.linalg.norm(CAMERA.project(local)[None] - pixels[:, None], axis=2)
        depth = scale * local[off.argmin(axis=1), 2] * (1 + noise * rng.normal(size=len(pixels)))
        depth[rng.random(len(pixels)) < 0.1] = 0
        return depth, noise * depth

    return depth_at


def test_a_map_is_brought_to_millimetres():
    local_map, points = tube()
    before = local_map.keyframes[5].camera_from_world[:3, 3].copy()
    assert make_metric(local_map, sensed(points, 0.03)) == pytest.approx(UNIT, rel=0.005)
    np.testing.assert_allclose(local_map.keyframes[5].camera_from_world[:3, 3], UNIT * before, rtol=0.005)
    np.testing.assert_allclose(local_map.tracks.points[:1500], points, rtol=0.005)


def test_a_sensor_that_sees_nothing_leaves_the_map_alone():
    local_map, _ = tube()
    blind = lambda frame, pixels: (np.zeros(len(pixels)), np.zeros(len(pixels)))  # noqa: E731
    points = local_map.tracks.points.copy()
    assert make_metric(local_map, blind) is None
    assert local_map.depth_at is None
    np.testing.assert_array_equal(local_map.tracks.points, points)


def test_only_some_keyframes_may_be_asked():
    local_map, points = tube(bend=0.2)
    first, last = (metric_scale(local_map, sensed(points, 0.01), frames) for frames in ([0, 1, 2], [21, 22, 23]))
    assert first > 1.05 * last


def test_adjustment_with_depth_straightens_a_scale_that_pictures_leave_bent():
    lengths = {}
    for name, with_depth in (("depth", True), ("pictures", False)):
        local_map, points = tube(1, bend=0.15)
        if with_depth:
            make_metric(local_map, sensed(points, 0.03))
        adjust_all(local_map)
        centres = np.stack([inverse(k.camera_from_world)[:3, 3] for k in local_map.keyframes])
        steps = np.linalg.norm(np.diff(centres, axis=0), axis=1)
        lengths[name] = steps.sum(), steps[-8:].sum() / steps[:8].sum()
    true = np.linalg.norm(np.diff([pose(k)[:3, 3] for k in range(COUNT)], axis=0), axis=1)
    assert lengths["depth"][0] == pytest.approx(true.sum(), rel=0.005)
    bend = true[-8:].sum() / true[:8].sum()
    assert abs(lengths["depth"][1] - bend) < 0.01
    assert abs(lengths["depth"][1] - bend) < abs(lengths["pictures"][1] - bend)
