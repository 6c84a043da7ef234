"""Local maps on disk as plain arrays: the result of a chunk's process, and the start of a resumed run."""

from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from haustra.core.ray_table import RayTable
from pipeline.mapping.local_map import LocalMap, TrackedFrame


def save_maps(maps: list[LocalMap], path: Path) -> None:
    """One .npz; it is whole or not there. Maps that were adjusted to features cannot be told apart from others."""
    arrays: dict[str, NDArray] = {"count": np.array(len(maps))}
    for number, local_map in enumerate(maps):
        arrays |= {f"{number}/{name}": array for name, array in _arrays(local_map).items()}
    begun = path.with_suffix(".part.npz")
    np.savez(begun, allow_pickle=False, **arrays)
    begun.replace(path)


def load_maps(path: Path, rays: RayTable) -> list[LocalMap]:
    """What `save_maps` wrote; raises what `numpy.load` does where it is damaged."""
    with np.load(path, allow_pickle=False) as arrays:
        return [_map(arrays, f"{number}/", rays) for number in range(int(arrays["count"]))]


def _arrays(local_map: LocalMap) -> dict[str, NDArray]:
    keyframes, posed = local_map.keyframes, local_map.tracked_frames
    highest = [int(k.ids.max(initial=-1)) for k in keyframes] + [int(p.ids.max(initial=-1)) for p in posed]
    used = 1 + max(highest, default=-1)
    return {
        "points": local_map.tracks.points[:used],
        "known": local_map.tracks.has_point[:used],
        "barred": local_map.tracks.rejected[:used],
        "keyframe_frames": np.array([k.frame for k in keyframes], np.int64),
        "keyframe_poses": np.array([k.camera_from_world for k in keyframes]).reshape(-1, 4, 4),
        "keyframe_counts": np.array([len(k.ids) for k in keyframes], np.int64),
        "keyframe_ids": np.concatenate([np.zeros(0, np.int64), *(k.ids for k in keyframes)]),
        "keyframe_pixels": np.concatenate([np.zeros((0, 2)), *(k.pixels for k in keyframes)]),
        "posed_frames": np.array([p.frame for p in posed], np.int64),
        "posed_keyframes": np.array([p.keyframe for p in posed], np.int64),
        "posed_poses": np.array([p.camera_from_keyframe for p in posed]).reshape(-1, 4, 4),
        "posed_counts": np.array([len(p.ids) for p in posed], np.int64),
        "posed_ids": np.concatenate([np.zeros(0, np.int32), *(p.ids for p in posed)]),
        "posed_pixels": np.concatenate([np.zeros((0, 2), np.float32), *(p.pixels for p in posed)]),
    }


def _map(arrays: np.lib.npyio.NpzFile, prefix: str, rays: RayTable) -> LocalMap:
    read = {name.removeprefix(prefix): arrays[name] for name in arrays.files if name.startswith(prefix)}
    result = LocalMap(rays)
    used = len(read["known"])
    result.tracks.reserve(used)
    for name, key in (("points", "points"), ("has_point", "known"), ("rejected", "barred")):  # keys since 0.1
        getattr(result.tracks, name)[:used] = read[key]
    for frame, camera_from_world, ids, pixels in zip(
        read["keyframe_frames"].tolist(),
        read["keyframe_poses"],
        *_parts(read["keyframe_counts"], read["keyframe_ids"], read["keyframe_pixels"]),
        strict=True,
    ):
        result.add_keyframe(frame, camera_from_world, ids, pixels)
    for frame, keyframe, camera_from_keyframe, ids, pixels in zip(
        read["posed_frames"].tolist(),
        read["posed_keyframes"].tolist(),
        read["posed_poses"],
        *_parts(read["posed_counts"], read["posed_ids"], read["posed_pixels"]),
        strict=True,
    ):
        result.tracked_frames.append(TrackedFrame(frame, keyframe, camera_from_keyframe, ids, pixels))
    return result


def _parts(counts: NDArray[np.int64], *joined: NDArray) -> list[list[NDArray]]:
    """Arrays (N,...) cut into pieces of so many rows."""
    starts = np.concatenate([[0], np.cumsum(counts)]).tolist()
    return [[array[begin:end] for begin, end in pairwise(starts)] for array in joined]
