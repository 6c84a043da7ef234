"""Submaps that saw the same place become one, on strong evidence only: a false merge is far worse than a missed one.

Strong means: two or more pairs of places that look alike, each with many matched points that one similarity explains in
both images, one and the same similarity for all of them, and borne out by pairs from different views on both sides.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from haustra.core.se3 import in_camera
from haustra.core.sim3 import scale_of, transform_camera, transform_points
from pipeline.mapping.lift_features import find_places
from pipeline.mapping.local_map import LocalMap
from pipeline.mapping.submap_matching import AROUND, Link, Shown, find_links, joint_similarity, strongest, sure_links
from pipeline.matching.keyframe_features import FindFeatures, Place, match
from pipeline.optimization.resection import reprojection_errors

MAX_TIE_PX = 12.0  # of a matched point from where it should be in a neighbouring place


@dataclass(frozen=True)
class Merged:
    """A map and the numbers of those that it was made of; one that was made of several waits for an adjustment."""

    map: LocalMap
    members: tuple[int, ...]


def merge_maps(maps: list[LocalMap], find: FindFeatures, seed: int) -> list[Merged]:
    """The maps with those joined that surely belong together; what is joined has forgotten its features.

    A grown map may touch one that it did not before; only the places that it gained are then compared.
    """
    if len(maps) < 2:
        return [Merged(local_map, (number,)) for number, local_map in enumerate(maps)]
    rng = np.random.default_rng(seed)
    left = [(number, Shown(m, find_places(m, find))) for number, m in enumerate(maps)]
    merged = []
    while left:
        first, base = left.pop(0)
        members, number = [first], 0
        tried = [0] * len(left)  # places of the base that were compared with each of the others,
        found: list[list[Link]] = [[] for _ in left]  # and what they gave
        while number < len(left):
            name, other = left[number]
            found[number] += find_links(Shown(base.map, base.places[tried[number] :]), other, rng, seed)
            tried[number] = len(base.places)
            links = sure_links(found[number], base, other)
            if not links:
                number += 1
                continue
            base = Shown(base.map, base.places + absorb(base, other, links))
            members.append(name)
            del left[number], tried[number], found[number]
            number = 0
        merged.append(Merged(base.map, tuple(members)))
    return merged


def absorb(shown: Shown, others: Shown, links: list[Link]) -> list[Place]:
    """Bring the second map into the first one's frame and tie the two by the matched points; returns its places in that
    frame. Both forget their features: those are found again in the joined map, across the seam too."""
    base, other = shown.map, others.map
    base_from_other = np.linalg.inv(joint_similarity(links))
    base.forget_features()
    other.forget_features()
    scale = scale_of(base_from_other)
    first_keyframe, first_track = len(base.keyframes), len(base.known)
    base.reserve(first_track + len(other.known))
    fresh = slice(first_track, first_track + len(other.known))
    base.points[fresh] = transform_points(base_from_other, other.points)
    base.known[fresh], base.barred[fresh], base.followed[fresh] = other.known, other.barred, other.followed
    for keyframe in other.keyframes:
        keyframe.pose, keyframe.ids = transform_camera(base_from_other, keyframe.pose), keyframe.ids + first_track
        base.keyframes.append(keyframe)
    for posed in other.posed:
        ids = (posed.ids + first_track).astype(np.int32)
        base.posed.append(replace(posed.scaled(float(scale)), keyframe=posed.keyframe + first_keyframe, ids=ids))
    for link in strongest(links):
        _tie(base, link, (shown.places, others.places), (0, first_keyframe))
    return [
        replace(p, keyframe=p.keyframe + first_keyframe, points=transform_points(base_from_other, p.points))
        for p in others.places
    ]


def _tie(base: LocalMap, link: Link, places: tuple[list[Place], list[Place]], offsets: tuple[int, int]) -> None:
    """Matched points as tracks for the last adjustment: seen by both keyframes, and by neighbours of each in its own
    map, since a point with one ray from either side says nothing of the scale between them."""
    world = link.first.points
    front = in_camera(base.keyframes[link.keyframe(1) + offsets[1]].pose, world)[:, 2] > 0
    begun = base.tracks_in_use()
    ids: NDArray[np.int64] = np.arange(begun, begun + int(front.sum()))
    base.reserve(begun + len(ids))
    base.points[ids], base.known[ids], base.barred[ids], base.followed[ids] = world[front], True, False, False
    for side, offset in enumerate(offsets):
        place, rows = link.places[side], link.rows[side][front]
        base.extend(place.keyframe + offset, ids, place.pixels[rows])
        number = next(k for k, other in enumerate(places[side]) if other.keyframe == place.keyframe)
        for k, other in enumerate(places[side]):
            if 0 < abs(k - number) <= AROUND:
                _see_again(base, ids, place.rooted[rows], other, other.keyframe + offset)


def _see_again(
    base: LocalMap, ids: NDArray[np.int64], descriptors: NDArray[np.float32], place: Place, number: int
) -> None:
    """Observations of tracks in another keyframe, where its features look alike and lie where the points project to."""
    pairs = match(descriptors, place.rooted)
    if len(pairs) == 0:
        return
    seen, gain = base.rays.look_up(place.pixels[pairs[:, 1]])
    near = reprojection_errors(base.keyframes[number].pose, base.points[ids[pairs[:, 0]]], seen, gain) < MAX_TIE_PX
    base.extend(number, ids[pairs[near, 0]], place.pixels[pairs[near, 1]])
