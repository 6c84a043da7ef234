"""A finished map adjusted once more, to features that are found anew in each of its keyframes.

A corner that is followed from frame to frame slides a little, and always the same way while the camera moves the same
way: that bends the scale along the path, and no adjustment of the same corners can see it. Features that each keyframe
finds for itself, matched to where the map has them, slide far less, the narrow ones least. The map's shape comes from
these alone; wider ones and the corners' points follow, and all features become points of the map.
"""

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from haustra.core.progress import Advance, unheard
from haustra.core.se3 import Array, in_camera, inverse, scaled
from pipeline.mapping.global_adjustment import growth, polish
from pipeline.mapping.lift_features import place_of
from pipeline.mapping.local_map import LocalMap
from pipeline.matching.feature_tracks import Tracks, both_narrow, join_features
from pipeline.matching.guided_matching import likeness_elsewhere, match_near
from pipeline.matching.keyframe_features import STILL_PX, FindFeatures, Place

# A wide feature's place changes while the camera withdraws, and bends the scale: 5 px were best on lossless pictures,
# more on compressed ones, where fine texture moves with its blocks (docs/lab/front_end.md).
WIDEST, WIDEST_SHARE = 8.0, 8 / 320  # px and share of the width, the larger of the two
AHEAD = 8  # keyframes with which each one's features are compared, besides as many that share most points with it
MIN_SHARED = 10  # points that make another keyframe worth comparing
MAX_OFF_SHARE = 0.019  # of the width: a feature from where the map has it, in another keyframe; 6 px of 320
MOVING_PX = 1.5  # way of what the map expects to move
MIN_SEEN = 20  # features of a keyframe that is fixed by them; another one follows its neighbour
TYPICAL = 100  # features of the median keyframe: fewer are no better than the corners
MIN_TIE = 12  # features that hold two keyframes together
MAX_FOLLOWING = 0.1  # share of keyframes that may follow
ROOTED = 64  # keyframes whose descriptors are kept as RootSIFT, half a megabyte each
THREADS = 2  # OpenCV and BLAS let go of the interpreter; the order of what they give is fixed

T = TypeVar("T")
Rooted = Callable[[int], NDArray[np.float32]]  # number of a keyframe -> its features' descriptors, (N,128)


def refit(local_map: LocalMap, find: FindFeatures, advance: Advance = unheard) -> float | None:
    """Move the map to where its own features have it. Returns how wide, in pixels, those that moved it were at most;
    None if they do not hold it.

    Narrow features are asked first, and all of them where those are too few: wide ones slide, but less than corners.
    The features of an earlier call are forgotten first.
    """
    local_map.forget_features()
    matched = _matched(local_map, find, advance)
    for widest in (widest_narrow(local_map.rays.camera.width), np.inf):
        tracks = matched.tracks(False, widest)
        moving = _map_of(local_map, matched.places, tracks)
        before = _adjusted(moving, advance)
        if before is not None:
            before[_guessed(matched.places, tracks)] = np.nan  # they say nothing of how the map grew
            _take_over(local_map, _map_of(local_map, matched.places, matched.tracks(True, widest)))
            _follow(local_map, moving, before)
            return widest
    return None


def widest_narrow(width: int) -> float:
    """Pixels across of the widest feature that still counts as narrow, in a picture of that width."""
    return max(WIDEST, WIDEST_SHARE * width)


def _adjusted(fitted: LocalMap, advance: Advance) -> Array | None:
    """Adjust a map of features: its points (T,3) from before, or None if the features do not hold it."""
    if not _is_held(fitted, TYPICAL):
        return None
    before = fitted.points.copy()
    polish(fitted, True, advance)
    return before if _is_held(fitted, TYPICAL / 2) else None


def _near(local_map: LocalMap) -> list[tuple[int, int]]:
    """Pairs of keyframes that follow each other or, after a join, saw the same from elsewhere."""
    seen = _incidence(local_map)
    shared = csr_array(seen @ seen.T)
    pairs = set()
    for one in range(len(local_map.keyframes)):
        pairs |= {(one, other) for other in range(one + 1, min(one + AHEAD + 1, len(local_map.keyframes)))}
        row = slice(shared.indptr[one], shared.indptr[one + 1])
        others, count = shared.indices[row], shared.data[row]
        far = (np.abs(others - one) > AHEAD) & (count >= MIN_SHARED)
        best = others[far][np.lexsort((others[far], -count[far]))[:AHEAD]]
        pairs |= {(min(one, int(k)), max(one, int(k))) for k in best}
    return sorted(pairs)


