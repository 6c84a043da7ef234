"""Poses that lie far from those just before and after: a tracker's glitch of some frames, which no camera moves by."""

import numpy as np
from numpy.typing import NDArray

from haustra.core.se3 import Array

AROUND = 4  # frames before and after; those beyond a gap say nothing of a place
FEWEST = 2  # poses on either side, without which none is judged
STEPS = 10.0  # times what the camera moves by in as many fast steps
FAST = 90  # percentile of the steps that are any
LEAST = 1e-3  # of the path's extent, where nearly all steps are zero


def stray_poses(world_from_camera: Array, frames: NDArray[np.int64]) -> tuple[NDArray[np.bool_], Array]:
    """Of poses (N,4,4) of ascending frames (N,): (N,) which are stray, and (N,) how far each is from the median place
    of its neighbours, in the poses' unit. A camera that moves on, however fast, passes its neighbours' median."""
    places = world_from_camera[:, :3, 3]
    stray = np.zeros(len(places), bool)
    if len(places) < 2:
        return stray, np.zeros(len(places))
    rows, beside = _neighbours(frames)
    away = _from_median(places, places, rows, beside)
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    fast = np.percentile(steps[steps > 0], FAST) if (steps > 0).any() else 0.0
    extent = np.ptp(np.percentile(places, [5, 95], axis=0), axis=0).max()
    limit = max(STEPS * AROUND * fast, LEAST * extent, np.finfo(float).tiny)
    trusted, left = places.copy(), away.copy()
    while left.max() > limit:  # the farthest first: it is no neighbour to judge others by
        row = int(left.argmax())
        stray[row], trusted[row] = True, np.nan
        near = np.arange(max(row - AROUND, 0), min(row + AROUND + 1, len(places)))
        away[near] = np.where(stray[near], away[near], _from_median(places[near], trusted, rows[near], beside[near]))
        left = np.where(stray, 0, away)
    return stray, away


def _neighbours(frames: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Rows (N,9) around each row, and which of them are near in time; none of a row with too few on a side."""
    spacing = float(np.median(np.diff(frames)))
    wanted = np.arange(len(frames))[:, None] + np.arange(-AROUND, AROUND + 1)
    rows = wanted.clip(0, len(frames) - 1)
    beside = (rows == wanted) & (np.abs(frames[rows] - frames[:, None]) <= AROUND * spacing)
    enough = np.minimum(beside[:, :AROUND].sum(axis=1), beside[:, AROUND + 1 :].sum(axis=1)) >= FEWEST
    return rows, beside & enough[:, None]


def _from_median(places: Array, trusted: Array, rows: NDArray[np.int64], beside: NDArray[np.bool_]) -> Array:
    """(K,) distances of places (K,3) from the medians of those beside them, of `trusted` (N,3), NaN where one is not; 0
    where none is."""
    around = np.where(beside[:, :, None], trusted[rows], np.nan)
    known = np.isfinite(around).any(axis=(1, 2))
    middle = places.copy()
    middle[known] = np.nanmedian(around[known], axis=1)
    return np.asarray(np.linalg.norm(places - middle, axis=1))
