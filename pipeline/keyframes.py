"""Which posed frames are completed and fused: those that see something new."""

import numpy as np
from numpy.typing import NDArray

from pipeline.submap import Submap

MIN_SHARED = 0.7  # share of a frame's points that the last keyframe also saw; below it the view has changed


def choose_keyframes(submap: Submap, width: int, motion: float) -> NDArray[np.int64]:
    """Rows of the keyframes: the first frame, then each whose shared points moved by more than `motion` image widths
    (median), or that shares too few points with the last keyframe."""
    order = np.argsort(submap.observations[:, 0], kind="stable")
    frame, point = submap.observations[order].T
    pixels = submap.pixels[order]
    starts = np.searchsorted(frame, np.arange(len(submap.frames) + 1))
    chosen = [0]
    for row in range(1, len(submap.frames)):
        mine, last = (slice(starts[r], starts[r + 1]) for r in (row, chosen[-1]))
        if _is_new(point[mine], pixels[mine], point[last], pixels[last], motion * width):
            chosen.append(row)
    return np.array(chosen)


def _is_new(
    points: NDArray[np.int64],
    pixels: NDArray[np.float64],
    last_points: NDArray[np.int64],
    last_pixels: NDArray[np.float64],
    min_motion_px: float,
) -> bool:
    shared, mine, theirs = np.intersect1d(points, last_points, return_indices=True)
    if len(shared) < MIN_SHARED * min(len(points), len(last_points)) or len(shared) == 0:
        return True
    return float(np.median(np.linalg.norm(pixels[mine] - last_pixels[theirs], axis=1))) > min_motion_px
