"""Single poses that lie far from those before and after: a tracker's glitch, which no camera moves by."""

import numpy as np
from numpy.typing import NDArray

from haustra.core.se3 import Array

AROUND = 4  # poses before and after
STEPS = 10.0  # times what the camera moves by in as many fast steps; out and back within a quarter of a second
FAST = 90  # percentile of the steps; the median is near zero where the camera rests most of the time
LEAST = 1e-3  # of the path's extent, where nearly all steps are zero


def stray_poses(world_from_camera: Array) -> tuple[NDArray[np.bool_], Array]:
    """Of poses (N,4,4) in the order of time: (N,) which are stray, and (N,) how far each is from the median place of
    its neighbours, in the poses' unit. A camera that moves on, however fast, passes its neighbours' median."""
    places = world_from_camera[:, :3, 3]
    stray, away = np.zeros(len(places), bool), _from_neighbours(places, places, np.arange(len(places)))
    if len(places) < 2:
        return stray, away
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    extent = np.ptp(np.percentile(places, [5, 95], axis=0), axis=0).max()
    limit = max(STEPS * AROUND * np.percentile(steps, FAST), LEAST * extent, np.finfo(float).tiny)
    trusted, left = places.copy(), away.copy()
    while left.max() > limit:  # the farthest first: it is no neighbour to judge others by
        row = int(left.argmax())
        stray[row], trusted[row] = True, np.nan
        beside = np.arange(max(row - AROUND, 0), min(row + AROUND + 1, len(places)))
        away[beside] = np.where(stray[beside], away[beside], _from_neighbours(places, trusted, beside))
        left = np.where(stray, 0, away)
    return stray, away


def _from_neighbours(places: Array, trusted: Array, rows: NDArray[np.int64]) -> Array:
    """Of some rows (K,): distances (K,) of their places from the medians of those around that are trusted, (N,3), NaN
    where one is not; 0 where none around is."""
    around = trusted[np.clip(rows[:, None] + np.arange(-AROUND, AROUND + 1), 0, len(trusted) - 1)]
    known = np.isfinite(around).any(axis=(1, 2))
    middle = np.zeros((len(rows), 3))
    middle[known] = np.nanmedian(around[known], axis=1)
    return np.where(known, np.linalg.norm(places[rows] - middle, axis=1), 0)
