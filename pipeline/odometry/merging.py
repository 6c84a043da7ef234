"""Submaps that saw the same place become one, on strong evidence only: a false merge is far worse than a missed one.

Strong means: two or more pairs of places, at different views on both sides, each with many matched points that one
similarity explains in both images, and one and the same similarity for all of them.
"""

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from pipeline.odometry.local_map import LocalMap
from pipeline.odometry.outcome import polish
from pipeline.odometry.places import Place, ReadFrame, find_places, look_alikes, match
from pipeline.odometry.poses import Array, in_camera, inverse
from pipeline.odometry.resection import reprojection_errors
from pipeline.odometry.similarity import (
    Side,
    moved_points,
    refine_similarity,
    scale_of,
    similarity_errors,
    sure_similarity,
)

PER_PLACE = 3  # look-alikes tried
MIN_BASELINE = 0.1  # of the median depth, between two pairs on both sides: neighbours see one and the same picture
SAME_SHARE = 0.7  # of one pair's inliers that another pair's similarity must explain
MAX_SAME_PX = 8.0
REACH = 4  # places on each side in which a matched point is looked for
MAX_TIE_PX = 12.0  # from where it should be there


@dataclass(frozen=True)
class Link:
    """A pair of places that fit: similarity, the points matched (inliers only), and their rows in the places."""

    places: tuple[Place, Place]
    second_from_first: Array
    first: Side
    second: Side
    rows: tuple[NDArray[np.int64], NDArray[np.int64]]

    def keyframe(self, side: int) -> int:
        return self.places[side].keyframe


def polish_and_merge(maps: list[LocalMap], read: ReadFrame, seed: int) -> tuple[list[LocalMap], int]:
    """Final maps, adjusted as wholes, and how many joins there were."""
    for local_map in maps:
        polish(local_map)
    if len(maps) < 2:
        return maps, 0
    merged = merge_maps(maps, read, seed)
    for local_map, joins in merged:
        if joins:
            polish(local_map, changed=True)
    return [local_map for local_map, _ in merged], sum(joins for _, joins in merged)


def merge_maps(maps: list[LocalMap], read: ReadFrame, seed: int) -> list[tuple[LocalMap, int]]:
    """The maps with those joined that surely belong together, each with the number of joins that made it.

    A grown map may touch one that it did not before; only the places that it gained are then compared.
    """
    rng = np.random.default_rng(seed)
    left = [(m, find_places(m, read)) for m in maps]
    merged = []
    while left:
        base, places = left.pop(0)
        number, joins = 0, 0
        tried = [0] * len(left)  # places of the base that were compared with each of the others,
        found: list[list[Link]] = [[] for _ in left]  # and what they gave
        while number < len(left):
            other, others = left[number]
            found[number] += find_links(base, places[tried[number] :], other, others, rng, seed)
            tried[number] = len(places)
            links = strongest(found[number], base, other)
            if not links:
                number += 1
                continue
            places = places + absorb(base, places, other, others, links)
            joins += 1
            del left[number], tried[number], found[number]
            number = 0
        merged.append((base, joins))
    return merged


def find_links(
    first: LocalMap,
    places: list[Place],
    second: LocalMap,
    others: list[Place],
    rng: np.random.Generator,
    seed: int,
) -> list[Link]:
    """Every look-alike pair of places that fits."""
    if not places or not others:
        return []
    links = (_link(first, places[i], second, others[j], rng) for i, j in look_alikes(places, others, PER_PLACE, seed))
    return [link for link in links if link is not None]


def strongest(links: list[Link], first: LocalMap, second: LocalMap) -> list[Link]:
    """The largest set of links that agree on one similarity; empty unless two of them come from different views on
    both sides, which makes one false likeness not enough."""
    best: list[Link] = []
    for link in links:
        agreeing = [other for other in links if _explains(link.second_from_first, other)]
        if len(agreeing) > len(best):
            best = agreeing
    apart = any(_are_apart(one, other, (first, second)) for one, other in combinations(best, 2))
    return best if apart else []


