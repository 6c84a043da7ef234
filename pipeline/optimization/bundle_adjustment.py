"""Bundle adjustment: Levenberg-Marquardt on the Schur complement of the points (`schur`, `kernels`).

Triggs et al., "Bundle adjustment: a modern synthesis", 2000, section 6. Residuals are linear in the plane z = 1 (see
`rays`), down-weighted by Cauchy's loss through reweighting. Beside Ceres and GTSAM on a tracker's windows:
`benchmarks.speed window-adjustment`, docs/lab/front_end.md.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from haustra.core.se3 import Array, moved
from pipeline.optimization.depth_residuals import MeasuredDepth, add_depth_equations, depth_cost
from pipeline.optimization.kernels import MIN_DEPTH, halved, normal_equations, onto_cameras, onto_points, robust_cost
from pipeline.optimization.schur import Coupling, check_sorted, gram, solve

DAMPING, LEAST_DAMPING = 1e-4, 1e-9
TOLERANCE = 1e-4  # share of the cost: what lowers it by less ends the adjustment


@dataclass(frozen=True)
class Bundle:
    """Cameras (C), points (P) and observations (M), sorted by camera.

    rotation (C,3,3), translation (C,3): camera_from_world. points (P,3). camera, point: (M,) rows. xy (M,2) on the
    plane z = 1, jacobian (M,2,2) pixels per unit there. fixed (C,) cameras that stay. measured: depth that a sensor
    gave at some of the observations.
    """

    rotation: Array
    translation: Array
    points: Array
    camera: NDArray[np.int64]
    point: NDArray[np.int64]
    xy: Array
    jacobian: Array
    fixed: NDArray[np.bool_]
    measured: MeasuredDepth | None = None

    @property
    def arrays(self) -> tuple[Array, Array, Array, NDArray[np.int64], NDArray[np.int64], Array, Array]:
        """All but `fixed` and `measured`, as the kernels take them."""
        return self.rotation, self.translation, self.points, self.camera, self.point, self.xy, self.jacobian

    def residuals(self) -> Array:
        """(M,2) pixels."""
        local = np.einsum("mij,mj->mi", self.rotation[self.camera], self.points[self.point])
        return reprojections(local + self.translation[self.camera], self.xy, self.jacobian)

    def errors(self) -> Array:
        """(M,) length of each residual, pixels; infinite behind the camera."""
        return np.linalg.norm(self.residuals(), axis=1)


def adjust(
    bundle: Bundle, iterations: int, loss_px: float, tolerance: float = TOLERANCE, damping: float = DAMPING
) -> Bundle:
    """Lower the robust cost of `bundle`: cameras that are not fixed, and all points. Never raises it.

    It ends where a step lowers the cost by less than `tolerance` of itself. `damping`: of the first step, as a share of
    the diagonal; what costs little to bend, as the scale along a path, it holds back most.
    Without two fixed cameras and without measured depth the scale is free; the damping then keeps it where it was.
    """
    bundle = _contiguous(bundle)
    observed = bundle.camera, bundle.point, len(bundle.rotation), len(bundle.points)
    check_sorted(*observed)
    coupling = None if bundle.fixed.all() else Coupling.of(*observed)  # points alone share nothing
    cost = _cost(bundle, loss_px)
    system = None
    for _ in range(iterations):
        if system is None:
            system = _linearise(bundle, loss_px)
        step = _solve(bundle, coupling, system, damping)
        if step is None:
            damping *= 10
            continue
        rotation, translation = moved(bundle.rotation, bundle.translation, step[0])
        candidate = replace(bundle, rotation=rotation, translation=translation, points=bundle.points + step[1])
        lowered = _cost(candidate, loss_px)
        if lowered < cost:
            decrease, bundle, cost = (cost - lowered) / cost, candidate, lowered
            damping, system = max(damping / 10, LEAST_DAMPING), None
            if decrease < tolerance:
                break
        else:
            damping *= 10
            if damping > 1e4:
                break
    return bundle


def reprojections(local: Array, xy: Array, jacobian: Array) -> Array:
    """(M,2) pixels that points in camera axes (M,3) miss their observations by."""
    depth = np.maximum(local[:, 2:], MIN_DEPTH)
    return np.einsum("mij,mj->mi", jacobian, local[:, :2] / depth - xy)


def _cost(bundle: Bundle, loss_px: float) -> float:
    cost, given = robust_cost(*bundle.arrays, loss_px), bundle.measured
    if given is not None:
        cost += depth_cost(*bundle.arrays[:5], given.observation, given.depth, given.error, loss_px)
    return cost


def _contiguous(bundle: Bundle) -> Bundle:
    """The same numbers as the kernels take them: other layouts would be compiled for themselves."""
    floats = (bundle.rotation, bundle.translation, bundle.points, bundle.xy, bundle.jacobian)
    rotation, translation, points, xy, jacobian = (np.ascontiguousarray(a, np.float64) for a in floats)
    camera, point = (np.ascontiguousarray(a, np.int64) for a in (bundle.camera, bundle.point))
    measured = None if bundle.measured is None else bundle.measured.contiguous()
    fixed = np.ascontiguousarray(bundle.fixed)
    return Bundle(rotation, translation, points, camera, point, xy, jacobian, fixed, measured)


@dataclass(frozen=True)
class _System:
    """Normal equations: camera blocks (C,6,6), point blocks (P,3,3), cross blocks (M,6,3), right-hand sides."""

    cameras: Array
    points: Array
    cross: Array
    camera_side: Array
    point_side: Array


def _linearise(bundle: Bundle, loss_px: float) -> _System:
    blocks, given = normal_equations(*bundle.arrays, bundle.fixed, loss_px), bundle.measured
    if given is not None:
        arrays = (*bundle.arrays[:5], given.observation, given.depth, given.error)
        add_depth_equations(*arrays, bundle.fixed, loss_px, *blocks)
    return _System(*blocks)


def _solve(bundle: Bundle, coupling: Coupling | None, system: _System, damping: float) -> tuple[Array, Array] | None:
    """Steps (C,6) and (P,3), or None if the damped system is not positive definite."""
    cameras, points = len(system.cameras), len(system.points)
    root = _inverse_root(_damped(system.points, damping))
    point_side = np.einsum("pji,pj->pi", root, system.point_side)
    camera_step = np.zeros((cameras, 6))
    if coupling is not None:
        free = np.flatnonzero(~bundle.fixed)
        half = halved(system.cross, root, bundle.point)
        reduced = gram(half, coupling).subtracted_from(_damped(system.cameras, damping))
        side = system.camera_side - onto_cameras(half, bundle.camera, bundle.point, point_side, cameras)
        step = solve(reduced.among(free), side[free])
        if step is None:
            return None
        camera_step[free] = step
        point_side = point_side - onto_points(half, bundle.camera, bundle.point, camera_step, points)
    point_step = np.einsum("pij,pj->pi", root, point_side)
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
