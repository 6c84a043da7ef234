"""Baselines without learning and without the image: nearest, linear and morphological (IP-Basic) completion.

All take a sparse depth, float32 (H,W) with 0 = none, and give a dense one of the same shape and unit; without a single
point the result is zero everywhere. Each is scale-equivariant: k times the input gives k times the output.
"""

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

Depth = NDArray[np.float32]


def nearest(sparse: Depth) -> Depth:
    """Depth of the nearest point, by Euclidean distance in pixels."""
    if not (sparse > 0).any():
        return np.zeros_like(sparse)
    rows, columns = distance_transform_edt(~(sparse > 0), return_distances=False, return_indices=True)
    return sparse[rows, columns]


def linear(sparse: Depth) -> Depth:
    """Linear over the Delaunay triangles of the points; outside of their hull, the nearest point."""
    # Here and not above: they take half a second, which every reader of a weight file would pay.
    from scipy.interpolate import LinearNDInterpolator
    from scipy.spatial import QhullError

    dense = nearest(sparse)
    pixels = np.argwhere(sparse > 0)
    if len(pixels) < 3:
        return dense
    try:
        interpolate = LinearNDInterpolator(pixels, sparse[sparse > 0].astype(np.float64))
    except QhullError:  # all on one line: no triangle
        return dense
    inside = interpolate(*np.indices(sparse.shape))
    return np.where(np.isnan(inside), dense, inside).astype(np.float32)


# Ku et al. (CRV 2018) work on KITTI in metres, up to 80; as shares of the greatest depth their constants are free of
# a unit.
NEAR, MIDDLE = 15 / 80, 30 / 80  # limits of the ranges that dilate widely and less widely
COLOUR_SIGMA = 0.5 / 80  # of the bilateral filter
CROSS_WIDTHS = {"far": 3, "middle": 5, "near": 7}


def _cross(width: int) -> NDArray[np.uint8]:
    return cv2.getStructuringElement(cv2.MORPH_CROSS, (width, width))


def _square(width: int) -> NDArray[np.uint8]:
    return np.ones((width, width), np.uint8)


def _spread(depth: Depth, kernel: NDArray[np.uint8]) -> Depth:
    """Smallest depth under the kernel, inf where there is none."""
    # An explicit border: OpenCV's default is the largest *finite* float, which would pass for a depth.
    return cv2.erode(depth, kernel, borderType=cv2.BORDER_CONSTANT, borderValue=np.inf)


def _fill_gaps(depth: Depth, width: int) -> Depth:
    return np.where(np.isinf(depth), _spread(depth, _square(width)), depth)


def ip_basic(sparse: Depth) -> Depth:
    """Morphological filling, after Ku, Harakeh and Waslander, "In defense of classical image processing" (CRV 2018).

    The published steps: near points spread wider than far ones and win where they meet; small gaps are closed; larger
    ones are filled from their rim; a median and a bilateral filter smooth. They invert the depth so that an empty
    pixel (0) loses against any depth under a dilation; here empty is inf and the dilation is a minimum, the same
    without an offset to choose. Left out: extending columns to the top of the image, which is about a LiDAR's lacking
    upper rows. Added: filling goes on until nothing is empty, since a hundred points leave wider holes than a LiDAR.
    """
    if not (sparse > 0).any():
        return np.zeros_like(sparse)
    greatest = float(sparse.max())
    known = sparse > 0
    ranges = {
        "far": known & (sparse > MIDDLE * greatest),
        "middle": known & (sparse > NEAR * greatest) & (sparse <= MIDDLE * greatest),
        "near": known & (sparse <= NEAR * greatest),
    }
    depth = np.full(sparse.shape, np.inf, np.float32)
    for name, members in ranges.items():  # nearer ranges come later and overwrite
        spread = _spread(np.where(members, sparse, np.inf).astype(np.float32), _cross(CROSS_WIDTHS[name]))
        depth = np.where(np.isinf(spread), depth, spread)
    depth = cv2.dilate(_spread(depth, _square(5)), _square(5), borderType=cv2.BORDER_CONSTANT, borderValue=-np.inf)
    depth = _median(_fill_gaps(_median(depth), 9))
    while np.isinf(depth).any():
        depth = _fill_gaps(depth, 5)
    return cv2.bilateralFilter(_median(depth), 5, COLOUR_SIGMA * greatest, 2.0)


def _median(depth: Depth) -> Depth:
    """5x5 median of the known pixels' surroundings; what is empty stays empty, and nothing becomes so."""
    smooth = cv2.medianBlur(depth, 5)
    return np.where(np.isinf(depth) | np.isinf(smooth), depth, smooth)


CLASSICAL: dict[str, Callable[[Depth], Depth]] = {"nearest": nearest, "linear": linear, "ip_basic": ip_basic}
