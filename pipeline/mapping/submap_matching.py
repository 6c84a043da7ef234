"""Matching of two submaps: verified keyframe matches that agree on one similarity and on the surface.

Keyframes that look alike are matched pair by pair, and each match gives a similarity of the two worlds. The largest
consensus set of matches gives one for all, of which pairs of keyframes around them must be inliers, from views that are
apart. Every match must also lay the two maps' surfaces on each other: what was matched may be one thing that occurs
twice, the wall around it is not.
"""

from dataclasses import dataclass
from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray

from haustra.core.se3 import Array, in_camera, inverse
from haustra.core.sim3 import transform_points
from pipeline.mapping.local_map import LocalMap
from pipeline.matching.depth_interpolation import interpolate_inverse_depth
from pipeline.matching.keyframe_features import MIN_FEATURES, KeyframeFeatures, features_of_view
from pipeline.matching.place_recognition import VisualWords, retrieve
from pipeline.matching.sift import FindFeatures
from pipeline.matching.sim3_match import (
    MIN_INLIER_SHARE,
    Sim3Match,
    candidate_rows,
    correspondences,
    rows_of_pairs,
    verify_match,
)
from pipeline.matching.sim3_ransac import (
    MAX_ERROR_PX,
    Correspondences,
    StackedCorrespondences,
    is_well_conditioned,
    refine_similarity,
    similarity_errors,
)

MOST_KEYFRAMES = 60  # of a map, evenly spaced, that are compared with other maps'
PER_KEYFRAME = 3  # look-alikes tried
MIN_BASELINE = 0.1  # of the median depth, between two matches on both sides: neighbours see one and the same picture
SAME_SHARE = 0.7  # of one match's inliers that another match's similarity must explain
MAX_SAME_PX = 8.0
AROUND = 4  # compared keyframes on each side of a matched one that may support its similarity
# Of the features of one map that fall on the other's surface: as far as it, in log depth. Of true matches 0.67 and more
# are, of tubes laid into each other at random under 0.4 in the median (docs/lab/front_end.md).
SAME_SURFACE, MAX_DEPTH_RATIO = 0.5, 0.2
# Pairs that must support a match that no other agrees with. Place recognition misses some look-alikes, so that a true
# join may have one match alone; those of films of benchmarks/coverage_films.yaml have 20 to 69 pairs.
LONE_SUPPORT = 5
EXPANDED = 5  # matches, those with most inliers, around which pairs of keyframes are tested


