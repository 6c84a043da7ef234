"""A map of keyframes whose poses are given: neighbours' features matched by their descriptors, and the points that the
poses triangulate.

These are enough to lift features to. Matched by them where the others' keyframes expect them, features become several
times as many points with longer tracks: here where the poses are still to be adjusted, else by the stage of points.
"""

from collections.abc import Sequence

import numpy as np

from haustra.core.progress import ProgressCallback
from haustra.core.ray_table import RayTable
from haustra.core.se3 import Array
from pipeline.frontend.known_poses.epipolar_lines import MatchedPair, inliers, unit_rays
from pipeline.mapping.feature_triangulation import empty_map, match_again, triangulate_features
from pipeline.mapping.local_map import LocalMap
from pipeline.mapping.map_adjustment import fit_points
from pipeline.matching.descriptor_matching import match_descriptors
from pipeline.matching.feature_tracks import FeatureTracks, join_features
from pipeline.matching.sift import FindFeatures, rootsift

NEIGHBOURS = 4  # keyframes ahead with which each is matched by descriptors


def build_map(
    frames: Sequence[int],
    world_from_camera: Array,
    rays: RayTable,
    find: FindFeatures,
    rough: bool,
    advance: ProgressCallback,
) -> LocalMap:
    """Keyframes at world_from_camera (N,4,4) and their points. rough: the poses are to be adjusted, so that all
    features are matched, and points stay that the poses do not fit."""
    seed = empty_map(list(frames), world_from_camera, rays)
    seed.insert_features(*_neighbour_tracks(frames, world_from_camera, rays, find, advance))
    triangulate_features(seed)
    if rough:
        return match_again(seed, find, advance, rough)
    fit_points(seed)
    return seed


def _neighbour_tracks(
    frames: Sequence[int], world_from_camera: Array, rays: RayTable, find: FindFeatures, advance: ProgressCallback
) -> tuple[FeatureTracks, list[Array]]:
    """Of matches by descriptors that lie on their epipolar lines."""
    found = [find(frame) for frame in frames]
    looks = [rootsift(features.descriptors) for features in found]
    unit = [unit_rays(rays, features.pixels) for features in found]
    pairs, matches = [], []
    for one in range(len(frames)):
        advance(one + 1, len(frames), "matching neighbours")
        for other in range(one + 1, min(one + NEIGHBOURS + 1, len(frames))):
            rows = match_descriptors(looks[one], looks[other])
            way = np.linalg.norm(found[one].pixels[rows[:, 0]] - found[other].pixels[rows[:, 1]], axis=1)
            pair = MatchedPair((one, other), unit[one][rows[:, 0]], unit[other][rows[:, 1]], way)
            pairs.append((one, other))
            matches.append(rows[inliers(pair, world_from_camera, rays.focal_px)[0]])
    nowhere = [np.zeros((len(features.pixels), 3)) for features in found]
    return join_features(nowhere, pairs, matches), [features.pixels for features in found]
