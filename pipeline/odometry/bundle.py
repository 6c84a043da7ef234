"""Bundle adjustment: Levenberg-Marquardt on the Schur complement of the points (`schur`), in NumPy.

Triggs et al., "Bundle adjustment: a modern synthesis", 2000, section 6. Residuals are linear in the plane z = 1 (see
`rays`), down-weighted by Cauchy's loss through reweighting. Preferred to Ceres, which would live in another process,
and to GTSAM, which takes a Python object for each observation; see docs/front_end.md.
"""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from pipeline.odometry.poses import Array, moved
from pipeline.odometry.schur import Blocks, gram, solve

DAMPING, LEAST_DAMPING = 1e-4, 1e-9
TOLERANCE = 1e-4  # share of the cost: what lowers it by less ends the adjustment
MIN_DEPTH = 1e-9  # points behind a camera are moved here: a large residual instead of a mirrored one


@dataclass(frozen=True)
class Bundle:
    """Cameras (C), points (P) and observations (M), sorted by camera.

    rotation (C,3,3), translation (C,3): camera_from_world. points (P,3). camera, point: (M,) rows. seen (M,2) on the
    plane z = 1, gain (M,2,2) pixels per unit there. fixed (C,) cameras that stay.
    """

    rotation: Array
    translation: Array
    points: Array
    camera: NDArray[np.int64]
    point: NDArray[np.int64]
    seen: Array
    gain: Array
    fixed: NDArray[np.bool_]

    def residuals(self) -> Array:
        """(M,2) pixels."""
        local = np.einsum("mij,mj->mi", self.rotation[self.camera], self.points[self.point])
        return reprojections(local + self.translation[self.camera], self.seen, self.gain)

    def errors(self) -> Array:
        """(M,) length of each residual, pixels; infinite behind the camera."""
        return np.linalg.norm(self.residuals(), axis=1)


def adjust(
    bundle: Bundle, iterations: int, loss_px: float, tolerance: float = TOLERANCE, damping: float = DAMPING
) -> Bundle:
    """Lower the robust cost of `bundle`: cameras that are not fixed, and all points. Never raises it.

    It ends where a step lowers the cost by less than `tolerance` of itself. `damping`: of the first step, as a share of
    the diagonal; what costs little to bend, as the scale along a path, it holds back most.
    Without two fixed cameras the scale is free; the damping then keeps it where it was.
    """
    sums = _Sums(bundle)
    cost = _cost(bundle, loss_px)
    system = None
    for _ in range(iterations):
        if system is None:
            system = _linearise(bundle, sums, loss_px)
        step = _solve(bundle, system, damping)
        if step is None:
            damping *= 10
            continue
        rotation, translation = moved(bundle.rotation, bundle.translation, step[0])
        candidate = replace(bundle, rotation=rotation, translation=translation, points=bundle.points + step[1])
        lowered = _cost(candidate, loss_px)
        if lowered < cost:
            gain, bundle, cost = (cost - lowered) / cost, candidate, lowered
            damping, system = max(damping / 10, LEAST_DAMPING), None
            if gain < tolerance:
                break
        else:
            damping *= 10
            if damping > 1e4:
                break
    return bundle


def reprojections(local: Array, seen: Array, gain: Array) -> Array:
    """(M,2) pixels that points in camera axes (M,3) miss their observations by."""
    depth = np.maximum(local[:, 2:], MIN_DEPTH)
    return np.einsum("mij,mj->mi", gain, local[:, :2] / depth - seen)


def cauchy_weight(squared: Array, loss_px: float) -> Array:
    """(M,) weight of each residual in reweighted least squares."""
    return 1 / (1 + squared / loss_px**2)


def _cost(bundle: Bundle, loss_px: float) -> float:
    squared = (bundle.residuals() ** 2).sum(axis=1)
    return float(loss_px**2 * np.log1p(squared / loss_px**2).sum())


def jacobians(local: Array, gain: Array) -> tuple[Array, Array]:
    """(M,2,6) by the pose's tangent and (M,2,3) by the point in the camera's axes."""
    inverse_depth = 1 / np.maximum(local[:, 2], MIN_DEPTH)
    projection = np.zeros((len(local), 2, 3))
    projection[:, 0, 0] = projection[:, 1, 1] = inverse_depth
    projection[:, :, 2] = -local[:, :2] * inverse_depth[:, None] ** 2
    by_local = gain @ projection
    x, y, z = (local[:, None, k] for k in range(3))
    a, b, c = (by_local[:, :, k] for k in range(3))  # a row of J [-x]x is the point cross this row of J
    return np.stack([y * c - z * b, z * a - x * c, x * b - y * a, a, b, c], axis=2), by_local


