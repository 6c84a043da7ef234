"""Whether parts of a submap give the path that the whole gives: each is adjusted again without the rest.

A right map of a still wall hardly moves. Where the wall moved, the lens is wrong or the map is false, each part had to
bend to the others, and goes its own way without them. What all of the wall does together no part can tell.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from haustra.core.camera import Camera
from haustra.core.sim3 import scale_of
from haustra.core.threads import single_threaded, workers
from pipeline.mapping.submap import Submap
from pipeline.optimization.bundle_adjustment import Bundle, adjust
from reconstruction.evaluation.trajectory_metrics import align_poses

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

STRETCHES = ((0.0, 2 / 3), (1 / 3, 1.0))  # of the frames, a third in common
MOST_FRAMES, MOST_POINTS = 80, 1500  # of a part: evenly spaced, and those seen most often
LEAST_FRAMES, LEAST_POINTS, LEAST_SEEN = 8, 30, 6  # LEAST_SEEN: points that move a frame; with fewer it stays
MIN_TRACK_LENGTH = 3
LOSS_PX, ITERATIONS, TOLERANCE, DAMPING = 1.0, 20, 1e-5, 1e-7


@dataclass(frozen=True)
class PathDifference:
    """Of two paths after the Sim(3) that fits centres and axes together: RMS distance of centres as a share of the
    length of one of them, and the median angle between cameras."""

    share: float
    angle_deg: float


def path_difference(poses: Array, others: Array) -> PathDifference:
    """Difference of two paths, world_from_camera (N,4,4) each; it is a share of the length of `others`.

    The axes have a say (`align_poses`), since the centres of a short and nearly straight path leave the rotation about
    it open: by them alone a map that is right to 1 % of its path can be turned by 20 degrees.
    """
    fit = align_poses(poses, others)
    aligned = fit @ poses
    off = np.linalg.norm(aligned[:, :3, 3] - others[:, :3, 3], axis=1)
    turn = np.swapaxes(others[:, :3, :3], 1, 2) @ (aligned[:, :3, :3] / scale_of(fit))
    length = float(np.linalg.norm(np.diff(others[:, :3, 3], axis=0), axis=1).sum())
    angle = np.degrees(np.median(Rotation.from_matrix(turn).magnitude()))
    return PathDifference(float(np.sqrt((off**2).mean())) / max(length, 1e-12), float(angle))


def by_stretches(submap: Submap, camera: Camera) -> PathDifference | None:
    """The larger difference from the whole map's path of two stretches of it; None where both are too short."""
    usable, every = _usable_rows(submap), np.ones(len(submap.points), dtype=bool)
    count = len(usable)
    stretches = [usable[_spread_rows(round(begin * count), round(end * count))] for begin, end in STRETCHES]
    paths = _all_readjusted(submap, camera, [(rows, every) for rows in stretches])
    found = [(path, rows) for path, rows in zip(paths, stretches, strict=True) if path is not None]
    return _larger([path_difference(path, submap.world_from_camera[rows]) for path, rows in found])


def by_halves_of_the_wall(submap: Submap, camera: Camera) -> PathDifference | None:
    """The larger difference of the paths by two halves of the wall, parted across each of its two main axes; None where
    no half has enough points."""
    usable = _usable_rows(submap)
    rows = usable[_spread_rows(0, len(usable))]
    halves = [points for half in _halves(submap) for points in (half, ~half)]
    paths = _all_readjusted(submap, camera, [(rows, points) for points in halves])
    found = list(zip(paths[::2], paths[1::2], strict=True))
    return _larger([path_difference(one, other) for one, other in found if one is not None and other is not None])


def _larger(found: list[PathDifference]) -> PathDifference | None:
    return PathDifference(max(f.share for f in found), max(f.angle_deg for f in found)) if found else None


def _usable_rows(submap: Submap) -> NDArray[np.int64]:
    """Of the frames that see anything; frames between given or mapped ones do not."""
    return np.unique(submap.observations[:, 0])


def _spread_rows(begin: int, end: int) -> NDArray[np.int64]:
    """At most so many of `end - begin` rows; none of none."""
    if end <= begin:
        return np.zeros(0, np.int64)
    return np.unique(np.linspace(begin, max(end - 1, begin), MOST_FRAMES).round().astype(np.int64))


def _halves(submap: Submap) -> list[Mask]:
    """Points (P,) on one side across each main axis, as often seen as those on the other."""
    if len(submap.points) < 2 * LEAST_POINTS:
        return []
    centred = submap.points - np.median(submap.points, axis=0)
    distance = np.linalg.norm(centred, axis=1)
    axes = np.linalg.svd(centred[distance < 4 * np.median(distance)], full_matrices=False)[2][:2]
    along = centred @ axes.T
    return [of > np.median(of[submap.observations[:, 1]]) for of in along.T]


def _all_readjusted(submap: Submap, camera: Camera, parts: list[tuple[NDArray[np.int64], Mask]]) -> list[Array | None]:
    """The path of each part, its rows and points: side by side, since the kernels let go of the interpreter."""
    with single_threaded(), ThreadPoolExecutor(workers()) as threads:
        return list(threads.map(lambda part: _readjusted(submap, camera, *part), parts))


def _readjusted(submap: Submap, camera: Camera, rows: NDArray[np.int64], among: Mask) -> Array | None:
    """Poses (K,4,4) of these rows adjusted to these points alone, (P,); None with too little to go by."""
    if len(rows) < LEAST_FRAMES:
        return None
    number = np.full(len(submap.frames), -1)
    number[rows] = np.arange(len(rows))
    row, point = submap.observations.T
    mine = (number[row] >= 0) & among[point]
    seen = np.bincount(point[mine], minlength=len(submap.points))
    points = np.argsort(-seen, kind="stable")[:MOST_POINTS]
    points = points[seen[points] >= MIN_TRACK_LENGTH]
    mine &= np.isin(point, points)
    held = np.bincount(number[row[mine]], minlength=len(rows)) >= LEAST_SEEN
    if len(points) < LEAST_POINTS or held.mean() < 0.5:
        return None
    return _adjusted(submap, camera, rows, points, np.flatnonzero(mine), ~held)


def _adjusted(
    submap: Submap,
    camera: Camera,
    rows: NDArray[np.int64],
    points: NDArray[np.int64],
    mine: NDArray[np.int64],
    fixed: Mask,
) -> Array:
    """Poses (K,4,4) of `rows` by the observations `mine` of `points`; one at least stays where it is."""
    place = np.zeros(len(submap.points), dtype=np.int64)
    place[points] = np.arange(len(points))
    row, point = submap.observations[mine].T
    plane, valid = camera.unproject(submap.pixels[mine])
    order = np.argsort(row, kind="stable")
    order = order[valid[order]]
    poses = submap.world_from_camera[rows].copy()
    rotation = np.swapaxes(poses[:, :3, :3], 1, 2)
    translation = -np.einsum("nij,nj->ni", rotation, poses[:, :3, 3])
    fixed[0] |= not fixed.any()
    done = adjust(
        Bundle(
            rotation,
            translation,
            submap.points[points],
            np.searchsorted(rows, row[order]),
            place[point[order]],
            plane[order],
            camera.pixel_jacobian(plane[order]),
            fixed,
        ),
        ITERATIONS,
        LOSS_PX,
        TOLERANCE,
        DAMPING,
    )
    poses[:, :3, :3] = np.swapaxes(done.rotation, 1, 2)
    poses[:, :3, 3] = -np.einsum("nji,nj->ni", done.rotation, done.translation)
    return poses
