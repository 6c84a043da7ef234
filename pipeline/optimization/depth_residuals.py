"""Depth residuals of bundle adjustment: what a sensor measured at an observation against the depth of its point.

The residual is linear in the inverse depth, (d / z - 1) d / sigma standard deviations: of a stereo rig that is the
disparity, what the right eye saw of a point of the left one, with the baseline held. One standard deviation weighs as
much as `SIGMA_PX` of a pixel, under the same Cauchy loss. A residual adds to the blocks of its own observation, so that
the system keeps its shape; without any, not a bit of it changes.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from haustra.core.numba_cache import compiled

Array = NDArray[np.floating[Any]]
Rows = NDArray[np.int64]
SIGMA_PX = 0.3  # of an observation; what tracking and SIFT err by
MIN_DEPTH = 1e-9  # points behind a camera are moved here, as in `kernels`


@dataclass(frozen=True)
class MeasuredDepth:
    """observation (D,): rows of the bundle's observations. depth (D,): z-depth in the bundle's unit. error (D,): its
    standard deviation as a share of it."""

    observation: Rows
    depth: NDArray[np.float64]
    error: NDArray[np.float64]

    def contiguous(self) -> "MeasuredDepth":
        """The same in contiguous arrays, as the kernels take it."""
        return MeasuredDepth(
            np.ascontiguousarray(self.observation, np.int64),
            np.ascontiguousarray(self.depth, np.float64),
            np.ascontiguousarray(self.error, np.float64),
        )


@compiled
def depth_cost(
    rotation: Array,
    translation: Array,
    points: Array,
    camera: Rows,
    point: Rows,
    observation: Rows,
    depth: Array,
    error: Array,
    loss: float,
) -> float:
    """Sum of Cauchy's loss over all measured depths, square pixels."""
    total = 0.0
    for k in range(len(observation)):
        c, p = camera[observation[k]], points[point[observation[k]]]
        z = translation[c, 2]
        for i in range(3):
            z += rotation[c, 2, i] * p[i]
        residual = SIGMA_PX * (depth[k] / max(z, MIN_DEPTH) - 1.0) / error[k]
        total += np.log1p(residual**2 / loss**2)
    return loss**2 * total


@compiled
def add_depth_equations(
    rotation: Array,
    translation: Array,
    points: Array,
    camera: Rows,
    point: Rows,
    observation: Rows,
    depth: Array,
    error: Array,
    fixed: NDArray[np.bool_],
    loss: float,
    of_cameras: Array,
    of_points: Array,
    cross: Array,
    camera_side: Array,
    point_side: Array,
) -> None:
    """Add the measured depths to the blocks and right-hand sides of `kernels.normal_equations`, in place."""
    local, by_pose = np.empty(3), np.zeros(6)
    for k in range(len(observation)):
        m = observation[k]
        c, p = camera[m], point[m]
        for i in range(3):
            local[i] = translation[c, i]
            for j in range(3):
                local[i] += rotation[c, i, j] * points[p, j]
        z = max(local[2], MIN_DEPTH)
        residual = SIGMA_PX * (depth[k] / z - 1.0) / error[k]
        slope = -SIGMA_PX * depth[k] / (z * z * error[k])
        weight = 1.0 / (1.0 + residual**2 / loss**2)
        for i in range(3):
            by_point = slope * rotation[c, 2, i]
            point_side[p, i] -= weight * by_point * residual
            for j in range(3):
                of_points[p, i, j] += weight * by_point * slope * rotation[c, 2, j]
        if fixed[c]:
            continue
        by_pose[0], by_pose[1], by_pose[5] = slope * local[1], -slope * local[0], slope
        for i in range(6):
            camera_side[c, i] -= weight * by_pose[i] * residual
            for j in range(6):
                of_cameras[c, i, j] += weight * by_pose[i] * by_pose[j]
            for j in range(3):
                cross[m, i, j] += weight * by_pose[i] * slope * rotation[c, 2, j]
