"""Scale breaks of a tracked map: where in it the scale jumps.

While a camera turns or stands still, new points are triangulated over a baseline that is hardly known. If their scale
differs from that of the points before, the same wall is in the map twice, at two depths, for as long as frames see
points of both scales. Bundle adjustment does not take that back: it drops what does not fit as outliers, and the two
parts are then constrained by nothing. Limits were chosen on one real film (docs/lab/front_end.md, "Scale breaks").
"""

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from haustra.core.se3 import Array
from pipeline.matching.keyframe_features import SparseView

NEIGHBOURS = 8  # points whose median depth a point is compared with
TWO_DEPTHS = np.log(1.6)  # log depth between a point and those around it
MIN_POINTS = 40  # of a keyframe that is judged
SMOOTHED = 5  # keyframes whose mean share counts
# Share of points at another depth than those around them, from which on there is a break; and the same in multiples of
# the map's median keyframe.
BREAK_SHARE, BREAK_MULTIPLE = 0.2, 5.0
MIN_KEYFRAMES = 8  # on each side of a break


def find_break(views: Sequence[SparseView]) -> int | None:
    """Number of the keyframe at which a map's scale breaks most clearly; None where it does not. views: of all
    keyframes, in their order."""
    count = len(views)
    if count < 2 * MIN_KEYFRAMES:
        return None
    share = shares_at_two_depths(views)
    smooth, half = np.full(count, np.nan), SMOOTHED // 2
    smooth[half : count - half] = np.lib.stride_tricks.sliding_window_view(share, SMOOTHED).mean(axis=1)
    smooth[:MIN_KEYFRAMES] = smooth[count - MIN_KEYFRAMES + 1 :] = np.nan
    if not np.isfinite(smooth).any():
        return None
    number = int(np.nanargmax(smooth))
    return number if smooth[number] >= max(BREAK_SHARE, BREAK_MULTIPLE * float(np.nanmedian(share))) else None


def shares_at_two_depths(views: Sequence[SparseView]) -> Array:
    """(K,) share of each keyframe's points that lie at another depth than those around them in the picture; NaN where
    it sees fewer than `MIN_POINTS`."""
    return np.array([_share(view.pixels, view.points[:, 2]) for view in views])


def _share(pixels: Array, depth: Array) -> float:
    """Of points at pixels (N,2), of z-depth (N,)."""
    front = depth > 0
    if np.count_nonzero(front) < MIN_POINTS:
        return np.nan
    _, nearest = cKDTree(pixels[front]).query(pixels[front], k=NEIGHBOURS + 1)
    log_depth = np.log(depth[front])
    around = np.median(log_depth[nearest[:, 1:]], axis=1)
    return float((np.abs(log_depth - around) > TWO_DEPTHS).mean())
