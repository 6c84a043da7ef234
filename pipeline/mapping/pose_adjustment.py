"""Poses of a finished submap, adjusted to all the features that are matched by them (docs/lab/pose_adjustment.md).

The front end adjusts a map to what its keyframes share. Between frames that lie closer, more features are matched once
the poses stand, and hold the poses better: where a camera moves by some millimetres, the directions in which it moved
and looked are uncertain, and the far wall leans with them.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from haustra.core.ray_table import RayTable
from haustra.core.se3 import Array, angle_between, compose, in_camera, inverse
from haustra.core.sim3 import scale_of, transform_camera, transform_points
from pipeline.mapping.final_adjustment import MIN_TYPICAL_FEATURES, constrained_keyframes
from pipeline.mapping.local_map import Keyframe, LocalMap
from pipeline.mapping.map_adjustment import MAX_ERROR_PX, adjust_all, fit_points
from pipeline.mapping.submap import Submap, sighting_errors
from pipeline.mapping.submap_of_map import map_of_submap
from reconstruction.evaluation.trajectory_metrics import align_poses

ADJUSTMENTS = 2  # each to the features that the poses before it triangulate
MOST_FRAMES = 1_000  # of one adjustment, which holds all their sightings; a submap with more keeps its poses
MIN_SHARED = 50  # features that hold two parts of a map together; fewer leave the scale between them free by percents
MIN_FRAMES_OF_CORNER = 3  # adjusted frames to which a corner is fitted; other corners are carried along


@dataclass(frozen=True)
class AdjustedPoses:
    """The submap, and by how much its adjusted frames turned in the median, degrees; 0 where the poses stayed."""

    submap: Submap
    turned_deg: float


def adjust_poses(submap: Submap, matched: LocalMap, triangulate: Callable[[LocalMap], None]) -> AdjustedPoses:
    """The submap with its frames' poses and its KLT corners as the features that are matched have them. Features' own
    points stay in the submap; `matched` gets them by the poses that come of it, from all that was matched: what
    contradicted the old poses may fit, and what was kept by them is partial to them.

    The poses stay where the features do not hold them, or are no more than those that the front end fitted them to.
    matched: keyframes at poses of the submap, and what they see of features. triangulate: finds the points of a map's
    features by its poses, and drops what contradicts them.
    """
    seen, found = matched.keyframes, submap
    fitted = len(submap.observations) - int(submap.is_klt[submap.observations[:, 1]].sum())

    def see_all_at(poses: Submap) -> None:
        matched.keyframes = _at_poses_of(poses, seen)
        matched.tracks.rejected[:] = False
        triangulate(matched)

    see_all_at(submap)
    usable = matched.incidence().nnz > fitted and len(seen) <= MOST_FRAMES
    for _ in range(ADJUSTMENTS * usable):
        adjusted = _adjusted_once(found, matched)
        found = adjusted or found
        see_all_at(found)  # one that is refused has moved and dropped some as well
        if adjusted is None:
            break
    pairs = zip(found.world_from_camera, submap.world_from_camera, strict=True)
    return AdjustedPoses(found, float(np.degrees(np.median([angle_between(new, old) for new, old in pairs]))))


def _at_poses_of(submap: Submap, seen: list[Keyframe]) -> list[Keyframe]:
    rows = np.searchsorted(submap.frames, [keyframe.frame for keyframe in seen])
    poses = [inverse(submap.world_from_camera[row]) for row in rows]
    return [replace(keyframe, camera_from_world=pose) for keyframe, pose in zip(seen, poses, strict=True)]


def _adjusted_once(submap: Submap, matched: LocalMap) -> Submap | None:
    """The submap with adjusted poses and corners; None where the features do not hold all parts of it together, before
    it or after what does not fit has been dropped."""
    among = matched.tracks.has_point.copy()
    constrained = constrained_keyframes(matched, among, MIN_TYPICAL_FEATURES, False, MIN_SHARED)
    if constrained is None:
        return None
    before = [keyframe.camera_from_world for keyframe in matched.keyframes], matched.tracks.points.copy()
    adjust_all(matched)
    constrained = constrained_keyframes(matched, among, MIN_TYPICAL_FEATURES / 2, False, MIN_SHARED / 2)
    if constrained is None:
        return None
    held = np.flatnonzero(constrained)
    _move_back(matched, *before, held)
    rows = np.searchsorted(submap.frames, [matched.keyframes[number].frame for number in held])
    poses = _carried(submap, rows, np.stack([matched.keyframes[number].camera_from_world for number in held]))
    return _with_corners(submap, poses, rows, matched.rays)


def _move_back(matched: LocalMap, cameras_from_world: list[Array], points: Array, held: NDArray[np.int64]) -> None:
    """To where the keyframes of numbers `held` fit best to their poses before, and as large as the points (T,3) were
    before: nothing holds an adjusted map's place and unit, and a path that was wrong does not say how large it is."""
    now, before = (
        np.stack([inverse(poses[number]) for number in held]).astype(np.float64)
        for poses in ([keyframe.camera_from_world for keyframe in matched.keyframes], cameras_from_world)
    )
    sim3 = align_poses(now, before)
    grown = []
    for number in held:
        keyframe = matched.keyframes[number]
        ids = keyframe.ids[matched.tracks.has_point[keyframe.ids]]
        depth = in_camera(keyframe.camera_from_world, matched.tracks.points[ids])[:, 2]
        depth_before = in_camera(cameras_from_world[number], points[ids])[:, 2]
        both = (depth > 0) & (depth_before > 0)
        grown.append(np.log(depth[both] / depth_before[both]))
    sim3[:3, :3] *= np.exp(-np.median(np.concatenate(grown))) / scale_of(sim3)
    sim3[:3, 3] = before[:, :3, 3].mean(axis=0) - sim3[:3, :3] @ now[:, :3, 3].mean(axis=0)
    for keyframe in matched.keyframes:
        keyframe.camera_from_world = transform_camera(sim3, keyframe.camera_from_world)
    matched.tracks.points = transform_points(sim3, matched.tracks.points)


