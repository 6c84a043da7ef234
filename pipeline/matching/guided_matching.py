"""Features that look alike where a map says that they should be, rather than anywhere in the picture.

Comparing all features of two pictures is a product of two large matrices for each pair of keyframes. Where the map is
right to some pixels, each feature has one or two candidates. What is lost is the rest of the picture, against which a
likeness must stand out (Lowe, IJCV 2004); a feature's own picture, which looks much the same, stands for it, and is
asked once for all pairs. See docs/lab/front_end.md for what that is worth.
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
    the second most there and than `elsewhere` (N,), what `likeness_elsewhere` gives of the first picture.

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


def likeness_elsewhere(pixels: Array, descriptors: Descriptors, radius: float) -> Array:
    """(N,) cosine to the most alike feature of the same picture farther than `radius` px away; -1 if there is none."""
    if pixels.shape != (len(descriptors), 2):
        raise ValueError(f"{len(descriptors)} descriptors do not fit pixels of shape {pixels.shape}")
    likeness = descriptors @ descriptors.T
    return _most_elsewhere(np.ascontiguousarray(pixels, np.float64), likeness, float(radius))


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
            likeness = 0.0
            for n in range(first.shape[1]):
                likeness += first[i, n] * second[j, n]
            if likeness > most[i]:
                next_most[i] = max(next_most[i], most[i])
                nearest[i], most[i] = j, likeness
            else:
                next_most[i] = max(next_most[i], likeness)
            if likeness > most_back[j]:
                back[j], most_back[j] = i, likeness
    pairs = np.empty((count, 2), np.int64)
    found = 0
    for i in range(count):
        j = nearest[i]
        if j >= 0 and back[j] == i and max(1 - most[i], 0.0) < ratio * (1 - next_most[i]):
            pairs[found, 0], pairs[found, 1] = i, j
            found += 1
    return pairs[:found]


@compiled
def _most_elsewhere(pixels: Array, likeness: NDArray[np.float32], radius: float) -> Array:
    most = np.full(len(pixels), -1.0)
    for i in range(len(pixels)):
        for j in range(len(pixels)):
            apart = (pixels[i, 0] - pixels[j, 0]) ** 2 + (pixels[i, 1] - pixels[j, 1]) ** 2
            if likeness[i, j] > most[i] and apart > radius**2:
                most[i] = likeness[i, j]
    return most
