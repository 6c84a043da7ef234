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
MIXED = 0.15  # standard deviation of a block's depths, of their mean: above it an edge lies in the block


def clouds_of(sensor: SensorDepth, rays: RayTable) -> Clouds:
    """A point for each block of the sensor's cells, the mean of those that measured: a block's noise is that of a cell
    over the root of their number, and cells left out would help nobody. None for a frame of which the sensor saw too
    little."""

    def cloud(frame: int) -> Array | None:
        found = sensor.image(frame)
        if found is None:
            return None
        depth, pixels = _blocks(found[0])
        pixels = sensor.working_pixels(pixels / np.array(found[0].shape[::-1]))
        near = (depth < FARTHEST_MM) & (pixels >= 0).all(axis=1)
        near &= (pixels < [rays.camera.width, rays.camera.height]).all(axis=1)
        pixels, depth = pixels[near], depth[near]
        if len(depth) < FEWEST_POINTS:
            return None
        return np.asarray(np.column_stack([rays.unproject(pixels)[0], np.ones(len(depth))]) * depth[:, None])

    return cloud


def _blocks(depth: Array) -> tuple[Array, Array]:
    """Mean depth (K,) of square blocks of cells between which no edge lies, of an image (h,w), 0 = none; and the mean
    place (K,2) of the cells that have depth, x and y, in cells. The smallest blocks that are at most MOST_POINTS."""
    row, column = np.nonzero(depth)
    values = depth[row, column]
    edge = max(1, int(np.sqrt(len(values) / MOST_POINTS)))
    while True:
        number = row // edge * depth.shape[1] + column // edge
        _, block, count = np.unique(number, return_inverse=True, return_counts=True)
        if len(count) <= MOST_POINTS:
            break
        edge += 1
    mean, x, y = (np.bincount(block, of) / count for of in (values, column + 0.5, row + 0.5))
    spread = np.sqrt(np.bincount(block, (values - mean[block]) ** 2) / count)
    whole = spread < MIXED * mean
    return mean[whole], np.stack([x, y], axis=1)[whole]


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