def _carried(submap: Submap, rows: NDArray[np.int64], cameras_from_world: Array) -> NDArray[np.float64]:
    """world_from_camera (N,4,4) of all frames, where those at `rows` (K,) have camera_from_world (K,4,4): between two
    of them the change of the pose, in the camera's axes, is interpolated; before the first and after the last it
    stays."""
    before = np.stack([inverse(pose) for pose in submap.world_from_camera])
    change = cameras_from_world @ np.stack([inverse(c) for c in before[rows]])
    at = submap.frames.clip(submap.frames[rows[0]], submap.frames[rows[-1]])
    shift = np.stack([np.interp(at, submap.frames[rows], change[:, axis, 3]) for axis in range(3)], axis=1)
    turn = Slerp(submap.frames[rows], Rotation.from_matrix(change[:, :3, :3]))(at)
    moved = np.stack([compose(r, t) for r, t in zip(turn.as_matrix(), shift, strict=True)]) @ before
    return np.stack([inverse(camera_from_world) for camera_from_world in moved]).astype(np.float64)


def _with_corners(
    submap: Submap, world_from_camera: NDArray[np.float64], rows: NDArray[np.int64], rays: RayTable
) -> Submap:
    """The submap at these poses (N,4,4). Its KLT corners are fitted to the frames at `rows` (K,); those that too few of
    these see are carried along with the first frame that sees them. What then does not fit is dropped."""
    corner = submap.is_klt[submap.observations[:, 1]]
    frame, point = submap.observations[corner].T
    first, place = np.unique(point, return_index=True)
    points = submap.points.copy()
    points[first] = _moved_along(points[first], submap.world_from_camera[frame[place]], world_from_camera[frame[place]])
    moved = replace(submap, points=points, world_from_camera=world_from_camera)
    seen = np.bincount(point[np.isin(frame, rows)], minlength=len(points)) >= MIN_FRAMES_OF_CORNER
    if seen.any():
        corners = map_of_submap(moved.without_points(~seen), rays, rows)
        tracks = np.flatnonzero(corners.tracks.has_point)
        fit_points(corners)
        fitted = points.copy()
        fitted[seen] = corners.tracks.points[tracks]
        moved = replace(moved, points=fitted)
    error_px = sighting_errors(moved, rays)
    fits = (error_px <= MAX_ERROR_PX) | ~corner
    left = np.bincount(moved.observations[fits, 1], minlength=len(points))
    summed = np.bincount(moved.observations[fits, 1], error_px[fits], len(points))
    mean_px = np.where(moved.is_klt, summed / np.maximum(left, 1), moved.error_px)
    fitting = replace(moved, observations=moved.observations[fits], pixels=moved.pixels[fits], error_px=mean_px)
    return fitting.without_points(moved.is_klt & (left < 2))


def _moved_along(points: Array, before: Array, after: Array) -> Array:
    """Points (N,3), each where it was for a camera that was at `before` (N,4,4) and is at `after`."""
    local = np.einsum("nij,ni->nj", before[:, :3, :3], points - before[:, :3, 3])
    return np.asarray(np.einsum("nij,nj->ni", after[:, :3, :3], local) + after[:, :3, 3])