def features_of_map(local_map: LocalMap, find: FindFeatures) -> list[KeyframeFeatures]:
    """Features of evenly spaced keyframes, of those with enough features to be compared."""
    step = max(1, -(-len(local_map.keyframes) // MOST_KEYFRAMES))
    found = [
        features_of_view(number, local_map.sparse_view(local_map.keyframes[number]), local_map.rays, find)
        for number in range(0, len(local_map.keyframes), step)
    ]
    return [features for features in found if len(features) >= MIN_FEATURES]


@dataclass(frozen=True)
class MapFeatures:
    """A map and the features of those of its keyframes that are compared."""

    map: LocalMap
    features: list[KeyframeFeatures]

    def camera_from_world(self, number: int) -> Array:
        """camera_from_world (4,4) of the keyframe that features `number` belong to."""
        return self.map.keyframes[self.features[number].keyframe].camera_from_world

    def correspondences(self, number: int, rows: NDArray[np.int64]) -> Correspondences:
        """Features at `rows` of compared keyframe `number`, with their points in the map's world."""
        return correspondences(self.features[number], rows, self.map.rays, self.camera_from_world(number))


Maps = tuple[MapFeatures, MapFeatures]


def find_matches(maps: Maps, rng: np.random.Generator, words: VisualWords, first: int = 0) -> list[Sim3Match]:
    """Verified matches of keyframes that look alike; of the first map only those from number `first` on."""
    similar = retrieve(words.similarities(maps[0].features[first:], maps[1].features), PER_KEYFRAME)
    pairs = [(i + first, j) for i, j in similar]
    alike = rows_of_pairs(maps[0].features, maps[1].features, pairs, drop_static=True)
    found = [_verified(maps, pair, rows, rng) for pair, rows in zip(pairs, alike, strict=True)]
    return [match for match in found if match is not None]


def consistent_matches(matches: list[Sim3Match], maps: Maps) -> list[Sim3Match]:
    """Support of the similarity on which most matches agree: pairs of keyframes around these that are inliers of it.

    Empty unless two matches agree or `LONE_SUPPORT` pairs support a single one, and unless two of the pairs come from
    different views on both sides: neighbours see one and the same picture. Pairs that do not support it are not counted
    against it, since they may see other wall.
    """
    agreeing = _agreeing(matches, maps)
    if not agreeing:
        return []
    candidates = _pairs_around(agreeing, maps)
    support = _support(joint_similarity(agreeing, maps), candidates, maps)
    support = _support(joint_similarity(support, maps), candidates, maps) if support else []
    if len(agreeing) == 1 and len(support) < LONE_SUPPORT:
        return []
    return support if any(_are_apart(one, other, maps) for one, other in combinations(support, 2)) else []


def joint_similarity(matches: list[Sim3Match], maps: Maps) -> Array:
    """`second_from_first` (4,4) of the worlds from the points of all matches: one pair of views alone leaves the scale
    to its noise."""
    best = matches[int(_explained(matches, maps).sum(axis=1).argmax())]
    return refine_similarity(second_from_first(best, maps), [_sides(match, maps) for match in matches])


def second_from_first(match: Sim3Match, maps: Maps) -> Array:
    """The similarity (4,4) of the two worlds that one match measures."""
    cameras = np.linalg.inv(match.first_from_second)
    return inverse(maps[1].camera_from_world(match.second)) @ cameras @ maps[0].camera_from_world(match.first)


def best_matches(matches: list[Sim3Match]) -> list[Sim3Match]:
    """Those with most inliers, each keyframe in one of them at most, so that no constraint counts twice."""
    kept: list[Sim3Match] = []
    for match in sorted(matches, key=lambda match: -match.inliers):
        if not any(match.first == other.first or match.second == other.second for other in kept):
            kept.append(match)
    return kept


def _verified(maps: Maps, pair: tuple[int, int], rows: NDArray[np.int64], rng: np.random.Generator) -> Sim3Match | None:
    features = maps[0].features[pair[0]], maps[1].features[pair[1]]
    match = verify_match(pair, *features, (maps[0].map.rays, maps[1].map.rays), rng, rows)
    return match if match is not None and _surfaces_agree(second_from_first(match, maps), *pair, maps) else None


def _sides(match: Sim3Match, maps: Maps) -> tuple[Correspondences, Correspondences]:
    """The inliers of a match in either world."""
    return maps[0].correspondences(match.first, match.rows[:, 0]), maps[1].correspondences(
        match.second, match.rows[:, 1]
    )


def _agreeing(matches: list[Sim3Match], maps: Maps) -> list[Sim3Match]:
    """The largest consensus set: all matches that are inliers of the similarity of one of them."""
    if not matches:
        return []
    explained = _explained(matches, maps)
    return [matches[k] for k in np.flatnonzero(explained[explained.sum(axis=1).argmax()])]


def _explained(matches: list[Sim3Match], maps: Maps) -> NDArray[np.bool_]:
    """(L,L) whether match `column` is an inlier of the similarity of match `row`: most of its points are, in pixels."""
    sides = [_sides(match, maps) for match in matches]
    first, second = (StackedCorrespondences.of([pair[k] for pair in sides]) for k in (0, 1))
    counts = np.diff([*first.starts, len(first.points)])
    rows = []
    for match in matches:
        similarity = second_from_first(match, maps)
        ahead = second.errors(similarity, first.points)
        back = first.errors(np.linalg.inv(similarity), second.points)
        explained = np.maximum(ahead, back) < MAX_SAME_PX
        rows.append(np.add.reduceat(explained.astype(np.int64), first.starts) >= SAME_SHARE * counts)
    return np.stack(rows)


@dataclass(frozen=True)
class _Candidate:
    """Two keyframes, rows (K,2) of their features that look alike, and the points of these in either world."""

    first: int
    second: int
    rows: NDArray[np.int64]
    sides: tuple[Correspondences, Correspondences]


def _pairs_around(matches: list[Sim3Match], maps: Maps) -> list[_Candidate]:
    """Matched pairs of keyframes, and pairs around those with most inliers."""
    pairs = set()
    for number, match in enumerate(sorted(matches, key=lambda match: -match.inliers)):
        reach = AROUND if number < EXPANDED else 0
        here = _around(match.first, reach, len(maps[0].features))
        pairs |= set(product(here, _around(match.second, reach, len(maps[1].features))))
    return [_candidate(i, j, maps) for i, j in sorted(pairs)]


def _candidate(i: int, j: int, maps: Maps) -> _Candidate:
    rows = candidate_rows(maps[0].features[i], maps[1].features[j], drop_static=True)
    return _Candidate(i, j, rows, (maps[0].correspondences(i, rows[:, 0]), maps[1].correspondences(j, rows[:, 1])))


def _support(similarity: Array, candidates: list[_Candidate], maps: Maps) -> list[Sim3Match]:
    """The pairs whose features and surfaces are inliers of `similarity` (of the worlds), which is not refined."""
    width, found = maps[0].map.rays.camera.width, []
    for pair in candidates:
        inlier = similarity_errors(similarity, *pair.sides) < MAX_ERROR_PX
        features = maps[0].features[pair.first], maps[1].features[pair.second]
        pixels = features[0].pixels[pair.rows[:, 0]], features[1].pixels[pair.rows[:, 1]]
        if is_well_conditioned(inlier, pixels, width, MIN_INLIER_SHARE) and _surfaces_agree(
            similarity, pair.first, pair.second, maps
        ):
            cameras = (
                maps[1].camera_from_world(pair.second) @ similarity @ inverse(maps[0].camera_from_world(pair.first))
            )
            between = np.asarray(np.linalg.inv(cameras), np.float64)
            found.append(Sim3Match(pair.first, pair.second, between, pair.rows[inlier]))
    return found


def _around(row: int, reach: int, count: int) -> range:
    return range(max(0, row - reach), min(row + reach + 1, count))


def _surfaces_agree(similarity: Array, i: int, j: int, maps: Maps) -> bool:
    """Whether most features of each keyframe that fall on the other's surface lie on it."""
    here, there = (
        shown.features[k].world_points(shown.camera_from_world(k)) for shown, k in zip(maps, (i, j), strict=True)
    )
    ahead = _share_on(transform_points(similarity, here), maps[1], j)
    back = _share_on(transform_points(np.linalg.inv(similarity), there), maps[0], i)
    return min(ahead, back) >= SAME_SURFACE


def _share_on(points: Array, shown: MapFeatures, number: int) -> float:
    """Share of points (N,3), of those in the hull of a keyframe's features, that are as far as the features around."""
    features = shown.features[number]
    local = in_camera(shown.camera_from_world(number), points)
    local = local[local[:, 2] > 0]
    surface = interpolate_inverse_depth(shown.map.rays.project(local), features.triangles, features.points[:, 2])
    inside = np.isfinite(surface) & (surface > 0)
    off = np.abs(np.log(local[inside, 2] * surface[inside]))
    return float((off < MAX_DEPTH_RATIO).mean()) if len(off) else 0.0


def _are_apart(one: Sim3Match, other: Sim3Match, maps: Maps) -> bool:
    """Whether two matches have a baseline between them, in the first map and in the second."""
    for shown, here, there in zip(maps, (one.first, one.second), (other.first, other.second), strict=True):
        centres = [inverse(shown.camera_from_world(number))[:3, 3] for number in (here, there)]
        keyframe = shown.map.keyframes[shown.features[here].keyframe]
        if np.linalg.norm(centres[0] - centres[1]) < MIN_BASELINE * shown.map.median_depth(keyframe):
            return False
    return True
