"""Values between known places, and beyond them."""

import numpy as np
from numpy.typing import ArrayLike, NDArray


def extrapolated(wanted: ArrayLike, known: ArrayLike, values: ArrayLike, slope: float) -> NDArray[np.float64]:
    """(N,) values at `wanted` (N,): between the ascending `known` (K,) on straight lines, beyond them by the slope."""
    at, places = np.asarray(wanted, np.float64), np.asarray(known, np.float64)
    beyond = np.minimum(at - places[0], 0) + np.maximum(at - places[-1], 0)
    return np.asarray(np.interp(at, places, np.asarray(values, np.float64)) + slope * beyond)
