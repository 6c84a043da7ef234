"""World points in the voxel blocks that the truncation band of a depth image passes through, compiled.

Neighbouring pixels mostly pass through the same blocks. So a point is given only where its block is another than that
of the point before it on its ray, and than those as far along the rays of the pixels to its left and above it.
"""

import numpy as np
from numpy.typing import NDArray

from haustra.core.numba_cache import compiled

STEP_OF_BLOCK = 0.6  # block edges between the points along a ray, at most

Values = NDArray[np.float32]


def band_points(
    depth: Values,
    centred_intrinsics: NDArray[np.float64],
    world_from_camera: NDArray[np.float64],
    reach: float,
    edge: float,
) -> Values:
    """World points (N,3), float32: of each pixel with a depth some in each block that its band passes through, but for
    corners of blocks that it cuts over less than `STEP_OF_BLOCK` edges.

    depth (H,W): z-depth, 0 = none. centred_intrinsics (3,3): the top-left pixel's centre is at (0, 0). reach: of the
    band, on each side of the depth along z. edge: of a block.
    """
    offsets = _offsets(depth.shape, centred_intrinsics, reach, edge)
    steps = len(offsets)
    turned = (world_from_camera[:3, :3] @ np.linalg.inv(centred_intrinsics)).astype(np.float32)
    shift = world_from_camera[:3, 3].astype(np.float32)
    points = np.empty((int(np.count_nonzero(depth)) * steps, 3), np.float32)
    return points[: _fill(depth, turned, shift, offsets, np.float32(1 / edge), points)]


def _offsets(
    shape: tuple[int, ...], centred_intrinsics: NDArray[np.float64], reach: float, edge: float
) -> NDArray[np.float32]:
    """z-depths beside a pixel's own, close enough along the longest ray, that of a corner."""
    height, width = shape
    corners = np.array([[0, width - 1, 0, width - 1], [0, 0, height - 1, height - 1], [1, 1, 1, 1]])
    longest = float(np.linalg.norm(np.linalg.inv(centred_intrinsics) @ corners, axis=0).max())
    return np.linspace(-reach, reach, 1 + int(np.ceil(2 * reach * longest / (STEP_OF_BLOCK * edge))), dtype=np.float32)


@compiled
def _fill(depth: Values, turned: Values, shift: Values, offsets: Values, per_length: np.float32, points: Values) -> int:
    """Write the points into `points`; their number. turned (3,3): from pixels (column, row, 1) to world axes."""
    height, width = depth.shape
    steps, count = len(offsets), 0
    # Blocks of the latest pixel with a depth, in this row and in each column above.
    left, above = np.zeros((steps, 3), np.int64), np.zeros((width, steps, 3), np.int64)
    has_left, has_above = False, np.zeros(width, np.bool_)
    block, ray = np.empty(3, np.int64), np.empty(3, np.float32)
    for row in range(height):
        has_left = False
        for column in range(width):
            if not depth[row, column] > 0:
                continue
            for axis in range(3):
                across, down = turned[axis, 0] * np.float32(column), turned[axis, 1] * np.float32(row)
                ray[axis] = across + down + turned[axis, 2]
            for step in range(steps):
                along = max(depth[row, column] + offsets[step], np.float32(0))
                for axis in range(3):
                    points[count, axis] = along * ray[axis] + shift[axis]
                    block[axis] = int(np.floor(points[count, axis] * per_length))
                known = has_left and _equal(block, left[step])
                known = known or (has_above[column] and _equal(block, above[column, step]))
                known = known or (step > 0 and _equal(block, left[step - 1]))
                left[step], above[column, step] = block, block
                if not known:
                    count += 1
            has_left = has_above[column] = True
    return count


@compiled
def _equal(one: NDArray[np.int64], other: NDArray[np.int64]) -> bool:
    return bool(one[0] == other[0] and one[1] == other[1] and one[2] == other[2])
