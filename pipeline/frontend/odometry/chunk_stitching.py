"""Stitching of consecutive chunks: the similarity of two maps from the frames that both posed.

No appearance is compared: a frame that both posed is the same picture. Each such frame says where one world lies in the
other, its scale by the depths of both maps along the same rays, so that a camera at rest does as well as a moving one.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from haustra.core.se3 import Array, in_camera, inverse
from haustra.core.sim3 import transform_camera, transform_points
from pipeline.mapping.local_map import LocalMap
from pipeline.matching.depth_interpolation import delaunay, interpolate_inverse_depth
from pipeline.matching.keyframe_features import MIN_FEATURES

MIN_SHARED = 10  # frames
MIN_AGREEING = 0.8  # of them
MAX_SPREAD = 0.1  # of a frame's scale, in log, from what is typical of them;
MAX_TURN = np.radians(1.5)  # of its rotation;
MAX_SHIFT = 0.05  # and of its place, in its own median depths


@dataclass(frozen=True)
class FrameObservation:
    """A frame in a map: camera_from_world (4,4), tracks (N,), pixels (N,2), and whether it is a keyframe there."""

    camera_from_world: Array
    ids: NDArray[np.int64]
    pixels: Array
    key: bool


def frame_observations(local_map: LocalMap) -> dict[int, FrameObservation]:
    """All frames of a map by their number."""
    found = {
        p.frame: FrameObservation(
            local_map.camera_from_world_of(p), p.ids.astype(np.int64), p.pixels.astype(np.float64), False
        )
        for p in local_map.tracked_frames
    }
    return found | {k.frame: FrameObservation(k.camera_from_world, k.ids, k.pixels, True) for k in local_map.keyframes}


def first_from_second(first: LocalMap, second: LocalMap) -> Array | None:
    """Similarity (4,4) of the two worlds by the frames that both posed; None if these are few or do not agree."""
    here, there = frame_observations(first), frame_observations(second)
    measured = {f: _scale(first, here[f], second, there[f]) for f in sorted(here.keys() & there.keys())}
    found = {f: scale_and_depth for f, scale_and_depth in measured.items() if scale_and_depth is not None}
    if len(found) < MIN_SHARED:
        return None
    shared, (logs, depth) = list(found), np.log(np.array(list(found.values()))).T
    cameras_from_world = [np.stack([of[f].camera_from_world for f in shared]) for of in (here, there)]
    turns = Rotation.from_matrix(np.swapaxes(cameras_from_world[0][:, :3, :3], 1, 2) @ cameras_from_world[1][:, :3, :3])
    centres = [np.stack([inverse(camera_from_world)[:3, 3] for camera_from_world in of]) for of in cameras_from_world]
    typical = turns[int(np.median([(turn.inv() * turns).magnitude() for turn in turns], axis=1).argmin())]
    scale = float(np.exp(np.median(logs)))
    shifts = centres[0] - scale * typical.apply(centres[1])
    off = np.linalg.norm(shifts - np.median(shifts, axis=0), axis=1) / np.exp(depth)
    turned = (typical.inv() * turns).magnitude()
    agree = (np.abs(logs - np.median(logs)) < MAX_SPREAD) & (turned < MAX_TURN) & (off < MAX_SHIFT)
    if agree.sum() < max(MIN_SHARED, MIN_AGREEING * len(shared)):
        return None
    scale, turn = float(np.exp(logs[agree].mean())), turns[agree].mean()
    similarity = np.eye(4)
    similarity[:3, :3] = scale * turn.as_matrix()
    similarity[:3, 3] = (centres[0] - scale * turn.apply(centres[1]))[agree].mean(axis=0)
    return similarity


def _scale(
    first: LocalMap, here: FrameObservation, second: LocalMap, there: FrameObservation
) -> tuple[float, float] | None:
    """Depth in the first map over depth in the second, along the rays of the second's points in a shared frame; and the
    frame's median depth in the first."""
    seen = []
    for local_map, observation in ((first, here), (second, there)):
        known = local_map.tracks.has_point[observation.ids]
        depth = in_camera(observation.camera_from_world, local_map.tracks.points[observation.ids[known]])[:, 2]
        seen.append((observation.pixels[known][depth > 0], depth[depth > 0]))
    if min(len(depth) for _, depth in seen) < MIN_FEATURES:
        return None
    (pixels, depth), (others, theirs) = seen
    ratio = 1 / (interpolate_inverse_depth(others, delaunay(pixels), depth) * theirs)
    good = np.isfinite(ratio) & (ratio > 0)
    return (float(np.median(ratio[good])), float(np.median(depth))) if good.sum() >= MIN_FEATURES else None


def stitch(first: LocalMap, second: LocalMap, first_from_second: Array, common_tracks: int = 0) -> LocalMap:
    """One map in the first one's world, frames in order. What either saw in a frame is seen in it; up to the middle of
    the shared frames poses are the first one's, from there on the second's. Neither map may have features.

    Tracks numbered below `common_tracks` are the same in both maps: their points, and in shared frames their pixels,
    are the second map's.
    """
    here, there = frame_observations(first), frame_observations(second)
    middle = np.median(sorted(here.keys() & there.keys()) or [max(here)])
    offset = 1 + max(int(s.ids.max(initial=-1)) for s in here.values())
    result = LocalMap(first.rays)
    result.tracks.place(0, first.tracks)
    result.tracks.has_point[:common_tracks] = False
    moved = transform_points(first_from_second, second.tracks.points)
    result.tracks.place(offset, replace(second.tracks, points=moved))
    for frame in sorted(here.keys() | there.keys()):
        mine, theirs = here.get(frame), there.get(frame)
        parts = [(theirs.ids + offset, theirs.pixels)] if theirs is not None else []
        if mine is not None:
            is_common = mine.ids < common_tracks
            own = ~is_common | (theirs is None)
            parts.insert(0, (np.where(is_common, mine.ids + offset, mine.ids)[own], mine.pixels[own]))
        ids, pixels = (np.concatenate(of) for of in zip(*parts, strict=True))
        if mine is not None and (theirs is None or frame < middle):
            camera_from_world = mine.camera_from_world
        else:
            assert theirs is not None
            camera_from_world = transform_camera(first_from_second, theirs.camera_from_world)
        if not result.keyframes or any(s is not None and s.key for s in (mine, theirs)):
            result.add_keyframe(frame, camera_from_world, ids, pixels)
        else:
            result.add_tracked_frame(frame, camera_from_world, ids, pixels)
    return result


def without_stubs(maps: list[LocalMap]) -> list[LocalMap]:
    """Those that pose a frame which no larger one does."""
    kept: list[LocalMap] = []
    claimed: set[int] = set()
    for local_map in sorted(maps, key=lambda m: -len(m.frames)):
        if not local_map.frames <= claimed:
            kept.append(local_map)
            claimed |= local_map.frames
    return [local_map for local_map in maps if any(local_map is k for k in kept)]