def _same(
    local_map: LocalMap, places: list[Place], elsewhere: list[Array], rooted: Rooted, pair: tuple[int, int]
) -> NDArray[np.int64]:
    """(K,2) features of a pair of keyframes that look alike and lie where the map says.

    elsewhere: of each keyframe, how much its features' most alike elsewhere in it look like them. What stands still in
    the picture where the wall should move is dirt, a reflection or text that was burned in.
    """
    here, there = (places[number] for number in pair)
    expected = local_map.rays.seen_at(in_camera(local_map.keyframes[there.keyframe].pose, here.points))
    first, second = (rooted(number) for number in pair)
    pairs = match_near(expected, there.pixels, first, second, elsewhere[pair[0]], _radius(local_map))
    before, now = here.pixels[pairs[:, 0]], there.pixels[pairs[:, 1]]
    way, foreseen = np.linalg.norm(now - before, axis=1), np.linalg.norm(expected[pairs[:, 0]] - before, axis=1)
    return pairs[~((way < STILL_PX) & (foreseen > MOVING_PX))]


def _radius(local_map: LocalMap) -> float:
    """Pixels within which a feature is looked for."""
    return MAX_OFF_SHARE * local_map.rays.camera.width


def _elsewhere(local_map: LocalMap, place: Place) -> Array:
    return likeness_elsewhere(place.pixels, place.rooted, _radius(local_map))


@dataclass(frozen=True)
class Matched:
    """Features of all keyframes, and of pairs of keyframes (K,2) numbers of those that are the same."""

    places: list[Place]
    pairs: list[tuple[int, int]]
    same: list[NDArray[np.int64]]

    def tracks(self, wide: bool, widest: float) -> Tracks:
        """Of matches between two features of at most `widest` pixels across, or of all other matches."""
        narrow = both_narrow([place.sizes for place in self.places], self.pairs, self.same, widest)
        chosen = [rows[good != wide] for rows, good in zip(self.same, narrow, strict=True)]
        return join_features([place.points for place in self.places], self.pairs, chosen)


def _matched(local_map: LocalMap, find: FindFeatures, advance: Advance) -> Matched:
    keyframes = range(len(local_map.keyframes))
    with ThreadPoolExecutor(THREADS) as threads:
        # At the picture's edge is the nearest wall, which the frame's depth needs most, and corners end before it.
        placed = threads.map(lambda number: place_of(local_map, number, find, beyond=True), keyframes)
        places = list(_counted(placed, len(keyframes), "finding features", advance))
        pairs = _near(local_map)
        # Each is asked for a dozen times in a row; those of all keyframes would be gigabytes.
        rooted = lru_cache(ROOTED)(lambda number: places[number].rooted)
        elsewhere = list(threads.map(partial(_elsewhere, local_map), places))
        found = threads.map(partial(_same, local_map, places, elsewhere, rooted), pairs)
        same = list(_counted(found, len(pairs), "matching pairs of keyframes", advance))
    # What tells features apart has done its part; it is nearly all of their memory.
    bare = [replace(place, descriptors=np.zeros((0, 128), np.uint8)) for place in places]
    return Matched(bare, pairs, same)


def _counted(results: Iterable[T], total: int, note: str, advance: Advance) -> Iterator[T]:
    """The same, and whoever waits is told how many there are already."""
    for done, result in enumerate(results, start=1):
        advance(done, total, note)
        yield result


def _guessed(places: list[Place], tracks: Tracks) -> NDArray[np.int64]:
    """Numbers of the tracks of which any feature's point is a guess."""
    starts = np.cumsum([0, *(len(place.points) for place in places)])
    guessed = np.concatenate([np.zeros(0, bool), *(place.guessed for place in places)])
    return np.unique(tracks.track[guessed[starts[tracks.place] + tracks.feature]])


