"""Compiled loops over observations, for bundle adjustment and for submap matching.

C cameras (rotation (C,3,3), translation (C,3), camera_from_world), P points (P,3), M observations: `camera` and `point`
(M,) rows, `xy` (M,2) on the plane z = 1, `jacobian` (M,2,2) pixels per unit there. The loss is Cauchy's, in pixels.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from haustra.core.numba_cache import compiled

Array = NDArray[np.floating[Any]]
Rows = NDArray[np.int64]

MIN_DEPTH = 1e-9  # points behind a camera are moved here: a large residual instead of a mirrored one


@compiled
def _residual(
    rotation: Array, translation: Array, point: Array, xy: Array, jacobian: Array, local: Array, residual: Array
) -> None:
    """One observation: the point in camera axes (3,), and by how many pixels (2,) it misses what was seen."""
    for i in range(3):
        local[i] = rotation[i, 0] * point[0] + rotation[i, 1] * point[1] + rotation[i, 2] * point[2] + translation[i]
    depth = max(local[2], MIN_DEPTH)
    x, y = local[0] / depth - xy[0], local[1] / depth - xy[1]
    residual[0] = jacobian[0, 0] * x + jacobian[0, 1] * y
    residual[1] = jacobian[1, 0] * x + jacobian[1, 1] * y


@compiled
def _jacobian(local: Array, jacobian: Array, by_pose: Array) -> None:
    """(2,6) of a residual by the pose's tangent, rotation first; its last three columns are those by the point in the
    camera's axes."""
    inverse_depth = 1.0 / max(local[2], MIN_DEPTH)
    for i in range(2):
        a, b = jacobian[i, 0] * inverse_depth, jacobian[i, 1] * inverse_depth
        c = -(a * local[0] + b * local[1]) * inverse_depth
        by_pose[i, 0] = local[1] * c - local[2] * b
        by_pose[i, 1] = local[2] * a - local[0] * c
        by_pose[i, 2] = local[0] * b - local[1] * a
        by_pose[i, 3], by_pose[i, 4], by_pose[i, 5] = a, b, c


@compiled
def _add_camera(by_pose: Array, residual: Array, weight: float, c: int, blocks: Array, side: Array) -> None:
    """One observation's share in the block and the right-hand side of its camera `c`, of (C,6,6) and (C,6)."""
    for j in range(6):
        first, second = weight * by_pose[0, j], weight * by_pose[1, j]
        side[c, j] -= first * residual[0] + second * residual[1]
        for k in range(6):
            blocks[c, j, k] += first * by_pose[0, k] + second * by_pose[1, k]


@compiled
def _weight(residual: Array, loss: float) -> float:
    """Of Cauchy's loss in reweighted least squares."""
    return 1.0 / (1.0 + (residual[0] ** 2 + residual[1] ** 2) / loss**2)


@compiled
def robust_cost(
    rotation: Array,
    translation: Array,
    points: Array,
    camera: Rows,
    point: Rows,
    xy: Array,
    jacobian: Array,
    loss: float,
) -> float:
    """Sum of Cauchy's loss over all observations, square pixels."""
    local, residual = np.empty(3), np.empty(2)
    total = 0.0
    for m in range(len(camera)):
        c = camera[m]
        _residual(rotation[c], translation[c], points[point[m]], xy[m], jacobian[m], local, residual)
        total += np.log1p((residual[0] ** 2 + residual[1] ** 2) / loss**2)
    return loss**2 * total


@compiled
def moved_residuals(
    transform: Array, points: Array, rotation: Array, translation: Array, camera: Rows, xy: Array, jacobian: Array
) -> Array:
    """(M,3): by how many pixels points (M,3), moved by an affine `transform` (4,4), miss what was seen; their depth."""
    result = np.empty((len(points), 3))
    moved, local, residual = np.empty(3), np.empty(3), np.empty(2)
    for m in range(len(points)):
        for i in range(3):
            moved[i] = transform[i, 3]
            for j in range(3):
                moved[i] += transform[i, j] * points[m, j]
        c = camera[m]
        _residual(rotation[c], translation[c], moved, xy[m], jacobian[m], local, residual)
        result[m, 0], result[m, 1], result[m, 2] = residual[0], residual[1], local[2]
    return result


@compiled
def normal_equations(
    rotation: Array,
    translation: Array,
    points: Array,
    camera: Rows,
    point: Rows,
    xy: Array,
    jacobian: Array,
    fixed: NDArray[np.bool_],
    loss: float,
) -> tuple[Array, Array, Array, Array, Array]:
    """Blocks of the cameras (C,6,6), of the points (P,3,3), across (M,6,3), and right-hand sides (C,6) and (P,3).

    Cameras that are `fixed` (C,) have zeros.
    """
    count = len(camera)
    of_cameras, of_points = np.zeros((len(rotation), 6, 6)), np.zeros((len(points), 3, 3))
    camera_side, point_side = np.zeros((len(rotation), 6)), np.zeros((len(points), 3))
    cross = np.zeros((count, 6, 3))
    local, residual, by_pose, by_point = np.empty(3), np.empty(2), np.empty((2, 6)), np.empty((2, 3))
    for m in range(count):
        c, p = camera[m], point[m]
        turn = rotation[c]
        _residual(turn, translation[c], points[p], xy[m], jacobian[m], local, residual)
        _jacobian(local, jacobian[m], by_pose)
        weight = _weight(residual, loss)
        for i in range(2):
            for k in range(3):
                by_point[i, k] = by_pose[i, 3] * turn[0, k] + by_pose[i, 4] * turn[1, k] + by_pose[i, 5] * turn[2, k]
        for j in range(3):
            first, second = weight * by_point[0, j], weight * by_point[1, j]
            point_side[p, j] -= first * residual[0] + second * residual[1]
            for k in range(3):
                of_points[p, j, k] += first * by_point[0, k] + second * by_point[1, k]
        if fixed[c]:
            continue
        _add_camera(by_pose, residual, weight, c, of_cameras, camera_side)
        for j in range(6):
            first, second = weight * by_pose[0, j], weight * by_pose[1, j]
            for k in range(3):
                cross[m, j, k] = first * by_point[0, k] + second * by_point[1, k]
    return of_cameras, of_points, cross, camera_side, point_side


