"""Words of a video and the likeness of its keyframes by them."""

import numpy as np
import pytest

from pipeline.matching import place_recognition
from pipeline.matching.keyframe_features import MIN_FEATURES, KeyframeFeatures
from pipeline.matching.place_recognition import VisualWords, retrieve, retrieve_within, vlad


def keyframe(number: int, place: int, count: int = 80) -> KeyframeFeatures:
    """Features of a place, each time with noise of its own."""
    rng = np.random.default_rng(place)
    codes = rng.integers(0, 200, (count, 128)) + np.random.default_rng([place, number]).integers(0, 40, (count, 128))
    points = np.ones((count, 3))
    return KeyframeFeatures(
        number, points[:, :2], codes.astype(np.uint8), points, np.ones(count), np.zeros(count, bool)
    )


@pytest.fixture(scope="module")
def two_maps() -> tuple[list[KeyframeFeatures], list[KeyframeFeatures]]:
    return [keyframe(k, place) for k, place in enumerate((0, 1, 2))], [keyframe(9 + k, k) for k in (2, 0, 5)]


def test_keyframes_of_one_place_are_the_most_alike(two_maps):
    first, second = two_maps
    found = VisualWords.of([*first, *second], 0).similarities(first, second)
    assert found[2].argmax() == 0
    assert found[0].argmax() == 1
    assert (2, 0) in retrieve(found, 1)


def test_likeness_is_the_cosine_of_the_signatures(two_maps):
    first, second = two_maps
    words = VisualWords.of([*first, *second], 0)
    centres = words._centres
    expected = [[float(vlad(a.rootsift, centres) @ vlad(b.rootsift, centres)) for b in second] for a in first]
    np.testing.assert_allclose(words.similarities(first, second), expected, atol=1e-6)
    np.testing.assert_allclose(np.diag(words.similarities(first, first)), 1, atol=1e-6)


def test_words_are_learnt_and_signatures_made_once(two_maps, monkeypatch):
    first, second = two_maps
    made = []
    monkeypatch.setattr(place_recognition, "vlad", lambda *a: made.append(1) or vlad(*a))
    words = VisualWords.of([*first, *second], 0)
    once = words.similarities(first, second)
    np.testing.assert_array_equal(words.similarities(first, second), once)
    np.testing.assert_array_equal(words.similarities(second, first), once.T)
    assert len(made) == len(first) + len(second)


def test_two_learnings_by_one_seed_agree(two_maps):
    first, second = two_maps
    one, other = (VisualWords.of([*first, *second], 3).similarities(first, second) for _ in range(2))
    np.testing.assert_array_equal(one, other)


def test_keyframes_with_too_few_features_are_like_nothing(two_maps):
    first, _ = two_maps
    poor = keyframe(5, 0, MIN_FEATURES - 1)
    found = VisualWords.of([*first, poor], 0).similarities(first, [first[0], poor])
    assert np.isneginf(found[:, 1]).all()
    assert np.isfinite(found[:, 0]).all()
    assert np.isneginf(VisualWords.of([poor], 0).similarities([poor], [poor])).all()
    assert VisualWords.of([], 0).similarities([], [poor]).shape == (0, 1)


def test_pairs_within_one_list_come_once(two_maps):
    first, _ = two_maps
    found = VisualWords.of(first, 0).similarities(first, first)
    np.fill_diagonal(found, -np.inf)
    assert retrieve_within(found, 2) == [(0, 1), (0, 2), (1, 2)]
