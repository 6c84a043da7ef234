"""Alignment of patches by their inverse depth: pictures of a tilted plane, whose depth is known exactly."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, map_coordinates

from pipeline.matching.patch_alignment import OFFSETS, WINDOW, PatchViews, align_patches, read_patches

FOCAL, SIZE, CENTRE = 160.0, 200, 100.0
PLANE = np.array([0.2, -0.1, 1.0]) / 20.0  # plane @ point = 1: about 20 ahead of the reference
BASELINES = np.array([[1.5, 0.0], [0.0, 1.5], [-1.0, 1.0], [2.0, 0.5]])  # of the other views, beside the reference
PIXELS = np.stack(np.meshgrid(np.arange(60.0, 141, 20), np.arange(60.0, 141, 20)), axis=-1).reshape(-1, 2) + 0.5


def picture_from(x, y, gain=1.0, offset=0.0):
    """The plane's texture as a camera at (x, y, 0) sees it; one plane, one texture, exact rays."""
    rng = np.random.default_rng(4)
    layers = [gaussian_filter(rng.normal(size=(600, 600)), s, mode="wrap") for s in (3.0, 6.0)]
    texture = 128 + 22 * sum(layer / layer.std() for layer in layers)
    column, row = np.meshgrid(np.arange(SIZE) + 0.5, np.arange(SIZE) + 0.5)
    ray = np.stack([(column - CENTRE) / FOCAL, (row - CENTRE) / FOCAL, np.ones_like(row)], axis=-1)
    depth = (1 - PLANE[:2] @ [x, y]) / (ray @ PLANE)
    place = [300 + 8 * (depth * ray[..., 1] + y), 300 + 8 * (depth * ray[..., 0] + x)]
    return np.clip(gain * map_coordinates(texture, place, order=1) + offset, 0, 255).astype(np.uint8)


def project(points):
    return points[..., :2] / points[..., 2:] * FOCAL + CENTRE


def on_plane(pixels):
    ray = np.concatenate([(pixels - CENTRE) / FOCAL, np.ones((*pixels.shape[:-1], 1))], axis=-1)
    return ray / (ray @ PLANE)[..., None]


def views_of(error):
    """Of the patches at `PIXELS`, thought to be at (1 + error) times their inverse depth, along the plane's slope."""
    patch, frame, centre, shape, motion = [], [], [], [], []
    guess = [on_plane(PIXELS + step) / (1 + error)[:, None] for step in ([0.0, 0.0], [1.0, 0.0], [0.0, 1.0])]
    for number, baseline in enumerate(BASELINES):
        other = [project(points - np.append(baseline, 0)) for points in guess]
        further = project(guess[0] / 1.001 - np.append(baseline, 0))
        patch.append(np.arange(len(PIXELS)))
        frame.append(np.full(len(PIXELS), number))
        centre.append(other[0])
        shape.append(np.stack([other[1] - other[0], other[2] - other[0]], axis=2))
        motion.append((further - other[0]) / 0.001)
    return PatchViews(*(np.concatenate(part) for part in (patch, frame, centre, shape, motion)))


def pictures(gain=1.0, offset=0.0):
    return {number: picture_from(*b, gain, offset) for number, b in enumerate(BASELINES)}


@pytest.mark.parametrize("wrong", [-0.08, -0.02, 0.0, 0.03, 0.08])
def test_the_true_depth_is_found_from_one_that_is_off(wrong):
    error = np.full(len(PIXELS), wrong)
    found = align_patches(read_patches(picture_from(0, 0), PIXELS), views_of(error), pictures())
    off = (1 + error) * (1 + found.shift) - 1
    assert np.median(np.abs(off)) < 0.002
    assert np.abs(off).max() < 0.02
    assert (found.correlating == len(BASELINES)).all()


