"""Guided matching: each feature is compared with those near its predicted position in the other picture.

Comparing all features of two pictures is a product of two large matrices for each pair of keyframes. Where the map is
right to some pixels, each feature has one or two candidates. The ratio test (Lowe, IJCV 2004) needs a second best match
from elsewhere; it is taken from the feature's own picture, which looks much the same, once for all pairs. Measured in
docs/lab/front_end.md.
"""

import numpy as np
from numpy.typing import NDArray

from haustra.core.numba_cache import compiled
from haustra.core.se3 import Array
from pipeline.matching.descriptor_matching import RATIO

Descriptors = NDArray[np.float32]  # (N,128), of length one


def match_near(
    expected: Array, pixels: Array, first: Descriptors, second: Descriptors, elsewhere: Array, radius: float
) -> NDArray[np.int64]:
    """(K,2) rows of features of two pictures that are each other's most alike within reach, and clearly more alike than
    the second most there and than `elsewhere` (N,), from `self_similarity` of the first picture.

    expected: (N,2) where the first one's features should be in the second one, NaN = nowhere; its own are at `pixels`
    (M,2); `radius` px is the reach.
    """
    floats = (np.ascontiguousarray(a, np.float64) for a in (expected, pixels, elsewhere))
    expected, pixels, elsewhere = floats
    first, second = np.ascontiguousarray(first, np.float32), np.ascontiguousarray(second, np.float32)
    here, there = len(expected), len(pixels)
    shapes = (expected.shape, pixels.shape, elsewhere.shape, first.shape, second.shape)
    if shapes != ((here, 2), (there, 2), (here,), (here, first.shape[1]), (there, first.shape[1])):
        raise ValueError(f"features of two pictures do not fit each other: {shapes}")  # the kernel checks no index
    return _match_near(expected, pixels, first, second, elsewhere, float(radius), RATIO**2)


def self_similarity(pixels: Array, descriptors: Descriptors, radius: float) -> Array:
    """(N,) cosine to the most alike feature of the same picture farther than `radius` px away; -1 if there is none."""
    if pixels.shape != (len(descriptors), 2):
        raise ValueError(f"{len(descriptors)} descriptors do not fit pixels of shape {pixels.shape}")
    similarity = descriptors @ descriptors.T
    return _most_elsewhere(np.ascontiguousarray(pixels, np.float64), similarity, float(radius))


@compiled
def _match_near(
    expected: Array,
    pixels: Array,
    first: Descriptors,
    second: Descriptors,
    elsewhere: Array,
    radius: float,
    ratio: float,
) -> NDArray[np.int64]:
    """`ratio`: of squared distances, 2 - 2 cosine, below which the nearest is clearly nearer."""
    by_row = np.argsort(pixels[:, 1])
    rows = pixels[by_row, 1]
    count = len(expected)
    nearest = np.full(count, -1)
    most, next_most = np.full(count, -1.0), elsewhere.copy()
    back, most_back = np.full(len(pixels), -1), np.full(len(pixels), -1.0)
    for i in range(count):
        if not (np.isfinite(expected[i, 0]) and np.isfinite(expected[i, 1])):
            continue
        for k in range(np.searchsorted(rows, expected[i, 1] - radius), len(rows)):
            if rows[k] > expected[i, 1] + radius:
                break
            j = by_row[k]
            if (pixels[j, 0] - expected[i, 0]) ** 2 + (pixels[j, 1] - expected[i, 1]) ** 2 > radius**2:
                continue
            similarity = 0.0
            for n in range(first.shape[1]):
                similarity += first[i, n] * second[j, n]
            if similarity > most[i]:
                next_most[i] = max(next_most[i], most[i])
                nearest[i], most[i] = j, similarity
            else:
                next_most[i] = max(next_most[i], similarity)
            if similarity > most_back[j]:
                back[j], most_back[j] = i, similarity
    pairs = np.empty((count, 2), np.int64)
    found = 0
    for i in range(count):
        j = nearest[i]
        if j >= 0 and back[j] == i and max(1 - most[i], 0.0) < ratio * (1 - next_most[i]):
            pairs[found, 0], pairs[found, 1] = i, j
            found += 1
    return pairs[:found]


@compiled
def _most_elsewhere(pixels: Array, similarity: NDArray[np.float32], radius: float) -> Array:
    most = np.full(len(pixels), -1.0)
    for i in range(len(pixels)):
        for j in range(len(pixels)):
            apart = (pixels[i, 0] - pixels[j, 0]) ** 2 + (pixels[i, 1] - pixels[j, 1]) ** 2
            if similarity[i, j] > most[i] and apart > radius**2:
                most[i] = similarity[i, j]
    return most
