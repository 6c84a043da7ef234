"""The classical fills against SciPy and hand-made cases."""

import numpy as np
import pytest
from scipy import ndimage
from scipy.spatial import cKDTree

from completion.networks.classical import CLASSICAL, ip_basic, linear, nearest


def scattered(height=24, width=20, points=30, seed=0):
    rng = np.random.default_rng(seed)
    sparse = np.zeros((height, width), np.float32)
    sparse.flat[rng.choice(height * width, points, replace=False)] = rng.uniform(5, 60, points)
    return sparse


def test_nearest_takes_a_point_that_no_other_is_nearer_than():
    sparse = scattered()
    pixels = np.argwhere(sparse > 0)
    dense = nearest(sparse)
    shortest, _ = cKDTree(pixels).query(np.argwhere(np.ones_like(sparse)))
    for (row, column), distance in zip(np.ndindex(*sparse.shape), shortest, strict=True):
        taken = pixels[sparse[tuple(pixels.T)] == dense[row, column]]
        assert np.hypot(*(taken - [row, column]).T).min() == pytest.approx(distance)


def test_linear_is_exact_on_a_plane_within_the_hull_and_nearest_outside():
    rows, columns = np.indices((20, 30))
    plane = (3 + 0.5 * rows + 0.25 * columns).astype(np.float32)
    corners = np.zeros_like(plane, dtype=bool)
    corners[[4, 4, 15, 15, 9], [6, 22, 6, 22, 13]] = True
    sparse = np.where(corners, plane, 0).astype(np.float32)
    dense = linear(sparse)
    assert dense.dtype == np.float32
    np.testing.assert_allclose(dense[4:16, 6:23], plane[4:16, 6:23], rtol=1e-6)
    outside = np.ones_like(corners)
    outside[4:16, 6:23] = False
    np.testing.assert_array_equal(dense[outside], nearest(sparse)[outside])


def literal_ip_basic(sparse):
    """The same steps with SciPy's filters and the bilateral filter as a loop."""
    far = sparse.max()

    def smallest(depth, footprint):
        return ndimage.minimum_filter(depth, footprint=footprint, mode="constant", cval=np.inf)

    def median(depth):
        smooth = ndimage.median_filter(depth, 5, mode="nearest")
        return np.where(np.isinf(depth) | np.isinf(smooth), depth, smooth)

    depth = np.full(sparse.shape, np.inf)
    for low, high, arm in ((30 / 80, 2, 1), (15 / 80, 30 / 80, 2), (0, 15 / 80, 3)):
        members = (sparse > low * far) & (sparse <= high * far)
        cross = np.zeros((2 * arm + 1, 2 * arm + 1))
        cross[arm], cross[:, arm] = 1, 1
        spread = smallest(np.where(members, sparse, np.inf), cross)
        depth = np.where(np.isinf(spread), depth, spread)
    shrunk = smallest(depth, np.ones((5, 5)))
    depth = median(ndimage.maximum_filter(shrunk, size=5, mode="constant", cval=-np.inf))
    depth = median(np.where(np.isinf(depth), smallest(depth, np.ones((9, 9))), depth))
    while np.isinf(depth).any():
        depth = np.where(np.isinf(depth), smallest(depth, np.ones((5, 5))), depth)
    padded, out = np.pad(median(depth), 2, mode="reflect"), np.zeros(sparse.shape)
    dy, dx = np.indices((5, 5)) - 2
    closeness = np.exp(-(dy**2 + dx**2) / (2 * 2.0**2)) * (dy**2 + dx**2 <= 4)
    for i, j in np.ndindex(*sparse.shape):
        patch = padded[i : i + 5, j : j + 5]
        weight = closeness * np.exp(-((patch - patch[2, 2]) ** 2) / (2 * (0.5 / 80 * far) ** 2))
        out[i, j] = (weight * patch).sum() / weight.sum()
    return out


@pytest.mark.parametrize("points", [1, 6, 30, 200])
def test_ip_basic_equals_its_scipy_transcription(points):
    sparse = scattered(40, 36, points)
    np.testing.assert_allclose(ip_basic(sparse), literal_ip_basic(sparse), rtol=2e-4)


def test_ip_basic_lets_the_near_point_win_where_two_meet():
    sparse = np.zeros((21, 41), np.float32)
    sparse[10, 15], sparse[10, 25] = 10.0, 100.0
    dense = ip_basic(sparse)
    assert dense[10, 15] == pytest.approx(10, rel=1e-3)
    assert dense[10, 20] == pytest.approx(10, rel=1e-3)
    assert dense[10, 40] == pytest.approx(100, rel=1e-3)


@pytest.mark.parametrize("name", CLASSICAL)
def test_classical_fills_are_dense_scale_equivariant_and_defined_for_few_points(name):
    fill, sparse = CLASSICAL[name], scattered()
    given = sparse.copy()
    dense = fill(sparse)
    np.testing.assert_array_equal(sparse, given)
    assert dense.dtype == np.float32
    assert dense.min() >= sparse[sparse > 0].min() * (1 - 1e-5)
    assert dense.max() <= sparse.max() * (1 + 1e-5)
    np.testing.assert_allclose(fill(0.01 * sparse), 0.01 * dense, rtol=1e-3)
    line = np.zeros_like(sparse)
    line[3, [2, 9, 15]] = 7.0
    np.testing.assert_allclose(fill(line), 7.0, rtol=1e-6)
    line[3, 9] = 0
    np.testing.assert_allclose(fill(line), 7.0, rtol=1e-6)
    assert (fill(np.zeros_like(sparse)) == 0).all()
