"""Scale breaks of a tracked map: where its scale jumps, the map is cut in two.

While a camera turns or stands still, new points are triangulated over a baseline that is hardly known. If their scale
differs from that of the points before, the same wall is in the map twice, at two depths, for as long as frames see
points of both scales. Bundle adjustment does not take that back: it drops what does not fit as outliers, and the two
parts are then constrained by nothing. Cut, each part has one scale, and submap merging may find the similarity between
them where both show the same wall. Limits were chosen on one real film (docs/lab/front_end.md, "Scale breaks").
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from haustra.core.progress import Progress
from haustra.core.se3 import in_camera
from pipeline.mapping.local_map import Keyframe, LocalMap

NEIGHBOURS = 8  # points whose median depth a point is compared with
TWO_DEPTHS = np.log(1.6)  # log depth between a point and those around it
MIN_POINTS = 40  # of a keyframe that is judged
SMOOTHED = 5  # keyframes whose mean share counts
# Share of points at another depth than those around them, from which on there is a break; and the same in multiples of
# the map's median keyframe.
BREAK_SHARE, BREAK_MULTIPLE = 0.2, 5.0
MIN_KEYFRAMES = 8  # of a part that is cut off
KEPT = 3  # keyframes before the cut whose new tracks keep their points in the later part


def cut_at_breaks(maps: list[LocalMap], progress: Progress) -> list[LocalMap]:
    """The maps, each cut where its scale breaks, in the order of their frames; a sentence says where."""
    result = []
    for local_map in maps:
        parts = _cut(local_map)
        for part in parts[1:]:
            progress.log(
                f"frame {part.keyframes[0].frame}: points side by side in the picture lie at two depths, as where the "
                "scale of the map changes; it is cut into two submaps there"
            )
        result += parts
    return result


def shares_at_two_depths(local_map: LocalMap) -> NDArray[np.float64]:
    """(K,) share of each keyframe's points that lie at another depth than those around them; NaN where it sees too few
    points."""
    return np.array([_share(local_map, keyframe) for keyframe in local_map.keyframes])


def _cut(local_map: LocalMap) -> list[LocalMap]:
    count = len(local_map.keyframes)
    share = shares_at_two_depths(local_map)
    typical = float(np.nanmedian(share)) if np.isfinite(share).any() else np.nan
    if count < 2 * MIN_KEYFRAMES or not np.isfinite(typical):
        return [local_map]
    window = np.lib.stride_tricks.sliding_window_view(share, SMOOTHED)
    smooth = np.full(count, np.nan)
    smooth[SMOOTHED // 2 : count - SMOOTHED // 2] = window.mean(axis=1)
    smooth[:MIN_KEYFRAMES] = smooth[count - MIN_KEYFRAMES :] = np.nan
    if not np.isfinite(smooth).any():
        return [local_map]
    number = int(np.nanargmax(smooth))
    if smooth[number] < max(BREAK_SHARE, BREAK_MULTIPLE * typical):
        return [local_map]
    return [*_cut(_part(local_map, 0, number)), *_cut(_part(local_map, number, count))]


def _share(local_map: LocalMap, keyframe: Keyframe) -> float:
    points, pixels = local_map.visible_points(keyframe)
    depth = in_camera(keyframe.camera_from_world, points)[:, 2]
    front = depth > 0
    if np.count_nonzero(front) < MIN_POINTS:
        return np.nan
    _, nearest = cKDTree(pixels[front]).query(pixels[front], k=NEIGHBOURS + 1)
    log_depth = np.log(depth[front])
    around = np.median(log_depth[nearest[:, 1:]], axis=1)
    return float((np.abs(log_depth - around) > TWO_DEPTHS).mean())


def _part(local_map: LocalMap, first: int, end: int) -> LocalMap:
    """The map of keyframes `first` to before `end` and the frames after each; without points that keyframes more than
    `KEPT` before `first` saw, which have the scale before the break."""
    part = local_map.copied()
    if first:
        seen = [k.ids for k in part.keyframes[: max(0, first - KEPT)]]
        before = np.unique(np.concatenate([np.zeros(0, np.int64), *seen]))
        part.tracks.has_point[before] = False
    part.keyframes = part.keyframes[first:end]
    part.tracked_frames = [
        replace(tracked, keyframe=tracked.keyframe - first)
        for tracked in part.tracked_frames
        if first <= tracked.keyframe < end
    ]
    return part
