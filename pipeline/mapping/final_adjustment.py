"""Final bundle adjustment of a map on SIFT features re-detected in each keyframe: KLT corners drift and bend the scale.

A corner that is tracked from frame to frame drifts along the direction of motion. That bends the scale along the path,
and no adjustment of the same corners shows it. Re-detected features, matched where the map predicts them, drift far
less, narrow ones least. The map is adjusted to narrow features alone; wide features and KLT points are moved along, and
all features become points of the map.
"""

from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from haustra.core.progress import Progress, ProgressCallback, no_progress
from haustra.core.se3 import Array, in_camera, inverse, scaled
from pipeline.mapping.local_map import LocalMap, TrackKind
from pipeline.mapping.map_adjustment import adjust_all, fit_points, growth
from pipeline.matching.feature_matching import MatchedFeatures, match_features
from pipeline.matching.sift import FindFeatures

# A wide feature's place changes while the camera withdraws, and bends the scale: 5 px were best on lossless pictures,
# more on compressed ones, where fine texture moves with its blocks (docs/lab/front_end.md).
WIDEST, WIDEST_SHARE = 8.0, 8 / 320  # px and share of the width, the larger of the two
MIN_SEEN = 20  # features of a keyframe that is held by them; another one follows its neighbour
MIN_TYPICAL_FEATURES = 100  # features of the median keyframe: fewer are no better than the corners
MIN_COMMON = 12  # features that hold two keyframes together
MAX_FOLLOWING = 0.1  # share of keyframes that may follow: those that see too few, or do not hang together with most


def adjust_maps(
    maps: list[LocalMap], find: FindFeatures, progress: Progress, changed: bool = False
) -> list[float | None]:
    """The last adjustment of each map: to its features (`adjust_maps_to_features`, which says what is returned); where
    these do not hold it, to its corners, `changed` or not (see `adjust_all`)."""
    held = adjust_maps_to_features(maps, find, progress)
    for local_map in (m for m, by in zip(maps, held, strict=True) if by is None):
        with progress.bar("adjusting to corners", None) as advance:
            adjust_all(local_map, changed, advance)
    return held


def adjust_maps_to_features(
    maps: list[LocalMap], find: FindFeatures, progress: Progress, may_part: bool = True
) -> list[float | None]:
    """Every map moved to where its own features have it; of each, how wide the features were at most, pixels. Maps that
    they do not hold (None) stay as they are, and a sentence says so. may_part: see `adjust_to_features`."""
    if not maps:
        return []
    held = []
    for local_map in maps:
        with progress.bar("adjusting to features", None) as advance:
            held.append(adjust_to_features(local_map, find, advance, may_part))
    for local_map in (m for m, by in zip(maps, held, strict=True) if by is None):
        first, last = local_map.keyframes[0].frame, local_map.keyframes[-1].frame
        progress.log(
            f"frames {first} to {last}: too few features to adjust the map by; its scale may bend along the path"
        )
    return held


def adjust_to_features(
    local_map: LocalMap, find: FindFeatures, advance: ProgressCallback = no_progress, may_part: bool = True
) -> float | None:
    """Move the map to where its own features have it. Returns how wide, in pixels, those that moved it were at most;
    None if too few do, which leaves poses and KLT points as they were.

    Narrow features are asked first, and all of them where those are too few: wide ones slide, but less than corners.
    may_part: where neither hold all keyframes together, a few may hang together alone; they then follow the others. Not
    for a map that was joined of two: there it would hide that the join is wrong. The features of an earlier call are
    forgotten first.
    """
    local_map.forget_features()
    views = [local_map.sparse_view(keyframe) for keyframe in local_map.keyframes]
    matched = match_features(views, local_map.incidence(), local_map.rays, find, advance)
    cameras_from_world = [keyframe.camera_from_world for keyframe in local_map.keyframes]
    world = [
        f.world_points(camera_from_world)
        for f, camera_from_world in zip(matched.features, cameras_from_world, strict=True)
    ]
    widths = widest_narrow(local_map.rays.camera.width), float(np.inf)
    for parted, widest in product((False, True) if may_part else (False,), widths):
        if _adjusted(local_map, matched, world, widest, parted, advance):
            return widest
        local_map.forget_features()
        for keyframe, camera_from_world in zip(local_map.keyframes, cameras_from_world, strict=True):
            keyframe.camera_from_world = camera_from_world
    return None


def widest_narrow(width: int) -> float:
    """Pixels across of the widest feature that still counts as narrow, in a picture of that width."""
    return max(WIDEST, WIDEST_SHARE * width)


