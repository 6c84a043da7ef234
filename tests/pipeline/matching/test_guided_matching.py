"""Features matched where a map says that they should be: against the same said with whole matrices."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.matching.descriptor_matching import RATIO
from pipeline.matching.guided_matching import match_near, self_similarity

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
    similarity = np.where(apart <= radius, first.astype(float) @ second.T.astype(float), -np.inf)
    pairs = []
    for i, row in enumerate(similarity):
        if not np.isfinite(row).any():
            continue
        j = int(row.argmax())
        rest = max(np.delete(row, j).max(initial=-1.0), elsewhere[i])
        if similarity[:, j].argmax() == i and max(1 - row[j], 0) < RATIO**2 * (1 - rest):
            pairs.append((i, j))
    return np.array(pairs, np.int64).reshape(-1, 2)


def changed(look, cosine, rng):
    """A descriptor of length one at about this cosine to another."""
    across = rng.normal(0, 1, look.shape)
    across -= (across @ look) * look
    return (cosine * look + np.sqrt(1 - cosine**2) * across / np.linalg.norm(across)).astype(np.float32)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10_000), st.integers(0, 40), st.booleans())
def test_it_is_what_whole_matrices_say(seed, count, asks_elsewhere):
    """Each feature of the first picture has up to three in the second, near where it should be or just out of reach, as
    alike as each other within some hundredths; neighbours want the same ones."""
    rng = np.random.default_rng(seed)
    first = descriptors(count, rng)
    expected = picture(count, rng, 40.0)
    places, looks = [picture(3, rng)], [descriptors(3, rng)]
    for place, look in zip(expected, first, strict=True):
        for _ in range(rng.integers(0, 4)):
            places.append(place + rng.normal(0, 4, (1, 2)))
            looks.append(changed(look, rng.uniform(0.8, 0.99), rng)[None])
    for k in range(1, count, 3):  # twins in the first picture
        first[k] = changed(first[k - 1], 0.97, rng)
        expected[k] = expected[k - 1] + rng.normal(0, 1, 2)
    expected[rng.random(count) < 0.1, rng.integers(0, 2)] = np.nan
    order = rng.permutation(sum(map(len, places)))
    pixels, second = np.concatenate(places)[order], np.concatenate(looks)[order]
    known = self_similarity(picture(count, rng), first, RADIUS)
    elsewhere = known if asks_elsewhere else np.full(count, -1.0)
    found = match_near(expected, pixels, first, second, elsewhere, RADIUS)
    np.testing.assert_array_equal(found, matched_by_matrices(expected, pixels, first, second, elsewhere, RADIUS))


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize(("best", "second", "clear"), [(0.97, 0.95, True), (0.97, 0.96, False), (0.9, 0.87, False)])
def test_the_best_must_be_clearly_better_than_the_second(turned, best, second, clear):
    """Whichever is met first: (1 - best) < 0.85^2 (1 - second)."""
    rng = np.random.default_rng(4)
    look = descriptors(1, rng)
    looks = np.stack([changed(look[0], best, rng), changed(look[0], second, rng)])
    pixels = np.array([[10.0, 9.0], [10.0, 11.0]])
    looks = looks[::-1] if turned else looks
    found = match_near(np.array([[10.0, 10.0]]), pixels, look, looks, np.array([-1.0]), RADIUS)
    assert found.tolist() == ([[0, int(turned)]] if clear else [])


def test_a_feature_is_matched_to_one_that_prefers_it():
    rng = np.random.default_rng(5)
    look = descriptors(1, rng)[0]
    first = np.stack([changed(look, 0.9, rng), changed(look, 0.99, rng)])
    found = match_near(np.full((2, 2), 10.0), np.full((1, 2), 10.0), first, look[None], np.full(2, -1.0), RADIUS)
    assert found.tolist() == [[1, 0]]


def test_most_are_found_and_none_out_of_reach():
    rng = np.random.default_rng(0)
    first, expected = descriptors(200, rng), picture(200, rng, 320)
    moved = expected + rng.uniform(-9, 9, (200, 2))
    elsewhere = self_similarity(expected, first, RADIUS)
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
    elsewhere = self_similarity(pixels, twice, RADIUS)
    assert elsewhere.min() > 0.95
    assert len(match_near(pixels, pixels[:1], twice, descriptors(1, rng, once), elsewhere, RADIUS)) == 0
    alone = match_near(pixels, pixels[:1], twice, descriptors(1, rng, once), np.full(2, -1.0), RADIUS)
    assert alone.tolist() == [[0, 0]]


def test_the_likeness_elsewhere_leaves_out_the_neighbourhood():
    rng = np.random.default_rng(2)
    pixels, looks = picture(50, rng), descriptors(50, rng)
    far = np.linalg.norm(pixels[:, None] - pixels[None], axis=2) > RADIUS
    expected = np.where(far, looks @ looks.T, -1).max(axis=1)
    np.testing.assert_allclose(self_similarity(pixels, looks, RADIUS), expected, atol=1e-6)
    np.testing.assert_array_equal(self_similarity(pixels, looks, 1e3), -1.0)


@pytest.mark.parametrize(("count", "others"), [(0, 0), (0, 3), (3, 0)])
def test_pictures_without_features(count, others):
    rng = np.random.default_rng(3)
    found = match_near(
        picture(count, rng), picture(others, rng), descriptors(count, rng), descriptors(others, rng),
        self_similarity(picture(count, rng), descriptors(count, rng), RADIUS), RADIUS,
    )  # fmt: skip
    assert found.shape == (0, 2)


def test_arrays_that_do_not_fit_are_refused():
    """The kernels check no index."""
    rng = np.random.default_rng(6)
    places, looks = picture(5, rng), descriptors(5, rng)
    good = {"expected": places, "pixels": places, "first": looks, "second": looks, "elsewhere": np.full(5, -1.0)}
    assert len(match_near(**good, radius=RADIUS)) == 5
    short = {name: array[:4] for name, array in good.items()}
    for name in good:
        with pytest.raises(ValueError, match="do not fit"):
            match_near(**(good | {name: short[name]}), radius=RADIUS)
    with pytest.raises(ValueError, match="do not fit"):
        match_near(**(good | {"second": looks[:, :64]}), radius=RADIUS)
    with pytest.raises(ValueError, match="do not fit"):
        self_similarity(places, looks[:3], RADIUS)
