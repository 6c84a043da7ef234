"""Camera poses from known points: robust refinement of one or of many, and a start where there is no motion prior."""

import cv2
import numpy as np
from numpy.typing import NDArray

from haustra.core.se3 import Array, compose, moved
from pipeline.optimization.kernels import pose_equations

MIN_POINTS = 6
RANSAC_ROUNDS = 400
SURE = 0.999  # chance that one of the samples is free of outliers


def refine_poses(
    rotation: Array,
    translation: Array,
    camera: NDArray[np.int64],
    points: Array,
    xy: Array,
    jacobian: Array,
    loss_px: float,
    iterations: int = 8,
) -> tuple[Array, Array]:
    """Poses (C,3,3), (C,3) of `camera_from_world` that fit points (M,3) seen at (M,2); rows in `camera` ascend.

    Gauss-Newton with Cauchy's weights; points stay. A camera without observations keeps its pose.
    """
    floats = (rotation, translation, points, xy, jacobian)
    rotation, translation, points, xy, jacobian = (np.ascontiguousarray(a, np.float64) for a in floats)
    camera = np.ascontiguousarray(camera, np.int64)
    for _ in range(iterations):
        normal, side = pose_equations(rotation, translation, points, camera, xy, jacobian, loss_px)
        diagonal = np.einsum("cii->ci", normal)
        diagonal += 1e-6 * diagonal + 1e-9
        step = np.linalg.solve(normal, side[:, :, None])[:, :, 0]
        step = np.where(np.isfinite(step), step, 0.0)
        rotation, translation = moved(rotation, translation, step)
        if np.abs(step[:, :3]).max(initial=0) < 1e-7:
            break
    return rotation, translation


def refine_pose(
    camera_from_world: Array, points: Array, xy: Array, jacobian: Array, loss_px: float, iterations: int = 8
) -> Array:
    """The 4x4 `camera_from_world` refined from `camera_from_world`."""
    row = np.zeros(len(points), dtype=np.int64)
    rotation, translation = refine_poses(
        camera_from_world[None, :3, :3], camera_from_world[None, :3, 3], row, points, xy, jacobian, loss_px, iterations
    )
    return compose(rotation[0], translation[0])


def reprojection_errors(camera_from_world: Array, points: Array, xy: Array, jacobian: Array) -> Array:
    """(N,) pixels; infinite behind the camera."""
    local = points @ camera_from_world[:3, :3].T + camera_from_world[:3, 3]
    front = local[:, 2] > 1e-9
    off = np.einsum("nij,nj->ni", jacobian, local[:, :2] / np.where(front, local[:, 2], 1.0)[:, None] - xy)
    return np.where(front, np.linalg.norm(off, axis=1), np.inf)


def robust_pose(
    points: Array, xy: Array, jacobian: Array, max_error_px: float, rng: np.random.Generator
) -> Array | None:
    """Pose from points (N,3) and their places (N,2) on the plane z = 1, whatever half of them are wrong.

    Samples of four give a pose by P3P (Gao; the fourth point picks the root), most inliers win, all inliers refine it.
    OpenCV's own sample consensus has one seed for all calls; here the generator decides. None if fewer than
    `MIN_POINTS` agree.
    """
    if len(points) < MIN_POINTS:
        return None
    best: Array | None = None
    most, rounds, done = 0, RANSAC_ROUNDS, 0
    while done < rounds:
        done += 1
        sample = rng.choice(len(points), 4, replace=False)
        found, turn, shift = cv2.solvePnP(
            np.ascontiguousarray(points[sample]), np.ascontiguousarray(xy[sample]), np.eye(3), None,
            flags=cv2.SOLVEPNP_P3P,
        )  # fmt: skip
        if not found:
            continue
        camera_from_world = compose(cv2.Rodrigues(turn)[0], shift.ravel())
        agreeing = int((reprojection_errors(camera_from_world, points, xy, jacobian) < max_error_px).sum())
        if agreeing > most:
            best, most = camera_from_world, agreeing
            rounds = min(RANSAC_ROUNDS, rounds_needed((most / len(points)) ** 4))
    if best is None or most < MIN_POINTS:
        return None
    for _ in range(2):
        inlier = reprojection_errors(best, points, xy, jacobian) < max_error_px
        if inlier.sum() < MIN_POINTS:
            return None
        best = refine_pose(best, points[inlier], xy[inlier], jacobian[inlier], max_error_px / 2)
    return best


def rounds_needed(clean: float) -> int:
    """Samples to draw so that one of them is free of outliers, as surely as `SURE`; `clean`: chance that one is."""
    return 1 if clean > SURE else int(np.ceil(np.log(1 - SURE) / np.log1p(-clean)))
