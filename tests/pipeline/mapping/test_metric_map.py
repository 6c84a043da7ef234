"""A map that a sensor's depth makes metric: its unit, and a bent scale that its adjustment straightens."""

import numpy as np
import pytest

from haustra.core.se3 import inverse
from pipeline.input.sensor.along_ray import doubt_of_axis
from pipeline.mapping.map_adjustment import adjust_all
from pipeline.mapping.metric_map import doubt_of_axis_by, make_metric, metric_scale
from tests.helpers.tubes.bent_tube import COUNT, UNIT, sensed, tube, world_from_camera_at


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
    true = np.linalg.norm(np.diff([world_from_camera_at(k)[:3, 3] for k in range(COUNT)], axis=0), axis=1)
    assert lengths["depth"][0] == pytest.approx(true.sum(), rel=0.005)
    bend = true[-8:].sum() / true[:8].sum()
    assert abs(lengths["depth"][1] - bend) < 0.01
    assert abs(lengths["depth"][1] - bend) < abs(lengths["pictures"][1] - bend)


def test_distances_along_the_rays_are_doubted_and_depth_is_not():
    local_map, points = tube()
    depth_at = sensed(points, 0.03)
    assert doubt_of_axis_by([local_map], depth_at) == ""
    assert doubt_of_axis_by([], depth_at) == ""

    def distance_at(frame, pixels):
        depth, sigma = depth_at(frame, pixels)
        plane, _ = local_map.rays.camera.unproject(pixels)
        return depth * np.sqrt(1 + (plane**2).sum(axis=1)), sigma

    assert "distances along each pixel's ray" in doubt_of_axis_by([local_map], distance_at)


def test_a_copy_of_a_map_shares_the_lens_and_the_sensor_alone():
    local_map, points = tube()
    make_metric(local_map, sensed(points, 0.03))
    copied, before = local_map.copied(), local_map.tracks.points.copy()
    assert copied.rays is local_map.rays
    assert copied.depth_at is local_map.depth_at
    copied.rescale(2.0)
    copied.keyframes[0].ids[:] = -1
    np.testing.assert_array_equal(local_map.tracks.points, before)
    assert (local_map.keyframes[0].ids >= 0).all()


def test_few_ratios_tell_nothing_of_the_axis():
    """Of noise alone one pattern always fits better."""
    rng = np.random.default_rng(0)
    for count in (37, 250):
        frame = np.arange(count) % 9
        assert not any(doubt_of_axis(rng.normal(0, 0.1, count), rng.uniform(0, 0.3, count), frame) for _ in range(50))
