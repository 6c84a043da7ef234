"""The order of points inside a lumen, from one end to the other, however often and whichever way it was travelled."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from reconstruction.coverage.wall_rays import WallRays

Array = NDArray[np.float64]

SURE_HOP = 0.9  # radii; shorter hops are not asked for wall, as a stray triangle must not cut the lumen
THROUGH_WALL = 1e6  # times a hop's cost where wall bars it: taken only where a gap in the track leaves no other


def ordered_path(walls: WallRays, points: Array, radius: float) -> Array:
    """The longest of the shortest paths through the points (N,3). A hop costs its length squared, so that paths keep to
    short hops along the lumen, and yet no gap in the track cuts it. Where two limbs of a loop touch, the shortest hop
    leads through the wall between them; hence wall bars a hop."""
    squared = np.stack([((points - point) ** 2).sum(axis=1) for point in points])
    cost = squared * np.where(_barred(walls, points, np.sqrt(squared), radius), THROUGH_WALL, 1.0)
    start = int(np.argmax(_reach(cost, squared, 0)[0]))
    reach, before = _reach(cost, squared, start)
    path = [int(np.argmax(reach))]
    while path[-1] != start:
        path.append(int(before[path[-1]]))
    return points[path]


def _barred(walls: WallRays, points: Array, length: Array, radius: float) -> NDArray[np.bool_]:
    """(N,N) hops that meet wall. Both ends are asked: from one of them, it may be met on its outer side."""
    barred = np.zeros(length.shape, bool)
    for row, point in enumerate(points):
        far = np.flatnonzero(length[row] > SURE_HOP * radius)
        direction = (points[far] - point) / length[row, far, None]
        barred[row, far] = walls.distance(point, direction) < length[row, far]
    return barred | barred.T


def _reach(cost: Array, squared: Array, start: int) -> tuple[Array, NDArray[np.int32]]:
    """How far each point lies along its cheapest path, and the point before it there. The way through a wall decides
    which path is cheapest but not how far it goes, or whatever lies behind a wall would be the lumen's end."""
    from scipy.sparse.csgraph import dijkstra

    price, before = dijkstra(cost, indices=start, return_predecessors=True)
    far = np.zeros(len(cost))
    for row in np.argsort(price, kind="stable").tolist():
        if row != start:
            far[row] = far[before[row]] + squared[before[row], row]
    return far, before
