"""TSDF integration of one frame into voxel blocks, compiled: one pass over the voxels, most of which are skipped.

B blocks of V voxels. rows (B,): the blocks' rows in the channels; corners (B,3): their first voxels in camera axes;
offsets (V,3): the other voxels from there. pinhole (4,): fx, fy, cx, cy, the top-left pixel's centre at (0, 0). depth,
weight, confidence (H,W) and colour (H,W,3) of the frame; truncation in the depth's unit. Channels of all blocks:
evidence (sum of weights), observations, tsdf in [-1,1], mean_confidence (blocks, V), mean_colour (blocks, V, 3); the
two means are integers, so many steps to one of confidence and to one grey level.
"""

import numpy as np
from numpy.typing import NDArray

from haustra.core.numba_cache import compiled

CONFIDENCE_STEPS, COLOUR_STEPS = 65535, 256  # so that 1 and 255 still fit into 16 bits

Values = NDArray[np.float32]
Steps = NDArray[np.uint16]


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
    observations: Steps,
    tsdf: Values,
    mean_confidence: Steps,
    mean_colour: Steps,
) -> None:
    """Update the channels' running averages in place where the frame has a weight; arguments as above."""
    height, width = depth.shape
    one, nothing = np.float32(1), np.float32(0)
    sure_steps, colour_steps = np.float32(CONFIDENCE_STEPS), np.float32(COLOUR_STEPS)
    for b in range(len(rows)):
        r = rows[b]
        for v in range(len(offsets)):
            z = corners[b, 2] + offsets[v, 2]
            if z <= nothing:
                continue
            i, j = _pixel(corners[b, 0] + offsets[v, 0], corners[b, 1] + offsets[v, 1], z, pinhole, height, width)
            if i < 0:
                continue
            added, distance = weight[i, j], depth[i, j] - z
            if added <= nothing or distance <= -truncation:
                continue
            evidence[r, v] += added
            share = added / max(evidence[r, v], np.float32(1e-12))
            if distance < truncation:
                observations[r, v] = min(observations[r, v] + 1, 65535)
            tsdf[r, v] += share * (max(-one, min(one, distance / truncation)) - tsdf[r, v])
            mean_confidence[r, v] = _moved(mean_confidence[r, v], confidence[i, j] * sure_steps, share)
            for c in range(3):
                mean_colour[r, v, c] = _moved(mean_colour[r, v, c], colour[i, j, c] * colour_steps, share)


@compiled
def _moved(mean: np.uint16, value: np.float32, share: np.float32) -> np.uint16:
    """A mean in steps, moved to a value in steps by a share of the way, to the nearest step. It does not move by less
    than half a step: what many weak views of one sign would add is lost."""
    before = np.float32(mean)
    return np.uint16(min(max(before + share * (value - before) + np.float32(0.5), np.float32(0)), np.float32(65535)))


@compiled
def _pixel(x: np.float32, y: np.float32, z: np.float32, pinhole: Values, height: int, width: int) -> tuple[int, int]:
    """Row and column of the pixel that sees a point in camera axes, z > 0; row -1 outside the image."""
    half, one, nothing = np.float32(0.5), np.float32(1), np.float32(0)
    inverse_z = one / max(z, np.float32(1e-9))
    column = pinhole[0] * x * inverse_z + (pinhole[2] + half)  # from the pixel's edge: truncated below
    row = pinhole[1] * y * inverse_z + (pinhole[3] + half)
    if not (column >= nothing and column < width and row >= nothing and row < height):
        return -1, -1
    return int(row), int(column)
