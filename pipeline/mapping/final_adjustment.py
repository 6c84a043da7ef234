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
MIN_SEEN = 20  # features of a keyframe that is adjusted to them; another one follows its neighbour
MIN_TYPICAL_FEATURES = 100  # features of the median keyframe: fewer are no better than the corners
MIN_COVISIBLE = 12  # features that two keyframes both see if they are neighbours in the covisibility graph
MAX_FOLLOWING = 0.1  # share of keyframes that may follow: those that see too few, or are not connected to most


def adjust_maps(
    maps: list[LocalMap], find: FindFeatures, progress: Progress, changed: bool = False
) -> list[float | None]:
    """The last adjustment of each map: to its features (`adjust_maps_to_features`, which says what is returned); where
    these constrain it too little, to its corners, `changed` or not (see `adjust_all`)."""
    widths = adjust_maps_to_features(maps, find, progress)
    for local_map in (m for m, width in zip(maps, widths, strict=True) if width is None):
        with progress.bar("adjusting to corners", None) as advance:
            adjust_all(local_map, changed, advance)
    return widths


def adjust_maps_to_features(
    maps: list[LocalMap], find: FindFeatures, progress: Progress, allow_disconnected: bool = True
) -> list[float | None]:
    """Adjust each map to its own features, and return how wide these were at most, in pixels. A map that they constrain
    too little (None) stays as it is, and a sentence says so. allow_disconnected: see `adjust_to_features`."""
    if not maps:
        return []
    widths = []
    for local_map in maps:
        with progress.bar("adjusting to features", None) as advance:
            widths.append(adjust_to_features(local_map, find, advance, allow_disconnected))
    for local_map in (m for m, width in zip(maps, widths, strict=True) if width is None):
        first, last = local_map.keyframes[0].frame, local_map.keyframes[-1].frame
        progress.log(
            f"frames {first} to {last}: too few features to adjust the map by; its scale may bend along the path"
        )
    return widths


def adjust_to_features(
    local_map: LocalMap, find: FindFeatures, advance: ProgressCallback = no_progress, allow_disconnected: bool = True
) -> float | None:
    """Adjust the map to its own features. Returns how wide these were at most, in pixels; None where they are too few,
    which leaves poses and KLT points as they were.

    Narrow features are tried first, then all, since wide ones slide, but less than corners. allow_disconnected: where
    neither connect all keyframes, a few that are connected among themselves alone may follow the others. Not for a map
    that was joined of two: there it would hide that the join is wrong. The features of an earlier call are forgotten
    first.
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
    for disconnected, widest in product((False, True) if allow_disconnected else (False,), widths):
        if _adjusted(local_map, matched, world, widest, disconnected, advance):
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
    disconnected: bool,
    advance: ProgressCallback,
) -> bool:
    """Whether features of at most `widest` pixels constrain the map, which is then adjusted to them; where they do not,
    the caller undoes what was changed. disconnected: a few keyframes need not be connected to the others."""
    local_map.insert_features(matched.tracks(world, True, widest), matched.pixels, TrackKind.WIDE_FEATURE)
    narrow = matched.tracks(world, False, widest)
    ids = local_map.insert_features(narrow, matched.pixels)
    moving = local_map.tracks.is_kind(TrackKind.FEATURE)
    constrained = constrained_keyframes(local_map, moving, MIN_TYPICAL_FEATURES, disconnected)
    if constrained is None:
        return False
    _forget_unconstrained(local_map, moving, constrained)  # so that they move nothing else
    old, before = [keyframe.camera_from_world for keyframe in local_map.keyframes], local_map.tracks.points.copy()
    adjust_all(local_map, True, advance, moving)
    constrained = constrained_keyframes(local_map, moving, MIN_TYPICAL_FEATURES / 2, disconnected)
    if constrained is None:
        return False
    sure = moving.copy()
    sure[ids[matched.extrapolated(narrow)]] = False  # guesses say nothing of how the map grew
    scale = _scales(local_map, old, before, sure)
    scale[~constrained] = np.nan
    _forget_unconstrained(local_map, moving, constrained)
    _propagate(local_map, old, scale, moving)
    fit_points(local_map)
    return True


def constrained_keyframes(
    local_map: LocalMap,
    among: NDArray[np.bool_],
    typical: float,
    disconnected: bool,
    min_covisible: float = MIN_COVISIBLE,
) -> NDArray[np.bool_] | None:
    """(K,) mask of the largest connected component of the covisibility graph of the keyframes that see enough of the
    tracks `among` (T,); neighbours in it both see `min_covisible` of these. None where it is too small, where the
    median keyframe sees fewer than `typical` of them, and, unless `disconnected`, where there is another component."""
    if len(local_map.keyframes) < 2:
        return None
    seen = local_map.incidence(among)
    count = np.diff(seen.indptr)
    numbers = np.flatnonzero(count >= MIN_SEEN)
    if len(numbers) == 0 or np.median(count) < typical:
        return None
    covisible = (seen[numbers] @ seen[numbers].T) >= min_covisible
    components, component = connected_components(covisible, directed=False)
    if components > 1 and not disconnected:
        return None
    constrained = np.zeros(len(count), dtype=bool)
    constrained[numbers[component == np.bincount(component).argmax()]] = True
    return constrained if constrained.sum() >= (1 - MAX_FOLLOWING) * len(count) else None


def _forget_unconstrained(local_map: LocalMap, moving: NDArray[np.bool_], constrained: NDArray[np.bool_]) -> None:
    """Forget points of tracks `moving` (T,) that no constrained keyframe, (K,), sees: nothing ties them to the map."""
    seen = np.asarray(local_map.incidence(moving)[np.flatnonzero(constrained)].sum(axis=0)).ravel() > 0
    local_map.tracks.has_point[moving & ~seen] = False


def _scales(local_map: LocalMap, old: list[Array], before: Array, sure: NDArray[np.bool_]) -> Array:
    """(K,) by how much each keyframe's features moved away from it, in the median; NaN where they are too few.

    old: the keyframes' camera_from_world (4,4) before the adjustment; before (T,3): the points then; sure (T,): mask of
    the features that count.
    """
    scale = np.full(len(old), np.nan)
    for number, (keyframe, camera_from_world) in enumerate(zip(local_map.keyframes, old, strict=True)):
        ids = keyframe.ids[(local_map.tracks.has_point & sure)[keyframe.ids]]
        if len(ids) >= MIN_SEEN:
            now = in_camera(keyframe.camera_from_world, local_map.tracks.points[ids])
            scale[number] = growth(in_camera(camera_from_world, before[ids]), now)
    return scale


def _propagate(local_map: LocalMap, old: list[Array], scale: Array, moving: NDArray[np.bool_]) -> None:
    """Carry along what did not take part in the adjustment: unconstrained keyframes with the nearest constrained one;
    other points with the first keyframe that saw them; frames between keyframes by the scale there.

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
