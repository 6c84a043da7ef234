"""Dense depth corrected by what it misses its sparse points by: simple kriging of the residuals.

A network learns how far to follow points of all kinds. Points whose errors are known say more, where they are good: by
how much the depth at a point is off, it is off around it. log(point / depth) is taken for a Gaussian process over the
picture and the log of the depth, so that of a fold's correction a third reaches the wall behind it at 1.4 times the
depth, a tenth at twice; the points' errors are independent, with wide tails. Away from the points the correction falls
off to none (Cressie, Statistics for Spatial Data, 1993, 3.2; Rasmussen and Williams, Gaussian Processes for Machine
Learning, 2006, 2.2). Constants: chosen on films kept for choosing (docs/lab/kriging.md).
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.ndimage import map_coordinates

REACH = 0.2  # of the picture's longer side, over which the correlation of the network's errors falls to 1/e,
REACH_IN_DEPTH = 0.3  # and of log depth
# Standard deviation of the process over the error that the network expects: a gain, chosen by the surface that comes of
# it. What points are missed by is explained by the expected error itself (below).
SPREAD = 1.5
LEAST_ERROR = 0.003  # relative, of any point: a part of it lies in the pixel that it is rounded to
# Of a point's told error, as which it counts here. Chosen by the surface, too: single depths hardly gain by it. Where
# all keyframes follow the points that they share, their depths presumably agree, even where the points are off.
OWN_SHARE = 0.35
# What points are missed by, over what their errors and the network's explain, in the median: up to the first the whole
# correction is applied, from the second on none, since nobody knows whether the points or the network are right. In the
# films from H.264 that this was chosen on it is 0.52 to 0.77 where the wall stands still, 1.09 to 1.8 where it moves by
# 2.5 mm; other still ones reach 0.9.
EXPLAINED, UNEXPLAINED = 0.85, 1.0
TAIL = 2.0  # standard deviations, of `OWN_SHARE` of the told ones, at which a point counts for half
UNKNOWN = 1.0  # told error from which on a point is left out: it would explain whatever is missed there
MOST_POINTS = 400  # unless asked for otherwise: the time grows with the cube; more are merged
CELL, CELL_DEPTH = 1 / 80, 0.1  # of the longer side, and of log depth, within which points are merged first
ROUNDS = 5  # of weighing points by what they are missed by
MOST_CHANGE = 0.5  # of log depth
# Up to which float32 does: the number of points times the variance of the process, which no eigenvalue exceeds, over
# the least variance of a point. What rounding changes is then less than that variance.
SINGLE_PRECISION = 3e6
NODES = 40  # of the grid on which the correction is computed, along the longer side
SLICES_APART = 0.05  # of its slices in log depth

Array = NDArray[np.float64]
Image = NDArray[np.float32]
Floats = NDArray[np.floating[Any]]  # of single or double precision


@dataclass(frozen=True)
class _Points:
    """N points: place (N,2) in longer sides of the picture, log_depth (N,) of the estimate, `missed` (N,) by how much
    its log is too small there; relative standard deviations: error (N,) of the point, `expected` (N,) of the estimate.
    """

    place: Array
    log_depth: Array
    missed: Array
    error: Array
    expected: Array

    def __len__(self) -> int:
        return len(self.missed)


def towards_points(
    depth: Image,
    expected: Image,
    sparse: Image,
    error: Image,
    most_points: int = MOST_POINTS,
    share: float | None = None,
) -> Image:
    """Dense depth (H,W), corrected; where it is 0, it stays 0.

    expected: (H,W) relative error that the network expects of it. sparse: (H,W) depth of points, 0 = none, in the same
    unit. error: (H,W) their relative standard deviations. Points of error `UNKNOWN` and more, those where one of the
    four is not finite, and such pixels count as none. most_points: beyond which those that are close are merged.
    share: of the correction that is applied; None: `explained_share` of these points.
    """
    points = _points_of(depth, expected, sparse, error)
    share = _share_of(points) if share is None else share
    if share == 0 or len(points) == 0:
        return depth
    points = _merged(points, most_points)
    variance = (SPREAD * float(np.median(points.expected))) ** 2
    told: Array = np.maximum(OWN_SHARE * points.error, LEAST_ERROR)
    exact_enough = len(points) * variance / float(told.min()) ** 2 < SINGLE_PRECISION
    precision: Any = np.float32 if exact_enough else np.float64
    place: Floats = points.place.astype(precision)
    log_depth: Floats = points.log_depth.astype(precision)
    covariance = _alike(place, place) * _alike_in_depth(log_depth, log_depth)
    covariance *= variance
    weights = share * variance * _kriging_weights(covariance, points.missed, told)
    return _corrected(depth, place, log_depth, weights)


def _points_of(depth: Image, expected: Image, sparse: Image, error: Image) -> _Points:
    finite = np.isfinite(sparse) & np.isfinite(depth) & np.isfinite(expected)
    at = np.nonzero((sparse > 0) & (depth > 0) & finite & (error < UNKNOWN))
    known, log_depth = sparse[at].astype(np.float64), np.log(depth[at].astype(np.float64))
    errors = (image[at].astype(np.float64) for image in (error, expected))
    return _Points(np.column_stack(at[::-1]) / max(depth.shape), log_depth, np.log(known) - log_depth, *errors)


def _merged(points: _Points, most: int) -> _Points:
    """No more than `most`: those of a cell, and of like depth there, become one; cells grow until there are few
    enough."""
    if len(points) <= most:
        return points
    from_nearest, larger = points.log_depth - points.log_depth.min(), 1.0
    while True:
        cells = (points.place // (larger * CELL), from_nearest[:, None] // (larger * CELL_DEPTH))
        across, down, slices = np.hstack(cells).astype(np.int64).T
        key = (across * (down.max() + 1) + down) * (slices.max() + 1) + slices
        unique, group = np.unique(key, return_inverse=True)
        if len(unique) <= most:
            return _one_of_each(points, group)
        larger *= 1.2


def _one_of_each(points: _Points, group: NDArray[np.int64]) -> _Points:
    """Of the points of each group their mean by precision. It is as sure as the surest of them, not surer: neighbours
    mostly err alike, by the poses that they share."""
    precision = np.maximum(points.error, LEAST_ERROR) ** -2.0
    total = np.bincount(group, precision)

    def mean(values: Array) -> Array:
        return np.asarray(np.bincount(group, precision * values) / total)

    surest = np.full(len(total), np.inf)
    np.minimum.at(surest, group, points.error)
    place = np.column_stack([mean(points.place[:, 0]), mean(points.place[:, 1])])
    return _Points(place, mean(points.log_depth), mean(points.missed), surest, mean(points.expected))


def explained_share(depth: Image, expected: Image, sparse: Image, error: Image) -> float:
    """From 0 to 1, how much of a correction is applied: by whether the points' errors and the network's explain what
    the points are missed by (`EXPLAINED`); 0 of fewer than three points. Arrays (H,W) as of `towards_points`, the
    depth not yet corrected by these points."""
    return _share_of(_points_of(depth, expected, sparse, error))


def _share_of(points: _Points) -> float:
    if len(points) < 3:
        return 0.0
    explained = np.hypot(np.maximum(points.error, LEAST_ERROR), points.expected)
    unexplained = float(np.median(np.abs(points.missed) / explained))
    return float(np.clip((UNEXPLAINED - unexplained) / (UNEXPLAINED - EXPLAINED), 0, 1))


def _alike(one: Floats, other: Floats) -> Floats:
    """(N,M) correlation by the distance of places (N,2) and (M,2), of their precision."""
    # In place: this is much of the arithmetic.
    squared, down = (np.subtract.outer(one[:, axis], other[:, axis]) for axis in (0, 1))
    squared *= squared
    down *= down
    squared += down
    distance = np.sqrt(squared, out=squared)
    distance /= -REACH
    return np.exp(distance, out=distance)


def _alike_in_depth(one: Floats, other: Floats) -> Floats:
    """(N,M) correlation by the difference of log depths (N,) and (M,), of their precision."""
    apart = np.subtract.outer(one, other)
    np.abs(apart, out=apart)
    apart /= -REACH_IN_DEPTH
    return np.exp(apart, out=apart)


def _kriging_weights(covariance: Floats, missed: Array, error: Array) -> Floats:
    """(N,) by which the covariances with the points are summed to a correction, of the covariance's precision; points
    that the others contradict weigh less, as if their errors were larger (Student's t, by reweighting)."""
    doubted, wanted, diagonal = error**2, missed.astype(covariance.dtype), np.arange(len(error))
    for _ in range(ROUNDS):
        total = covariance.copy()
        total[diagonal, diagonal] += doubted
        weights = cho_solve(cho_factor(total, overwrite_a=True, check_finite=False), wanted, check_finite=False)
        doubted = error**2 * (1 + ((missed - covariance @ weights) / (TAIL * error)) ** 2)
    return np.asarray(weights)


def _corrected(depth: Image, place: Floats, log_depth_of_points: Floats, weights: Floats) -> Image:
    """Depth (H,W) times the correction, which is computed on a grid over the picture and log depth."""
    height, width = depth.shape
    known = (depth > 0) & np.isfinite(depth)
    log_depth = np.log(depth[known])
    longer = max(height, width)
    apart = longer / NODES
    across, down = (np.arange(0, side + apart, apart) for side in (width, height))
    slices = np.arange(log_depth.min(), log_depth.max() + SLICES_APART, SLICES_APART)
    nodes = np.stack(np.meshgrid(across / longer, down / longer), axis=2).reshape(-1, 2)
    of_slices = weights[:, None] * _alike_in_depth(log_depth_of_points, slices.astype(weights.dtype))
    grid = (_alike(nodes.astype(weights.dtype), place) @ of_slices).reshape(len(down), len(across), len(slices))
    rows, columns = np.nonzero(known)
    at = np.stack([rows / apart, columns / apart, (log_depth - slices[0]) / SLICES_APART])
    change = map_coordinates(grid.astype(np.float32), at, order=1, mode="nearest")
    corrected = depth.copy()
    corrected[known] *= np.exp(np.clip(change, -MOST_CHANGE, MOST_CHANGE))
    return corrected
