"""Averaging a frame into voxel blocks, compiled: one pass over the voxels, most of which a frame says nothing about."""

import numpy as np
from numpy.typing import NDArray

from haustra.core.numba_cache import compiled

Values = NDArray[np.float32]


@compiled
def average_frame(
    rows: NDArray[np.int64],
    corners: Values,
    offsets: Values,
    pinhole: Values,
    depth: Values,
    weight: Values,
    confidence: Values,
    colour: Values,
    truncation: np.float32,
    evidence: Values,
    observations: Values,
    tsdf: Values,
    sure: Values,
    mean_colour: Values,
) -> None:
    """Running averages of the voxels of blocks `rows` (B,), where the frame has a weight.

    corners (B,3): first voxels in camera axes; offsets (V,3): the others from there. pinhole (4,): fx, fy, cx, cy, the
    top-left pixel's centre at (0, 0). depth, weight, confidence (H,W) and colour (H,W,3) of the frame. Channels of all
    blocks: evidence, observations, tsdf, sure (blocks, V), mean_colour (blocks, V, 3).
    """
    height, width = depth.shape
    half, one, nothing = np.float32(0.5), np.float32(1), np.float32(0)
    fx, fy, cx, cy = pinhole[0], pinhole[1], pinhole[2] + half, pinhole[3] + half  # from the pixel's edge: truncated
    for b in range(len(rows)):
        r = rows[b]
        for v in range(len(offsets)):
            z = corners[b, 2] + offsets[v, 2]
            if z <= nothing:
                continue
            inverse_z = one / max(z, np.float32(1e-9))
            column = fx * (corners[b, 0] + offsets[v, 0]) * inverse_z + cx
            row = fy * (corners[b, 1] + offsets[v, 1]) * inverse_z + cy
            if not (column >= nothing and column < width and row >= nothing and row < height):
                continue
            i, j = int(row), int(column)
            added, distance = weight[i, j], depth[i, j] - z
            if added <= nothing or distance <= -truncation:
                continue
            evidence[r, v] += added
            share = added / max(evidence[r, v], np.float32(1e-12))
            if distance < truncation:
                observations[r, v] += one
            tsdf[r, v] += share * (max(-one, min(one, distance / truncation)) - tsdf[r, v])
            sure[r, v] += share * (confidence[i, j] - sure[r, v])
            for c in range(3):
                mean_colour[r, v, c] += share * (colour[i, j, c] - mean_colour[r, v, c])
