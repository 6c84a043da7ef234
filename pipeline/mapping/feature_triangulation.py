"""Points of SIFT features that the poses alone triangulate, and poses that fit all of these features.

A bundle adjustment of many features forgives some that are matched wrongly or seen from too near together: they cost
its poses nothing, and stay as points that are off by tens of percent. Depth that is completed from them follows them.
Once the poses stand, each feature is matched anew where poses and points expect it, and becomes a point only if its
rays meet, at an angle.
"""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from haustra.core.camera import Camera
from haustra.core.frame_spacing import LEAST_FRAMES, closer_where_few
from haustra.core.progress import ProgressCallback
from haustra.core.ray_table import RayTable, ray_table
from haustra.core.se3 import Array, inverse
from haustra.core.threads import prefetched
from pipeline.mapping.local_map import FEATURES, DepthAt, Keyframe, LocalMap
from pipeline.mapping.map_adjustment import fit_points
from pipeline.mapping.metric_map import make_metric
from pipeline.mapping.pose_adjustment import AdjustedPoses, adjust_poses
from pipeline.mapping.submap import Submap, refined_camera
from pipeline.mapping.submap_of_map import MIN_SEEN, map_of_submap, to_submap
from pipeline.matching.feature_matching import match_features
from pipeline.matching.patch_alignment import groups
from pipeline.matching.sift import FindFeatures
from pipeline.optimization.triangulation import meeting_points

MIN_ANGLE = np.radians(0.6)  # of a point's rays: poses that stand err less than those that are being tracked
OUTLIER = 2.0  # times the median error; chosen on withdrawal_b, low_texture_b and insertion_b (docs/lab/points.md)
MIN_ERROR_PX = 0.4  # that is always forgiven: pictures without noise have errors of a few hundredths
MOSTLY_SEEN = 0.9  # share of the frames that see points where a front end leaves points in all of them
CHUNK = 2_000  # points triangulated in one go: some twenty megabytes
AT_ONCE = 2  # chunks, each by a thread of its own
ROUNDS = 4  # of dropping what a track's other observations contradict
NO_IDS, NO_PIXELS = np.zeros(0, np.int64), np.zeros((0, 2))


def triangulate_again(
    submap: Submap,
    camera: Camera,
    motion_px: float,
    find: FindFeatures,
    advance: ProgressCallback,
    depth_at: DepthAt | None = None,
    least: int = LEAST_FRAMES,
    adjust: bool = False,
) -> AdjustedPoses | None:
    """The submap with the points of its features found anew. None where the poses triangulate too few.

    adjust: the poses to these features first, and KLT corners with them (`adjust_poses`); else both stay, as they do
    where a sensor's depth has adjusted them.

    camera: of the working frames. motion_px: at the median depth, between the frames whose features are matched; less
    where these are fewer than `least`. depth_at: what a sensor measured, by which the points were adjusted too.
    """
    adjust = adjust and depth_at is None
    rays = ray_table(refined_camera(camera, submap))
    rows, with_features = _rows(submap, rays.focal_px, motion_px, least)
    if len(rows) == 0:  # no frame sees enough points to lift its features by
        return None
    seed = [map_of_submap(submap, rays, np.union1d(rows, with_features))]
    scale = None if depth_at is None else make_metric(seed[0], depth_at)
    triangulate_features(seed[0])
    fit_points(seed[0])
    chosen = set(submap.frames[rows].tolist())
    seed[0].keyframes = [keyframe for keyframe in seed[0].keyframes if keyframe.frame in chosen]
    # Taken out of the list, the seed is gone before the matches are triangulated: a long film's is large.
    matched = match_again(seed.pop(), find, advance, rough=adjust)
    adjusted = adjust_poses(submap, matched, _points_by_poses) if adjust else AdjustedPoses(submap, 0.0)
    found = to_submap(matched, submap.camera_params, refit=False)
    if found is None:
        return None
    return replace(adjusted, submap=_with_features_of(adjusted.submap, found.scaled(1 / (scale or 1.0))))


def _points_by_poses(matched: LocalMap) -> None:
    triangulate_features(matched)
    fit_points(matched)


def frames_of_features(submap: Submap, camera: Camera, motion_px: float, least: int = LEAST_FRAMES) -> list[int]:
    """Numbers of the frames whose features `triangulate_again` will match, with the same arguments."""
    rows, _ = _rows(submap, refined_camera(camera, submap).focal_px, motion_px, least)
    return [int(frame) for frame in submap.frames[rows]]


