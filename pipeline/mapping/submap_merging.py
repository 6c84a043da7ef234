"""Merging of submaps that saw the same place; strict, since a false merge is far worse than a missed one.

Two submaps are merged on pairs of keyframes that look alike, each with many matched features that are inliers of one
similarity in both pictures. Two or more pairs must agree on one and the same similarity, and pairs from different views
on both sides must support it; a single pair is enough where many around it support it.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from haustra.core.progress import Progress
from haustra.core.se3 import in_camera
from haustra.core.sim3 import scale_of, transform_camera, transform_points
from pipeline.mapping.final_adjustment import adjust_maps_to_features
from pipeline.mapping.local_map import LocalMap, TrackKind
from pipeline.mapping.map_adjustment import adjust_all
from pipeline.mapping.submap_matching import (
    AROUND,
    MapFeatures,
    best_matches,
    consistent_matches,
    features_of_map,
    find_matches,
    joint_similarity,
)
from pipeline.matching.descriptor_matching import match_descriptors
from pipeline.matching.keyframe_features import KeyframeFeatures
from pipeline.matching.place_recognition import VisualWords
from pipeline.matching.sift import FindFeatures
from pipeline.matching.sim3_match import Sim3Match
from pipeline.optimization.resection import reprojection_errors

Features = list[KeyframeFeatures]
MAX_NEIGHBOUR_PX = 12.0  # of a matched point from where it should be in a neighbouring keyframe


@dataclass(frozen=True)
class Merged:
    """A map and the numbers of those that it was made of; one that was made of several waits for an adjustment."""

    map: LocalMap
    members: tuple[int, ...]


def merge_and_adjust(
    maps: list[LocalMap], widths: list[float | None], find: FindFeatures, seed: int, progress: Progress
) -> tuple[list[LocalMap], int]:
    """Maps that saw the same places made one, and how many joins there were. widths: of each map, of the features that
    it was adjusted to, as `adjust_maps` gives them.

    Each map must have been adjusted: where its scale bends, it is another at its end than elsewhere. A merged map is
    adjusted to the features of the whole. Where these are too few, though the parts had enough, the parts are given
    back as they were.
    """
    if len(maps) < 2:
        return maps, 0
    apart = [local_map.copied() for local_map in maps]
    with progress.bar("merging submaps", None):
        merged = merge_maps(maps, find, seed)
    result: list[LocalMap] = []
    for whole in merged:
        if len(whole.members) == 1:
            result.append(whole.map)
            continue
        (width,) = adjust_maps_to_features([whole.map], find, progress, allow_disconnected=False)
        before = [one for one in (widths[number] for number in whole.members) if one is not None]
        if len(before) < len(whole.members):  # one of them never was
            if width is None:
                adjust_all(whole.map, changed=True)
        elif width is None or width > max(before):
            progress.log(f"{len(before)} submaps stay separate: they match, but too few features agree after merging")
            result += [apart[number] for number in whole.members]
            continue
        result.append(whole.map)
    return result, len(maps) - len(result)


def merge_maps(maps: list[LocalMap], find: FindFeatures, seed: int) -> list[Merged]:
    """The maps with those merged that surely belong together; what was merged has forgotten its features.

    A grown map may touch one that it did not before; only the keyframes that it gained are then compared.
    """
    if len(maps) < 2:
        return [Merged(local_map, (number,)) for number, local_map in enumerate(maps)]
    rng = np.random.default_rng(seed)
    left = [(number, MapFeatures(m, features_of_map(m, find))) for number, m in enumerate(maps)]
    words = VisualWords.of([features for _, shown in left for features in shown.features], seed)
    merged = []
    while left:
        first, base = left.pop(0)
        members, number = [first], 0
        compared = [0] * len(left)  # keyframes of the base that were compared with each of the others,
        found: list[list[Sim3Match]] = [[] for _ in left]  # and what they gave
        while number < len(left):
            name, other = left[number]
            found[number] += find_matches((base, other), rng, words, compared[number])
            compared[number] = len(base.features)
            matches = consistent_matches(found[number], (base, other))
            if not matches:
                number += 1
                continue
            base = merge_into(base, other, matches)
            members.append(name)
            del left[number], compared[number], found[number]
            number = 0
        merged.append(Merged(base.map, tuple(members)))
    return merged


def merge_into(base: MapFeatures, other: MapFeatures, matches: list[Sim3Match]) -> MapFeatures:
    """Bring the second map into the first one's world and join the two by the matched points.

    Both forget the SIFT features that they were adjusted to: those are matched again in the merged map.
    """
    base_from_other = np.linalg.inv(joint_similarity(matches, (base, other)))
    scale, whole, added = float(scale_of(base_from_other)), base.map, other.map
    whole.forget_features()
    added.forget_features()
    first_keyframe, first_track = len(whole.keyframes), len(whole.tracks)
    whole.tracks.place(
        first_track, replace(added.tracks, points=transform_points(base_from_other, added.tracks.points))
    )
    for keyframe in added.keyframes:
        keyframe.camera_from_world, keyframe.ids = (
            transform_camera(base_from_other, keyframe.camera_from_world),
            keyframe.ids + first_track,
        )
        whole.keyframes.append(keyframe)
    for tracked in added.tracked_frames:
        ids = (tracked.ids + first_track).astype(np.int32)
        whole.tracked_frames.append(replace(tracked.scaled(scale), keyframe=tracked.keyframe + first_keyframe, ids=ids))
    moved = [replace(f, keyframe=f.keyframe + first_keyframe, points=scale * f.points) for f in other.features]
    grown = MapFeatures(whole, base.features + moved)
    for match in best_matches(matches):
        _join(grown, match, (base.features, moved))
    return grown


def _join(
    grown: MapFeatures, match: Sim3Match, features: tuple[list[KeyframeFeatures], list[KeyframeFeatures]]
) -> None:
    """Matched points as tracks for the next adjustment: seen by both keyframes, and by neighbours of each in its own
    map, since a point with one ray from either side says nothing of the scale between them."""
    whole, numbers = grown.map, (match.first, match.second)
    here, there = (whole.keyframes[of[k].keyframe].camera_from_world for of, k in zip(features, numbers, strict=True))
    world = features[0][match.first].world_points(here)[match.rows[:, 0]]
    front = in_camera(there, world)[:, 2] > 0
    begun = whole.tracks_in_use()
    ids: NDArray[np.int64] = np.arange(begun, begun + int(front.sum()))
    tracks = whole.tracks
    tracks.reserve(begun + len(ids))
    tracks.points[ids], tracks.has_point[ids], tracks.rejected[ids] = world[front], True, False
    tracks.kind[ids] = TrackKind.MERGE
    for of, number, column in zip(features, numbers, match.rows[front].T, strict=True):
        whole.extend(of[number].keyframe, ids, of[number].pixels[column])
        for k in range(max(0, number - AROUND), min(len(of), number + AROUND + 1)):
            if k != number:
                _see_again(whole, ids, of[number].rootsift[column], of[k])


def _see_again(
    whole: LocalMap, ids: NDArray[np.int64], descriptors: NDArray[np.float32], other: KeyframeFeatures
) -> None:
    """Observations of tracks in another keyframe, where its features look alike and lie where the points project to."""
    rows = match_descriptors(descriptors, other.rootsift)
    if len(rows) == 0:
        return
    xy, jacobian = whole.rays.unproject(other.pixels[rows[:, 1]])
    camera_from_world, points = whole.keyframes[other.keyframe].camera_from_world, whole.tracks.points[ids[rows[:, 0]]]
    near = reprojection_errors(camera_from_world, points, xy, jacobian) < MAX_NEIGHBOUR_PX
    whole.extend(other.keyframe, ids[rows[near, 0]], other.pixels[rows[near, 1]])
