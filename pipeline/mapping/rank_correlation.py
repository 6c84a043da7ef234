"""Spearman's rank correlation, as SciPy has it."""

import numpy as np
from numpy.typing import NDArray


def rank_correlation(first: NDArray[np.floating], second: NDArray[np.floating]) -> float:
    """Of two arrays (N,), from -1 to 1; NaN where one of them is constant."""
    # Here and not above: importing it takes half a second, which the first frames need not wait for.
    from scipy.stats import spearmanr

    return float(spearmanr(first, second).statistic)
