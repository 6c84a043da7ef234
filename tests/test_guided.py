"""Features matched where a map says that they should be: against the same said with whole matrices."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.odometry.guided import likeness_elsewhere, match_near
from pipeline.odometry.places import RATIO

RADIUS = 6.0


def descriptors(count, rng, like=None):
    """(N,128) of length one, as RootSIFT: random, or a little changed."""
    values = rng.random((count, 128)) if like is None else like + rng.normal(0, 0.02, like.shape)
    return (values / np.linalg.norm(values, axis=1, keepdims=True)).astype(np.float32)


def picture(count, rng, side=60.0):
    return rng.uniform(0, side, (count, 2))


def matched_by_matrices(expected, pixels, first, second, elsewhere, radius):
    """Nearest both ways of those within reach, and nearer by the ratio than the second and than what is elsewhere."""
    apart = np.linalg.norm(expected[:, None] - pixels[None], axis=2)
    likeness = np.where(apart <= radius, first.astype(float) @ second.T.astype(float), -np.inf)
    pairs = []
    for i, row in enumerate(likeness):
        if not np.isfinite(row).any():
            continue
        j = int(row.argmax())
        rest = max(np.delete(row, j).max(initial=-1.0), elsewhere[i])
        if likeness[:, j].argmax() == i and max(1 - row[j], 0) < RATIO**2 * (1 - rest):
            pairs.append((i, j))
    return np.array(pairs, np.int64).reshape(-1, 2)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000), st.integers(0, 60), st.integers(0, 60))
def test_it_is_what_whole_matrices_say(seed, count, others):
    """Features of the second picture are the first's, moved by some pixels and changed, and some of their own."""
    rng = np.random.default_rng(seed)
    first = descriptors(count, rng)
    kept = min(count, others)
    expected = picture(count, rng)
    expected[rng.random(count) < 0.1] = np.nan
    pixels = picture(others, rng)
    pixels[:kept] = np.where(np.isfinite(expected[:kept]), expected[:kept], 30) + rng.normal(0, 3, (kept, 2))
    second = descriptors(others, rng)
    second[:kept] = descriptors(kept, rng, first[:kept])
    elsewhere = likeness_elsewhere(picture(count, rng), first, RADIUS)
    found = match_near(expected, pixels, first, second, elsewhere, RADIUS)
    np.testing.assert_array_equal(found, matched_by_matrices(expected, pixels, first, second, elsewhere, RADIUS))


def test_most_are_found_and_none_out_of_reach():
    rng = np.random.default_rng(0)
    first, expected = descriptors(200, rng), picture(200, rng, 320)
    moved = expected + rng.uniform(-9, 9, (200, 2))
    elsewhere = likeness_elsewhere(expected, first, RADIUS)
    found = match_near(expected, moved, first, descriptors(200, rng, first), elsewhere, RADIUS)
    near = np.flatnonzero(np.linalg.norm(moved - expected, axis=1) < RADIUS)
    assert 50 < len(near) < 150
    np.testing.assert_array_equal(found, np.stack([near, near], axis=1))


def test_a_texture_that_repeats_is_not_matched():
    """The same patch twice in the first picture, far apart: either could be what the second one shows."""
    rng = np.random.default_rng(1)
    once = descriptors(1, rng)
    twice = np.concatenate([once, descriptors(1, rng, once)])
    pixels = np.array([[10.0, 10.0], [50.0, 50.0]])
    elsewhere = likeness_elsewhere(pixels, twice, RADIUS)
    assert elsewhere.min() > 0.95
    assert len(match_near(pixels, pixels[:1], twice, descriptors(1, rng, once), elsewhere, RADIUS)) == 0
    alone = match_near(pixels, pixels[:1], twice, descriptors(1, rng, once), np.full(2, -1.0), RADIUS)
    assert alone.tolist() == [[0, 0]]


def test_the_likeness_elsewhere_leaves_out_the_neighbourhood():
    rng = np.random.default_rng(2)
    pixels, looks = picture(50, rng), descriptors(50, rng)
    far = np.linalg.norm(pixels[:, None] - pixels[None], axis=2) > RADIUS
    expected = np.where(far, looks @ looks.T, -1).max(axis=1)
    np.testing.assert_allclose(likeness_elsewhere(pixels, looks, RADIUS), expected, atol=1e-6)
    np.testing.assert_array_equal(likeness_elsewhere(pixels, looks, 1e3), -1.0)


@pytest.mark.parametrize(("count", "others"), [(0, 0), (0, 3), (3, 0)])
def test_pictures_without_features(count, others):
    rng = np.random.default_rng(3)
    found = match_near(
        picture(count, rng), picture(others, rng), descriptors(count, rng), descriptors(others, rng),
        likeness_elsewhere(picture(count, rng), descriptors(count, rng), RADIUS), RADIUS,
    )  # fmt: skip
    assert found.shape == (0, 2)