def _adjusted(
    local_map: LocalMap,
    matched: MatchedFeatures,
    world: list[Array],
    widest: float,
    parted: bool,
    advance: ProgressCallback,
) -> bool:
    """Whether features of at most `widest` pixels hold the map, which is then adjusted to them; what they left behind,
    if they do not, is for the caller to undo. parted: a few keyframes may hang together alone."""
    local_map.insert_features(matched.tracks(world, True, widest), matched.pixels, TrackKind.WIDE_FEATURE)
    narrow = matched.tracks(world, False, widest)
    ids = local_map.insert_features(narrow, matched.pixels)
    moving = local_map.tracks.is_kind(TrackKind.FEATURE)
    held = _held_keyframes(local_map, moving, MIN_TYPICAL_FEATURES, parted)
    if held is None:
        return False
    _forget_unheld(local_map, moving, held)  # so that they move nothing else
    old, before = [keyframe.camera_from_world for keyframe in local_map.keyframes], local_map.tracks.points.copy()
    adjust_all(local_map, True, advance, moving)
    held = _held_keyframes(local_map, moving, MIN_TYPICAL_FEATURES / 2, parted)
    if held is None:
        return False
    sure = moving.copy()
    sure[ids[matched.extrapolated(narrow)]] = False  # guesses say nothing of how the map grew
    scale = _scales(local_map, old, before, sure)
    scale[~held] = np.nan
    _forget_unheld(local_map, moving, held)
    _propagate(local_map, old, scale, moving)
    fit_points(local_map)
    return True


def _held_keyframes(
    local_map: LocalMap, among: NDArray[np.bool_], typical: float, parted: bool
) -> NDArray[np.bool_] | None:
    """(K,) the keyframes that see enough of the tracks `among` (T,) and hang together by them: the most that do. None
    where these are too few, where the median keyframe sees fewer than `typical`, and, unless `parted`, where others
    that see enough hang together alone."""
    if len(local_map.keyframes) < 2:
        return None
    seen = local_map.incidence(among)
    count = np.diff(seen.indptr)
    fixed = np.flatnonzero(count >= MIN_SEEN)
    if len(fixed) == 0 or np.median(count) < typical:
        return None
    together = (seen[fixed] @ seen[fixed].T) >= MIN_COMMON
    parts, part = connected_components(together, directed=False)
    if parts > 1 and not parted:
        return None
    held = np.zeros(len(count), dtype=bool)
    held[fixed[part == np.bincount(part).argmax()]] = True
    return held if held.sum() >= (1 - MAX_FOLLOWING) * len(count) else None


def _forget_unheld(local_map: LocalMap, moving: NDArray[np.bool_], held: NDArray[np.bool_]) -> None:
    """Points of tracks `moving` (T,) that no keyframe of `held` (K,) sees: their own world is not the map's."""
    seen = np.asarray(local_map.incidence(moving)[np.flatnonzero(held)].sum(axis=0)).ravel() > 0
    local_map.tracks.has_point[moving & ~seen] = False


def _scales(local_map: LocalMap, old: list[Array], before: Array, sure: NDArray[np.bool_]) -> Array:
    """(K,) by how much each keyframe's features moved away from it, in the median; NaN where too few fix it.

    old: the keyframes' poses before the adjustment; before (T,3): the points then; sure (T,): features to ask.
    """
    scale = np.full(len(old), np.nan)
    for number, (keyframe, camera_from_world) in enumerate(zip(local_map.keyframes, old, strict=True)):
        ids = keyframe.ids[(local_map.tracks.has_point & sure)[keyframe.ids]]
        if len(ids) >= MIN_SEEN:
            now = in_camera(keyframe.camera_from_world, local_map.tracks.points[ids])
            scale[number] = growth(in_camera(camera_from_world, before[ids]), now)
    return scale


def _propagate(local_map: LocalMap, old: list[Array], scale: Array, moving: NDArray[np.bool_]) -> None:
    """Bring what did not take part to the adjusted keyframes: keyframes that features do not fix, to their neighbours;
    all other points, to the first keyframe that saw them; frames between keyframes, to the unit there.

    scale (K,): growth of each keyframe's surroundings, NaN where unknown; moving (T,): tracks that took part.
    """
    fixed, now = np.flatnonzero(np.isfinite(scale)), [keyframe.camera_from_world for keyframe in local_map.keyframes]
    tracks, points = local_map.tracks, local_map.tracks.points.copy()
    for number in range(len(old) - 1, -1, -1):
        keyframe, reference = local_map.keyframes[number], int(fixed[np.abs(fixed - number).argmin()])
        scale[number] = scale[reference]
        keyframe.camera_from_world = scaled(old[number] @ inverse(old[reference]), scale[reference]) @ now[reference]
        seen = keyframe.ids[(tracks.has_point & ~moving)[keyframe.ids]]
        points[seen] = in_camera(
            inverse(keyframe.camera_from_world), scale[number] * in_camera(old[number], tracks.points[seen])
        )
    tracks.points = points
    local_map.tracked_frames = [tracked.scaled(scale[tracked.keyframe]) for tracked in local_map.tracked_frames]
