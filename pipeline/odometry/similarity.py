"""Similarity between two maps from points that both know: sample consensus, judged in both cameras' images."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from pipeline.odometry.bundle import reprojections
from pipeline.odometry.poses import Array, in_camera
from pipeline.odometry.resection import reprojection_errors, rounds_needed
from reconstruction.errors import ReconstructionError
from reconstruction.trajectory import align_umeyama

MAX_ERROR_PX = 4.0
MIN_INLIERS = 20
MIN_SPREAD = 0.1  # of the width: standard deviation of the inliers in both images, along the narrower direction
MAX_SCALE = 20.0  # two maps of one place are in units of its depth; farther apart is a false fit


@dataclass(frozen=True)
class Side:
    """One map's view of the shared points: points (N,3) in its world, camera_from_world pose, seen (N,2), gain."""

    points: Array
    pose: Array
    seen: Array
    gain: Array

    def at(self, rows: NDArray) -> "Side":
        return replace(self, points=self.points[rows], seen=self.seen[rows], gain=self.gain[rows])


def similarity_errors(second_from_first: Array, first: Side, second: Side) -> Array:
    """(N,) worse of the two reprojection errors, pixels: each map's points, moved, in the other's camera."""
    ahead = moved_points(second_from_first, first.points)
    back = moved_points(np.linalg.inv(second_from_first), second.points)
    return np.maximum(
        reprojection_errors(second.pose, ahead, second.seen, second.gain),
        reprojection_errors(first.pose, back, first.seen, first.gain),
    )


def robust_similarity(
    first: Side, second: Side, rng: np.random.Generator, most_rounds: int = 300, max_error_px: float = MAX_ERROR_PX
) -> tuple[Array, NDArray[np.bool_]] | None:
    """The 4x4 `second_from_first` with scale, and which pairs of points (N,) agree; None if no sample gave any."""
    count = len(first.points)
    if count < 4:
        return None
    best, most, rounds, done = None, 3, most_rounds, 0
    while done < rounds:
        done += 1
        sample = rng.choice(count, 3, replace=False)
        if not _is_alike(first.points[sample], second.points[sample]):
            continue
        found = _fit(first.points[sample], second.points[sample])
        if found is None:
            continue
        agreeing = int((similarity_errors(found, first, second) < max_error_px).sum())
        if agreeing > most:
            best, most = found, agreeing
            rounds = min(most_rounds, rounds_needed((most / count) ** 3))
    if best is None:
        return None
    for _ in range(3):
        inlier = similarity_errors(best, first, second) < max_error_px
        refined = _fit(first.points[inlier], second.points[inlier]) if inlier.sum() >= 3 else None
        if refined is None or (similarity_errors(refined, first, second) < max_error_px).sum() < inlier.sum():
            break
        best = refined
    return best, similarity_errors(best, first, second) < max_error_px


def scale_of(similarity: Array) -> float:
    return float(np.cbrt(np.linalg.det(similarity[:3, :3])))


def refine_similarity(similarity: Array, sides: list[tuple[Side, Side]]) -> Array:
    """`second_from_first` fitted to the images of all pairs of sides, both ways, with Cauchy's loss.

    The closed form above takes one map's points to be exact, which lowers the scale; asking both maps' images alike
    favours neither.
    """
    scale = scale_of(similarity)
    start = np.concatenate(
        [Rotation.from_matrix(similarity[:3, :3] / scale).as_rotvec(), similarity[:3, 3], [np.log(scale)]]
    )

    def residuals(x: Array) -> Array:
        moved = np.eye(4)
        moved[:3, :3], moved[:3, 3] = np.exp(x[6]) * Rotation.from_rotvec(x[:3]).as_matrix(), x[3:6]
        back = np.linalg.inv(moved)
        found = []
        for first, second in sides:
            for transform, source, camera in ((moved, first, second), (back, second, first)):
                local = in_camera(camera.pose, moved_points(transform, source.points))
                found.append(reprojections(local, camera.seen, camera.gain).ravel())
        return np.concatenate(found).clip(-1e3, 1e3)

    found = least_squares(residuals, start, loss="cauchy", f_scale=1.0, max_nfev=40).x
    refined = np.eye(4)
    refined[:3, :3], refined[:3, 3] = np.exp(found[6]) * Rotation.from_rotvec(found[:3]).as_matrix(), found[3:6]
    return refined


def _fit(source: Array, target: Array) -> Array | None:
    try:
        found = align_umeyama(np.asarray(source, np.float64), np.asarray(target, np.float64), with_scale=True)
    except ReconstructionError:
        return None
    return found if np.isfinite(found).all() and 1 / MAX_SCALE < scale_of(found) < MAX_SCALE else None


def sure_similarity(
    first: Side,
    second: Side,
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
    found = robust_similarity(first, second, rng, most_rounds)
    return found if found is not None and is_sure(found[1], pixels, width, min_share) else None


def is_sure(inlier: NDArray[np.bool_], pixels: tuple[Array, Array], width: int, min_share: float) -> bool:
    """Whether enough matches (N,) agree, spread over both images. pixels: (N,2) in either, `width` px wide."""
    if inlier.sum() < MIN_INLIERS or inlier.mean() < min_share:
        return False
    return min(_narrow_spread(p[inlier]) for p in pixels) >= MIN_SPREAD * width


def _narrow_spread(pixels: Array) -> float:
    return float(np.sqrt(max(np.linalg.eigvalsh(np.cov(pixels.T))[0], 0)))


def _is_alike(source: Array, target: Array) -> bool:
    """Whether two triangles are similar enough to be worth a fit: three ratios of sides that agree within a half."""
    sides = [np.linalg.norm(p - p[[1, 2, 0]], axis=1) for p in (source, target)]
    ratio = sides[1] / np.maximum(sides[0], 1e-12)
    return bool(ratio.min() > 0 and ratio.max() < 1.5 * ratio.min())


def moved_pose(transform: Array, camera_from_world: Array) -> Array:
    """A pose of the world that `transform`, a similarity, moves elsewhere, in that world and its unit."""
    scale, result = scale_of(transform), np.eye(4)
    result[:3, :3] = camera_from_world[:3, :3] @ (transform[:3, :3] / scale).T
    result[:3, 3] = scale * camera_from_world[:3, 3] - result[:3, :3] @ transform[:3, 3]
    return result


def moved_points(transform: Array, points: Array) -> Array:
    return points @ transform[:3, :3].T + transform[:3, 3]
