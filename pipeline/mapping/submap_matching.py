"""Links: pairs of places of two maps that one similarity explains, and when they are evidence enough for a join.

A pair that looks alike is fitted for itself; such fits must agree with one another. What they agree on is then asked of
the places around them as it stands, and it must hold from different views. Every link, fitted or asked, must also lay
the two maps' surfaces on each other: what was matched may be one thing that occurs twice, the wall around it is not.
"""

from dataclasses import dataclass
from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray

from haustra.core.se3 import Array, in_camera, inverse
from pipeline.mapping.local_map import LocalMap
from pipeline.matching.keyframe_features import STILL_PX, Place, inverse_depth_at, look_alikes, match
from pipeline.matching.sim3_ransac import (
    MAX_ERROR_PX,
    Side,
    Stack,
    is_sure,
    moved_points,
    refine_similarity,
    similarity_errors,
    sure_similarity,
)

PER_PLACE = 3  # look-alikes tried
MIN_BASELINE = 0.1  # of the median depth, between two pairs on both sides: neighbours see one and the same picture
SAME_SHARE = 0.7  # of one pair's inliers that another pair's similarity must explain
MAX_SAME_PX = 8.0
AROUND = 4  # places on each side of a linked one that are asked for support
# Of the matches. Places that are not the same agree in 12 of them at most, a fifth: the number of inliers, 20, is the
# stricter limit there, the share where there are hundreds of matches (docs/lab/front_end.md).
MIN_INLIER_SHARE = 0.2
ROUNDS = 1000  # so few that agree are met in 99.9 of 100 tries
# Of the features of one map that fall on the other's surface: as far as it, in log depth. Of true links 0.67 and more
# are, of tubes laid into each other at random under 0.4 in the median (docs/lab/front_end.md).
SAME_SURFACE, MAX_DEPTH_RATIO = 0.5, 0.2
ASKED = 5  # links, the strongest, around which they are asked


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


@dataclass(frozen=True)
class Shown:
    """A map and its places."""

    map: LocalMap
    places: list[Place]


def find_links(first: Shown, second: Shown, rng: np.random.Generator, seed: int) -> list[Link]:
    """Every look-alike pair of places that fits, each with a similarity of its own."""
    if not first.places or not second.places:
        return []
    pairs = look_alikes(first.places, second.places, PER_PLACE, seed)
    links = (_fitted(first, first.places[i], second, second.places[j], rng) for i, j in pairs)
    return [link for link in links if link is not None]


def sure_links(links: list[Link], first: Shown, second: Shown) -> list[Link]:
    """What bears out the similarity on which most links agree: the pairs of places around them that it explains.

    Empty unless two links agree, and unless two of the pairs come from different views on both sides: neighbours see
    one and the same picture. Pairs that do not bear it out are not counted against it, since they may see other wall.
    """
    agreeing = _agreeing(links)
    if len(agreeing) < 2:
        return []
    asked = _asked(agreeing, first, second)
    found = _support(joint_similarity(agreeing), asked, first, second)
    found = _support(joint_similarity(found), asked, first, second) if found else []
    maps = first.map, second.map
    return found if any(_are_apart(one, other, maps) for one, other in combinations(found, 2)) else []


@dataclass(frozen=True)
class _Pair:
    """Two places with their matched features, (K,2) rows, and what either map knows of these."""

    places: tuple[Place, Place]
    pairs: NDArray[np.int64]
    sides: tuple[Side, Side]

    @property
    def pixels(self) -> tuple[Array, Array]:
        return self.places[0].pixels[self.pairs[:, 0]], self.places[1].pixels[self.pairs[:, 1]]

    def link(self, similarity: Array, inlier: NDArray[np.bool_]) -> Link:
        rows = self.pairs[inlier, 0], self.pairs[inlier, 1]
        return Link(self.places, similarity, self.sides[0].at(inlier), self.sides[1].at(inlier), rows)


def _fitted(first: Shown, place: Place, second: Shown, other: Place, rng: np.random.Generator) -> Link | None:
    pair = _matched(first, place, second, other)
    width = first.map.rays.camera.width
    found = sure_similarity(*pair.sides, pair.pixels, width, rng, MIN_INLIER_SHARE, ROUNDS)
    if found is None or not _lays_surfaces_together(found[0], first, place, second, other):
        return None
    return pair.link(*found)


def _matched(first: Shown, place: Place, second: Shown, other: Place) -> _Pair:
    """Features that look alike; not those at the same pixel in both, as dirt and text are wherever the camera is."""
    pairs = match(place.rooted, other.rooted)
    way = np.linalg.norm(place.pixels[pairs[:, 0]] - other.pixels[pairs[:, 1]], axis=1)
    pairs = pairs[way > STILL_PX]
    sides = _side(first.map, place, pairs[:, 0]), _side(second.map, other, pairs[:, 1])
    return _Pair((place, other), pairs, sides)


