"""A map of keyframes whose poses are given: features matched between them, and the points that the poses triangulate.

Twice: neighbours by their descriptors alone, which gives enough points to lift features to; then, by these, each
feature where the others' keyframes expect it (`feature_matching`), which finds several times as many and longer tracks.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from haustra.core.progress import ProgressCallback
from haustra.core.ray_table import RayTable
from haustra.core.se3 import Array, inverse
from pipeline.frontend.known_poses.epipolar_check import MatchedPair, inliers, unit_rays
from pipeline.mapping.local_map import LocalMap, TrackKind
from pipeline.mapping.map_adjustment import fit_points
from pipeline.matching.descriptor_matching import match_descriptors
from pipeline.matching.feature_matching import match_features
from pipeline.matching.feature_tracks import FeatureTracks, join_features
from pipeline.matching.sift import FindFeatures, rootsift

NEIGHBOURS = 4  # keyframes ahead with which each is matched by descriptors
MIN_ANGLE = np.radians(0.6)  # of a point's rays: poses that are given err less than tracked ones
NO_IDS, NO_PIXELS = np.zeros(0, np.int64), np.zeros((0, 2))


def choose_frames(world_from_camera: Array, depth: float, focal_px: float, motion_px: float) -> NDArray[np.int64]:
    """Rows of the keyframes: the first, and each whose view at the median depth has moved by `motion_px`.

    depth: of the wall, in the unit of world_from_camera (N,4,4).
    """
    chosen = [0]
    for row in range(1, len(world_from_camera)):
        last, now = world_from_camera[chosen[-1]], world_from_camera[row]
        turned = np.arccos(np.clip((np.trace(last[:3, :3].T @ now[:3, :3]) - 1) / 2, -1, 1))
        moved = np.linalg.norm(now[:3, 3] - last[:3, 3]) / depth
        if focal_px * (turned + moved) >= motion_px:
            chosen.append(row)
    return np.array(chosen)


def build_map(
    frames: Sequence[int],
    world_from_camera: Array,
    rays: RayTable,
    find: FindFeatures,
    rough: bool,
    advance: ProgressCallback,
) -> LocalMap:
    """Keyframes at world_from_camera (N,4,4) and their points. rough: the poses are to be adjusted, so that points stay
    that they do not fit."""
    seed = _with_keyframes(frames, world_from_camera, rays)
    _insert(seed, *_neighbour_tracks(frames, world_from_camera, rays, find, advance))
    _triangulate(seed)
    views = [seed.sparse_view(keyframe) for keyframe in seed.keyframes]
    matched = match_features(views, seed.incidence(), rays, find, advance)
    cameras_from_world = [keyframe.camera_from_world for keyframe in seed.keyframes]
    world = [f.world_points(c) for f, c in zip(matched.features, cameras_from_world, strict=True)]
    result = _with_keyframes(frames, world_from_camera, rays)
    _insert(result, matched.tracks(world, False, np.inf), [features.pixels for features in matched.features])
    if not rough:
        _triangulate(result)
        fit_points(result)
    return result


def _with_keyframes(frames: Sequence[int], world_from_camera: Array, rays: RayTable) -> LocalMap:
    empty = LocalMap(rays)
    for frame, matrix in zip(frames, world_from_camera, strict=True):
        empty.add_keyframe(int(frame), inverse(matrix), NO_IDS, NO_PIXELS)
    return empty


def _insert(local_map: LocalMap, tracks: FeatureTracks, pixels: list[Array]) -> None:
    """Tracks of the keyframes' features; pixels: of all features of each."""
    ids = local_map.insert_tracks(tracks.points, TrackKind.FEATURE)
    starts = np.searchsorted(tracks.place, np.arange(len(local_map.keyframes) + 1))
    for number in range(len(local_map.keyframes)):
        mine = slice(starts[number], starts[number + 1])
        local_map.extend(number, ids[tracks.track[mine]], pixels[number][tracks.feature[mine]])


def _triangulate(local_map: LocalMap) -> None:
    """All points anew, from the poses alone."""
    local_map.tracks.has_point[:] = False
    local_map.triangulate_new(window=len(local_map.keyframes), min_angle=MIN_ANGLE)


def _neighbour_tracks(
    frames: Sequence[int], world_from_camera: Array, rays: RayTable, find: FindFeatures, advance: ProgressCallback
) -> tuple[FeatureTracks, list[Array]]:
    """Of matches by descriptors that lie on their epipolar lines."""
    found = [find(frame) for frame in frames]
    looks = [rootsift(features.descriptors) for features in found]
    unit = [unit_rays(rays, features.pixels) for features in found]
    pairs, same = [], []
    for one in range(len(frames)):
        advance(one + 1, len(frames), "matching neighbours")
        for other in range(one + 1, min(one + NEIGHBOURS + 1, len(frames))):
            rows = match_descriptors(looks[one], looks[other])
            way = np.linalg.norm(found[one].pixels[rows[:, 0]] - found[other].pixels[rows[:, 1]], axis=1)
            pair = MatchedPair((one, other), unit[one][rows[:, 0]], unit[other][rows[:, 1]], way)
            pairs.append((one, other))
            same.append(rows[inliers(pair, world_from_camera, rays.focal_px)[0]])
    nowhere = [np.zeros((len(features.pixels), 3)) for features in found]
    return join_features(nowhere, pairs, same), [features.pixels for features in found]
