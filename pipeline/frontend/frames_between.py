"""Poses of the frames between those that were mapped: points of the map are tracked into them from the nearest mapped
frame, and pose them.

A mapper that takes many times as long for a frame as tracking does maps every n-th frame of a long stretch. The others
have their pose from the same map. They see nothing of it, as frames between given poses: points and depth come of the
mapped frames, whose poses were adjusted together.
"""

import time
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from haustra.core.camera import Camera
from haustra.core.progress import ProgressCallback, no_progress
from haustra.core.ray_table import ray_table
from haustra.core.se3 import Array, in_camera, interpolated, inverse
from pipeline.frontend.odometry.klt import TrackerImage, track_klt, tracker_image
from pipeline.frontend.odometry.tracking import INLIER_PX, MIN_INLIER_SHARE, MIN_INLIERS
from pipeline.input.frames import Frames
from pipeline.mapping.map_adjustment import LOSS_PX
from pipeline.mapping.submap import Submap, refined_camera
from pipeline.matching.sift_cache import ReadFrame
from pipeline.optimization.resection import refine_pose, reprojection_errors

MOST_APART_S = 1.0  # stretches that are mapped at once may lie far apart
KEPT_VIEWS = 4  # mapped frames before and after, and the one that is posed


def every_nth(frames: Frames, every: int) -> Frames:
    """Every n-th of the frames, and the last one, also before a gap between stretches."""
    ends = np.flatnonzero(np.diff(frames.seconds) > MOST_APART_S)
    rows = np.unique([*range(0, len(frames.index), every), *ends, len(frames.index) - 1])
    return frames.at(rows)


def with_frames_between(
    submap: Submap,
    frames: Frames,
    every: int,
    read: ReadFrame,
    deadline: float | None = None,
    advance: ProgressCallback = no_progress,
) -> Submap:
    """The submap of every n-th of `frames`, with those of the others that see enough of its points, at most `every`
    frames and a second away from one that it has. Points and mapped poses stay. deadline: by `time.monotonic()`, after
    which no more are posed."""
    missing = _near(frames, np.searchsorted(frames.index, submap.frames), every)
    resection = _Resection(submap, frames.camera, read)
    numbers: list[NDArray[np.int64]] = [submap.frames]
    poses = [submap.world_from_camera]
    for number, row in enumerate(missing):
        if deadline is not None and time.monotonic() >= deadline:
            break
        advance(number, len(missing))
        camera_from_world = resection.pose(int(frames.index[row]))
        if camera_from_world is not None:
            numbers.append(frames.index[[row]])
            poses.append(np.asarray(inverse(camera_from_world)[None], np.float64))
    advance(len(missing), len(missing))
    order = np.argsort(np.concatenate(numbers))
    observations = submap.observations.copy()
    observations[:, 0] = np.argsort(order)[observations[:, 0]]
    return replace(
        submap,
        frames=np.concatenate(numbers)[order],
        world_from_camera=np.concatenate(poses)[order],
        observations=observations,
    )


def _near(frames: Frames, mapped: NDArray[np.int64], every: int) -> NDArray[np.int64]:
    """Rows (K,) of the frames near those in the rows `mapped` (N,), which ascend, but these."""
    rows = np.setdiff1d(np.arange(len(frames.index)), mapped)
    if not len(mapped):
        return rows[:0]
    after = np.searchsorted(mapped, rows)
    sides = mapped[np.stack([after - 1, after]).clip(0, len(mapped) - 1)]
    is_near = np.abs(sides - rows) <= every
    is_near &= np.abs(frames.seconds[sides] - frames.seconds[rows]) <= MOST_APART_S
    return rows[is_near.any(axis=0)]


class _Resection:
    """Frames posed by the points of a submap."""

    def __init__(self, submap: Submap, camera: Camera, read: ReadFrame) -> None:
        self.submap, self.rays = submap, ray_table(refined_camera(camera, submap))
        self.order, self.begins = submap.by_frame()
        self.view = lru_cache(KEPT_VIEWS)(lambda frame: self._view(read, frame))

    def _view(self, read: ReadFrame, frame: int) -> TrackerImage:
        rgb, mask = read(frame)
        return tracker_image(rgb, self.rays.masked(mask))

    def pose(self, frame: int) -> Array | None:
        """`camera_from_world` by the points of the nearest mapped frame, or of the one on its other side; None where
        too few of either are found. A pose between those of the two is where they are sought."""
        mapped = self.submap.frames
        after = int(np.searchsorted(mapped, frame))
        sides = [row for row in (after - 1, after) if 0 <= row < len(mapped)]
        guess = self.submap.world_from_camera[sides[0]]
        if len(sides) == 2:
            poses = self.submap.world_from_camera[sides]
            guess = interpolated(mapped[sides].astype(np.float64), poses, np.array([float(frame)]))[0]
        for row in sorted(sides, key=lambda row: abs(int(mapped[row]) - frame)):
            found = self._by_points_of(row, frame, inverse(guess))
            if found is not None:
                return found
        return None

    def _by_points_of(self, row: int, frame: int, camera_from_world: Array) -> Array | None:
        seen = self.order[self.begins[row] : self.begins[row + 1]]
        rows, places = self.submap.observations[seen, 1], self.submap.pixels[seen].astype(np.float32)
        expected = self.rays.project(in_camera(camera_from_world, self.submap.points[rows])).astype(np.float32)
        inside = np.isfinite(expected).all(axis=1)
        rows, places, expected = rows[inside], places[inside], expected[inside]
        if len(rows) < MIN_INLIERS:
            return None
        pixels, tracked = track_klt(self.view(int(self.submap.frames[row])), self.view(frame), places, expected)
        rows, pixels = rows[tracked], pixels[tracked]
        if len(rows) < MIN_INLIERS:
            return None
        points = self.submap.points[rows]
        xy, jacobian = self.rays.unproject(pixels)
        for loss_px in (2 * LOSS_PX, LOSS_PX):
            camera_from_world = refine_pose(camera_from_world, points, xy, jacobian, loss_px)
        errors = reprojection_errors(camera_from_world, points, xy, jacobian)
        inlier = errors < INLIER_PX
        if inlier.sum() < MIN_INLIERS or inlier.mean() < MIN_INLIER_SHARE:
            return None
        return camera_from_world