def _side(local_map: LocalMap, place: Place, rows: NDArray[np.int64]) -> Side:
    seen, gain = local_map.rays.look_up(place.pixels[rows])
    return Side(place.points[rows], local_map.keyframes[place.keyframe].pose, seen, gain)


def strongest(links: list[Link]) -> list[Link]:
    """Of links the strongest, each place in one of them at most: what ties the maps, without saying all of it twice."""
    kept: list[Link] = []
    for link in sorted(links, key=lambda link: -len(link.rows[0])):
        if not any(link.keyframe(side) == other.keyframe(side) for other in kept for side in (0, 1)):
            kept.append(link)
    return kept


def _agreeing(links: list[Link]) -> list[Link]:
    """The largest set of links that the similarity of one of them explains."""
    if not links:
        return []
    explained = _explained(links)
    return [links[k] for k in np.flatnonzero(explained[explained.sum(axis=1).argmax()])]


def _explained(links: list[Link]) -> NDArray[np.bool_]:
    """(L,L) whether the similarity of the one (row) explains the other (column)."""
    first, second = Stack.of([link.first for link in links]), Stack.of([link.second for link in links])
    counts = np.diff([*first.starts, len(first.points)])
    rows = []
    for link in links:
        ahead = second.errors(link.second_from_first, first.points)
        back = first.errors(np.linalg.inv(link.second_from_first), second.points)
        explained = np.maximum(ahead, back) < MAX_SAME_PX
        rows.append(np.add.reduceat(explained.astype(np.int64), first.starts) >= SAME_SHARE * counts)
    return np.stack(rows)


def joint_similarity(links: list[Link]) -> Array:
    """One similarity from the points of all links: one pair of views alone leaves the scale to its noise."""
    best = links[int(_explained(links).sum(axis=1).argmax())]
    return refine_similarity(best.second_from_first, [(link.first, link.second) for link in links])


def _asked(links: list[Link], first: Shown, second: Shown) -> list[_Pair]:
    """Linked pairs of places, and pairs around the strongest."""
    rows = [{place.keyframe: row for row, place in enumerate(shown.places)} for shown in (first, second)]
    asked = set()
    for number, link in enumerate(sorted(links, key=lambda link: -len(link.rows[0]))):
        i, j = (of[link.keyframe(side)] for side, of in enumerate(rows))
        reach = AROUND if number < ASKED else 0
        asked |= set(product(_around(i, reach, len(first.places)), _around(j, reach, len(second.places))))
    return [_matched(first, first.places[a], second, second.places[b]) for a, b in sorted(asked)]


def _support(similarity: Array, asked: list[_Pair], first: Shown, second: Shown) -> list[Link]:
    """The pairs whose matches and surfaces `similarity` explains as it stands."""
    width, found = first.map.rays.camera.width, []
    for pair in asked:
        inlier = similarity_errors(similarity, *pair.sides) < MAX_ERROR_PX
        sure = is_sure(inlier, pair.pixels, width, MIN_INLIER_SHARE)
        if sure and _lays_surfaces_together(similarity, first, pair.places[0], second, pair.places[1]):
            found.append(pair.link(similarity, inlier))
    return found


def _around(row: int, reach: int, count: int) -> range:
    return range(max(0, row - reach), min(row + reach + 1, count))


def _lays_surfaces_together(second_from_first: Array, first: Shown, place: Place, second: Shown, other: Place) -> bool:
    """Whether most features of each place that fall on the other's surface lie on it."""
    there = _share_on(moved_points(second_from_first, place.points), second.map, other)
    back = _share_on(moved_points(np.linalg.inv(second_from_first), other.points), first.map, place)
    return min(there, back) >= SAME_SURFACE


def _share_on(points: Array, local_map: LocalMap, place: Place) -> float:
    """Share of points (N,3), of those in the hull of a place's features, that are as far as the features around."""
    pose = local_map.keyframes[place.keyframe].pose
    local = in_camera(pose, points)
    local = local[local[:, 2] > 0]
    depth = in_camera(pose, place.points)[:, 2]
    surface = inverse_depth_at(local_map.rays.project(local), place.triangles, depth)
    inside = np.isfinite(surface) & (surface > 0)
    off = np.abs(np.log(local[inside, 2] * surface[inside]))
    return float((off < MAX_DEPTH_RATIO).mean()) if len(off) else 0.0


def _are_apart(one: Link, other: Link, maps: tuple[LocalMap, LocalMap]) -> bool:
    """Whether two links have a baseline between them, in the first map and in the second."""
    for side, local_map in enumerate(maps):
        here, there = (local_map.keyframes[link.keyframe(side)] for link in (one, other))
        baseline = float(np.linalg.norm(inverse(here.pose)[:3, 3] - inverse(there.pose)[:3, 3]))
        if baseline < MIN_BASELINE * local_map.median_depth(here):
            return False
    return True
