"""Tracking backwards from the beginning of a map, to frames that were lost on the way forwards, and to the map before.

A new map needs parallax to begin, and what was filmed until then is lost. Its points, once they are there, also pose
those frames, in reverse order of time. Where that reaches frames that an earlier map posed, the two maps have frames in
common and are stitched, if these agree, as two chunks are (`chunk_stitching`).
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from haustra.core.progress import ProgressCallback, no_progress
from pipeline.frontend.odometry.chunk_stitching import first_from_second, stitch, without_stubs
from pipeline.frontend.odometry.corner_tracks import CornerTracks
from pipeline.frontend.odometry.klt import TrackerImage
from pipeline.frontend.odometry.tracking import MAX_JUMP, MAX_LOST_FRAMES, Tracker
from pipeline.mapping.local_map import LocalMap

COPIED = 12  # keyframes of the map's beginning that the reversed map starts from
OVERLAP = 20  # frames of an earlier map after which there is no need to go on
Look = Callable[[int], tuple[NDArray[np.uint8], TrackerImage]]  # a frame's picture (H,W,3), and as the tracker needs it


def extend_backwards(
    maps: list[LocalMap],
    index: NDArray[np.int64],
    look: Look,
    stride: int,
    keyframe_motion: float,
    seed: int,
    advance: ProgressCallback = no_progress,
) -> tuple[list[LocalMap], int]:
    """The maps with what could be tracked before their first frame, those stitched that share frames and agree, and how
    many were stitched.

    maps: in order of time, without features. index (N,): numbers of the frames that can be tracked, ascending.
    """
    result: list[LocalMap] = []
    stitched = 0
    for number, local_map in enumerate(maps):
        advance(number, len(maps))
        taken: set[int] = set().union(*(earlier.frames for earlier in result))
        whole = _with_earlier_frames(local_map, index, look, taken, stride, keyframe_motion, seed)
        sharing = sorted(result, key=lambda earlier: -len(earlier.frames & whole.frames))
        for earlier in sharing:
            similarity = first_from_second(earlier, whole)
            if similarity is not None:
                whole = stitch(earlier, whole, similarity)
                result = [other for other in result if other is not earlier]
                stitched += 1
                break
        result.append(whole)
    advance(len(maps), len(maps))
    return without_stubs(result), stitched


def _with_earlier_frames(
    local_map: LocalMap,
    index: NDArray[np.int64],
    look: Look,
    taken: set[int],
    stride: int,
    keyframe_motion: float,
    seed: int,
) -> LocalMap:
    """The map and, stitched to it, the frames before it that could be tracked; `taken`: frames that others posed."""
    first = local_map.keyframes[0].frame
    before = index[index < first][::-1]
    if not len(before) or first - before[0] > MAX_JUMP * stride:
        return local_map
    reversed_map, tracks = _reversed_beginning(local_map)
    _, view = look(first)
    rng = np.random.default_rng([seed, first])
    tracker = Tracker(reversed_map, tracks, view, first, rng, keyframe_motion, stride)
    shared = 0
    for frame in map(int, before):
        steps = max(1, round((tracker.frame - frame) / stride))
        if steps > MAX_LOST_FRAMES:
            break
        rgb, view = look(frame)
        if tracker.process(frame, steps, view, rgb) == "lost":
            continue
        shared += frame in taken
        if shared >= OVERLAP:
            break
    if min(reversed_map.frames) >= min(local_map.frames):
        return local_map
    similarity = first_from_second(reversed_map, local_map)
    if similarity is None:
        return local_map
    return stitch(reversed_map, local_map, similarity, common_tracks=len(local_map.tracks))


def _reversed_beginning(local_map: LocalMap) -> tuple[LocalMap, CornerTracks]:
    """A map of the first keyframes in reverse order, and the tracks that its last keyframe, the first one, has points
    for."""
    copied = local_map.keyframes[:COPIED]
    last = len(copied) - 1
    beginning = LocalMap(local_map.rays)
    beginning.tracks.place(0, local_map.tracks)
    for keyframe in reversed(copied):
        beginning.add_keyframe(keyframe.frame, keyframe.camera_from_world, keyframe.ids, keyframe.pixels)
    for tracked in local_map.tracked_frames:
        if tracked.keyframe < last:  # beyond, its place is between a copied keyframe and one that is not
            beginning.tracked_frames.append(replace(tracked, keyframe=last - tracked.keyframe))
    first = local_map.keyframes[0]
    known = local_map.tracks.has_point[first.ids]
    tracks = CornerTracks()
    tracks.ids = first.ids[known].copy()
    tracks.now = tracks.reference_pixels = first.pixels[known].astype(np.float32)
    tracks.found = np.ones(len(tracks.ids), dtype=bool)
    tracks.count = len(local_map.tracks)
    return beginning, tracks
