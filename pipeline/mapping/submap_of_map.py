"""Conversion of a finished `LocalMap` to the `Submap` that every front end returns, and of a submap to such a map."""

import numpy as np
from numpy.typing import NDArray

from haustra.core.ray_table import RayTable
from haustra.core.se3 import Array, compose, inverse
from pipeline.mapping.local_map import LocalMap, TrackKind
from pipeline.mapping.map_adjustment import LOSS_PX, MAX_ERROR_PX
from pipeline.mapping.submap import MIN_FRAMES, Submap
from pipeline.optimization.bundle_adjustment import reprojections
from pipeline.optimization.resection import refine_poses

MIN_SEEN = 8  # points that a frame must see to be called posed
CHUNK = 500  # frames refined at once


def submaps_of(
    maps: list[LocalMap], params: tuple[float, ...], sigma: tuple[float, ...] = (), kind: TrackKind | None = None
) -> list[Submap]:
    """Submaps of the maps that are long enough, most frames first; kind: see `to_submap`."""
    found = [to_submap(local_map, params, sigma, kind) for local_map in maps]
    kept = [submap for submap in found if submap is not None and len(submap.frames) >= MIN_FRAMES]
    return sorted(kept, key=lambda submap: -len(submap.frames))


def to_submap(
    local_map: LocalMap,
    camera_params: tuple[float, ...],
    camera_sigma: tuple[float, ...] = (),
    kind: TrackKind | None = None,
    refit: bool = True,
) -> Submap | None:
    """The submap; None if no frame sees enough. kind: of keyframes and tracks of this kind alone. refit: fit the poses
    once more to the points; False: they stay as they are."""
    frames, cameras_from_world, counts, ids, pixels = _gather(local_map, kind)
    row = np.repeat(np.arange(len(frames)), counts)
    cameras_from_world, error = _refine(local_map, cameras_from_world, row, ids, pixels, refit)
    good = error < MAX_ERROR_PX
    while True:  # frames with too few points, and points with too few frames, until neither is left
        views = np.bincount(ids[good], minlength=len(local_map.tracks))
        seen = np.bincount(row[good], minlength=len(frames))
        kept = good & (views[ids] >= 2) & (seen[row] >= MIN_SEEN)
        if (kept == good).all():
            break
        good = kept
    if not good.any():
        return None
    tracks, point = np.unique(ids[good], return_inverse=True)
    used, frame = np.unique(row[good], return_inverse=True)
    summed = np.bincount(point, error[good], minlength=len(tracks))
    return Submap(
        frames[used],
        np.stack([inverse(cameras_from_world[k]) for k in used]),
        np.asarray(local_map.tracks.points[tracks], np.float64),
        summed / np.bincount(point, minlength=len(tracks)),
        np.stack([frame, point], axis=1),
        pixels[good].astype(np.float64),
        camera_params,
        camera_sigma,
        local_map.tracks.kind[tracks] == TrackKind.KLT,
    )


def map_of_submap(submap: Submap, rays: RayTable, rows: NDArray[np.int64] | None = None) -> LocalMap:
    """A map whose keyframes are the submap's frames, or those at `rows`, and its tracks all points; rays: of its
    refined camera."""
    local_map = LocalMap(rays)
    ids = local_map.insert_tracks(submap.points, TrackKind.FEATURE)
    local_map.tracks.kind[ids[submap.is_klt]] = TrackKind.KLT
    order, starts = submap.by_frame()
    for row in (np.arange(len(submap.frames)) if rows is None else rows).tolist():
        mine = order[starts[row] : starts[row + 1]]
        seen, pixels = ids[submap.observations[mine, 1]], submap.pixels[mine]
        local_map.add_keyframe(int(submap.frames[row]), inverse(submap.world_from_camera[row]), seen, pixels)
    return local_map


def _gather(
    local_map: LocalMap, kind: TrackKind | None
) -> tuple[NDArray[np.int64], Array, NDArray[np.int64], NDArray[np.int64], NDArray]:
    """Frames ascending, their poses (N,4,4), numbers of observations, then all observations: track, pixels."""
    found: dict[int, tuple[Array, NDArray, NDArray]] = {}
    usable = local_map.tracks.has_point if kind is None else local_map.tracks.has_point & local_map.tracks.is_kind(kind)
    for tracked in local_map.tracked_frames if kind is None else ():
        found[tracked.frame] = (local_map.camera_from_world_of(tracked), tracked.ids, tracked.pixels)
    for keyframe in local_map.keyframes:
        found[keyframe.frame] = (keyframe.camera_from_world, keyframe.ids, keyframe.pixels)
    frames = np.array(sorted(found), dtype=np.int64)
    masks = [usable[found[f][1]] for f in frames]
    return (
        frames,
        np.stack([found[f][0] for f in frames]),
        np.array([int(m.sum()) for m in masks]),
        np.concatenate([found[f][1][m] for f, m in zip(frames, masks, strict=True)]).astype(np.int64),
        np.concatenate([found[f][2][m] for f, m in zip(frames, masks, strict=True)]),
    )


def _refine(
    local_map: LocalMap,
    cameras_from_world: Array,
    row: NDArray[np.int64],
    ids: NDArray[np.int64],
    pixels: NDArray,
    refit: bool,
) -> tuple[Array, Array]:
    """All poses fitted once more to the final points, unless they stay, and the error of each observation in pixels."""
    cameras_from_world, errors = cameras_from_world.copy(), np.zeros(len(ids))
    for first in range(0, len(cameras_from_world), CHUNK):
        part = slice(*np.searchsorted(row, [first, first + CHUNK]))
        block = cameras_from_world[first : first + CHUNK]
        xy, jacobian = local_map.rays.unproject(pixels[part])
        points, mine = local_map.tracks.points[ids[part]], row[part] - first
        rotation, shift = block[:, :3, :3], block[:, :3, 3]
        if refit:
            rotation, shift = refine_poses(rotation, shift, mine, points, xy, jacobian, LOSS_PX)
        cameras_from_world[first : first + CHUNK] = [compose(r, t) for r, t in zip(rotation, shift, strict=True)]
        local = np.einsum("mij,mj->mi", rotation[mine], points) + shift[mine]
        off = np.linalg.norm(reprojections(local, xy, jacobian), axis=1)
        errors[part] = np.where(local[:, 2] > 1e-9, off, np.inf)
    return cameras_from_world, errors
