"""SIFT features of posed keyframes, lifted to 3-D by the sparse points and matched where the poses predict them."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache, partial
from itertools import chain, groupby
from operator import itemgetter
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from haustra.core.progress import ProgressCallback
from haustra.core.ray_table import RayTable
from haustra.core.se3 import Array, in_camera
from pipeline.matching.feature_tracks import FeatureTracks, both_narrow, join_features
from pipeline.matching.guided_matching import match_near, self_similarity
from pipeline.matching.keyframe_features import (
    KeyframeFeatures,
    SparseView,
    features_of_view,
    without_descriptors,
)
from pipeline.matching.sift import FindFeatures, rootsift
from pipeline.matching.sim3_match import STATIC_PX

AHEAD = 8  # keyframes with which each one's features are compared, besides as many that share most points with it
MIN_SHARED = 10  # points that make another keyframe worth comparing
MAX_OFF_SHARE = 0.019  # of the width: a feature from where the poses have it, in another keyframe; 6 px of 320
MOVING_PX = 1.5  # way of what the poses expect to move
CACHED = 64  # keyframes whose descriptors are kept as RootSIFT, half a megabyte each
THREADS = 2  # OpenCV and BLAS let go of the interpreter; the order of what they give is fixed

T = TypeVar("T")
RootSift = Callable[[int], NDArray[np.float32]]  # number of a keyframe -> its features' descriptors, (N,128)


@dataclass(frozen=True)
class MatchedFeatures:
    """Features of all keyframes, and matches of pairs of keyframes: (K,2) rows of the features in either."""

    features: list[KeyframeFeatures]
    pairs: list[tuple[int, int]]
    matches: list[NDArray[np.int32]]

    @property
    def pixels(self) -> list[Array]:
        """Of each keyframe, where its features are (N,2)."""
        return [features.pixels for features in self.features]

    def tracks(self, points: list[Array], wide: bool, widest: float) -> FeatureTracks:
        """Tracks of matches between two features of at most `widest` pixels across, or (`wide`) of all other matches.

        points: of each keyframe, its features' points (N,3) in the world.
        """
        narrow = both_narrow([features.sizes for features in self.features], self.pairs, self.matches, widest)
        chosen = [rows[good != wide] for rows, good in zip(self.matches, narrow, strict=True)]
        return join_features(points, self.pairs, chosen)

    def extrapolated(self, tracks: FeatureTracks) -> NDArray[np.int64]:
        """Numbers of the tracks of which any feature's depth is a guess."""
        starts = np.cumsum([0, *(len(features) for features in self.features)])
        guessed = np.concatenate([np.zeros(0, bool), *(features.extrapolated for features in self.features)])
        return np.unique(tracks.track[guessed[starts[tracks.place] + tracks.feature]])


def match_features(
    views: Sequence[SparseView], seen: csr_array, rays: RayTable, find: FindFeatures, advance: ProgressCallback
) -> MatchedFeatures:
    """Find features in all keyframes and match them between keyframes that are near in time or share points.

    seen: (keyframes, tracks) ones where a keyframe sees a known point.
    """
    radius = MAX_OFF_SHARE * rays.camera.width
    with ThreadPoolExecutor(THREADS) as threads:

        def lift(number: int, view: SparseView) -> tuple[KeyframeFeatures, Array]:
            # At the picture's edge is the nearest wall, which the frame's depth needs most, and corners end before it.
            of = features_of_view(number, view, rays, find, extrapolate=True)
            return without_descriptors(of), self_similarity(of.pixels, of.rootsift, radius)

        def described(number: int) -> NDArray[np.float32]:
            mine = features[number]
            return rootsift(find(views[number].frame).descriptors[mine.rows]) if len(mine) else mine.rootsift

        found = threads.map(lift, range(len(views)), views)
        lifted = list(_counted(found, len(views), "finding features", advance))
        features, elsewhere = [of for of, _ in lifted], [similarity for _, similarity in lifted]
        pairs = covisible_pairs(seen)
        # Each is asked for a dozen times in a row; those of all keyframes would be gigabytes.
        roots = lru_cache(CACHED)(described)
        match = partial(_match_with, views, rays, features, elsewhere, roots)
        partners = {one: [other for _, other in of] for one, of in groupby(pairs, key=itemgetter(0))}
        matched = threads.map(match, partners.keys(), partners.values())
        matches = list(_counted(chain.from_iterable(matched), len(pairs), "matching pairs of keyframes", advance))
    return MatchedFeatures(features, pairs, matches)


def covisible_pairs(seen: csr_array) -> list[tuple[int, int]]:
    """Pairs of keyframes that follow each other or, after a merge, saw the same from elsewhere."""
    shared, total = csr_array(seen @ seen.T), seen.shape[0]
    pairs = set()
    for one in range(total):
        pairs |= {(one, other) for other in range(one + 1, min(one + AHEAD + 1, total))}
        row = slice(shared.indptr[one], shared.indptr[one + 1])
        others, points = shared.indices[row], shared.data[row]
        far = (np.abs(others - one) > AHEAD) & (points >= MIN_SHARED)
        best = others[far][np.lexsort((others[far], -points[far]))[:AHEAD]]
        pairs |= {(min(one, int(k)), max(one, int(k))) for k in best}
    return sorted(pairs)


def _match_with(
    views: Sequence[SparseView],
    rays: RayTable,
    features: list[KeyframeFeatures],
    elsewhere: list[Array],
    roots: RootSift,
    one: int,
    others: list[int],
) -> list[NDArray[np.int32]]:
    """Of a keyframe and each of some others, (K,2) features that look alike and lie where the poses say.

    elsewhere: of each keyframe, how much its features' most alike elsewhere in it look like them. What stands still in
    the picture where the wall should move is dirt, a reflection or text that was burned in.
    """
    here, radius = features[one], MAX_OFF_SHARE * rays.camera.width
    world = here.world_points(views[one].camera_from_world)
    # Of all others at once: a thousand points are projected in less time than it takes to ask for it.
    local = np.concatenate([in_camera(views[other].camera_from_world, world) for other in others])
    expected_in = rays.project_valid(local).reshape(len(others), len(here), 2)
    found = []
    for other, expected in zip(others, expected_in, strict=True):
        there = features[other]
        rows = match_near(expected, there.pixels, roots(one), roots(other), elsewhere[one], radius)
        before, now = here.pixels[rows[:, 0]], there.pixels[rows[:, 1]]
        way, foreseen = np.linalg.norm(now - before, axis=1), np.linalg.norm(expected[rows[:, 0]] - before, axis=1)
        found.append(rows[~((way < STATIC_PX) & (foreseen > MOVING_PX))].astype(np.int32))  # millions are held
    return found


def _counted(results: Iterable[T], total: int, note: str, advance: ProgressCallback) -> Iterator[T]:
    """The same; progress is reported as they come."""
    for done, result in enumerate(results, start=1):
        advance(done, total, note)
        yield result
