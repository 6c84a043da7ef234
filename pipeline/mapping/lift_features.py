"""SIFT features of a map's keyframes lifted to points of its world, by the depth of the map's points around them."""

import numpy as np
from scipy.spatial import cKDTree

from haustra.core.se3 import in_camera, inverse
from pipeline.mapping.local_map import LocalMap
from pipeline.matching.keyframe_features import MIN_POINTS, FindFeatures, Place, inverse_depth_at, triangulated

MAX_PLACES = 60  # of a map


def find_places(local_map: LocalMap, find: FindFeatures) -> list[Place]:
    """Evenly spaced places of a map."""
    step = -(-len(local_map.keyframes) // MAX_PLACES)
    places = []
    for number in range(0, len(local_map.keyframes), max(1, step)):
        places.append(place_of(local_map, number, find))
    return [place for place in places if len(place.points) >= MIN_POINTS]


def place_of(local_map: LocalMap, number: int, find: FindFeatures, beyond: bool = False) -> Place:
    """SIFT features within the hull of the keyframe's map points, where the lens has rays.

    `beyond` the hull, too, as deep as the nearest of those points: a guess, for who looks whether it is borne out.
    """
    keyframe = local_map.keyframes[number]
    found = find(keyframe.frame)
    x, y = np.floor(found.pixels).astype(int).T
    found = found.at(local_map.rays.usable[y, x] > 0)
    known = local_map.known[keyframe.ids]
    nowhere = Place(number, np.zeros((0, 2)), found.descriptors[:0], np.zeros((0, 3)), np.zeros(0), np.zeros(0, bool))
    if known.sum() < MIN_POINTS or len(found.pixels) == 0:
        return nowhere
    depth = in_camera(keyframe.pose, local_map.points[keyframe.ids[known]])[:, 2]
    front = depth > 0
    depth, pixels = depth[front], keyframe.pixels[known][front]
    inverse_depth = inverse_depth_at(found.pixels, triangulated(pixels), depth)
    outside = ~np.isfinite(inverse_depth)
    if beyond and len(depth) >= MIN_POINTS:
        inverse_depth[outside] = 1 / depth[cKDTree(pixels).query(found.pixels[outside])[1]]
    good = np.isfinite(inverse_depth)
    seen, _ = local_map.rays.look_up(found.pixels[good])
    local = np.concatenate([seen, np.ones((len(seen), 1))], axis=1) / inverse_depth[good, None]
    points = in_camera(inverse(keyframe.pose), local)
    return Place(number, found.pixels[good], found.descriptors[good], points, found.sizes[good], outside[good])
