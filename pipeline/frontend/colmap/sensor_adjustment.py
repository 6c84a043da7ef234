"""COLMAP's models in millimetres: adjusted once more, with a sensor's depth at their observations.

COLMAP knows nothing of depth. For a stereo film the depth is what the right eye saw, so that the rig's baseline holds
the scale along the whole path (`depth_residuals`), as it does in odometry.
"""

from haustra.core.camera import Camera
from haustra.core.progress import Progress
from haustra.core.ray_table import ray_table
from pipeline.frontend.base import FoundSubmap
from pipeline.input.sensor.sensor_depth import SensorDepth
from pipeline.mapping.map_adjustment import adjust_all
from pipeline.mapping.metric_map import make_metric
from pipeline.mapping.submap import Submap, refined_camera
from pipeline.mapping.submap_of_map import map_of_submap, to_submap

LEAST_KEPT = 0.9  # of a model's frames; an adjustment that loses more has not fitted


def adjusted_to_sensor(
    found: list[FoundSubmap], camera: Camera, sensor: SensorDepth, progress: Progress
) -> list[FoundSubmap]:
    """Each model in mm and adjusted; those of which the sensor saw too little, or that it does not fit, stay."""
    with progress.bar("adjusting to depth", len(found)) as advance:
        adjusted = []
        for number, one in enumerate(found, start=1):
            metric = metric_submap(one.submap, camera, sensor)
            adjusted.append(one if metric is None else FoundSubmap(metric))
            advance(number)
    left = sum(before is after for before, after in zip(found, adjusted, strict=True))
    if left:
        progress.log(
            f"{left} of {len(found)} models are not adjusted by the sensor: it saw too few of their points, or frames "
            "would have been lost"
        )
    return adjusted


def metric_submap(submap: Submap, camera: Camera, sensor: SensorDepth) -> Submap | None:
    """The submap in mm, all its frames and points adjusted to its pixels and the sensor's depth; None where the sensor
    saw too few of its points, or frames are lost."""
    local_map = map_of_submap(submap, ray_table(refined_camera(camera, submap)))
    if make_metric(local_map, sensor.for_adjustment) is None:
        return None
    adjust_all(local_map)
    metric = to_submap(local_map, submap.camera_params, submap.camera_sigma, refit=False)
    if metric is None or len(metric.frames) < LEAST_KEPT * len(submap.frames):
        return None
    return metric
