"""Which keyframe of the page shows where a missed region lies, and where in its picture."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

INNER = 0.8  # share of the picture, across and down, in which a direction is well in view

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RegionMark:
    """row: of the views that were asked for. at: shares of the picture's width and height, from its upper left corner;
    None where the region's middle is in none of the pictures."""

    row: int
    at: tuple[float, float] | None


def mark_region(
    centre: Array, frame: int, world_from_camera: Array, frames: NDArray[np.int64], half_view: Array
) -> RegionMark:
    """Of views (N,4,4) of frames (N,), N > 0: the one nearest in time to `frame` that has `centre` (3,) well in its
    picture, else in it at all, else the nearest one. half_view (2,): half the width and height of the picture at depth
    1. The wall may hide the place there."""
    offset = np.einsum("nji,nj->ni", world_from_camera[:, :3, :3], centre - world_from_camera[:, :3, 3])
    ahead = offset[:, 2] > 0
    across = offset[:, :2] / np.where(ahead, offset[:, 2], 1.0)[:, None] / half_view
    away = np.abs(frames - frame)
    for limit in (INNER, 1.0):
        seen = ahead & (np.abs(across) <= limit).all(axis=1)
        if seen.any():
            row = int(np.argmin(np.where(seen, away, np.inf)))
            x, y = (1 + across[row]) / 2
            return RegionMark(row, (float(x), float(y)))
    return RegionMark(int(np.argmin(away)), None)
