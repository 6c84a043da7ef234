"""A sensor's cells put together to points of a cloud: on the wall, with less noise, none across an edge."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from haustra.core.camera import Camera
from haustra.core.ray_table import RayTable
from pipeline.config import SensorSettings
from pipeline.frontend.odometry.bridging.depth_clouds import MOST_POINTS, clouds_of
from pipeline.input.sensor.sensor_depth import SensorDepth

CAMERA = Camera("PINHOLE", 320, 320, (200.0, 200.0, 160.0, 160.0))
UNIT_MM = 0.01
NORMAL, AWAY_MM = np.array([0.3, -0.2, 1.0]), 30.0  # a plane: normal . point = away


def plane(zones: tuple[int, int]) -> np.ndarray:
    """(rows, columns) depth, mm, of the middles of the cells."""
    columns, rows = zones
    x, y = np.meshgrid((np.arange(columns) + 0.5) * 320 / columns, (np.arange(rows) + 0.5) * 320 / rows)
    rays = np.stack([(x - 160) / 200, (y - 160) / 200, np.ones_like(x)], axis=-1)
    return AWAY_MM / (rays @ NORMAL)


def cloud_of(depth: np.ndarray, folder: Path) -> np.ndarray | None:
    path = folder / "0.png"
    cv2.imwrite(str(path), np.round(depth / UNIT_MM).astype(np.uint16))
    sensor = SensorDepth({0: path}, SensorSettings(), UNIT_MM, (0, 0, 320, 320), 1.0, (320, 320))
    return clouds_of(sensor, RayTable(CAMERA))(0)


@pytest.mark.parametrize("zones", [(30, 30), (64, 64), (240, 180), (320, 320)])
def test_points_lie_on_the_plane_that_was_seen(zones, tmp_path):
    rng = np.random.default_rng(0)
    depth = plane(zones) * (rng.random(zones[::-1]) > 0.2)  # a fifth is missing
    points = cloud_of(depth, tmp_path)
    assert points is not None
    assert 0.5 * MOST_POINTS < len(points) <= MOST_POINTS or len(points) == (depth > 0).sum()
    np.testing.assert_allclose(points @ NORMAL, AWAY_MM, atol=0.05)


@pytest.mark.parametrize(("zones", "edge"), [((64, 64), 2), ((240, 180), 6)])
def test_noise_falls_with_the_root_of_the_cells(zones, edge, tmp_path):
    rng = np.random.default_rng(1)
    depth = plane(zones)
    points = cloud_of(depth * (1 + 0.03 * rng.normal(size=depth.shape)), tmp_path)
    assert points is not None
    off = points @ NORMAL / AWAY_MM - 1
    assert off.std() == pytest.approx(0.03 / edge, rel=0.1)
    assert abs(off.mean()) < 3 * off.std() / np.sqrt(len(off))


@pytest.mark.parametrize("side", [39, 40, 64, 128, 240, 320])
@pytest.mark.parametrize("known", [0.3, 0.9])
@pytest.mark.parametrize("noise", [0.0, 0.08])
def test_sparse_and_noisy_sensors_have_clouds(side, known, noise, tmp_path):
    rng = np.random.default_rng(2)
    depth = plane((side, side)) * (1 + noise * rng.normal(size=(side, side))) * (rng.random((side, side)) < known)
    points = cloud_of(depth, tmp_path)
    assert points is not None
    assert min(side * side * known, MOST_POINTS) / 5 < len(points) <= MOST_POINTS


def test_a_coarse_grid_spread_over_a_fine_image_has_a_cloud(tmp_path):
    depth = np.zeros((320, 320))
    depth[2::5, 2::5] = plane((320, 320))[2::5, 2::5]
    points = cloud_of(depth, tmp_path)
    assert points is not None
    assert len(points) > 1000
    np.testing.assert_allclose(points @ NORMAL, AWAY_MM, atol=0.05)


def test_no_point_floats_between_two_walls(tmp_path):
    depth = np.full((64, 64), 20.0)
    depth[:, 31:] = 60.0  # the edge falls within a block
    points = cloud_of(depth, tmp_path)
    assert points is not None
    assert set(np.round(points[:, 2], 3)) == {20.0, 60.0}
    assert len(points) == 32 * 31


def test_a_frame_that_shows_little_has_no_cloud(tmp_path):
    depth = np.zeros((64, 64))
    depth[:10, :10] = 20.0
    assert cloud_of(depth, tmp_path) is None
