"""The sparse points that a keyframe's depth is completed from: the map's, and a sensor's, each with its own error."""

from collections.abc import Callable

import numpy as np

from haustra.core.progress import Progress
from pipeline.depth.completed_submap import CompletedSubmap
from pipeline.depth.sensor.gathered_points import SensedFilm
from pipeline.depth.sensor.sensor_points import sensor_points
from pipeline.depth.sensor.sensor_scale import sensor_scale
from pipeline.depth.sparse_depth import OUTLIER_RATIO, SparseDepth, SparseDepthMaker, is_outlier
from pipeline.input.frames import Frames
from pipeline.input.sensor.sensor_depth import SensorDepth
from pipeline.mapping.submap import refined_camera

NOTHING = SparseDepth(np.zeros((0, 2)), np.zeros(0), np.zeros(0))


def points_of(
    completed: CompletedSubmap, frames: Frames, sensor: SensorDepth | None, progress: Progress
) -> Callable[[int], SparseDepth]:
    """Points of a frame by its row in the submap. HaustraError where the sensor contradicts the map."""
    maker = SparseDepthMaker(completed.submap, completed.camera)
    scale = None if sensor is None else sensor_scale(completed.submap, sensor)
    if sensor is None or scale is None:
        if sensor is not None:
            progress.log("the sensor saw too few of the map's points: its depth is left out")
        return maker.sparse_depth
    progress.log(str(scale))
    if sensor.settings.points == "none":
        return maker.sparse_depth
    lens = refined_camera(frames.camera, completed.submap)
    film = SensedFilm(completed.submap, sensor, lens, completed.camera, scale.mm_per_unit)

    def joined(row: int) -> SparseDepth:
        points = film.gathered(row) if sensor.settings.points == "gathered" else NOTHING
        if len(points.depth) == 0:
            frame = int(completed.submap.frames[row])
            points = sensor_points(sensor, frame, lens, completed.camera, scale.mm_per_unit)
        return join(maker.sparse_depth(row), points)

    return joined


def join(first: SparseDepth, second: SparseDepth) -> SparseDepth:
    """Both, without those that the company of all contradicts."""
    pixels, depth, error = (
        np.concatenate(pair)
        for pair in ((first.pixels, second.pixels), (first.depth, second.depth), (first.error, second.error))
    )
    kept = ~is_outlier(pixels, depth, OUTLIER_RATIO)
    return SparseDepth(pixels[kept], depth[kept], error[kept])