@compiled
def pose_equations(
    rotation: Array, translation: Array, points: Array, camera: Rows, xy: Array, jacobian: Array, loss: float
) -> tuple[Array, Array]:
    """Blocks (C,6,6) and right-hand sides (C,6) of the poses alone; points (M,3), one for each observation."""
    blocks, side = np.zeros((len(rotation), 6, 6)), np.zeros((len(rotation), 6))
    local, residual, by_pose = np.empty(3), np.empty(2), np.empty((2, 6))
    for m in range(len(camera)):
        c = camera[m]
        _residual(rotation[c], translation[c], points[m], xy[m], jacobian[m], local, residual)
        _jacobian(local, jacobian[m], by_pose)
        _add_camera(by_pose, residual, _weight(residual, loss), c, blocks, side)
    return blocks, side


@compiled
def halved(cross: Array, root: Array, point: Rows) -> Array:
    """Each block across (M,6,3) times the root (P,3,3), upper triangular, of its point's inverse block; transposed,
    (M,3,6), since six numbers in a row are multiplied at once."""
    half = np.empty((len(point), 3, 6))
    for m in range(len(point)):
        r = root[point[m]]
        for j in range(6):
            x, y, z = cross[m, j, 0], cross[m, j, 1], cross[m, j, 2]
            half[m, 0, j] = x * r[0, 0]
            half[m, 1, j] = x * r[0, 1] + y * r[1, 1]
            half[m, 2, j] = x * r[0, 2] + y * r[1, 2] + z * r[2, 2]
    return half


@compiled
def onto_cameras(half: Array, camera: Rows, point: Rows, values: Array, cameras: int) -> Array:
    """(C,6) the (6C,3P) matrix whose blocks are those of `half` (M,3,6) transposed, times values (P,3)."""
    result = np.zeros((cameras, 6))
    for m in range(len(camera)):
        v = values[point[m]]
        for j in range(6):
            result[camera[m], j] += half[m, 0, j] * v[0] + half[m, 1, j] * v[1] + half[m, 2, j] * v[2]
    return result


@compiled
def onto_points(half: Array, camera: Rows, point: Rows, values: Array, points: int) -> Array:
    """(P,3) the transpose of that matrix, times values (C,6)."""
    result = np.zeros((points, 3))
    for m in range(len(camera)):
        v = values[camera[m]]
        for k in range(3):
            for j in range(6):
                result[point[m], k] += half[m, k, j] * v[j]
    return result


@compiled
def _row(values: Array) -> tuple[float, float, float, float, float, float]:
    return values[0], values[1], values[2], values[3], values[4], values[5]


@compiled
def products(
    half: Array,
    camera: Rows,
    point: Rows,
    starts: Rows,
    by_point: Rows,
    begins: Rows,
    column: Rows,
    firsts: Rows,
    first: int,
    last: int,
    blocks: Array,
) -> None:
    """That matrix times its own transpose: the rows of cameras `first` to `last`, added to `blocks` (K,6,6), which
    begin as zeros. `schur.Coupling` says what the others are."""
    slot = np.empty(len(starts), np.int64)
    for c in range(first, last):
        for k in range(firsts[c], firsts[c + 1]):
            slot[column[k]] = k
        for m in range(starts[c], starts[c + 1]):
            for k in range(begins[point[m]], begins[point[m] + 1]):
                n = by_point[k]
                if camera[n] < c:
                    continue
                # One row of the block at once, written out: a loop over it is not turned into vector instructions,
                # since for all that the compiler knows the block might lie in `half`.
                to = slot[camera[n]]
                a0, a1, a2, a3, a4, a5 = _row(half[n, 0])
                b0, b1, b2, b3, b4, b5 = _row(half[n, 1])
                c0, c1, c2, c3, c4, c5 = _row(half[n, 2])
                for i in range(6):
                    x, y, z = half[m, 0, i], half[m, 1, i], half[m, 2, i]
                    blocks[to, i, 0] += x * a0 + y * b0 + z * c0
                    blocks[to, i, 1] += x * a1 + y * b1 + z * c1
                    blocks[to, i, 2] += x * a2 + y * b2 + z * c2
                    blocks[to, i, 3] += x * a3 + y * b3 + z * c3
                    blocks[to, i, 4] += x * a4 + y * b4 + z * c4
                    blocks[to, i, 5] += x * a5 + y * b5 + z * c5
