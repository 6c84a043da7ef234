"""RANSAC of the similarity between two maps from matched 3-D points, with inliers counted in both images."""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from haustra.core.se3 import Array
from haustra.core.sim3 import scale_of, transform_points, umeyama_batch
from pipeline.optimization.kernels import MIN_DEPTH, moved_residuals
from pipeline.optimization.resection import reprojection_errors, rounds_needed

MAX_ERROR_PX = 4.0
MIN_INLIERS = 20
MIN_SPREAD = 0.1  # of the width: standard deviation of the inliers in both images, along the narrower direction
MAX_SCALE = 20.0  # two maps of one place are in units of its depth; farther apart is a false fit
BATCH = 64  # samples judged at once


@dataclass(frozen=True)
class Correspondences:
    """One map's view of the shared points: points (N,3) in its world, camera_from_world (4,4), xy (N,2) on
    the plane z = 1, jacobian (N,2,2) pixels per unit there."""

    points: Array
    camera_from_world: Array
    xy: Array
    jacobian: Array

    def at(self, rows: NDArray) -> "Correspondences":
        return replace(self, points=self.points[rows], xy=self.xy[rows], jacobian=self.jacobian[rows])


@dataclass(frozen=True)
class StackedCorrespondences:
    """Correspondences of several cameras one after another: points (M,3), xy (M,2), jacobian (M,2,2), the number of the
    camera (M,) that each belongs to; of each, camera_from_world as rotation (S,3,3) and shift (S,3), and where its
    points begin, starts (S,)."""

    points: Array
    xy: Array
    jacobian: Array
    side: NDArray[np.int64]
    rotation: Array
    shift: Array
    starts: NDArray[np.int64]

    @staticmethod
    def of(sides: list[Correspondences]) -> "StackedCorrespondences":
        counts = [len(side.points) for side in sides]
        cameras_from_world = np.stack([side.camera_from_world for side in sides])
        return StackedCorrespondences(
            np.concatenate([side.points for side in sides]),
            np.concatenate([side.xy for side in sides]),
            np.concatenate([side.jacobian for side in sides]),
            np.repeat(np.arange(len(sides)), counts),
            np.ascontiguousarray(cameras_from_world[:, :3, :3]),
            np.ascontiguousarray(cameras_from_world[:, :3, 3]),
            np.cumsum([0, *counts[:-1]]),
        )

    def residuals(self, transform: Array, points: Array) -> Array:
        """(M,3): by how many pixels points (M,3) of another world, moved into this one, miss what was seen; depth."""
        if points.shape != self.points.shape:
            raise ValueError(f"{self.points.shape} was seen, not {points.shape}")  # the kernel checks no index
        return moved_residuals(
            np.ascontiguousarray(transform), points, self.rotation, self.shift, self.side, self.xy, self.jacobian
        )

    def errors(self, transform: Array, points: Array) -> Array:
        """(M,) pixels, the same; infinite behind the camera."""
        residuals = self.residuals(transform, points)
        off = np.sqrt(residuals[:, 0] ** 2 + residuals[:, 1] ** 2)
        return np.where(residuals[:, 2] > MIN_DEPTH, off, np.inf)


def similarity_errors(second_from_first: Array, first: Correspondences, second: Correspondences) -> Array:
    """(N,) worse of the two reprojection errors, pixels: each map's points, moved, in the other's camera."""
    ahead = transform_points(second_from_first, first.points)
    back = transform_points(np.linalg.inv(second_from_first), second.points)
    return np.maximum(
        reprojection_errors(second.camera_from_world, ahead, second.xy, second.jacobian),
        reprojection_errors(first.camera_from_world, back, first.xy, first.jacobian),
    )


def robust_similarity(
    first: Correspondences,
    second: Correspondences,
    rng: np.random.Generator,
    most_rounds: int = 300,
    fewest: int = 4,
) -> tuple[Array, NDArray[np.bool_]] | None:
    """The 4x4 `second_from_first` with scale, and which pairs of points (N,) agree; None if no sample gave any.

    fewest: pairs that must agree to be of use; samples are drawn until so many would surely have been met."""
    count = len(first.points)
    if count < max(4, fewest):
        return None
    best, most, done = None, 3, 0
    rounds = min(most_rounds, rounds_needed((fewest / count) ** 3))
    while done < rounds:
        size = min(BATCH, rounds - done)
        done += size
        sample = rng.random((size, count)).argpartition(2, axis=1)[:, :3]
        sample = sample[_are_alike(first.points[sample], second.points[sample])]
        found = _fits(first.points[sample], second.points[sample])
        if len(found) == 0:
            continue
        agreeing = (_errors_of_each(found, first, second) < MAX_ERROR_PX).sum(axis=1)
        if agreeing.max() > most:
            best, most = found[agreeing.argmax()], int(agreeing.max())
            rounds = min(rounds, rounds_needed((most / count) ** 3))
    return None if best is None else _refitted(best, first, second)


def _refitted(best: Array, first: Correspondences, second: Correspondences) -> tuple[Array, NDArray[np.bool_]]:
    """Fitted to all that agree, three times or until fewer do; and which do in the end."""
    inlier = similarity_errors(best, first, second) < MAX_ERROR_PX
    for _ in range(3):
        refined = _fits(first.points[inlier][None], second.points[inlier][None])
        if len(refined) == 0:
            break
        agreeing = similarity_errors(refined[0], first, second) < MAX_ERROR_PX
        if agreeing.sum() < inlier.sum():
            break
        best, inlier = refined[0], agreeing
    return best, inlier