def _are_apart(one: Link, other: Link, maps: tuple[LocalMap, LocalMap]) -> bool:
    """Whether two links have a baseline between them, in the first map and in the second."""
    for side, local_map in enumerate(maps):
        here, there = (local_map.keyframes[link.keyframe(side)] for link in (one, other))
        baseline = float(np.linalg.norm(inverse(here.pose)[:3, 3] - inverse(there.pose)[:3, 3]))
        if baseline < MIN_BASELINE * local_map.median_depth(here):
            return False
    return True


def _link(first: LocalMap, place: Place, second: LocalMap, other: Place, rng: np.random.Generator) -> Link | None:
    pairs = match(place.rooted, other.rooted)
    sides = []
    for local_map, shown, rows in ((first, place, pairs[:, 0]), (second, other, pairs[:, 1])):
        seen, gain = local_map.rays.look_up(shown.pixels[rows])
        sides.append(Side(shown.points[rows], local_map.keyframes[shown.keyframe].pose, seen, gain))
    pixels = place.pixels[pairs[:, 0]], other.pixels[pairs[:, 1]]
    found = sure_similarity(sides[0], sides[1], pixels, first.rays.camera.width, rng)
    if found is None:
        return None
    similarity, inlier = found
    inliers = pairs[inlier, 0], pairs[inlier, 1]
    return Link((place, other), similarity, sides[0].at(inlier), sides[1].at(inlier), inliers)


def _explains(similarity: Array, link: Link) -> bool:
    return float((similarity_errors(similarity, link.first, link.second) < MAX_SAME_PX).mean()) >= SAME_SHARE


def absorb(base: LocalMap, shown: list[Place], other: LocalMap, places: list[Place], links: list[Link]) -> list[Place]:
    """Bring `other` into `base`'s frame and tie the two by the matched points; returns its places in that frame.

    shown, places: of `base` and of `other`.
    """
    base_from_other = np.linalg.inv(_joint(links))
    scale = scale_of(base_from_other)
    first_keyframe, first_track = len(base.keyframes), len(base.known)
    base.reserve(first_track + len(other.known))
    fresh = slice(first_track, first_track + len(other.known))
    base.points[fresh] = moved_points(base_from_other, other.points)
    base.known[fresh], base.barred[fresh], base.followed[fresh] = other.known, other.barred, other.followed
    for keyframe in other.keyframes:
        keyframe.pose, keyframe.ids = _in_frame(keyframe.pose, base_from_other, scale), keyframe.ids + first_track
        base.keyframes.append(keyframe)
    for posed in other.posed:
        ids = (posed.ids + first_track).astype(np.int32)
        base.posed.append(replace(posed.scaled(scale), keyframe=posed.keyframe + first_keyframe, ids=ids))
    for link in links:
        _tie(base, link, (shown, places), (0, first_keyframe))
    return [
        replace(p, keyframe=p.keyframe + first_keyframe, points=moved_points(base_from_other, p.points)) for p in places
    ]


def _joint(links: list[Link]) -> Array:
    """One similarity from the points of all links: one pair of views alone leaves the scale to its noise."""
    best = max(links, key=lambda link: sum(_explains(link.second_from_first, other) for other in links))
    return refine_similarity(best.second_from_first, [(link.first, link.second) for link in links])


def _in_frame(pose: Array, base_from_other: Array, scale: float) -> Array:
    """A camera_from_world of the other map as one of the base's world and scale."""
    moved = np.eye(4)
    moved[:3, :3] = pose[:3, :3] @ (base_from_other[:3, :3] / scale).T
    moved[:3, 3] = scale * pose[:3, 3] - moved[:3, :3] @ base_from_other[:3, 3]
    return moved


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
            if 0 < abs(k - number) <= REACH:
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
