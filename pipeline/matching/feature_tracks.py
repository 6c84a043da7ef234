"""Tracks of features over several pictures, joined from pairwise matches."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from haustra.core.se3 import Array


@dataclass(frozen=True)
class FeatureTracks:
    """points (T,3) in the world; (M,) observations, by picture: feature number `feature` of picture `place` belongs to
    `track`."""

    points: Array
    track: NDArray[np.int64]
    place: NDArray[np.int64]
    feature: NDArray[np.int64]


def both_narrow(
    sizes: Sequence[Array], pairs: Sequence[tuple[int, int]], matches: Sequence[NDArray[np.integer[Any]]], widest: float
) -> list[NDArray[np.bool_]]:
    """For each pair of pictures, (K,) whether both features of a match are at most `widest` pixels across.

    sizes: (N,) px, of each picture's features. matches: of each pair, (K,2) numbers of the features in either picture.
    """
    narrow = [of <= widest for of in sizes]
    return [
        narrow[one][rows[:, 0]] & narrow[other][rows[:, 1]] for (one, other), rows in zip(pairs, matches, strict=True)
    ]


def join_features(
    points: Sequence[Array], pairs: Sequence[tuple[int, int]], matches: Sequence[NDArray[np.integer[Any]]]
) -> FeatureTracks:
    """Tracks of two pictures and more, each at the mean of its features' points.

    points: (N,3) in the world of each picture's features. matches: of each pair of pictures, (K,2) numbers of matched
    features. Where a track would have two features of one picture, it has none there.
    """
    starts = np.concatenate([[0], np.cumsum([len(p) for p in points])]).astype(np.int64)
    label = connected_components(_match_graph(starts, pairs, matches), directed=False)[1]
    place = np.repeat(np.arange(len(points)), np.diff(starts))
    in_picture = label.astype(np.int64) * len(points) + place  # of one track and one picture
    _, group, times = np.unique(in_picture, return_inverse=True, return_counts=True)
    single = np.flatnonzero(times[group] == 1)
    seen = np.bincount(label[single], minlength=int(starts[-1]))
    chosen = single[seen[label[single]] >= 2]
    track = np.unique(label[chosen], return_inverse=True)[1]
    world = np.concatenate([np.zeros((0, 3)), *points])[chosen]
    total = np.stack([np.bincount(track, world[:, k]) for k in range(3)], axis=1)
    mean = total / np.maximum(np.bincount(track), 1)[:, None]
    return FeatureTracks(mean, track, place[chosen], chosen - starts[place[chosen]])


def _match_graph(
    starts: NDArray[np.int64], pairs: Sequence[tuple[int, int]], matches: Sequence[NDArray[np.integer[Any]]]
) -> coo_array:
    """(N,N) ones between matched features, numbered through all pictures; starts: number of each picture's first."""
    # Of a long film there are tens of millions: each is held once, in as few bytes as do.
    ends = np.empty((2, sum(map(len, matches))), np.int32 if starts[-1] < 2**31 else np.int64)
    filled = 0
    for (one, other), rows in zip(pairs, matches, strict=True):
        ends[0, filled : filled + len(rows)] = rows[:, 0] + starts[one]
        ends[1, filled : filled + len(rows)] = rows[:, 1] + starts[other]
        filled += len(rows)
    return coo_array((np.ones(filled, np.int8), (ends[0], ends[1])), shape=(int(starts[-1]),) * 2)
