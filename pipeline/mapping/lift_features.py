"""SIFT features of a map's keyframes, lifted to points by the depth of the map's own points around them."""

from haustra.core.se3 import in_camera
from pipeline.mapping.local_map import LocalMap
from pipeline.matching.keyframe_features import MIN_FEATURES, KeyframeFeatures, lift_features
from pipeline.matching.sift import FindFeatures

MOST_KEYFRAMES = 60  # of a map, evenly spaced, that are compared with other maps'


def features_of_map(local_map: LocalMap, find: FindFeatures) -> list[KeyframeFeatures]:
    """Of evenly spaced keyframes, those with enough features to be compared."""
    step = -(-len(local_map.keyframes) // MOST_KEYFRAMES)
    found = [features_of_keyframe(local_map, k, find) for k in range(0, len(local_map.keyframes), max(1, step))]
    return [features for features in found if len(features) >= MIN_FEATURES]


def features_of_keyframe(
    local_map: LocalMap, number: int, find: FindFeatures, extrapolate: bool = False
) -> KeyframeFeatures:
    """Of keyframe `number`; none where it sees too few points. extrapolate: see `lift_features`."""
    keyframe = local_map.keyframes[number]
    points, pixels = local_map.visible_points(keyframe)
    if len(points) < MIN_FEATURES:
        return KeyframeFeatures.none(number)
    depth = in_camera(keyframe.camera_from_world, points)[:, 2]
    front = depth > 0
    enough = extrapolate and int(front.sum()) >= MIN_FEATURES
    return lift_features(number, find(keyframe.frame), local_map.rays, pixels[front], depth[front], enough)
