"""A map made metric by a sensor's depth: brought to millimetres, and from then on adjusted with what the sensor
measured at its observations."""

import numpy as np
from numpy.typing import NDArray

from haustra.core.progress import Progress
from haustra.core.se3 import Array, in_camera
from pipeline.input.sensor.along_ray import FEWEST, doubt_of_axis
from pipeline.mapping.local_map import DepthAt, Keyframe, LocalMap
from pipeline.optimization.depth_residuals import MeasuredDepth

LEAST_ERROR = 0.003  # share of the depth; a cell of a sensor covers some wall, whatever it says of its noise


def make_all_metric(maps: list[LocalMap], depth_at: DepthAt, progress: Progress) -> None:
    """Maps that a sensor saw enough of in millimetres, to be adjusted with what it measured."""
    scales = [make_metric(local_map, depth_at) for local_map in maps if local_map.depth_at is None]
    if None in scales:
        progress.log(f"the sensor saw too few points of {scales.count(None)} of {len(maps)} maps to adjust them by it")


def make_metric(local_map: LocalMap, depth_at: DepthAt) -> float | None:
    """Bring the map to millimetres by the median ratio of its observations' depths, and let its adjustments see them;
    None, and nothing done, where too few have one. Returns mm per former unit."""
    scale = metric_scale(local_map, depth_at)
    if scale is not None:
        local_map.rescale(scale)
        local_map.depth_at = depth_at
    return scale


def metric_scale(local_map: LocalMap, depth_at: DepthAt, frames: list[int] | None = None) -> float | None:
    """mm per unit of the map; None where too few observations have a depth. frames: of the keyframes that are asked;
    None: all."""
    log_ratio, _, _ = _log_ratios(local_map, depth_at, frames)
    return float(np.exp(np.median(log_ratio))) if len(log_ratio) >= FEWEST else None


def doubt_of_axis_by(maps: list[LocalMap], depth_at: DepthAt) -> str:
    """A sentence where a sensor seems to give distances along the rays, by maps that were not yet adjusted by it."""
    found = [_log_ratios(local_map, depth_at, None) for local_map in maps]
    return doubt_of_axis(*(np.concatenate(parts) for parts in zip(*found, strict=True))) if found else ""


def _log_ratios(
    local_map: LocalMap, depth_at: DepthAt, frames: list[int] | None
) -> tuple[Array, Array, NDArray[np.int64]]:
    """Of observations (K,) with a depth: log of mm per unit, log of distance over depth in the map, and frame."""
    ratios, slants, numbers = [np.zeros(0)], [np.zeros(0)], [np.zeros(0, np.int64)]
    for keyframe in local_map.keyframes:
        if frames is not None and keyframe.frame not in frames:
            continue
        points, pixels = local_map.visible_points(keyframe)
        away, measured = (
            in_camera(keyframe.camera_from_world, points),
            depth_at(keyframe.frame, pixels.astype(np.float64))[0],
        )
        known = (away[:, 2] > 0) & (measured > 0)
        ratios.append(np.log(measured[known] / away[known, 2]))
        slants.append(np.log(np.linalg.norm(away[known], axis=1) / away[known, 2]))
        numbers.append(np.full(int(known.sum()), keyframe.frame))
    return np.concatenate(ratios), np.concatenate(slants), np.concatenate(numbers)


def measured_depth(depth_at: DepthAt, keyframes: list[Keyframe], masks: list[NDArray[np.bool_]]) -> MeasuredDepth:
    """What the sensor says of the observations that `masks` (N,) choose of each keyframe, in their order, mm."""
    seen = [(k.frame, k.pixels[mask].astype(np.float64)) for k, mask in zip(keyframes, masks, strict=True)]
    found = [depth_at(frame, pixels) for frame, pixels in seen]
    depth = np.concatenate([one for one, _ in found]).astype(np.float64)
    sigma = np.concatenate([one for _, one in found]).astype(np.float64)
    known = np.flatnonzero(depth > 0)
    return MeasuredDepth(known, depth[known], np.maximum(sigma[known] / depth[known], LEAST_ERROR))
