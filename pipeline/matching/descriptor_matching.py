"""Descriptor matching of two pictures: mutual nearest neighbours that pass the ratio test."""

import numpy as np
from numpy.typing import NDArray

RATIO = 0.85  # nearest over second-nearest distance (Lowe, IJCV 2004)


def match_descriptors(first: NDArray[np.float32], second: NDArray[np.float32]) -> NDArray[np.int64]:
    """(K,2) rows of descriptors, (N,128) and (M,128) of length one, that are each other's nearest and clearly nearer
    than the second nearest."""
    if len(first) < 2 or len(second) < 2:
        return np.zeros((0, 2), dtype=np.int64)
    similarity = first @ second.T  # squared distances are 2 - 2 similarity
    row, nearest = np.arange(len(first)), similarity.argmax(axis=1)
    best = similarity[row, nearest]
    mutual = best == similarity.max(axis=0)[nearest]
    similarity[row, nearest] = -1
    good = mutual & (np.maximum(1 - best, 0) < RATIO**2 * (1 - similarity.max(axis=1)))
    _, once = np.unique(nearest[good], return_index=True)  # of equal descriptors, one
    chosen = np.flatnonzero(good)[np.sort(once)]
    return np.stack([chosen, nearest[chosen]], axis=1)