def _map_of(local_map: LocalMap, places: list[Place], tracks: Tracks) -> LocalMap:
    """The same keyframes, which see these tracks of features and nothing else."""
    fitted = LocalMap(local_map.rays)
    fitted.reserve(len(tracks.points))
    fitted.points[: len(tracks.points)] = tracks.points
    fitted.known[: len(tracks.points)] = True
    starts = np.searchsorted(tracks.place, np.arange(len(local_map.keyframes) + 1))
    for number, (keyframe, place) in enumerate(zip(local_map.keyframes, places, strict=True)):
        mine = slice(starts[number], starts[number + 1])
        fitted.add_keyframe(keyframe.frame, keyframe.pose, tracks.track[mine], place.pixels[tracks.feature[mine]])
    return fitted


def _is_held(fitted: LocalMap, typical: float) -> bool:
    """Whether features are many, few keyframes are left to follow, and all others hang together."""
    if len(fitted.keyframes) < 2:
        return False
    seen = _incidence(fitted)
    count = np.diff(seen.indptr)
    fixed = np.flatnonzero(count >= MIN_SEEN)
    if len(fixed) < (1 - MAX_FOLLOWING) * len(count) or np.median(count) < typical:
        return False
    tied = (seen[fixed] @ seen[fixed].T) >= MIN_TIE
    return connected_components(tied, directed=False)[0] == 1


def _incidence(local_map: LocalMap) -> csr_array:
    """(keyframes, tracks) ones where a keyframe sees a known point."""
    ids = [np.unique(k.ids[local_map.known[k.ids]]) for k in local_map.keyframes]
    starts = np.concatenate([[0], np.cumsum([len(i) for i in ids])])
    columns = np.concatenate([np.zeros(0, np.int64), *ids])
    return csr_array((np.ones(len(columns)), columns, starts), shape=(len(ids), len(local_map.known)))


def _follow(local_map: LocalMap, fitted: LocalMap, before: Array) -> None:
    """Take over the keyframes' poses; frames between them and the old points follow, the features join the points.

    before: the features' points (T,3) from before the adjustment, NaN where they were guesses.
    """
    old, scale = [keyframe.pose for keyframe in local_map.keyframes], _scales(local_map, fitted, before)
    fixed = np.flatnonzero(np.isfinite(scale))
    points = local_map.points.copy()
    for number in range(len(old) - 1, -1, -1):  # a point follows the first keyframe that saw it
        keyframe, guide = local_map.keyframes[number], int(fixed[np.abs(fixed - number).argmin()])
        scale[number] = scale[guide]
        keyframe.pose = scaled(old[number] @ inverse(old[guide]), scale[guide]) @ fitted.keyframes[guide].pose
        seen = keyframe.ids[local_map.known[keyframe.ids]]
        points[seen] = in_camera(inverse(keyframe.pose), scale[number] * in_camera(old[number], local_map.points[seen]))
    local_map.points = points
    local_map.posed = [posed.scaled(scale[posed.keyframe]) for posed in local_map.posed]
    _take_over(local_map, fitted)
    local_map.fit_points()


def _scales(local_map: LocalMap, fitted: LocalMap, before: Array) -> Array:
    """(K,) by how much each keyframe's features moved away from it, in the median; NaN where too few fix it."""
    scale = np.full(len(fitted.keyframes), np.nan)
    for number, (keyframe, old) in enumerate(zip(fitted.keyframes, local_map.keyframes, strict=True)):
        ids = keyframe.ids[fitted.known[keyframe.ids] & np.isfinite(before[keyframe.ids, 0])]
        if len(ids) >= MIN_SEEN:
            scale[number] = growth(in_camera(old.pose, before[ids]), in_camera(keyframe.pose, fitted.points[ids]))
    return scale


def _take_over(local_map: LocalMap, fitted: LocalMap) -> None:
    """The features as tracks of the map."""
    ids = local_map.add_features(fitted.points, fitted.known)
    for number, keyframe in enumerate(fitted.keyframes):
        good = fitted.known[keyframe.ids]
        local_map.extend(number, ids[keyframe.ids[good]], keyframe.pixels[good])