def test_neither_gain_nor_offset_matters():
    error = np.full(len(PIXELS), 0.03)
    reference = read_patches(picture_from(0, 0), PIXELS)
    plain = align_patches(reference, views_of(error), pictures())
    dimmed = align_patches(reference, views_of(error), pictures(0.5, 30))
    np.testing.assert_allclose(dimmed.shift, plain.shift, atol=0.003)
    assert (dimmed.correlating == len(BASELINES)).all()


def test_two_calls_agree():
    error = np.full(len(PIXELS), 0.03)
    reference, views, shown = read_patches(picture_from(0, 0), PIXELS), views_of(error), pictures()
    first, second = (align_patches(reference, views, shown) for _ in range(2))
    for name, values in vars(first).items():
        np.testing.assert_array_equal(values, getattr(second, name))


def test_noise_makes_the_depth_unsure_and_sigma_says_so():
    error, rng = np.zeros(len(PIXELS)), np.random.default_rng(2)
    reference, views = read_patches(picture_from(0, 0), PIXELS), views_of(error)
    shown, sigma, off = pictures(), [], []
    for noise in (2.0, 12.0):
        noisy = {k: np.clip(p + rng.normal(0, noise, p.shape), 0, 255).astype(np.uint8) for k, p in shown.items()}
        found = align_patches(reference, views, noisy)
        sigma.append(np.median(found.sigma))
        off.append(np.sqrt(np.mean(found.shift**2)))
    assert sigma[1] > 3 * sigma[0]
    assert off[1] > 2 * off[0]
    assert 0.3 < off[1] / sigma[1] < 3  # independent noise: sigma is what it says


def test_pictures_of_something_else_do_not_correlate():
    error = np.zeros(len(PIXELS))
    noise = np.random.default_rng(7).normal(size=(len(BASELINES), SIZE, SIZE))
    shown = {k: np.clip(128 + 300 * gaussian_filter(n, 3), 0, 255).astype(np.uint8) for k, n in enumerate(noise)}
    found = align_patches(read_patches(picture_from(0, 0), PIXELS), views_of(error), shown)
    assert np.mean(2 * found.correlating > found.views) < 0.1


def test_a_patch_without_a_view_stays_where_it_is():
    views = views_of(np.zeros(len(PIXELS)))
    kept = views.patch != 3
    views = replace(views, **{name: values[kept] for name, values in vars(views).items()})
    found = align_patches(read_patches(picture_from(0, 0), PIXELS), views, pictures())
    assert found.shift[3] == 0
    assert found.views[3] == found.correlating[3] == 0


def test_a_patch_is_read_where_it_lies():
    """A ramp of grey values: at pixel (x, y), whose centre is at x + 0.5, it has the value 2 x + y + 7."""
    column, row = np.meshgrid(np.arange(60), np.arange(50))
    patches = read_patches((2 * column + row + 7).astype(np.uint8), np.array([[20.5, 30.5], [21.0, 30.5]]))
    expected = 2 * (20 + OFFSETS[:, 0]) + 30 + OFFSETS[:, 1] + 7
    np.testing.assert_allclose(patches.grey, [expected, expected + 1], atol=0.07)  # read to a 32nd of a pixel
    np.testing.assert_allclose(patches.by_x, 2.0, atol=1e-4)
    np.testing.assert_allclose(patches.by_y, 1.0, atol=1e-4)
    assert pytest.approx(1.0) == WINDOW.sum()


@pytest.mark.parametrize("value", [np.nan, np.inf, -1e300])
def test_a_view_at_no_finite_place_confirms_nothing(value):
    """It reads no memory beyond the picture either."""
    views = views_of(np.zeros(len(PIXELS)))
    centre = views.centre.copy()
    centre[views.patch == 3] = value
    found = align_patches(read_patches(picture_from(0, 0), PIXELS), replace(views, centre=centre), pictures())
    assert found.correlating[3] == 0
    assert (np.delete(found.correlating, 3) == len(BASELINES)).all()
