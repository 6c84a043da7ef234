"""Path ordering: points inside a lumen in order from end to end, however often and whichever way it was travelled."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from reconstruction.coverage.wall_rays import WallRays

Array = NDArray[np.float64]

FREE_STEP = 0.9  # lumen radii up to which a step is not tested for wall, as a stray triangle must not cut the lumen
WALL_COST = 1e6  # factor on the cost of a step through wall: taken only where a gap in the track leaves no other


def ordered_path(walls: WallRays, points: Array, radius: float) -> Array:
    """The longest of the shortest paths through points (N,3), as points (K,3) in order; `radius` is the lumen's.

    A step costs its length squared, so that paths take short steps along the lumen, and yet no gap in the track cuts
    it. Where two limbs of a loop touch, the shortest step leads through the wall between them; such steps cost
    WALL_COST times as much.
    """
    squared = np.stack([((points - point) ** 2).sum(axis=1) for point in points])
    cost = squared * np.where(_through_wall(walls, points, np.sqrt(squared), radius), WALL_COST, 1.0)
    start = int(np.argmax(_path_lengths(cost, squared, 0)[0]))
    length, before = _path_lengths(cost, squared, start)
    path = [int(np.argmax(length))]
    while path[-1] != start:
        path.append(int(before[path[-1]]))
    return points[path]


def _through_wall(walls: WallRays, points: Array, length: Array, radius: float) -> NDArray[np.bool_]:
    """(N,N) steps that meet wall. Rays go from both ends: from one of them, the wall may be met on its outer side."""
    blocked = np.zeros(length.shape, bool)
    for row, point in enumerate(points):
        far = np.flatnonzero(length[row] > FREE_STEP * radius)
        direction = (points[far] - point) / length[row, far, None]
        blocked[row, far] = walls.distance(point, direction) < length[row, far]
    return blocked | blocked.T


def _path_lengths(cost: Array, squared: Array, start: int) -> tuple[Array, NDArray[np.int32]]:
    """Sum of squared steps (N,) along each point's cheapest path from `start`, and the point before it there (N,).

    WALL_COST decides which path is cheapest but does not enter its length, or points behind a wall would be the
    lumen's end.
    """
    from scipy.sparse.csgraph import dijkstra

    price, before = dijkstra(cost, indices=start, return_predecessors=True)
    length = np.zeros(len(cost))
    for row in np.argsort(price, kind="stable").tolist():
        if row != start:
            length[row] = length[before[row]] + squared[before[row], row]
    return length, before
