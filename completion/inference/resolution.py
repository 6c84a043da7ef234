"""Resolution at which a frame is completed, and resampling to it and back.

The network smooths over a fixed number of pixels; at a higher resolution, which dense points allow, that is less of the
wall. Chosen on rendered frames and on runs of validation videos (docs/lab/completion.md).
"""

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.float32]
Frame = tuple[NDArray[np.uint8], Image, Image]  # rgb (H,W,3), sparse depth and trust (H,W)

SIDE = 320  # px, longer side; the weights were trained on images of 192 to 320 px
# px, from so many points on, with more than one iteration; with a single one, a second would be worth more. 448 px
# has the smaller error on single frames with exact points, and no better meshes (docs/lab/completion.md).
SIDE_FOR_MANY, MANY_POINTS = 384, 600
MOST_ENLARGED = 1.5  # greatest upsampling factor
EDGE = 1.2  # ratio of depths within 3x3 pixels from which a resized depth keeps an edge there instead of a slope


def resolution_factor(side: int, points: int, iterations: int) -> float:
    """Resampling factor for an image of longer side `side` px with so many points."""
    if iterations > 1 and points >= MANY_POINTS:
        return min(SIDE_FOR_MANY / side, MOST_ENLARGED)
    return min(SIDE / side, 1.0)


def resized(rgb: NDArray[np.uint8], sparse: Image, trust: Image, factor: float) -> Frame:
    """Image, sparse depth and trust at `factor` times the resolution; of points in one pixel, the most trusted."""
    if factor == 1:
        return rgb, sparse, trust
    size = (max(1, round(rgb.shape[1] * factor)), max(1, round(rgb.shape[0] * factor)))
    rows, columns = np.nonzero(sparse)
    order = np.argsort(trust[rows, columns], kind="stable")
    rows, columns = rows[order], columns[order]
    new_rows = ((rows + 0.5) * size[1] / rgb.shape[0]).astype(int)
    new_columns = ((columns + 0.5) * size[0] / rgb.shape[1]).astype(int)
    new_sparse, new_trust = np.zeros((2, size[1], size[0]), dtype=np.float32)
    new_sparse[new_rows, new_columns] = sparse[rows, columns]
    new_trust[new_rows, new_columns] = trust[rows, columns]
    return cv2.resize(rgb, size, interpolation=cv2.INTER_AREA if factor < 1 else cv2.INTER_CUBIC), new_sparse, new_trust


def restore_resolution(depth: Image, error: Image, size: tuple[int, int]) -> tuple[Image, Image]:
    """Depth and error (h,w) -> at `size` (width, height) px: bilinear, but nearest at depth edges, between whose two
    sides there is no surface."""
    if depth.shape == size[::-1]:
        return depth, error
    around = np.ones((3, 3), np.uint8)
    edge = cv2.dilate(depth, around) > EDGE * cv2.erode(depth, around)
    edge = cv2.resize(edge.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST_EXACT) > 0
    nearest = cv2.resize(depth, size, interpolation=cv2.INTER_NEAREST_EXACT)
    return np.where(edge, nearest, cv2.resize(depth, size)), cv2.resize(error, size)
