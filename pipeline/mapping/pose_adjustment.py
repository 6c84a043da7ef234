"""Poses of a finished submap, adjusted to all the features that are matched by them.

The front end adjusts a map to what its keyframes share. Between frames that lie closer, three to five times as many
features are matched once the poses stand, and these hold the poses better: where a camera moves by some millimetres,
the directions in which it moved and looked are uncertain by degrees, and the far wall leans with them.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from haustra.core.progress import ProgressCallback
from haustra.core.ray_table import RayTable
from haustra.core.se3 import Array, compose, inverse
from haustra.core.sim3 import transform_camera, transform_points
from pipeline.mapping.final_adjustment import constrained_keyframes, forget_unconstrained
from pipeline.mapping.local_map import LocalMap
from pipeline.mapping.map_adjustment import adjust_all, fit_points
from pipeline.mapping.submap import Submap
from pipeline.mapping.submap_of_map import map_of_submap
from reconstruction.evaluation.trajectory_metrics import align_poses

MIN_TYPICAL_FEATURES = 100  # of the median keyframe; fewer hold it no better than the front end did
MIN_SEEN = 3  # adjusted frames that hold a corner; other corners are carried along
SIGHTINGS = 200_000  # projected at once


def adjust_poses(submap: Submap, matched: LocalMap, advance: ProgressCallback) -> Submap:
    """The submap with its frames' poses and its KLT corners as the features that are matched have them; features' own
    points stay. The submap itself where these do not hold the poses.

    matched: keyframes at poses of the submap, and features that have points; it is adjusted, and moved back by the
    Sim(3) between its poses before and after, so that the submap's axes and unit stay. Frames between its keyframes are
    carried along.
    """
    among = matched.tracks.has_point.copy()
    constrained = constrained_keyframes(matched, among, MIN_TYPICAL_FEATURES, True)
    if constrained is None:
        return submap
    forget_unconstrained(matched, among, constrained)
    rows = np.searchsorted(submap.frames, [keyframe.frame for keyframe in matched.keyframes])
    adjust_all(matched, advance=advance)
    held = np.flatnonzero(constrained)
    _move_back(matched, submap.world_from_camera[rows[held]], held)
    adjusted = np.stack([matched.keyframes[number].camera_from_world for number in held])
    cameras_from_world = _carried(submap, rows[held], adjusted)
    for keyframe, row in zip(matched.keyframes, rows, strict=True):
        keyframe.camera_from_world = cameras_from_world[row]
    world_from_camera = np.stack([inverse(camera_from_world) for camera_from_world in cameras_from_world])
    return _with_corners(submap, world_from_camera.astype(np.float64), rows[held], matched.rays)


def _move_back(matched: LocalMap, before: NDArray[np.float64], held: NDArray[np.int64]) -> None:
    """To where the keyframes of numbers `held` (K,) fit best to where they were, `before` (K,4,4): nothing holds an
    adjusted map's place and unit."""
    now = np.stack([inverse(matched.keyframes[number].camera_from_world) for number in held])
    sim3 = align_poses(now.astype(np.float64), before)
    for keyframe in matched.keyframes:
        keyframe.camera_from_world = transform_camera(sim3, keyframe.camera_from_world)
    matched.tracks.points = transform_points(sim3, matched.tracks.points)


def _carried(submap: Submap, rows: NDArray[np.int64], cameras_from_world: Array) -> Array:
    """camera_from_world (N,4,4) of all frames, of which those at `rows` (K,) have these (K,4,4): between two of them
    the change of the pose, in the camera's axes, is interpolated; before the first and after the last it stays."""
    before = np.stack([inverse(pose) for pose in submap.world_from_camera])
    change = cameras_from_world @ np.stack([inverse(c) for c in before[rows]])
    at = submap.frames.clip(submap.frames[rows[0]], submap.frames[rows[-1]])
    shift = np.stack([np.interp(at, submap.frames[rows], change[:, axis, 3]) for axis in range(3)], axis=1)
    turn = Slerp(submap.frames[rows], Rotation.from_matrix(change[:, :3, :3]))(at)
    return np.stack([compose(r, t) for r, t in zip(turn.as_matrix(), shift, strict=True)]) @ before


def _with_corners(
    submap: Submap, world_from_camera: NDArray[np.float64], rows: NDArray[np.int64], rays: RayTable
) -> Submap:
    """The submap at these poses (N,4,4). Its KLT corners are fitted to the frames at `rows` (K,); those that fewer than
    `MIN_SEEN` of these see are carried along with the first frame that does."""
    corner = submap.is_klt[submap.observations[:, 1]]
    points = submap.points.copy()
    frame, point = submap.observations[corner].T
    first, place = np.unique(point, return_index=True)
    points[first] = _moved_along(points[first], submap.world_from_camera[frame[place]], world_from_camera[frame[place]])
    moved = replace(submap, points=points, world_from_camera=world_from_camera)
    seen = np.bincount(point[np.isin(frame, rows)], minlength=len(points)) >= MIN_SEEN
    if seen.any():
        corners = map_of_submap(moved.without_points(~seen), rays, rows)
        tracks = np.flatnonzero(corners.tracks.has_point)
        fit_points(corners)
        points[seen] = corners.tracks.points[tracks]
    error_px = np.where(submap.is_klt, mean_reprojection(moved, rays), submap.error_px)
    return replace(moved, error_px=error_px)


def _moved_along(points: Array, before: Array, after: Array) -> Array:
    """Points (N,3), each where it was for a camera that was at `before` (N,4,4) and is at `after`."""
    local = np.einsum("nij,ni->nj", before[:, :3, :3], points - before[:, :3, 3])
    return np.asarray(np.einsum("nij,nj->ni", after[:, :3, :3], local) + after[:, :3, 3])


def mean_reprojection(submap: Submap, rays: RayTable) -> Array:
    """(P,) px, of each point over all that see it; infinite where one of these cannot."""
    total = np.zeros(len(submap.points))
    for first in range(0, len(submap.observations), SIGHTINGS):
        frame, point = submap.observations[first : first + SIGHTINGS].T
        pose = submap.world_from_camera[frame]
        local = np.einsum("mi,mij->mj", submap.points[point] - pose[:, :3, 3], pose[:, :3, :3])
        off = np.linalg.norm(rays.project(local) - submap.pixels[first : first + SIGHTINGS], axis=1)
        total += np.bincount(point, np.nan_to_num(off, nan=np.inf), minlength=len(total))
    return total / np.maximum(submap.track_lengths(), 1)
