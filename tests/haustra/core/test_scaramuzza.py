"""Scaramuzza's lens against the rays that its authors define, which have a closed form."""

import numpy as np
import pytest

from haustra.core.camera import Camera
from haustra.core.lenses.scaramuzza import parameters_of
from haustra.core.ray_table import RayTable

# C3VD's numbers (DurrLab/C3VD), its centre in COLMAP's pixels.
A = (769.243600037458, -0.000812770624150226, 6.25674244578925e-07, -1.19662182144280e-09)
CENTRE, STRETCH = (679.044839263292, 543.475887548343), (0.99998688224999, 0.00288273829525059, -0.00296316513429569)
CAMERA = Camera("SCARAMUZZA", 1350, 1080, parameters_of(*A, CENTRE, STRETCH))
PIXELS = np.stack(np.meshgrid(np.arange(0, 1351, 27.0), np.arange(0, 1081, 27.0)), axis=-1).reshape(-1, 2)


def defined_rays(pixels, stretch):
    """Unit rays (N,3) by the definition: the ray of the unstretched (u, v) is (u, v, a0 + a2 rho^2 + ...)."""
    uv = np.linalg.solve(stretch, (pixels - CENTRE).T).T
    rho = np.hypot(*uv.T)
    rays = np.column_stack([uv, A[0] + A[1] * rho**2 + A[2] * rho**3 + A[3] * rho**4])
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)


def angles(first, second):
    first, second = (rays / np.linalg.norm(rays, axis=1, keepdims=True) for rays in (first, second))
    return np.linalg.norm(np.cross(first, second), axis=1)


def matrix(c, d, e):
    return np.array([[c, d], [e, 1.0]])


def test_rays_and_pixels_are_those_of_the_definition():
    expected = defined_rays(PIXELS, matrix(*STRETCH))
    plane, known = CAMERA.unproject(PIXELS)
    assert known.mean() > 0.9
    assert angles(np.column_stack([plane, np.ones(len(plane))]), expected)[known].max() < 1e-12
    ahead = np.degrees(np.arccos(expected[:, 2])) < 95  # sideways too, where the plane z = 1 has nothing
    np.testing.assert_allclose(CAMERA.project(expected[ahead]), PIXELS[ahead], atol=1e-6)


def test_the_stretch_matrix_is_not_its_transpose():
    """C3VD's renderer fills a column-major matrix: its [[c, e], [d, 1]] differs from ours by up to half a degree."""
    c, d, e = STRETCH
    ours, other = defined_rays(PIXELS, matrix(c, d, e)), defined_rays(PIXELS, matrix(c, e, d))
    plane, known = CAMERA.unproject(PIXELS)
    found = np.column_stack([plane, np.ones(len(plane))])
    assert angles(found, ours)[known].max() < 1e-12
    assert 0.1 < np.degrees(angles(found, other)[known].max()) < 0.6


def test_half_the_picture_has_the_same_rays():
    half = CAMERA.cropped_and_scaled(100, 60, 1100, 900, 0.5)
    rays = defined_rays(PIXELS, matrix(*STRETCH))
    rays = rays[rays[:, 2] > 0.3]
    np.testing.assert_allclose(half.project(rays), (CAMERA.project(rays) - [100, 60]) / 2, atol=1e-9)


def test_the_angle_past_which_a_lens_turns_back():
    """With b2 = -0.5 alone the ray of radius rho is (rho, 1 - rho^2 / 2), which looks farther out for ever; with
    b2 = +0.5 its angle arctan(rho / (1 + rho^2 / 2)) is greatest at rho = sqrt(2)."""
    wide = Camera("SCARAMUZZA", 100, 100, (50.0, 50.0, 50.0, -0.5, 0.0, 0.0, 1.0, 0.0, 0.0))
    assert wide.lens.valid_angle(wide.distortion) > np.pi / 2
    narrow = Camera("SCARAMUZZA", 100, 100, (50.0, 50.0, 50.0, 0.5, 0.0, 0.0, 1.0, 0.0, 0.0))
    assert narrow.lens.valid_angle(narrow.distortion) == pytest.approx(np.arctan(np.sqrt(2) / 2), abs=1e-6)
    table = RayTable(narrow)
    lost = table.project_valid(np.array([[0.9, 0.0, 1.0], [0.3, 0.1, 1.0]]))
    assert np.isnan(lost[0]).all()
    assert np.isfinite(lost[1]).all()


def test_a_pinhole_is_the_lens_without_distortion():
    plain = Camera("SCARAMUZZA", 100, 80, (50.0, 49.0, 41.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0))
    pinhole = Camera("PINHOLE", 100, 80, (50.0, 50.0, 49.0, 41.0))
    rays = np.random.default_rng(0).uniform([-1, -1, 1], [1, 1, 2], (50, 3))
    np.testing.assert_allclose(plain.project(rays), pinhole.project(rays), atol=1e-9)
