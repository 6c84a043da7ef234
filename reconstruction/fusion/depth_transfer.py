"""Depth of other views, carried into one view: points with an expected error, from all views that saw the wall.

Each pixel of another view is projected forward, so that nothing depends on a depth of the view itself. In every cell of
a few pixels the nearest point of each view hides those behind it; the views' points are then merged where they agree,
and are as unsure as they differ where they do not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from haustra.core.numba_cache import compiled

MIN_Z = 1e-9  # below which a point lies behind the camera
STRIDE = 2  # px between the pixels of a view that are carried over
SAME_WALL = 3.0  # times the two expected errors, within which two views' points are of one wall
LEAST_GAP = 0.02  # relative difference that is of one wall whatever the errors
INDEPENDENT = 2.0  # views of one wall err alike: however many agree, no more than so many count

Depth = NDArray[np.float32]


@dataclass(frozen=True)
class UnsureView:
    """A posed depth map with its errors; depth and translation in one unit."""

    depth: Depth  # (H,W) z-depth, 0 = none
    error: Depth  # (H,W) expected relative error: mean absolute, the scale of a Laplace distribution
    intrinsics: NDArray[np.float64]  # (3,3), the top-left pixel's centre at (0.5, 0.5)
    world_from_camera: NDArray[np.float64]  # (4,4)


def transferred(
    shape: tuple[int, int],
    intrinsics: NDArray[np.float64],
    world_from_camera: NDArray[np.float64],
    others: Sequence[UnsureView],
    cell_px: int,
) -> tuple[Depth, Depth]:
    """Depth and its relative error (H,W) of the wall that `others` saw, at one pixel of each cell at most, 0 = none.

    shape, intrinsics (3,3), world_from_camera (4,4): of the view that they are carried into. cell_px: side of a cell.
    """
    rows, columns = -(-shape[0] // cell_px), -(-shape[1] // cell_px)
    found = np.zeros((len(others), rows, columns, 4), np.float32)  # z, error, row, column; z 0 = none
    pinhole = _pinhole(intrinsics)
    for number, other in enumerate(others):
        view_from_other = np.linalg.inv(world_from_camera) @ other.world_from_camera
        depth, error = (np.ascontiguousarray(image, np.float32) for image in (other.depth, other.error))
        _splat(
            depth, error, _pinhole(other.intrinsics), view_from_other, pinhole, shape, cell_px, STRIDE, found[number]
        )
    return _merged(found, shape)


def _pinhole(intrinsics: NDArray[np.float64]) -> NDArray[np.float64]:
    """fx, fy, cx, cy (4,) of a matrix (3,3)."""
    return np.asarray(intrinsics, np.float64)[[0, 1, 0, 1], [0, 1, 2, 2]]


@compiled
def _splat(
    depth: Depth,
    error: Depth,
    pinhole: NDArray[np.float64],
    view_from_other: NDArray[np.float64],
    view_pinhole: NDArray[np.float64],
    shape: tuple[int, int],
    cell_px: int,
    stride: int,
    found: NDArray[np.float32],
) -> None:
    """Write the nearest of one view's points in each cell to `found` (rows, columns, 4)."""
    a, b, c = view_from_other[0], view_from_other[1], view_from_other[2]
    for row in range(0, depth.shape[0], stride):
        for column in range(0, depth.shape[1], stride):
            far = depth[row, column]
            if not far > 0:
                continue
            x = (column + 0.5 - pinhole[2]) / pinhole[0] * far
            y = (row + 0.5 - pinhole[3]) / pinhole[1] * far
            z = c[0] * x + c[1] * y + c[2] * far + c[3]
            if not z > MIN_Z:
                continue
            u = view_pinhole[0] * (a[0] * x + a[1] * y + a[2] * far + a[3]) / z + view_pinhole[2]
            v = view_pinhole[1] * (b[0] * x + b[1] * y + b[2] * far + b[3]) / z + view_pinhole[3]
            if not (u >= 0 and u < shape[1] and v >= 0 and v < shape[0]):
                continue
            cell = found[int(v) // cell_px, int(u) // cell_px]
            if cell[0] == 0 or z < cell[0]:
                cell[0], cell[1], cell[2], cell[3] = z, error[row, column] * far / z, int(v), int(u)


@compiled
def _merged(found: NDArray[np.float32], shape: tuple[int, int]) -> tuple[Depth, Depth]:
    """Points of V views (V, rows, columns, 4) -> depth and relative error (H,W)."""
    depth, error = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    for i in range(found.shape[1]):
        for j in range(found.shape[2]):
            best, weight = -1, 0.0
            for k in range(found.shape[0]):  # the point on which most weight agrees
                if found[k, i, j, 0] == 0:
                    continue
                agreed = 0.0
                for m in range(found.shape[0]):
                    if found[m, i, j, 0] > 0 and _one_wall(found[k, i, j], found[m, i, j]):
                        agreed += 1 / max(found[m, i, j, 1], 1e-4) ** 2
                if agreed > weight:
                    best, weight = k, agreed
            if best < 0:
                continue
            chosen = found[best, i, j]
            total, mean, squares, spread, against = 0.0, 0.0, 0.0, 0.0, 0.0
            down, right = 0.0, 0.0  # where the mean of their depths lies: wall is slanted
            for m in range(found.shape[0]):
                if found[m, i, j, 0] == 0:
                    continue
                w = 1 / max(found[m, i, j, 1], 1e-4) ** 2
                off = np.log(found[m, i, j, 0] / chosen[0])
                if _one_wall(chosen, found[m, i, j]):
                    total += w
                    squares += w * w
                    mean += w * off
                    spread += w * off * off
                    down += w * (found[m, i, j, 2] + 0.5)
                    right += w * (found[m, i, j, 3] + 0.5)
                else:
                    against += w
            mean /= total
            views = min(total * total / squares, INDEPENDENT)
            expected = total / squares  # the mean square error that they state, by weight
            scatter = max(spread / total - mean * mean, 0.0)
            doubt = 1 + against / total
            row, column = int(down / total), int(right / total)
            depth[row, column] = chosen[0] * np.exp(mean)
            error[row, column] = np.sqrt((expected / views + scatter) * doubt)
    return depth, error


@compiled
def _one_wall(a: NDArray[np.float32], b: NDArray[np.float32]) -> bool:
    """Whether two points (z, relative error, ...) may be of one surface."""
    return abs(np.log(a[0] / b[0])) <= LEAST_GAP + SAME_WALL * np.sqrt(a[1] ** 2 + b[1] ** 2)
