"""Clouds of a depth sensor's frames: one frame's, and those of frames around one of known pose put together."""

from collections.abc import Callable

import numpy as np

from haustra.core.ray_table import RayTable
from haustra.core.se3 import Array, in_camera, inverse
from pipeline.input.sensor.sensor_depth import SensorDepth

Clouds = Callable[[int], Array | None]  # (N,3) of a frame, mm, in the camera's axes
REACH, STEP = 40, 4  # frames on one side of a frame that are taken together, and how far apart
MOST_POINTS, FARTHEST_MM = 1500, 80.0  # of a cloud
FEWEST_POINTS = 200


def clouds_of(sensor: SensorDepth, rays: RayTable) -> Clouds:
    """Thinned evenly; None for a frame of which the sensor saw too little."""

    def cloud(frame: int) -> Array | None:
        found = sensor.cells(frame)
        if found is None:
            return None
        pixels, depth, _ = found
        near = (depth < FARTHEST_MM) & (pixels >= 0).all(axis=1)
        near &= (pixels < [rays.camera.width, rays.camera.height]).all(axis=1)
        step = max(1, int(near.sum()) // MOST_POINTS)
        pixels, depth = pixels[near][::step], depth[near][::step]
        if len(depth) < FEWEST_POINTS:
            return None
        return np.asarray(np.column_stack([rays.unproject(pixels)[0], np.ones(len(depth))]) * depth[:, None])

    return cloud


def joint_cloud(
    world_from_camera: dict[int, Array], frame: int, direction: int, clouds: Clouds, least: int = 0
) -> Array | None:
    """Clouds (N,3) of a frame and those up to `REACH` after or before it, one in `STEP`, in the frame's axes."""
    others = [frame + direction * step for step in range(least, REACH + 1, STEP)]
    seen = [
        in_camera(inverse(world_from_camera[frame]) @ world_from_camera[other], cloud)
        for other in others
        if other in world_from_camera and (cloud := clouds(other)) is not None
    ]
    return np.concatenate(seen) if seen else None
