"""Selection of the frames whose depth is completed: new parallax, and enough sparse points."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d

from haustra.core.frame_spacing import LEAST_FRAMES, closer_where_few
from haustra.core.se3 import Array
from pipeline.mapping.submap import Submap

NEAR_WALL = 80  # percentile of the motion: the middle of a lumen stands still while the wall beside the camera passes
WELL_SEEN = 0.5  # share of the points of the best of the frames around that a keyframe must have
AROUND = 10  # frames on either side; a front end may give some frames far more points than those between
MIN_SHARED = 0.5  # share of a frame's points that the last keyframe also saw; below it the view has changed


def choose_keyframes(submap: Submap, width: int, motion: float, least: int = LEAST_FRAMES) -> NDArray[np.int64]:
    """Rows of the keyframes, of the frames that see enough points.

    The first, then each whose shared points moved by more than `motion` image widths (`NEAR_WALL` percentile), or that
    shares too few points with the last keyframe; of less motion where that gives fewer than `least`.
    """
    order, starts = submap.by_frame()
    good = _well_seen(np.diff(starts))

    def seen(row: int) -> tuple[NDArray[np.int32], Array]:
        mine = order[starts[row] : starts[row + 1]]
        return submap.observations[mine, 1], submap.pixels[mine]

    return closer_where_few(partial(_new_views, good, seen), motion * width, len(good), least)


def _new_views(
    rows: NDArray[np.int64], seen: Callable[[int], tuple[NDArray[np.int32], Array]], motion_px: float
) -> NDArray[np.int64]:
    """Of the rows the first, and each that is a new view beside the last one taken. seen: a row's points and pixels."""
    chosen = [int(rows[0])]
    last = seen(chosen[0])
    for row in rows[1:].tolist():
        now = seen(row)
        if is_new_view(*now, *last, motion_px):
            chosen.append(row)
            last = now
    return np.array(chosen)


def _well_seen(count: NDArray[np.int64]) -> NDArray[np.int64]:
    """Rows that may be keyframes: those with enough points beside the frames around them; where that leaves a gap, all
    rows of the gap that see any point; all rows if none does."""
    good = count >= WELL_SEEN * maximum_filter1d(count, 2 * AROUND + 1, mode="nearest")
    near = maximum_filter1d(good.astype(np.uint8), AROUND + 1, mode="constant")  # within half of AROUND
    usable = (good | (near == 0)) & (count > 0)
    return np.flatnonzero(usable) if usable.any() else np.arange(len(count))


def is_new_view(
    points: NDArray[np.integer[Any]],
    pixels: Array,
    last_points: NDArray[np.integer[Any]],
    last_pixels: Array,
    min_motion_px: float,
) -> bool:
    """Whether a frame shows enough that is new: tracks (N,) and their pixels (N,2), and those of the last keyframe."""
    shared, mine, theirs = np.intersect1d(points, last_points, return_indices=True)
    if len(shared) < MIN_SHARED * min(len(points), len(last_points)) or len(shared) == 0:
        return True
    return float(np.percentile(np.linalg.norm(pixels[mine] - last_pixels[theirs], axis=1), NEAR_WALL)) > min_motion_px
