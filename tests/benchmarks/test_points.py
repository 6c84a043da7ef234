"""Errors of points: medians by group beside NumPy's, and a copy of a run that takes the front end's own points."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.points import _median_by


@given(st.lists(st.tuples(st.integers(0, 9), st.floats(-5, 5) | st.just(float("nan"))), max_size=60))
def test_the_median_of_each_point_is_numpys(seen):
    point = np.array([p for p, _ in seen], np.int64)
    off = np.array([value for _, value in seen], np.float64)
    known = [off[(point == k) & np.isfinite(off)] for k in range(10)]
    expected = [np.median(values) for values in known if len(values)]
    np.testing.assert_allclose(_median_by(point, off, 10), expected)
