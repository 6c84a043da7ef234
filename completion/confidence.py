"""Conversion between relative error and confidence, the same for sparse points and for completed depth."""

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

# e0 in confidence = e0^2 / (e0^2 + e^2), e the relative error: 3 % is 0.75 mm of a wall 25 mm away. For large e it is
# proportional to the inverse variance, by which fusion weights.
HALF_CONFIDENCE_ERROR = 0.03

Array = TypeVar("Array")  # a NumPy array or a torch tensor


def confidence_from_error(error: Array) -> Array:
    """Relative error -> confidence in [0,1]; one half at `HALF_CONFIDENCE_ERROR`."""
    variance = HALF_CONFIDENCE_ERROR**2
    return variance / (variance + error * error)  # type: ignore[operator]


def error_from_confidence(confidence: NDArray[np.floating], least: float = 0.0) -> NDArray[np.float32]:
    """The inverse of `confidence_from_error`: predicted relative error; that of a confidence of `least` where it is
    lower, which keeps it finite unless that is 0."""
    with np.errstate(divide="ignore"):
        return (HALF_CONFIDENCE_ERROR * np.sqrt(1 / np.maximum(confidence, least) - 1)).astype(np.float32)
