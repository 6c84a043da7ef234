"""Rays read from a table, beside SciPy's bilinear interpolation of it."""

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from haustra.core.camera import Camera
from haustra.core.ray_table import RayTable

FISHEYE = Camera("OPENCV_FISHEYE", 64, 48, (30.0, 31.0, 32.0, 24.0, 0.02, -0.01, 0.0, 0.0))


def test_rays_are_read_bilinearly_and_beyond_the_rim_as_at_it():
    rays = RayTable(FISHEYE)
    pixels = np.random.default_rng(0).uniform([-5, -5], [70, 53], (500, 2))
    limited = np.clip(pixels, 0, [64 - 1e-6, 48 - 1e-6])
    expected = RegularGridInterpolator((np.arange(49), np.arange(65)), rays._table)(limited[:, ::-1])
    plane, jacobian = rays.unproject(pixels)
    np.testing.assert_allclose(plane, expected[:, :2], atol=1e-12)
    np.testing.assert_allclose(jacobian.reshape(-1, 4), expected[:, 2:], atol=1e-10)


def test_a_pixel_that_is_none_has_no_ray_and_none_at_all_give_none():
    rays = RayTable(FISHEYE)
    plane, jacobian = rays.unproject(np.array([[np.nan, 3.0], [4.0, np.nan], [10.0, 11.0]]))
    assert np.isnan(plane[:2]).all()
    assert np.isnan(jacobian[:2]).all()
    assert np.isfinite(plane[2]).all()
    assert rays.unproject(np.zeros((0, 2)))[1].shape == (0, 2, 2)


def test_pixels_of_half_precision_are_read_as_they_are():
    rays = RayTable(FISHEYE)
    pixels = np.array([[3.25, 7.5], [60.125, 40.75]], np.float32)
    np.testing.assert_array_equal(rays.unproject(pixels)[0], rays.unproject(pixels.astype(np.float64))[0])
