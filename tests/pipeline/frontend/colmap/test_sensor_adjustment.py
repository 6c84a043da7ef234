"""COLMAP's model of a tube whose scale is bent, and a sensor whose depth straightens it."""

from types import SimpleNamespace

import numpy as np
import pytest

from haustra.core.progress import SilentProgress
from haustra.core.sim3 import scale_of, umeyama
from pipeline.frontend.base import FoundSubmap
from pipeline.frontend.colmap.sensor_adjustment import adjusted_to_sensor, metric_submap
from pipeline.mapping.submap_of_map import map_of_submap, to_submap
from tests.helpers.tubes.bent_tube import CAMERA, COUNT, UNIT, sensed, tube, world_from_camera_at


def bent_model(seed=0):
    local_map, points = tube(seed, bend=0.03)
    return to_submap(local_map, CAMERA.params, refit=False), points


def sensor_of(points, noise=0.03):
    return SimpleNamespace(for_adjustment=sensed(points, noise))


def true_centres():
    return np.array([world_from_camera_at(k)[:3, 3] for k in range(COUNT)])


def test_model_comes_out_in_millimetres_and_straight():
    submap, points = bent_model()
    assert np.linalg.norm(np.diff(submap.centres, axis=0), axis=1).sum() < 100 / UNIT  # far from millimetres
    metric = metric_submap(submap, CAMERA, sensor_of(points))
    np.testing.assert_array_equal(metric.frames, submap.frames)
    target = umeyama(metric.centres, true_centres(), with_scale=True)
    assert scale_of(target) == pytest.approx(1, abs=0.005)
    steps = np.linalg.norm(np.diff(metric.centres, axis=0), axis=1)
    true = np.linalg.norm(np.diff(true_centres(), axis=0), axis=1)
    assert steps[-8:].sum() / steps[:8].sum() == pytest.approx(true[-8:].sum() / true[:8].sum(), abs=0.01)
    assert metric.error_px.mean() < 1


def test_submap_survives_the_way_through_a_map():
    submap, _ = bent_model(1)
    again = to_submap(map_of_submap(submap, tube(1)[0].rays), CAMERA.params, refit=False)
    np.testing.assert_array_equal(again.frames, submap.frames)
    np.testing.assert_allclose(again.world_from_camera, submap.world_from_camera, atol=1e-12)
    np.testing.assert_allclose(again.points, submap.points, atol=1e-12)
    order = lambda s: np.lexsort(s.observations.T)  # noqa: E731
    np.testing.assert_allclose(again.pixels[order(again)], submap.pixels[order(submap)], atol=1e-9)


def test_model_that_the_sensor_did_not_see_stays():
    submap, _ = bent_model()
    blind = SimpleNamespace(
        stereo=False, for_adjustment=lambda frame, pixels: (np.zeros(len(pixels)), np.zeros(len(pixels)))
    )
    found = [FoundSubmap(submap, None)]
    assert adjusted_to_sensor(found, CAMERA, blind, SilentProgress()) == found
