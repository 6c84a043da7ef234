"""Rank correlation against SciPy's."""

import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import spearmanr

from haustra.core.rank_correlation import rank_correlation


@given(st.integers(0, 2**32 - 1), st.integers(3, 60), st.sampled_from([1, 2, 5, 1000]))
def test_it_is_scipys_with_and_without_ties(seed: int, count: int, levels: int) -> None:
    rng = np.random.default_rng(seed)
    first = rng.integers(0, levels, count) / 7
    second = (first + rng.integers(0, levels + 1, count)).astype(np.float32)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # SciPy warns of constant values
        expected = float(spearmanr(first, second).statistic)
    assert rank_correlation(first, second) == pytest.approx(expected, abs=1e-12, nan_ok=True)