def _rows(submap: Submap, focal_px: float, motion_px: float, least: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows of the frames whose features are matched, and of all that see features.

    Where only some frames see points, as of given poses, these are keyframes already, and all of them are taken.
    """
    feature = ~submap.is_klt[submap.observations[:, 1]]
    seen = np.bincount(submap.observations[:, 0], minlength=len(submap.frames))
    rows = np.flatnonzero(seen >= MIN_SEEN)
    if len(rows) >= MOSTLY_SEEN * len(seen):
        depth = float(np.median(submap.depths()))
        rows = rows[choose_frames(submap.world_from_camera[rows], depth, focal_px, motion_px, least)]
    return rows, np.unique(submap.observations[feature, 0])


def choose_frames(
    world_from_camera: Array, depth: float, focal_px: float, motion_px: float, least: int = LEAST_FRAMES
) -> NDArray[np.int64]:
    """Rows of the keyframes: the first, and each whose view at the median depth has moved by `motion_px`; by less where
    that gives fewer than `least`.

    depth: of the wall, in the unit of world_from_camera (N,4,4).
    """
    apart = partial(_moved_apart, world_from_camera, focal_px / depth, focal_px)
    return closer_where_few(apart, motion_px, len(world_from_camera), least)


def _moved_apart(
    world_from_camera: Array, px_per_unit: float, px_per_radian: float, motion_px: float
) -> NDArray[np.int64]:
    """Rows of frames of which each is `motion_px` from the one before: its shift and its turn, in pixels, summed."""
    chosen = [0]
    for row in range(1, len(world_from_camera)):
        last, now = world_from_camera[chosen[-1]], world_from_camera[row]
        turned = np.arccos(np.clip((np.trace(last[:3, :3].T @ now[:3, :3]) - 1) / 2, -1, 1))
        moved = np.linalg.norm(now[:3, 3] - last[:3, 3])
        if px_per_radian * turned + px_per_unit * moved >= motion_px:
            chosen.append(row)
    return np.array(chosen)


def empty_map(frames: list[int], world_from_camera: Array, rays: RayTable) -> LocalMap:
    """Keyframes at world_from_camera (N,4,4) that see nothing yet."""
    local_map = LocalMap(rays)
    for frame, matrix in zip(frames, world_from_camera, strict=True):
        local_map.add_keyframe(int(frame), inverse(matrix), NO_IDS, NO_PIXELS)
    return local_map


def match_again(seed: LocalMap, find: FindFeatures, advance: ProgressCallback, rough: bool = False) -> LocalMap:
    """A map of the seed's keyframes and their features, matched where the seed's poses and points expect them.

    rough: the poses are still to be adjusted, so that points stay that they do not fit."""
    views = [seed.sparse_view(keyframe) for keyframe in seed.keyframes]
    matched = match_features(views, seed.incidence(), seed.rays, find, advance)
    cameras_from_world = [keyframe.camera_from_world for keyframe in seed.keyframes]
    world = [f.world_points(c) for f, c in zip(matched.features, cameras_from_world, strict=True)]
    result = empty_map([k.frame for k in seed.keyframes], np.stack([inverse(c) for c in cameras_from_world]), seed.rays)
    result.depth_at = seed.depth_at
    del seed, views
    result.insert_features(matched.tracks(world, False, np.inf), matched.pixels)
    if not rough:
        triangulate_features(result)
        fit_points(result)
    return result


def triangulate_features(local_map: LocalMap) -> None:
    """All points of features anew, from the poses alone; observations that the others of their track contradict are
    dropped, and then tracks whose rays do not meet, or at less than `MIN_ANGLE`."""
    tracks = local_map.tracks
    features = tracks.is_kind(*FEATURES)
    tracks.has_point[features] = False
    rays, limit = _rays_of(local_map, features), None
    rays = rays.of_several(np.ones(len(rays.track), bool))
    for number in range(ROUNDS + 1):
        if len(rays.track) == 0:
            break
        found, point = np.unique(rays.track, return_inverse=True)
        points, angle, error = _triangulated(local_map, rays, point, len(found))
        limit = largest_error(error, np.bincount(point)[point]) if limit is None else limit
        starts = np.searchsorted(point, np.arange(len(found)))
        good = (np.maximum.reduceat(error, starts) <= limit) & (angle > MIN_ANGLE)
        tracks.points[found[good]], tracks.has_point[found[good]] = points[good], True
        finite = np.where(np.isfinite(error), error, 0.0)  # a point behind a camera has no error that is one
        worst = np.maximum.reduceat(finite, starts)
        bad = error > np.maximum(limit, 0.5 * worst[point])
        if number == ROUNDS or not bad.any():
            break
        rays = rays.of_several(~bad)
    _keep(local_map, features, rays)


def largest_error(error: Array, seen: NDArray[np.int64]) -> float:
    """Reprojection error, px, above which an observation counts as a wrong match: `OUTLIER` times the median.

    error (M,) of observations, of tracks that `seen` (M,) keyframes see; two rays alone nearly always meet.
    """
    several = error[(seen >= 3) & np.isfinite(error)]
    return max(MIN_ERROR_PX, OUTLIER * float(np.median(several))) if len(several) else MIN_ERROR_PX


@dataclass(frozen=True)
class _Rays:
    """(M,) observations, sorted by `track`: number of their keyframe, and their place among what that keyframe sees. Of
    a long film there are millions, so that the rays themselves stay with the keyframes."""

    track: NDArray[np.int64]
    keyframe: NDArray[np.int32]
    place: NDArray[np.int32]

    def where(self, chosen: NDArray[np.bool_]) -> "_Rays":
        return _Rays(*(array[chosen] for array in vars(self).values()))

    def of_several(self, among: NDArray[np.bool_]) -> "_Rays":
        """Of these observations (M,) those of tracks that two of them or more are of."""
        seen = np.bincount(self.track[among], minlength=self.track.max(initial=-1) + 1)
        return self.where(among & (seen[self.track] >= 2))


def _rays_of(local_map: LocalMap, among: NDArray[np.bool_]) -> _Rays:
    keyframes = local_map.keyframes
    chosen = [np.flatnonzero(among[k.ids]).astype(np.int32) for k in keyframes]
    track = np.concatenate([k.ids[mine] for k, mine in zip(keyframes, chosen, strict=True)])
    order = np.argsort(track, kind="stable")
    number = np.repeat(np.arange(len(chosen), dtype=np.int32), [len(mine) for mine in chosen])
    return _Rays(track[order], number[order], np.concatenate(chosen)[order])


def _triangulated(local_map: LocalMap, rays: _Rays, point: NDArray[np.int64], count: int) -> tuple[Array, Array, Array]:
    """Points (count,3), their widest angle (count,), and the error of each observation (M,), px."""
    cameras_from_world = np.stack([k.camera_from_world for k in local_map.keyframes])

    def meeting(first: int) -> tuple[Array, Array, Array]:
        last = min(first + CHUNK, count)
        part = slice(*np.searchsorted(point, [first, last]))
        mine = cameras_from_world[rays.keyframe[part]]
        xy, jacobian = _seen_at(local_map.keyframes, rays.keyframe[part], rays.place[part])
        return meeting_points(mine[:, :3, :3], mine[:, :3, 3], point[part] - first, last - first, xy, jacobian)

    found = list(prefetched(meeting, range(0, count, CHUNK), 1, AT_ONCE))
    points, error, angle = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return points, angle, error


def _seen_at(keyframes: list[Keyframe], number: NDArray[np.int32], place: NDArray[np.int32]) -> tuple[Array, Array]:
    """xy (M,2) and jacobian (M,2,2) of observations, by their keyframes' numbers (M,) and places there (M,)."""
    xy, jacobian = np.empty((len(number), 2)), np.empty((len(number), 2, 2))
    order = np.argsort(number, kind="stable")
    for one, part in groups(number[order]):
        mine = order[part]
        xy[mine], jacobian[mine] = keyframes[one].xy[place[mine]], keyframes[one].jacobian[place[mine]]
    return xy, jacobian


def _keep(local_map: LocalMap, features: NDArray[np.bool_], rays: _Rays) -> None:
    """Of what keyframes see of features, these rays of tracks that have a point."""
    kept = [~features[keyframe.ids] for keyframe in local_map.keyframes]
    mine = np.flatnonzero(local_map.tracks.has_point[rays.track])
    order = mine[np.argsort(rays.keyframe[mine], kind="stable")]
    for number, part in groups(rays.keyframe[order]):
        kept[number][rays.place[order[part]]] = True
    for keyframe, mask in zip(local_map.keyframes, kept, strict=True):
        keyframe.keep(mask)


def _with_features_of(submap: Submap, found: Submap) -> Submap:
    """The submap's frames and KLT corners, and the features that were found in some of these frames."""
    corners = submap.without_points(~submap.is_klt)
    observations = found.observations + np.array([0, len(corners.points)])
    observations[:, 0] = np.searchsorted(submap.frames, found.frames)[found.observations[:, 0]]
    return replace(
        corners,
        points=np.concatenate([corners.points, found.points]),
        error_px=np.concatenate([corners.error_px, found.error_px]),
        observations=np.concatenate([corners.observations, observations]),
        pixels=np.concatenate([corners.pixels, found.pixels]),
        klt=np.concatenate([corners.is_klt, np.zeros(len(found.points), bool)]),
    )
