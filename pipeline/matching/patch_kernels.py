"""Compiled loop over the pictures of patches in one frame, for their alignment (`patch_alignment.py`)."""

from math import isfinite, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from haustra.core.numba_cache import compiled

Array = NDArray[np.floating[Any]]
Rows = NDArray[np.int64]


@compiled
def compare(
    picture: NDArray[np.uint8],
    centre: Array,
    shape: Array,
    offsets: Array,
    window: Array,
    patch: Rows,
    reference: Array,
    by_x: Array,
    by_y: Array,
    least_deviation: float,
    found: Array,
) -> None:
    """Of N views in a picture (H,W), 2x2 pixels and more: centre (N,2) in COLMAP's convention, shape (N,2,2) of pixels
    by offset, patch (N,) the row of their reference.

    offsets (K,2), window (K,) of sum 1; reference (P,K) normalised patches and their derivatives by_x, by_y (P,K).
    found (N,4) is written: the correlation, the products of the difference with by_x and by_y, and its square, each
    summed under the window; 0 where centre or shape is not finite. Patches are read bilinearly; beyond the border they
    have its value.
    """
    count, (height, width), flat = len(window), picture.shape, picture.ravel()
    grey, at, right, down = np.empty(count), np.empty(count, np.int64), np.empty(count), np.empty(count)
    for v in range(len(patch)):
        found[v, :] = 0.0
        if not isfinite(centre[v].sum() + shape[v].sum()):
            continue
        mean, p = 0.0, patch[v]
        for k in range(count):  # apart from the reading, which is no arithmetic: half the time
            x = centre[v, 0] + shape[v, 0, 0] * offsets[k, 0] + shape[v, 0, 1] * offsets[k, 1] - 0.5
            y = centre[v, 1] + shape[v, 1, 0] * offsets[k, 0] + shape[v, 1, 1] * offsets[k, 1] - 0.5
            x, y = min(max(x, 0.0), width - 1.0), min(max(y, 0.0), height - 1.0)
            column, row = min(int(x), width - 2), min(int(y), height - 2)
            at[k], right[k], down[k] = row * width + column, x - column, y - row
        for k in range(count):
            i = at[k]
            above = flat[i] * (1.0 - right[k]) + flat[i + 1] * right[k]
            below = flat[i + width] * (1.0 - right[k]) + flat[i + width + 1] * right[k]
            grey[k] = above * (1.0 - down[k]) + below * down[k]
            mean += window[k] * grey[k]
        variance = 0.0
        for k in range(count):
            variance += window[k] * (grey[k] - mean) ** 2
        scale = 1.0 / max(sqrt(variance), least_deviation)
        correlation, along_x, along_y, squared = 0.0, 0.0, 0.0, 0.0
        for k in range(count):
            shown = (grey[k] - mean) * scale
            difference = shown - reference[p, k]
            correlation += window[k] * shown * reference[p, k]
            along_x += window[k] * difference * by_x[p, k]
            along_y += window[k] * difference * by_y[p, k]
            squared += window[k] * difference * difference
        found[v, 0], found[v, 1], found[v, 2], found[v, 3] = correlation, along_x, along_y, squared
