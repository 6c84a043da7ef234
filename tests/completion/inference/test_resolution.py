"""The resolution at which a frame is completed, and how its depth is restored to the image's."""

from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from completion import DepthCompleter
from completion.inference.completer import load_depth_network
from completion.inference.resolution import resized, resolution_factor, restore_resolution


@pytest.fixture(scope="module")
def network():
    return load_depth_network("mscsa")


def frame(points, height=400, width=320, seed=0):
    rng = np.random.default_rng(seed)
    rgb = rng.integers(20, 230, (height, width, 3), dtype=np.uint8)
    sparse = np.zeros((height, width), np.float32)
    sparse.flat[rng.choice(height * width, points, replace=False)] = rng.uniform(10, 50, points)
    return rgb, sparse


@pytest.mark.parametrize(
    ("side", "points", "iterations", "expected"),
    [
        (640, 100, 1, 320),
        (640, 1000, 1, 320),
        (640, 100, 2, 320),
        (640, 1000, 2, 384),
        (320, 1000, 2, 384),
        (320, 1000, 1, 320),
        (200, 1000, 2, 300),  # one and a half times, no more
        (200, 100, 2, 200),
        (200, 100, 1, 200),
    ],
)
def test_the_size_follows_iterations_and_points(side, points, iterations, expected):
    assert resolution_factor(side, points, iterations) * side == pytest.approx(expected)


def test_each_frame_of_a_batch_is_completed_at_its_own_size(network):
    frames = [frame(points) for points in (100, 1000)]
    rgb, sparse = (np.stack(part) for part in zip(*frames, strict=True))
    for iterations, sides in ((1, (320, 320)), (2, (320, 384))):
        mixed = DepthCompleter(network, precision="fp32", iterations=iterations).batch(rgb, sparse)[0]
        for index, side in enumerate(sides):
            fixed = DepthCompleter(network, precision="fp32", resolution=side, iterations=iterations)
            np.testing.assert_allclose(mixed[index], fixed(rgb[index], sparse[index])[0], rtol=1e-3)


def noting_size(iterate, seen, image, log_sparse, *rest):
    seen.append(log_sparse.shape[2:])
    return iterate(image, log_sparse, *rest)


@pytest.mark.parametrize(("side", "points", "expected"), [(100, 300, (100, 80)), (None, 1000, (384, 307))])
def test_depth_is_computed_at_the_resolution_and_restored_to_the_images(monkeypatch, network, side, points, expected):
    rgb, sparse = frame(points)
    completer = DepthCompleter(network, precision="fp32", resolution=side)
    seen = []
    for made in (completer.network, completer.recurrent):
        monkeypatch.setattr(made, "iterate", partial(noting_size, made.iterate, seen))
    depth, confidence = completer(rgb, sparse)
    assert seen == [expected, expected]
    assert depth.shape == confidence.shape == (400, 320)


@settings(max_examples=60, deadline=None)
@given(st.integers(40, 90), st.integers(40, 90), st.floats(0.4, 1.5), st.data())
def test_a_point_stays_on_what_the_image_shows_there(height, width, factor, data):
    """The middle of a square that the resizing of the image moves by itself, against the point in its middle."""
    row, column = (data.draw(st.integers(10, side - 11)) for side in (height, width))
    rgb = np.zeros((height, width, 3), np.uint8)
    rgb[row - 4 : row + 5, column - 4 : column + 5] = 200
    sparse = np.zeros((height, width), np.float32)
    sparse[row, column] = 30
    new_rgb, new_sparse, _ = resized(rgb, sparse, sparse / 30, factor)
    light = new_rgb[..., 0].astype(float)
    middle = np.array([(light * grid).sum() for grid in np.indices(light.shape)]) / light.sum()
    (place,) = np.argwhere(new_sparse > 0)
    assert np.abs(place - middle).max() <= 0.55  # half a pixel, and the square's grey levels


@settings(max_examples=30, deadline=None)
@given(st.integers(10, 60), st.integers(10, 60), st.floats(0.2, 1.5), st.integers(0, 2**32 - 1))
def test_the_surest_point_of_a_pixel_stays_with_its_own_depth(height, width, factor, seed):
    rgb, sparse = frame(40, height, width, seed)
    trust = np.divide(1, sparse, out=np.zeros_like(sparse), where=sparse > 0)  # so each tells the other
    _, new_sparse, new_trust = resized(rgb, sparse, trust, factor)
    there = new_sparse > 0
    assert np.array_equal(there, new_trust > 0)
    np.testing.assert_allclose(new_trust[there], 1 / new_sparse[there], rtol=1e-6)
    assert new_sparse[there].min() == sparse[sparse > 0].min()
    if factor >= 1:
        assert there.sum() == 40


@settings(max_examples=30, deadline=None)
@given(st.integers(8, 40), st.integers(8, 40), st.floats(0.5, 4), st.integers(2, 6))
def test_between_the_two_sides_of_an_edge_no_depth_is_invented(height, width, zoom, column):
    depth = np.full((height, width), 20, np.float32)
    depth[:, column:] = 40
    size = round(width * zoom), round(height * zoom)
    back, _ = restore_resolution(depth, np.ones_like(depth), size)
    assert back.shape == (size[1], size[0])
    assert set(np.unique(back)) == {20, 40}
    # The edge is where it was, to half a pixel of the one and one of the other.
    assert abs((back[0] == 20).sum() / zoom - column) <= 0.5 + 1 / zoom


@pytest.mark.parametrize("size", [(100, 75), (28, 21)])
def test_a_slope_comes_back_as_a_slope(size):
    rows, columns = np.mgrid[:30, :40].astype(np.float32)
    plane = 50 + 0.5 * columns + 0.3 * rows
    back, _ = restore_resolution(plane, plane, size)
    y, x = (np.mgrid[: size[1], : size[0]] + 0.5) * 40 / size[0] - 0.5  # pixel centres in the first image
    inside = (slice(2, -2), slice(2, -2))
    np.testing.assert_allclose(back[inside], (50 + 0.5 * x + 0.3 * y)[inside], rtol=1e-4)