class _Sums:
    """Sums over the observations of each camera, which lie together, and of each point."""

    def __init__(self, bundle: Bundle) -> None:
        count = len(bundle.camera)
        self.by_point = csr_array((np.ones(count), (bundle.point, np.arange(count))), shape=(len(bundle.points), count))
        self.starts = np.searchsorted(bundle.camera, np.arange(len(bundle.rotation) + 1))

    def by_camera(self, first: Array, second: Array) -> Array:
        """(C,6,K) sums of first' @ second over each camera's observations, (M,2,6) and (M,2,K)."""
        parts = [slice(begin, end) for begin, end in pairwise(self.starts.tolist())]
        width = second.shape[2]
        return np.stack([first[part].reshape(-1, 6).T @ second[part].reshape(-1, width) for part in parts])


@dataclass(frozen=True)
class _System:
    """Normal equations: camera blocks (C,6,6), point blocks (P,3,3), cross blocks (M,6,3), right-hand sides."""

    cameras: Array
    points: Array
    cross: Array
    camera_side: Array
    point_side: Array
    starts: NDArray[np.int64]


def _linearise(bundle: Bundle, sums: _Sums, loss_px: float) -> _System:
    rotation = bundle.rotation[bundle.camera]
    local = np.einsum("mij,mj->mi", rotation, bundle.points[bundle.point]) + bundle.translation[bundle.camera]
    residual = reprojections(local, bundle.seen, bundle.gain)
    weight = cauchy_weight((residual**2).sum(axis=1), loss_px)
    by_pose, by_local = jacobians(local, bundle.gain)
    by_pose[bundle.fixed[bundle.camera]] = 0
    by_point = by_local @ rotation
    weighted_pose, weighted_point = by_pose * weight[:, None, None], by_point * weight[:, None, None]
    count = len(residual)

    def outer(first: Array, second: Array) -> Array:
        return (np.swapaxes(first, 1, 2) @ second).reshape(count, -1)

    side = residual[:, :, None]
    return _System(
        sums.by_camera(weighted_pose, by_pose),
        (sums.by_point @ outer(weighted_point, by_point)).reshape(-1, 3, 3),
        outer(weighted_pose, by_point).reshape(-1, 6, 3),
        -sums.by_camera(weighted_pose, side)[:, :, 0],
        -(sums.by_point @ outer(weighted_point, side)),
        sums.starts,
    )


def _solve(bundle: Bundle, system: _System, damping: float) -> tuple[Array, Array] | None:
    """Steps (C,6) and (P,3), or None if the damped system is not positive definite."""
    cameras, points = len(system.cameras), len(system.points)
    free = np.flatnonzero(~bundle.fixed)
    root = _inverse_root(_damped(system.points, damping))
    half = Blocks(system.cross @ root[bundle.point], bundle.point, system.starts, points)
    rows = half.rows(0, cameras)
    point_side = np.einsum("pji,pj->pi", root, system.point_side)
    camera_step = np.zeros((cameras, 6))
    if len(free):
        reduced = gram(half).subtracted_from(_damped(system.cameras, damping))
        side = system.camera_side - (rows @ point_side.ravel()).reshape(cameras, 6)
        step = solve(reduced.among(free), side[free])
        if step is None:
            return None
        camera_step[free] = step
    rest = point_side - (rows.T @ camera_step.ravel()).reshape(points, 3)
    point_step = np.einsum("pij,pj->pi", root, rest)
    return (camera_step, point_step) if np.isfinite(camera_step).all() and np.isfinite(point_step).all() else None


def _damped(blocks: Array, damping: float) -> Array:
    result = blocks.copy()
    diagonal = np.arange(blocks.shape[1])
    result[:, diagonal, diagonal] = blocks[:, diagonal, diagonal] * (1 + damping) + 1e-12
    return result


def _inverse_root(blocks: Array) -> Array:
    """R (P,3,3) with R R' the inverse of symmetric positive blocks: Cholesky's factors, inverted, written out, which is
    ten times faster than LAPACK called for each. NaN where a block is not positive."""
    with np.errstate(invalid="ignore", divide="ignore"):
        p = 1 / np.sqrt(blocks[:, 0, 0])
        a, b = p * blocks[:, 0, 1], p * blocks[:, 0, 2]
        q = 1 / np.sqrt(blocks[:, 1, 1] - a * a)
        c = q * (blocks[:, 1, 2] - a * b)
        r = 1 / np.sqrt(blocks[:, 2, 2] - b * b - c * c)
    result = np.zeros_like(blocks)
    result[:, 0, 0], result[:, 1, 1], result[:, 2, 2] = p, q, r
    result[:, 0, 1], result[:, 1, 2] = -a * p * q, -c * q * r
    result[:, 0, 2] = (a * c * q - b) * p * r
    return result
