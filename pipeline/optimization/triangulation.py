"""Points from rays: where the rays of a track pass closest, refined in pixels."""

import numpy as np
from numpy.typing import NDArray

from haustra.core.se3 import Array
from pipeline.optimization.kernels import MIN_DEPTH

REFINEMENTS = 3


def triangulate(
    rotation: Array, translation: Array, point: NDArray[np.int64], count: int, xy: Array, jacobian: Array
) -> tuple[Array, Array, Array]:
    """Points (count,3), largest reprojection error (count,) in pixels, and widest angle to the first ray, radians: of
    `meeting_points`."""
    points, error, angle = meeting_points(rotation, translation, point, count, xy, jacobian)
    return points, np.maximum.reduceat(error, np.searchsorted(point, np.arange(count))), angle


def meeting_points(
    rotation: Array, translation: Array, point: NDArray[np.int64], count: int, xy: Array, jacobian: Array
) -> tuple[Array, Array, Array]:
    """Points (count,3), reprojection error of each observation (M,) in pixels, and widest angle to the first ray
    (count,), radians.

    rotation (M,3,3) and translation (M,3) are of the camera of each observation; `point` ascends and names every point
    at least once. An error is infinite where a point comes out behind a camera.
    """
    rays = np.concatenate([xy, np.ones((len(xy), 1))], axis=1)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    rays = np.einsum("mji,mj->mi", rotation, rays)
    centres = -np.einsum("mji,mj->mi", rotation, translation)
    starts = np.searchsorted(point, np.arange(count))
    square = np.eye(3) - rays[:, :, None] * rays[:, None, :]
    normal = np.add.reduceat(square, starts) + 1e-9 * np.eye(3)
    side = np.add.reduceat(np.einsum("mij,mj->mi", square, centres), starts)
    points = np.linalg.solve(normal, side[:, :, None])[:, :, 0]
    points = _refined(points, rotation, translation, point, starts, xy, jacobian)
    local = np.einsum("mij,mj->mi", rotation, points[point]) + translation
    front = local[:, 2] > 1e-9
    off = np.einsum("mij,mj->mi", jacobian, local[:, :2] / np.where(front, local[:, 2], 1.0)[:, None] - xy)
    error = np.where(front, np.linalg.norm(off, axis=1), np.inf)
    cosine = np.einsum("mi,mi->m", rays, rays[starts][point])
    angle = np.arccos(np.clip(np.minimum.reduceat(cosine, starts), -1, 1))
    return points, error, angle


def _refined(
    points: Array,
    rotation: Array,
    translation: Array,
    point: NDArray[np.int64],
    starts: NDArray[np.int64],
    xy: Array,
    jacobian: Array,
) -> Array:
    """Gauss-Newton on the reprojection error of each point; a step to behind a camera is left out."""
    for _ in range(REFINEMENTS):
        local = np.einsum("mij,mj->mi", rotation, points[point]) + translation
        behind = np.minimum.reduceat(local[:, 2], starts) < 1e-9
        residual = np.einsum("mij,mj->mi", jacobian, local[:, :2] / np.maximum(local[:, 2:], MIN_DEPTH) - xy)
        by_point = _by_local(local, jacobian) @ rotation
        normal = np.add.reduceat(np.swapaxes(by_point, 1, 2) @ by_point, starts)
        diagonal = np.einsum("pii->pi", normal)
        diagonal += 1e-6 * diagonal + 1e-12
        side = -np.add.reduceat(np.einsum("mij,mi->mj", by_point, residual), starts)
        step = np.linalg.solve(normal, side[:, :, None])[:, :, 0]
        points = points + np.where(behind[:, None] | ~np.isfinite(step), 0.0, step)
    return points


def _by_local(local: Array, jacobian: Array) -> Array:
    """(M,2,3) of the residuals by the points in their camera's axes."""
    inverse_depth = 1 / np.maximum(local[:, 2], MIN_DEPTH)
    projection = np.zeros((len(local), 2, 3))
    projection[:, 0, 0] = projection[:, 1, 1] = inverse_depth
    projection[:, :, 2] = -local[:, :2] * inverse_depth[:, None] ** 2
    return jacobian @ projection
