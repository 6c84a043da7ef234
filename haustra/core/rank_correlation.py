"""Spearman's rank correlation; `scipy.stats` has it too, but takes most of a second to import."""

import numpy as np
from numpy.typing import NDArray


def rank_correlation(first: NDArray[np.floating], second: NDArray[np.floating]) -> float:
    """Rank correlation of two arrays (N,) of finite values, from -1 to 1; equal values share the mean of their ranks.
    NaN where one of them is constant."""
    one, other = _centred_ranks(first), _centred_ranks(second)
    with np.errstate(invalid="ignore"):
        return float(np.divide(one @ other, np.sqrt((one @ one) * (other @ other))))


def _centred_ranks(values: NDArray[np.floating]) -> NDArray[np.float64]:
    _, place, count = np.unique(values, return_inverse=True, return_counts=True)
    last = np.cumsum(count)
    ranks = (last - (count - 1) / 2)[place]
    return np.asarray(ranks - ranks.mean())