def refine_similarity(similarity: Array, sides: list[tuple[Correspondences, Correspondences]]) -> Array:
    """`second_from_first` fitted to the images of all pairs of sides, both ways, with Cauchy's loss.

    The closed form above takes one map's points to be exact, which lowers the scale; asking both maps' images alike
    favours neither.
    """
    scale = float(scale_of(similarity))
    start = np.concatenate(
        [Rotation.from_matrix(similarity[:3, :3] / scale).as_rotvec(), similarity[:3, 3], [np.log(scale)]]
    )

    one, other = (StackedCorrespondences.of([pair[k] for pair in sides]) for k in (0, 1))

    def residuals(x: Array) -> Array:
        moved = np.eye(4)
        moved[:3, :3], moved[:3, 3] = np.exp(x[6]) * Rotation.from_rotvec(x[:3]).as_matrix(), x[3:6]
        ahead = other.residuals(moved, one.points)[:, :2]
        back = one.residuals(np.linalg.inv(moved), other.points)[:, :2]
        return np.concatenate([ahead.ravel(), back.ravel()]).clip(-1e3, 1e3)

    found = least_squares(residuals, start, loss="cauchy", f_scale=1.0, max_nfev=40).x
    refined = np.eye(4)
    refined[:3, :3], refined[:3, 3] = np.exp(found[6]) * Rotation.from_rotvec(found[:3]).as_matrix(), found[3:6]
    return refined


def _fits(source: Array, target: Array) -> Array:
    """(K',4,4) similarities of K sets of points (K,N,3), without those of sets that none can have moved so."""
    if source.shape[0] == 0 or source.shape[1] < 3:
        return np.zeros((0, 4, 4))
    found = umeyama_batch(np.asarray(source, np.float64), np.asarray(target, np.float64), with_scale=True)
    found = found[np.isfinite(found).all(axis=(1, 2))]
    scale = scale_of(found)
    return found[(scale > 1 / MAX_SCALE) & (scale < MAX_SCALE)]


def _errors_of_each(transforms: Array, first: Correspondences, second: Correspondences) -> Array:
    """(K,N) `similarity_errors` of K transforms (K,4,4)."""
    ahead, back = second.camera_from_world @ transforms, first.camera_from_world @ np.linalg.inv(transforms)
    return np.maximum(
        _reprojected(ahead, first.points, second.xy, second.jacobian),
        _reprojected(back, second.points, first.xy, first.jacobian),
    )


def _reprojected(camera_from_world: Array, points: Array, xy: Array, jacobian: Array) -> Array:
    """(K,N) pixels by which points (N,3) miss their places under each of (K,4,4), affine; infinite behind it."""
    local = points @ np.swapaxes(camera_from_world[:, :3, :3], 1, 2) + camera_from_world[:, None, :3, 3]
    front = local[:, :, 2] > 1e-9
    off = local[:, :, :2] / np.where(front, local[:, :, 2], 1.0)[:, :, None] - xy
    return np.where(front, np.linalg.norm(np.einsum("nij,knj->kni", jacobian, off), axis=2), np.inf)


def verified_similarity(
    first: Correspondences,
    second: Correspondences,
    pixels: tuple[Array, Array],
    width: int,
    rng: np.random.Generator,
    min_share: float,
    most_rounds: int = 300,
) -> tuple[Array, NDArray[np.bool_]] | None:
    """`robust_similarity` if enough of the matches agree, a share of `min_share` at least, spread over both images.

    pixels: (N,2) where the points lie in either image, `width` px wide.
    """
    if len(first.points) < MIN_INLIERS:
        return None
    fewest = max(MIN_INLIERS, math.ceil(min_share * len(first.points)))
    found = robust_similarity(first, second, rng, most_rounds, fewest=fewest)
    return found if found is not None and is_well_conditioned(found[1], pixels, width, min_share) else None


def is_well_conditioned(inlier: NDArray[np.bool_], pixels: tuple[Array, Array], width: int, min_share: float) -> bool:
    """Whether enough matches (N,) agree, spread over both images. pixels: (N,2) in either, `width` px wide."""
    if inlier.sum() < MIN_INLIERS or inlier.mean() < min_share:
        return False
    return min(_narrow_spread(p[inlier]) for p in pixels) >= MIN_SPREAD * width


def _narrow_spread(pixels: Array) -> float:
    return float(np.sqrt(max(np.linalg.eigvalsh(np.cov(pixels.T))[0], 0)))


def _are_alike(source: Array, target: Array) -> NDArray[np.bool_]:
    """(K,) whether two triangles (K,3,3) are similar enough to be worth a fit: three ratios of sides that agree within
    a half."""
    sides = [np.linalg.norm(p - p[:, [1, 2, 0]], axis=2) for p in (source, target)]
    ratio = sides[1] / np.maximum(sides[0], 1e-12)
    return (ratio.min(axis=1) > 0) & (ratio.max(axis=1) < 1.5 * ratio.min(axis=1))
